//! A rover with wheels, a GPS receiver and a camera that sees the direction of a lighthouse: three
//! kinds of measurement in one map, kept current while it drives.
//!
//!     cargo run -p evergraph --example rover
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use evergraph::factors::{Bearing2, Geodetic, GpsPosition2, LocalFrame};
use evergraph::formats::Dialect;
use evergraph::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // East and north of here, in metres.
    let frame = LocalFrame::new(Geodetic::from_degrees(54.1830, 12.0850, 3.0))?;
    let truth: Vec<Pose2> = std::iter::successors(Some(Pose2::new(0.0, 0.0, 0.3)), |pose| {
        Some(*pose * Pose2::new(2.0, 0.0, 0.05))
    })
    .take(20)
    .collect();
    let lighthouse = Point2::new(30.0, 40.0);

    let wheels = Noise::from_sigmas(&[0.1, 0.05, 0.01])?;
    let receiver = Noise::from_sigmas(&[2.0, 2.0])?;
    let camera = Noise::from_sigmas(&[0.005])?;
    let antenna = Point2::new(-0.4, 0.0);

    let mut smoother = Smoother::new(Settings::default())?;
    let mut poses: Vec<Key<Pose2>> = Vec::new();
    let mut light: Option<Key<Point2>> = None;
    for (k, pose) in truth.iter().enumerate() {
        let mut change = smoother.change();
        // The wheels slip a little, always to the right.
        let driven = Pose2::new(2.0, 0.0, 0.045);
        let start = match poses.last() {
            Some(last) => smoother.estimate(*last)? * driven,
            None => Pose2::new(0.0, 0.0, 0.0),
        };
        let key = change.add_variable(&start);
        if let Some(last) = poses.last() {
            change.add_factor(BetweenPose2::new(*last, key, driven, wheels.clone())?);
        } else {
            // One position says nothing about where the rover looks; a compass does, roughly.
            let compass = Noise::from_sigmas(&[100.0, 100.0, 0.5])?;
            change.add_factor(Prior::new(key, Pose2::identity(), compass)?);
        }

        // What the receiver says, in degrees; here it is the truth.
        let at = *pose * antenna;
        let fix = frame.to_geodetic(Point3::new(at.x(), at.y(), 0.0));
        let local = frame.to_local(fix);
        let position = Point2::new(local.x(), local.y());
        change.add_factor(GpsPosition2::with_lever_arm(key, position, antenna, receiver.clone())?);

        // A single direction does not place the lighthouse: it comes in with the tenth pose, and the
        // directions from there on tell the rest.
        if k >= 10 {
            let seen = pose.inverse() * lighthouse;
            let bearing = seen.y().atan2(seen.x());
            let light = *light.get_or_insert_with(|| change.add_variable(&Point2::new(20.0, 30.0)));
            if k == 10 {
                let anywhere = Noise::isotropic(2, 100.0)?;
                change.add_factor(Prior::new(light, Point2::new(20.0, 30.0), anywhere)?);
            }
            let bearing = Bearing2::new(key, light, bearing, camera.clone())?;
            change.add_factor(Robust::new(bearing, evergraph::model::Kernel::huber(1.345)?));
        }
        smoother.apply(change)?;
        poses.push(key);
    }
    let report = smoother.optimize(&BatchSettings::default())?;
    println!(
        "{:?} after {} iterations, error {:.4}",
        report.status, report.iterations, report.error
    );

    let last = smoother.estimate(poses[poses.len() - 1])?;
    println!("rover: x {:.3} m, y {:.3} m, heading {:.3} rad", last.x(), last.y(), last.theta());
    let light = light.ok_or("the rover has driven past the lighthouse")?;
    let found = smoother.estimate(light)?;
    println!("lighthouse: x {:.2} m, y {:.2} m", found.x(), found.y());
    let back = frame.to_geodetic(Point3::new(found.x(), found.y(), 0.0));
    let (latitude, longitude) = back.degrees();
    println!("on the chart: {latitude:.5} north, {longitude:.5} east");

    let document = Document::from_graph("rover.g2o", smoother.graph(), &smoother.estimates())?;
    let mut text = Vec::new();
    document.write(&mut text, Dialect::G2o)?;
    println!("as a g2o file it has {} lines", text.split(|byte| *byte == b'\n').count() - 1);
    Ok(())
}
