//! A measurement of your own, without a derivative by hand: the range of a laser beam to a wall
//! whose place is not known either.
//!
//!     cargo run -p evergraph --example autodiff
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use evergraph::factors::autodiff::{AutoDiff, Number, Parameters, Residual, Transform2, Vector2};
use evergraph::prelude::*;

/// How far a beam goes from the robot until it meets a wall.
///
/// The wall is the line `x cos a + y sin a = c` with the parameters `(a, c)`: the direction of its
/// normal, radians, and its distance from the origin, metres.
#[derive(Debug)]
struct BeamToWall {
    /// Direction of the beam in the robot's frame, radians.
    beam: f64,
    /// The measured range, metres.
    range: f64,
}

impl Residual<1> for BeamToWall {
    type Variables = (Pose2, Parameters<2>);
    const NAME: &'static str = "BeamToWall";

    fn evaluate<T: Number>(&self, (robot, wall): (Transform2<T>, Vector2<T>)) -> [T; 1] {
        let (sin, cos) = wall[0].sin_cos();
        let position = robot.translation();
        let gap = wall[1] - (position.x * cos + position.y * sin);
        // How much of each metre of the beam goes towards the wall.
        let towards = (robot.heading() + self.beam - wall[0]).cos();
        [gap / towards - self.range]
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The truth: a wall on the left, and a robot that drifts to the right.
    let (normal, distance) = (1.5_f64, 4.0_f64);
    let step = Pose2::new(1.0, 0.0, -0.03);
    let truth: Vec<Pose2> =
        std::iter::successors(Some(Pose2::identity()), |pose| Some(*pose * step)).take(6).collect();
    let range = |robot: &Pose2, beam: f64| {
        let gap = distance - robot.x() * normal.cos() - robot.y() * normal.sin();
        gap / (robot.theta() + beam - normal).cos()
    };

    let mut smoother = Smoother::new(Settings::default())?;
    let mut change = smoother.change();
    let start = change.add_variable(&truth[0]);
    change.add_factor(Prior::new(start, truth[0], Noise::from_sigmas(&[0.01, 0.01, 0.01])?)?);
    // A first guess: straight on the left, three metres away.
    let wall = change.add_variable(&VectorN::new([std::f64::consts::FRAC_PI_2, 3.0]));

    // The odometry does not notice the drift; two laser beams do.
    let odometry = Noise::from_sigmas(&[0.05, 0.05, 0.05])?;
    let laser = Noise::isotropic(1, 0.01)?;
    let mut robots = vec![start];
    for (k, robot) in truth.iter().enumerate() {
        if k > 0 {
            let guess = Pose2::new(k as f64, 0.0, 0.0);
            let next = change.add_variable(&guess);
            let forward = Pose2::new(1.0, 0.0, 0.0);
            change.add_factor(BetweenPose2::new(robots[k - 1], next, forward, odometry.clone())?);
            robots.push(next);
        }
        for beam in [1.0, 2.0] {
            let seen = BeamToWall { beam, range: range(robot, beam) };
            change.add_factor(AutoDiff::new((robots[k], wall), seen, laser.clone())?);
        }
    }
    smoother.apply(change)?;
    let report = smoother.optimize(&BatchSettings::default())?;

    println!(
        "{:?} after {} iterations, error {:.4}",
        report.status, report.iterations, report.error
    );
    let estimate = smoother.estimate(wall)?;
    println!(
        "wall: normal {:.3} rad (truth {normal}), distance {:.3} m (truth {distance})",
        estimate.as_slice()[0],
        estimate.as_slice()[1]
    );
    for (robot, truth) in robots.iter().zip(&truth) {
        let pose = smoother.estimate(*robot)?;
        println!(
            "robot: x {:.3} m, y {:+.3} m, heading {:+.3} rad (truth {:.3}, {:+.3}, {:+.3})",
            pose.x(),
            pose.y(),
            pose.theta(),
            truth.x(),
            truth.y(),
            truth.theta()
        );
    }
    Ok(())
}
