//! A rover with wheels, a GPS receiver and a camera that sees the direction of a lighthouse: three
//! kinds of measurement in one map, kept current while it drives.
//!
//! Nothing is known beforehand, and no start value is made up. The first poses wait until GPS has told
//! the heading, the lighthouse waits until its bearings have enough parallax.
//!
//!     cargo run -p evergraph --example rover
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::sync::Arc;

use evergraph::factors::{Bearing2, Geodetic, GpsPosition2, LocalFrame};
use evergraph::formats::Dialect;
use evergraph::initialize::{Body, Certainty, End, Geometry, Sighting, place_landmark};
use evergraph::prelude::*;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    // East and north of here, in metres.
    let frame = LocalFrame::new(Geodetic::from_degrees(54.1830, 12.0850, 3.0))?;
    let truth: Vec<Pose2> = std::iter::successors(Some(Pose2::new(0.0, 0.0, 0.3)), |pose| {
        Some(*pose * Pose2::new(2.0, 0.0, 0.05))
    })
    .take(20)
    .collect();
    let lighthouse = Point2::new(30.0, 40.0);

    let mut rover = Rover::new()?;
    let mut steps = truth.iter();
    // The rover drives its first metres without a map: from two positions GPS tells the heading.
    let mut poses = rover.begin(&frame, steps.by_ref())?;
    for pose in steps {
        let last = poses[poses.len() - 1];
        let mut change = rover.smoother.change();
        let key = rover.drive(&mut change, last)?;
        change.add_factor(rover.gps(key, position(&frame, pose))?);
        let seen = pose.inverse() * lighthouse;
        rover.see(&mut change, key, seen.y().atan2(seen.x()))?;
        rover.smoother.apply(change)?;
        poses.push(key);
    }
    let report = rover.smoother.optimize(&BatchSettings::default())?;
    println!(
        "{:?} after {} iterations, error {:.4}",
        report.status, report.iterations, report.error
    );

    let last = rover.smoother.estimate(poses[poses.len() - 1])?;
    println!("rover: x {:.3} m, y {:.3} m, heading {:.3} rad", last.x(), last.y(), last.theta());
    let light = rover.light.ok_or("the rover has driven past the lighthouse")?;
    let found = rover.smoother.estimate(light)?;
    println!("lighthouse: x {:.2} m, y {:.2} m", found.x(), found.y());
    let back = frame.to_geodetic(Point3::new(found.x(), found.y(), 0.0));
    let (latitude, longitude) = back.degrees();
    println!("on the chart: {latitude:.5} north, {longitude:.5} east");

    let (graph, estimates) = (rover.smoother.graph(), rover.smoother.estimates()?);
    let document = Document::from_graph("rover.g2o", graph, &estimates)?;
    let mut text = Vec::new();
    document.write(&mut text, Dialect::G2o)?;
    println!("as a g2o file it has {} lines", text.split(|byte| *byte == b'\n').count() - 1);
    Ok(())
}

/// The position that the receiver tells at a true pose: that of its antenna.
fn position(frame: &LocalFrame, pose: &Pose2) -> Point2 {
    let at = *pose * ANTENNA;
    let fix = frame.to_geodetic(Point3::new(at.x(), at.y(), 0.0));
    let local = frame.to_local(fix);
    Point2::new(local.x(), local.y())
}

/// The antenna on the robot (m), and the motion that the wheels tell: they slip a little to the right.
const ANTENNA: Point2 = Point2::new(-0.4, 0.0);

fn driven() -> Pose2 {
    Pose2::new(2.0, 0.0, 0.045)
}

struct Rover {
    smoother: Smoother,
    wheels: Noise,
    receiver: Noise,
    camera: Noise,
    /// Bearings of the lighthouse that wait until they place it.
    waiting: Vec<(Key<Pose2>, f64)>,
    light: Option<Key<Point2>>,
}

impl Rover {
    fn new() -> Result<Self, Failure> {
        Ok(Self {
            smoother: Smoother::new(Settings::default())?,
            wheels: Noise::from_sigmas(&[0.1, 0.05, 0.01])?,
            receiver: Noise::from_sigmas(&[2.0, 2.0])?,
            camera: Noise::from_sigmas(&[0.005])?,
            waiting: Vec::new(),
            light: None,
        })
    }

