//! A singular system: the variables that are free are named first, and no others.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::{Bearing2, BetweenPose2, Prior, Range};
use evergraph_model::{Change, Key, LieGroup, Noise, Point2, Pose2, VariableId};
use evergraph_solver::{BatchSettings, Elimination, Settings, Singular, Smoother, SmootherError};
use nalgebra::DMatrix;

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

/// Poses on a bent line, of which each third step is known to `1 / weak` only and the others to
/// `1 / strong`.
fn pieces(change: &mut Change, strong: f64, weak: f64) -> Vec<(Key<Pose2>, Pose2)> {
    let at = |k: usize| Pose2::new(k as f64, 0.2 * (k % 3) as f64, 0.3 * k as f64);
    let poses: Vec<_> = (0..12).map(|k| (change.add_variable(&at(k)), at(k))).collect();
    for (k, pair) in poses.windows(2).enumerate() {
        let noise = Noise::isotropic(3, 1.0 / if k % 3 == 2 { weak } else { strong }).unwrap();
        let [(from, here), (to, there)] = [pair[0], pair[1]];
        change.add_factor(BetweenPose2::new(from, to, here.between(&there), noise).unwrap());
    }
    poses
}

/// Ratios of information, from where all agree to what only QR can tell from rounding.
const WEIGHTS: [(f64, f64); 4] = [(1e2, 1e1), (1e6, 1e-1), (1e6, 1e-3), (1e9, 1e-1)];

#[test]
fn weights_far_apart_leave_nothing_undetermined() {
    for (strong, weak) in WEIGHTS {
        for elimination in [Elimination::Cholesky, Elimination::Qr] {
            for prior in [strong, weak] {
                let settings = Settings::default().with_elimination(elimination);
                let mut smoother = Smoother::new(settings).unwrap();
                let mut change = smoother.change();
                let poses = pieces(&mut change, strong, weak);
                let ((first, at), (last, end)) = (poses[0], poses[11]);
                let noise = Noise::isotropic(3, 1.0 / prior).unwrap();
                change.add_factor(Prior::new(first, at, noise).unwrap());
                // A loop of the weak kind: its error is shared by the weak steps.
                let noise = Noise::isotropic(3, 1.0 / weak).unwrap();
                let loop_closure = at.between(&end.compose(&Pose2::new(0.05, 0.0, 0.0)));
                change.add_factor(BetweenPose2::new(first, last, loop_closure, noise).unwrap());
                smoother.apply(change).unwrap();
                smoother.optimize(&BatchSettings::default()).unwrap();
                let moved = |k: usize| {
                    let (key, _) = poses[k];
                    let (before, _) = poses[k - 1];
                    let now = smoother
                        .estimate(before)
                        .unwrap()
                        .between(&smoother.estimate(key).unwrap());
                    poses[k - 1].1.between(&poses[k].1).between(&now).log().norm()
                };
                let (rigid, loose) = (moved(1), moved(3));
                let share = 2.0 * (weak / strong).powi(2);
                assert!(rigid < share * loose + 1e-9, "{strong} {weak} {prior}: {rigid} {loose}");
                assert!((5e-3..5e-2).contains(&loose), "{strong} {weak} {prior}: {loose}");
            }
        }
    }
}

#[test]
fn free_directions_are_told_from_weakly_determined_ones() {
    for (strong, weak) in WEIGHTS {
        for elimination in [Elimination::Cholesky, Elimination::Qr] {
            let settings = Settings::default().with_elimination(elimination);
            let mut smoother = Smoother::new(settings).unwrap();
            let mut change = smoother.change();
            pieces(&mut change, strong, weak);
            let error = smoother.apply(change).unwrap_err();
            assert!(
                matches!(
                    error,
                    SmootherError::Singular(Singular::Component { count: 12, free: 3, .. })
                ),
                "{strong} {weak}: {error}"
            );

            // Held, with two lights of one bearing each.
            let mut change = smoother.change();
            let poses = pieces(&mut change, strong, weak);
            let noise = Noise::isotropic(3, 1.0 / strong).unwrap();
            change.add_factor(Prior::new(poses[0].0, poses[0].1, noise).unwrap());
            let lights = [1, 7].map(|k| {
                let (key, at) = poses[k];
                let light = change.add_variable(&at.transform_point(&Point2::new(0.0, 4.0)));
                let noise = Noise::isotropic(1, 1.0 / strong).unwrap();
                let bearing = std::f64::consts::FRAC_PI_2;
                change.add_factor(Bearing2::new(key, light, bearing, noise).unwrap());
                (light.id(), 1)
            });
            let mut found = free_variables(&mut smoother, change);
            found.sort_by_key(|(variable, _)| lights.iter().position(|it| it.0 == *variable));
            assert_eq!(found, lights, "{strong} {weak}");
        }
    }
}

/// Errors of neighbouring poses that are strongly correlated make factors between columns that are larger
/// than one, pose by pose; their products say nothing of what is determined.
#[test]
fn a_long_chain_of_correlated_steps_is_determined() {
    let mut smoother =
        Smoother::new(Settings::default().with_elimination(Elimination::Qr)).unwrap();
    let mut change = smoother.change();
    let at = |k: usize| Pose2::new(0.7 * k as f64, (0.1 * k as f64).sin(), 1.3 * k as f64);
    let keys: Vec<Key<Pose2>> = (0..400).map(|k| change.add_variable(&at(k))).collect();
    let firm = Noise::isotropic(3, 0.01).unwrap();
    change.add_factor(Prior::new(keys[0], at(0), firm).unwrap());
    for k in 1..keys.len() {
        // Along a diagonal of the robot's frame a step is known a hundred times better than across.
        let root =
            DMatrix::from_row_slice(3, 3, &[1e3, -1e3, 5e2, 0.0, 10.0, 0.0, 0.0, 0.0, 100.0]);
        let noise = Noise::from_information(&root.tr_mul(&root)).unwrap();
        let step = at(k - 1).between(&at(k));
        change.add_factor(BetweenPose2::new(keys[k - 1], keys[k], step, noise).unwrap());
    }
    smoother.apply(change).unwrap();
}
