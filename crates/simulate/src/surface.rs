//! Spirals over curved surfaces.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::World;
use crate::builder::{Builder, Closures};
use crate::error::{WorldError, check_at_least, check_poses, check_positive, check_sigmas};
use crate::pose::{about_y, about_z};

/// The surface of a [`Surface`] world, centered at the origin with its axis along z.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Shape {
    /// The robot winds around the axis from one pole to the other.
    Sphere {
        /// Radius (m).
        radius: f64,
    },
    /// The robot winds around the tube, once around the axis.
    Torus {
        /// From the axis to the middle of the tube (m).
        major: f64,
        /// Radius of the tube (m).
        minor: f64,
    },
}

/// A spiral over a closed surface; x points along the rings, z out of the surface.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Surface {
    /// How many poses, at least 2.
    pub poses: u32,
    /// Names the world; see the crate page.
    pub seed: u64,
    /// The surface.
    pub shape: Shape,
    /// How many poses go once around, at least 3.
    pub ring: u32,
    /// Standard deviations of the odometry (m, m, m, rad, rad, rad).
    pub odometry: [f64; 6],
    /// When earlier poses are recognized.
    pub closures: Closures<6>,
}

impl Surface {
    /// The kind of world that sphere2500 is: as many rings as there are poses in one, 1 m from pose
    /// to pose at the equator, one closure a pose, with the ring below.
    #[must_use]
    pub fn sphere(poses: u32, seed: u64) -> Self {
        let ring = ring(poses, 1.0);
        let radius = f64::from(ring) / (2.0 * PI);
        let spacing = PI * radius * f64::from(ring) / f64::from(poses.max(1));
        Self::new(
            poses,
            seed,
            Shape::Sphere { radius },
            ring,
            spacing,
            [0.1, 0.1, 0.1, 0.01, 0.01, 0.04],
        )
    }

    /// A torus with the kind of motion and noise that the torus data sets have: 1 m from pose to
    /// pose, one closure a pose, with the ring before.
    #[must_use]
    pub fn torus(poses: u32, seed: u64) -> Self {
        let ring = ring(poses, 0.5);
        let minor = f64::from(ring) / (2.0 * PI);
        let major = 2.0 * minor;
        let spacing = 2.0 * PI * (major + minor) * f64::from(ring) / f64::from(poses.max(1));
        let sigmas = [0.05, 0.05, 0.01, 0.005, 0.005, 0.01];
        Self::new(poses, seed, Shape::Torus { major, minor }, ring, spacing, sigmas)
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

    /// Sets [`shape`](Self::shape).
    #[must_use]
    pub const fn with_shape(mut self, shape: Shape) -> Self {
        self.shape = shape;
        self
    }

    /// Sets [`ring`](Self::ring).
    #[must_use]
    pub const fn with_ring(mut self, ring: u32) -> Self {
        self.ring = ring;
        self
    }

    /// Sets [`odometry`](Self::odometry).
    #[must_use]
    pub const fn with_odometry(mut self, odometry: [f64; 6]) -> Self {
        self.odometry = odometry;
        self
    }

    /// Sets [`closures`](Self::closures).
    #[must_use]
    pub const fn with_closures(mut self, closures: Closures<6>) -> Self {
        self.closures = closures;
        self
    }

    /// Makes the world.
    ///
    /// # Errors
    /// [`WorldError`] when a parameter is out of its range.
    pub fn generate(&self) -> Result<World, WorldError> {
        self.check()?;
        let truth: Vec<_> = (0..self.poses).map(|index| self.pose(index)).collect();
        let mut builder = Builder::new(&truth, &self.odometry, &self.closures, self.seed);
        for _ in 0..truth.len() {
            builder.step();
        }
        builder.finish(&[])
    }

    /// `spacing` is the largest distance between neighbouring rings.
    fn new(poses: u32, seed: u64, shape: Shape, ring: u32, spacing: f64, sigmas: [f64; 6]) -> Self {
        let closures = Closures {
            probability: 1.0,
            radius: 1.25 * spacing,
            per_pose: 1,
            gap: ring / 2 + 1,
            turn: PI,
            sigmas,
        };
        Self { poses, seed, shape, ring, odometry: sigmas, closures }
    }

    fn check(&self) -> Result<(), WorldError> {
        check_poses(self.poses)?;
        check_at_least("ring", self.ring.into(), 3.0)?;
        match self.shape {
            Shape::Sphere { radius } => check_positive("shape.radius", radius)?,
            Shape::Torus { major, minor } => {
                check_positive("shape.minor", minor)?;
                check_at_least("shape.major", major, minor)?;
            }
        }
        check_sigmas("odometry", &self.odometry)?;
        self.closures.check()
    }

    fn pose(&self, index: u32) -> Isometry3<f64> {
        let turns = f64::from(index % self.ring) / f64::from(self.ring);
        let progress = (f64::from(index) + 0.5) / f64::from(self.poses);
        match self.shape {
            Shape::Sphere { radius } => {
                // From the south pole up; y of the turned frame points east, and so becomes x.
                let out = about_z(2.0 * PI * turns) * about_y(PI * (1.0 - progress));
                let at = out * Translation3::new(0.0, 0.0, radius).vector;
                Isometry3::from_parts(at.into(), out * about_z(FRAC_PI_2))
            }
            Shape::Torus { major, minor } => {
                let (sin, cos) = libm::sincos(2.0 * PI * turns);
                let around = about_z(2.0 * PI * progress);
                let at = around * Translation3::new(major + minor * cos, 0.0, minor * sin).vector;
                // x of the frame turned about the tube points outward and z along it: exchange them.
                let exchange = UnitQuaternion::new_unchecked(Quaternion::new(
                    0.0,
                    FRAC_1_SQRT_2,
                    0.0,
                    FRAC_1_SQRT_2,
                ));
                Isometry3::from_parts(at.into(), around * about_y(-2.0 * PI * turns) * exchange)
            }
        }
    }
}

/// Poses in a ring, so that rings and poses in a ring stand in the proportion `1 : ratio²`.
fn ring(poses: u32, ratio: f64) -> u32 {
    ((ratio * f64::from(poses).sqrt()).round() as u32).max(3)
}