    /// Collects poses until GPS holds the map in the world, then brings all of them in, in their place.
    fn begin<'a>(
        &mut self,
        frame: &LocalFrame,
        truth: impl Iterator<Item = &'a Pose2>,
    ) -> Result<Vec<Key<Pose2>>, Failure> {
        // By the wheels alone, from wherever the rover began.
        let mut shape = vec![Pose2::identity()];
        let mut body = Body::new(&Geometry::Pose2(shape[0]));
        let mut fixes = Vec::new();
        let scratch = &mut self.smoother.change();
        for pose in truth {
            let here = shape[shape.len() - 1];
            let fix = position(frame, pose);
            let gps = self.gps(scratch.add_variable(&here), fix)?;
            body.tie(Arc::new(gps), |_| Some(End::Moving(Geometry::Pose2(here))));
            fixes.push(fix);
            if body.gauge().is_fixed() {
                break;
            }
            shape.push(here * driven());
        }
        let motion = body.fit().ok_or("no position was measured")?;
        let mut change = self.smoother.change();
        let mut poses: Vec<Key<Pose2>> = Vec::new();
        for (at, fix) in shape.iter().zip(fixes) {
            let Some(Geometry::Pose2(start)) = Geometry::Pose2(*at).moved(&motion) else {
                return Err("the map is of the plane".into());
            };
            let key = change.add_variable(&start);
            if let Some(&last) = poses.last() {
                change.add_factor(BetweenPose2::new(last, key, driven(), self.wheels.clone())?);
            }
            change.add_factor(self.gps(key, fix)?);
            poses.push(key);
        }
        self.smoother.apply(change)?;
        Ok(poses)
    }

    /// A new pose; it starts where the wheels lead from the current estimate of the last.
    fn drive(&self, change: &mut Change, last: Key<Pose2>) -> Result<Key<Pose2>, Failure> {
        let key = change.add_variable(&(self.smoother.estimate(last)? * driven()));
        change.add_factor(BetweenPose2::new(last, key, driven(), self.wheels.clone())?);
        Ok(key)
    }

    fn gps(&self, pose: Key<Pose2>, fix: Point2) -> Result<GpsPosition2, Failure> {
        Ok(GpsPosition2::with_lever_arm(pose, fix, ANTENNA, self.receiver.clone())?)
    }

    /// A bearing of the lighthouse, in radians. A single direction places nothing: the lighthouse comes in
    /// with the first bearing that does, and with all that waited.
    fn see(&mut self, change: &mut Change, pose: Key<Pose2>, bearing: f64) -> Result<(), Failure> {
        self.waiting.push((pose, bearing));
        let light = match self.light {
            Some(light) => light,
            None => match self.place(change)? {
                Some(at) => *self.light.insert(change.add_variable(&at)),
                None => return Ok(()),
            },
        };
        for (pose, bearing) in self.waiting.drain(..) {
            let bearing = Bearing2::new(pose, light, bearing, self.camera.clone())?;
            change.add_factor(Robust::new(bearing, Kernel::huber(1.345)?));
        }
        Ok(())
    }

    /// The position of the lighthouse, if the bearings that wait determine it.
    fn place(&self, change: &Change) -> Result<Option<Point2>, Failure> {
        let light = self.smoother.change().add_variable(&Point2::new(0.0, 0.0));
        // The newest pose is not in the map yet.
        let started = |id| change.new_variables().iter().find(|(new, _)| *new == id);
        let known = |id| match started(id) {
            Some((_, start)) => Some(start.clone()),
            None => self.smoother.estimate_value(id).ok(),
        };
        let mut sightings = Vec::new();
        for &(pose, bearing) in &self.waiting {
            let bearing = Bearing2::new(pose, light, bearing, self.camera.clone())?;
            sightings.extend(Sighting::new(Arc::new(bearing), light.id(), known));
        }
        Ok(place_landmark(&sightings, Certainty::Sure))
    }
}
