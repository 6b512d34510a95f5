//! Walks through the streets of a flat town.

use std::f64::consts::PI;

use nalgebra::{Isometry2, Translation2};

use crate::World;
use crate::builder::{Builder, Closures};
use crate::error::{WorldError, check_at_least, check_poses, check_probability, check_sigmas};
use crate::landmarks::{Field, Landmarks};
use crate::noise::{Purpose, Stream};
use crate::pose::quarter_turns;

/// Of the turns at a corner, so many are turns back; the others go left or right alike.
const BACK: f64 = 0.1;

/// A random walk through a square town, one meter a step.
///
/// Streets run along both axes, [`block`](Self::block) meters apart. At a corner the robot goes on
/// or turns; a turn and the step after it are one motion, as in M3500. It starts in the middle at
/// the identity and never leaves the town.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Grid {
    /// How many poses, at least 2.
    pub poses: u32,
    /// Names the world; see the crate page.
    pub seed: u64,
    /// From one street to the next (m), at least 1.
    pub block: u32,
    /// From the middle of the town to each of its sides, in blocks, at least 1. The smaller the
    /// town, the more often a place is visited.
    pub blocks: u32,
    /// How likely the robot turns at a corner.
    pub turn: f64,
    /// Standard deviations of the odometry (m, m, rad).
    pub odometry: [f64; 3],
    /// When earlier poses are recognized.
    pub closures: Closures<3>,
    /// Landmarks, if any.
    pub landmarks: Option<Landmarks>,
}

impl Grid {
    /// The kind of world that Olson's M3500 is: short blocks, closures with any heading, 0.022 m and
    /// rad of noise. 0.6 closures a pose at 10⁴ poses; 0.8 at 10⁶, where walks cross more often.
    #[must_use]
    pub fn manhattan(poses: u32, seed: u64) -> Self {
        let sigmas = [1.0 / 2000.0_f64.sqrt(); 3];
        Self {
            poses,
            seed,
            block: 4,
            blocks: blocks(poses, 4, 0.42),
            turn: 0.5,
            odometry: sigmas,
            closures: Closures {
                probability: 0.06,
                radius: 2.0,
                per_pose: 3,
                gap: 10,
                turn: PI,
                sigmas,
            },
            landmarks: None,
        }
    }

    /// The kind of world that city10000 is: longer streets, 0.02 m and 0.01 rad of noise. 1.1
    /// closures a pose at 10⁴ poses; 1.6 at 10⁶.
    #[must_use]
    pub fn city(poses: u32, seed: u64) -> Self {
        let sigmas = [0.02, 0.02, 0.01];
        Self {
            poses,
            seed,
            block: 10,
            blocks: blocks(poses, 10, 0.5),
            turn: 0.5,
            odometry: sigmas,
            closures: Closures {
                probability: 0.08,
                radius: 2.0,
                per_pose: 6,
                gap: 10,
                turn: PI,
                sigmas,
            },
            landmarks: None,
        }
    }

    /// Sets [`poses`](Self::poses).
    #[must_use]
    pub const fn with_poses(mut self, poses: u32) -> Self {
        self.poses = poses;
        self
    }

    /// Sets [`seed`](Self::seed).
    #[must_use]
    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets [`block`](Self::block).
    #[must_use]
    pub const fn with_block(mut self, block: u32) -> Self {
        self.block = block;
        self
    }

    /// Sets [`blocks`](Self::blocks).
    #[must_use]
    pub const fn with_blocks(mut self, blocks: u32) -> Self {
        self.blocks = blocks;
        self
    }

    /// Sets [`turn`](Self::turn).
    #[must_use]
    pub const fn with_turn(mut self, turn: f64) -> Self {
        self.turn = turn;
        self
    }

    /// Sets [`odometry`](Self::odometry).
    #[must_use]
    pub const fn with_odometry(mut self, odometry: [f64; 3]) -> Self {
        self.odometry = odometry;
        self
    }

    /// Sets [`closures`](Self::closures).
    #[must_use]
    pub const fn with_closures(mut self, closures: Closures<3>) -> Self {
        self.closures = closures;
        self
    }

    /// Sets [`landmarks`](Self::landmarks).
    #[must_use]
    pub const fn with_landmarks(mut self, landmarks: Option<Landmarks>) -> Self {
        self.landmarks = landmarks;
        self
    }

    /// Makes the world.
    ///
    /// # Errors
    /// [`WorldError`] when a parameter is out of its range.
    pub fn generate(&self) -> Result<World, WorldError> {
        let side = self.check()?;
        let mut field = match &self.landmarks {
            Some(landmarks) => {
                let count = landmarks.count(side, self.poses)?;
                Some(Field::new(landmarks, count, side, self.seed))
            }
            None => None,
        };
        let truth = self.walk();
        let mut builder = Builder::new(&truth, &self.odometry, &self.closures, self.seed);
        for _ in 0..truth.len() {
            let index = builder.step();
            if let Some(field) = &mut field {
                field.observe(index, &mut builder);
            }
        }
        builder.finish(&field.map_or_else(Vec::new, Field::into_seen))
    }

    /// Checks the parameters and returns the length of the town's side.
    fn check(&self) -> Result<f64, WorldError> {
        check_poses(self.poses)?;
        check_at_least("block", self.block.into(), 1.0)?;
        check_at_least("blocks", self.blocks.into(), 1.0)?;
        check_probability("turn", self.turn)?;
        check_sigmas("odometry", &self.odometry)?;
        self.closures.check()?;
        Ok(2.0 * f64::from(self.block) * f64::from(self.blocks))
    }

    fn walk(&self) -> Vec<Isometry2<f64>> {
        let mut stream = Stream::new(self.seed, Purpose::Walk);
        let block = i64::from(self.block);
        let half = block * i64::from(self.blocks);
        let inside = |[x, y]: [i64; 2]| x.abs() <= half && y.abs() <= half;
        let (mut at, mut heading) = ([0_i64, 0], 0);
        let mut poses = Vec::with_capacity(self.poses as usize);
        loop {
            let translation = Translation2::new(at[0] as f64, at[1] as f64);
            poses.push(Isometry2::from_parts(translation, quarter_turns(heading)));
            if poses.len() == self.poses as usize {
                return poses;
            }
            if at.iter().all(|coordinate| coordinate % block == 0) {
                // The town has two ways on at each of its corners, so this ends.
                heading = loop {
                    let turned = (heading + self.choose_turn(&mut stream)) % 4;
                    if inside(ahead(at, turned)) {
                        break turned;
                    }
                };
            }
            at = ahead(at, heading);
        }
    }

    /// A turn at a corner, in quarter turns to the left.
    fn choose_turn(&self, stream: &mut Stream) -> u32 {
        if !stream.chance(self.turn) {
            0
        } else if stream.chance(BACK) {
            2
        } else {
            1 + 2 * u32::from(stream.chance(0.5))
        }
    }
}

/// One step from `at` along `heading`.
fn ahead([x, y]: [i64; 2], heading: u32) -> [i64; 2] {
    match heading {
        0 => [x + 1, y],
        1 => [x, y + 1],
        2 => [x - 1, y],
        _ => [x, y - 1],
    }
}

/// A town whose half side is `ratio * sqrt(poses)` meters, so that places are visited about as often
/// in worlds of any size.
fn blocks(poses: u32, block: u32, ratio: f64) -> u32 {
    ((ratio * f64::from(poses).sqrt() / f64::from(block)).round() as u32).max(1)
}
