//! A singular system: the variables that are free are named first, and no others.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::{Bearing2, BetweenPose2, Prior, Range};
use evergraph_model::{Change, Key, LieGroup, Noise, Point2, Pose2, VariableId};
use evergraph_solver::{Settings, Singular, Smoother, SmootherError};

/// A line of poses with a prior on the first.
fn poses(change: &mut Change, count: usize) -> Vec<Key<Pose2>> {
    let at = |k: usize| Pose2::new(k as f64, 0.1 * (k as f64).sin(), 0.05 * k as f64);
    let keys: Vec<Key<Pose2>> = (0..count).map(|k| change.add_variable(&at(k))).collect();
    let firm = Noise::from_sigmas(&[0.01, 0.01, 0.002]).unwrap();
    change.add_factor(Prior::new(keys[0], at(0), firm.clone()).unwrap());
    for k in 1..count {
        let odometry =
            BetweenPose2::new(keys[k - 1], keys[k], at(k - 1).between(&at(k)), firm.clone());
        change.add_factor(odometry.unwrap());
    }
    keys
}

fn free_variables(smoother: &mut Smoother, change: Change) -> Vec<(VariableId, usize)> {
    match smoother.apply(change) {
        Err(SmootherError::Singular(Singular::Variables { variables })) => {
            variables.iter().map(|free| (free.variable, free.free)).collect()
        }
        other => panic!("not singular: {other:?}"),
    }
}

#[test]
fn landmarks_with_one_bearing_each_are_named_alone() {
    for landmarks in [1, 5, 13, 40] {
        let mut smoother = Smoother::new(Settings::default()).unwrap();
        let mut change = smoother.change();
        let keys = poses(&mut change, 20);
        let mut expected = Vec::new();
        for k in 0..landmarks {
            let light = change.add_variable(&Point2::new(k as f64, 3.0 + k as f64));
            let noise = Noise::isotropic(1, 0.02).unwrap();
            let bearing = 1.5 - 0.05 * (k % 20) as f64;
            change.add_factor(Bearing2::new(keys[k % 20], light, bearing, noise).unwrap());
            expected.push((light.id(), 1));
        }
        let mut found = free_variables(&mut smoother, change);
        found.sort_by_key(|(variable, _)| expected.iter().position(|it| it.0 == *variable));
        assert_eq!(found, expected);
    }
}

#[test]
fn a_direction_is_counted_once_for_each_variable_that_it_moves() {
    // Ranges hold each landmark along the line to the pose or to the other landmark only.
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut change = smoother.change();
    let keys = poses(&mut change, 20);
    let [a, b] = [3.0, 5.0].map(|y| change.add_variable(&Point2::new(2.0, y)));
    let noise = Noise::isotropic(1, 0.1).unwrap();
    change.add_factor(Range::new(keys[2], a, 3.0, noise.clone()).unwrap());
    change.add_factor(Range::new(a, b, 2.0, noise.clone()).unwrap());
    let found = free_variables(&mut smoother, change);
    assert_eq!(found, [(a.id(), 1), (b.id(), 1)]);
}
