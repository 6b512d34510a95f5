//! What errors of trajectories obey, whatever the trajectory.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::num::NonZeroUsize;

use evergraph_evaluate::{
    AbsoluteError, Alignment, Ambiguity, Association, EvaluateError, PosePairs, RelativeError,
    RelativePairs, Similarity,
};
use evergraph_formats::{Stamps, Trajectory};
use evergraph_model::{LieGroup, Pose2, Pose3, Value};
use proptest::collection::vec;
use proptest::prelude::*;

fn pose3() -> impl Strategy<Value = Pose3> {
    let number = |limit: f64| -limit..limit;
    let tangent = (number(50.0), number(50.0), number(50.0), number(2.0), number(2.0), number(2.0));
    tangent.prop_map(|(x, y, z, rx, ry, rz)| Pose3::exp(&[x, y, z, rx, ry, rz].into()))
}

fn pose2() -> impl Strategy<Value = Pose2> {
    (-50.0..50.0, -50.0..50.0, -3.1..3.1).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
}

fn trajectory<P: evergraph_model::Manifold>(poses: &[P]) -> Trajectory {
    Trajectory::of_estimates("poses", (0..).zip(poses.iter().map(Value::new))).unwrap()
}

fn pairs<P: evergraph_model::Manifold>(estimate: &[P], truth: &[P]) -> PosePairs {
    PosePairs::new(&trajectory(estimate), &trajectory(truth), Association::Id).unwrap()
}

fn ate(pairs: &PosePairs, similarity: &Similarity) -> AbsoluteError {
    AbsoluteError::of(pairs, similarity).unwrap()
}

fn apart(a: &Pose3, b: &Pose3) -> f64 {
    a.between(b).log().amax()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn a_known_motion_is_found(poses in vec(pose3(), 4..30), motion in pose3()) {
        let moved: Vec<Pose3> = poses.iter().map(|pose| motion.compose(pose)).collect();
        let pairs = pairs(&poses, &moved);
        for alignment in [Alignment::Rigid, Alignment::Similarity, Alignment::FirstPose] {
            let aligned = pairs.align(alignment).unwrap();
            prop_assert_eq!(aligned.ambiguity, None);
            prop_assert!(apart(&aligned.similarity.motion, &motion) < 1e-9, "{alignment:?}");
            prop_assert!((aligned.similarity.scale - 1.0).abs() < 1e-9);
            let error = ate(&pairs, &aligned.similarity);
            prop_assert!(error.translation.max < 1e-9 && error.rotation.max < 1e-9);
        }
    }

    #[test]
    fn a_known_motion_of_the_plane_is_found_in_the_plane(
        poses in vec(pose2(), 2..30), motion in pose2()
    ) {
        let moved: Vec<Pose2> = poses.iter().map(|pose| motion.compose(pose)).collect();
        let pairs = pairs(&poses, &moved);
        prop_assert!(pairs.is_planar());
        let aligned = pairs.align(Alignment::Rigid).unwrap();
        let found = aligned.similarity.motion;
        let [qx, qy, _, _] = found.rotation().quaternion();
        prop_assert_eq!((found.z(), qx, qy), (0.0, 0.0, 0.0));
        prop_assert!(ate(&pairs, &aligned.similarity).translation.max < 1e-9);
    }

    #[test]
    fn a_known_scale_is_found(poses in vec(pose3(), 4..30), motion in pose3(), scale in 0.01..100.0) {
        let known = Similarity { scale, motion };
        let moved: Vec<Pose3> = poses.iter().map(|pose| known.transform_pose(pose)).collect();
        let pairs = pairs(&poses, &moved);
        let found = pairs.align(Alignment::Similarity).unwrap().similarity;
        prop_assert!((found.scale / scale - 1.0).abs() < 1e-9);
        prop_assert!(ate(&pairs, &found).translation.max < 1e-9 * scale.max(1.0));
    }

    /// No motion near the one that is found is better, and none at all is not better either.
    /// With fewer poses than it takes to tell that these have nothing in common.
    #[test]
    fn alignment_is_the_least(
        both in vec((pose3(), pose3()), 2..12), step in pose3(), size in -4..0_i32
    ) {
        let (estimate, truth): (Vec<Pose3>, Vec<Pose3>) = both.into_iter().unzip();
        let pairs = pairs(&estimate, &truth);
        let sse = |similarity: &Similarity| ate(&pairs, similarity).translation.sse;
        let rigid = pairs.align(Alignment::Rigid).unwrap().similarity;
        let scaled = pairs.align(Alignment::Similarity).unwrap().similarity;
        let least = sse(&rigid);
        let limit = least * (1.0 - 1e-12);
        prop_assert!(sse(&Similarity::identity()) >= limit);
        prop_assert!(sse(&scaled) <= least * (1.0 + 1e-12));
        let step = Pose3::exp(&(step.log() * 10f64.powi(size)));
        for motion in [step.compose(&rigid.motion), rigid.motion.compose(&step), step] {
            let other = Similarity { scale: 1.0, motion };
            prop_assert!(sse(&other) >= limit);
        }
        for factor in [0.99, 1.01] {
            let other = Similarity { scale: scaled.scale * factor, ..scaled };
            prop_assert!(sse(&other) >= sse(&scaled) * (1.0 - 1e-12));
        }
    }

    #[test]
    fn relative_errors_do_not_see_where_a_map_lies(
        both in vec((pose3(), pose3()), 8..20), left in pose3(), right in pose3(), all in any::<bool>()
    ) {
        let (estimate, truth): (Vec<Pose3>, Vec<Pose3>) = both.into_iter().unzip();
        let moved = |motion: &Pose3, poses: &[Pose3]| -> Vec<Pose3> {
            poses.iter().map(|pose| motion.compose(pose)).collect()
        };
        let between = RelativePairs::default().with_delta(NonZeroUsize::new(3).unwrap()).with_all(all);
        let here = RelativeError::of(&pairs(&estimate, &truth), between).unwrap();
        let there = pairs(&moved(&left, &estimate), &moved(&right, &truth));
        let there = RelativeError::of(&there, between).unwrap();
        prop_assert!((here.translation.rmse - there.translation.rmse).abs() < 1e-9);
        prop_assert!((here.rotation.max - there.rotation.max).abs() < 1e-7);
        prop_assert_eq!(here.translation.count, if all { truth.len() - 3 } else { (truth.len() - 1) / 3 });
    }
}

/// Positions on a line, one metre apart.
fn along(motion: &Pose3) -> Vec<Pose3> {
    let at = |k: u32| Pose3::exp(&[f64::from(k), 0.0, 0.0, 0.0, 0.0, 0.0].into());
    (0..10).map(|k| motion.compose(&at(k))).collect()
}

proptest! {
    /// A straight way leaves the turn about it open, with noise or without: the orientations give it.
    #[test]
    fn a_straight_way_is_turned_by_its_orientations(
        estimate in pose3(), truth in pose3(), noise in vec(pose3(), 30)
    ) {
        for size in [0.0, 1e-4] {
            let shake = |poses: Vec<Pose3>, noise: &[Pose3]| -> Vec<Pose3> {
                let small = |by: &Pose3| [by.x(), by.y(), by.z()].map(|x| 0.02 * size * x);
                let shaken = poses.iter().zip(noise).map(|(pose, by)| {
                    let [x, y, z] = small(by);
                    pose.compose(&Pose3::exp(&[x, y, z, 0.0, 0.0, 0.0].into()))
                });
                shaken.collect()
            };
            let (a, b) = noise.split_at(15);
            let pairs = pairs(&shake(along(&estimate), a), &shake(along(&truth), b));
            let aligned = pairs.align(Alignment::Rigid).unwrap();
            if size == 0.0 {
                prop_assert_eq!(aligned.ambiguity, Some(Ambiguity::Line));
            }
            if aligned.ambiguity.is_some() {
                let error = ate(&pairs, &aligned.similarity);
                prop_assert!(error.translation.max < 1e-9 + 10.0 * size);
                prop_assert!(error.rotation.max < 1e-6 + 10.0 * size);
            }
        }
    }

    /// A robot that stands still, wherever and with whatever noise.
    #[test]
    fn one_place_is_turned_by_its_orientations(
        estimate in pose3(), truth in pose3(), noise in vec(pose3(), 40), moves in any::<bool>()
    ) {
        for size in [0.0, 1e-3] {
            let still = |at: &Pose3, noise: &[Pose3], size: f64| -> Vec<Pose3> {
                let shake = |by: &Pose3| {
                    let by = [by.x(), by.y(), by.z()].map(|x| size * x);
                    at.compose(&Pose3::exp(&[by[0], by[1], by[2], 0.0, 0.0, 0.0].into()))
                };
                noise.iter().map(shake).collect()
            };
            let (a, b) = noise.split_at(20);
            // The truth may move where the estimate is exactly in one place.
            let size_of_truth = if moves && size == 0.0 { 0.1 } else { size };
            let pairs = pairs(&still(&estimate, a, size), &still(&truth, b, size_of_truth));
            let aligned = pairs.align(Alignment::Similarity).unwrap();
            if size == 0.0 {
                prop_assert_eq!(aligned.ambiguity, Some(Ambiguity::Still));
            }
            if aligned.ambiguity == Some(Ambiguity::Still) {
                prop_assert_eq!(aligned.similarity.scale, 1.0);
                prop_assert!(ate(&pairs, &aligned.similarity).rotation.max < 1e-6);
            }
        }
    }

    #[test]
    fn partners_in_time_are_the_nearest(
        few in vec(0..1000_u32, 1..10), many in vec(0..1000_u32, 10..60), reach in 0..100_u32
    ) {
        let sorted = |mut times: Vec<u32>| -> Vec<f64> {
            times.sort_unstable();
            times.iter().map(|&t| f64::from(t)).collect()
        };
        let (few, many, max_difference) = (sorted(few), sorted(many), f64::from(reach));
        // Poses lie at their numbers, so that a pair says which they are.
        let found = PosePairs::new(&timed(&few), &timed(&many), Association::Time { max_difference });
        let found = found.map_or_else(|_| Vec::new(), |pairs| pairs.pairs().to_vec());
        for (k, time) in few.iter().enumerate() {
            let nearest = many.iter().map(|other| (other - time).abs()).fold(f64::INFINITY, f64::min);
            let pair = found.iter().find(|pair| pair.estimate.x() == k as f64);
            prop_assert_eq!(pair.is_some(), nearest <= max_difference);
            if let Some(pair) = pair {
                prop_assert_eq!((many[pair.truth.x() as usize] - time).abs(), nearest);
            }
        }
    }
}

#[test]
fn a_way_back_is_aligned_by_half_a_turn() {
    let back = Pose3::exp(&[0.0, 0.0, 1.0, 0.0, std::f64::consts::PI, 0.0].into());
    let pairs = pairs(&along(&Pose3::identity()), &along(&back));
    let aligned = pairs.align(Alignment::Rigid).unwrap();
    assert_eq!(aligned.ambiguity, Some(Ambiguity::Line));
    assert!(ate(&pairs, &aligned.similarity).translation.max < 1e-9);
}

#[test]
fn orientations_that_say_nothing_leave_the_smallest_turn() {
    // Quarter turns all around, as often each way.
    let turned =
        |k: u32| Pose3::exp(&[0.0, 0.0, 0.0, 0.0, 0.0, f64::from(k) * std::f64::consts::PI].into());
    let pairs = pairs(&[Pose3::identity(); 4], &[turned(0), turned(1), turned(0), turned(1)]);
    let aligned = pairs.align(Alignment::Rigid).unwrap();
    assert_eq!(aligned.ambiguity, Some(Ambiguity::Still));
    assert!(aligned.similarity.motion.rotation().log().norm() < 1e-9);
}

#[test]
fn the_plane_is_not_measured_by_space_nor_times_by_ids() {
    let plane = trajectory(&[Pose2::new(0.0, 0.0, 0.0), Pose2::new(1.0, 0.0, 0.0)]);
    let lifted = |z: f64| [0.0, 1.0].map(|x| Pose3::exp(&[x, 0.0, z, 0.0, 0.0, 0.0].into()));
    let [flat, high] = [0.0, 0.5].map(|z| trajectory(&lifted(z)));
    assert!(PosePairs::new(&plane, &flat, Association::Id).is_ok());
    for (a, b) in [(&plane, &high), (&high, &plane)] {
        let error = PosePairs::new(a, b, Association::Id).unwrap_err();
        assert!(matches!(error, EvaluateError::PlaneAgainstSpace { .. }), "{error}");
    }
    for (times, is_refused) in [([0.0, 1.0], false), ([0.0, 1.001], true)] {
        let timed = timed(&times);
        for (a, b) in [(&flat, &timed), (&timed, &flat)] {
            // Timed poses have ids here too; what was asked for is to pair by time.
            let refused = matches!(
                PosePairs::new(a, b, Association::TIME),
                Err(EvaluateError::TimesAgainstIds { .. })
            );
            assert_eq!(refused, is_refused);
        }
    }
}

/// In space the mirror image of a square fits it, turned over; in the plane it does not.
#[test]
fn no_map_is_turned_over() {
    let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0], [-1.0, 3.0]];
    let [here, mirrored] = [1.0, -1.0].map(|s| corners.map(|[x, y]| Pose2::new(x, s * y, 0.0)));
    let planar = pairs(&mirrored, &here);
    let aligned = planar.align(Alignment::Rigid).unwrap();
    assert!(ate(&planar, &aligned.similarity).translation.rmse > 0.5);
    let lift =
        |poses: [Pose2; 5]| poses.map(|p| Pose3::exp(&[p.x(), p.y(), 1.0, 0.0, 0.0, 0.0].into()));
    let spatial = pairs(&lift(mirrored), &lift(here));
    let aligned = spatial.align(Alignment::Rigid).unwrap();
    assert_eq!(aligned.ambiguity, None);
    assert!(ate(&spatial, &aligned.similarity).translation.rmse < 1e-9);
}

#[test]
fn numbers_too_large_are_an_error() {
    let far = [-1.0, 1.0, 0.5].map(|s| Pose3::exp(&[s * 1.7e308, 0.0, 0.0, 0.0, 0.0, 0.0].into()));
    let near = [0.0, 1.0, 2.0].map(|x| Pose3::exp(&[x, 0.0, 0.0, 0.0, 0.0, 0.0].into()));
    let pairs = pairs(&far, &near);
    assert!(matches!(pairs.align(Alignment::Rigid), Err(EvaluateError::Overflow)));
    let error = AbsoluteError::of(&pairs, &Similarity::identity());
    assert!(matches!(error, Err(EvaluateError::Overflow)));
    let relative = RelativeError::of(&pairs, RelativePairs::default());
    assert!(matches!(relative, Err(EvaluateError::Overflow)));
}

fn timed(times: &[f64]) -> Trajectory {
    let poses: Vec<Pose2> = (0..times.len()).map(|k| Pose2::new(k as f64, 0.0, 0.0)).collect();
    let csv: String = (0..).zip(times).map(|(id, t): (u32, _)| format!("{id},{t}\n")).collect();
    trajectory(&poses).with_stamps(&Stamps::parse("times", csv.as_bytes()).unwrap()).unwrap()
}

#[test]
fn the_nearest_time_within_reach_is_the_partner() {
    let found = |estimate: &Trajectory, truth: &Trajectory, max_difference| -> Vec<(f64, f64)> {
        let pairs = PosePairs::new(estimate, truth, Association::Time { max_difference }).unwrap();
        pairs.pairs().iter().map(|pair| (pair.estimate.x(), pair.truth.x())).collect()
    };
    let (few, many) = (timed(&[1.0, 2.0, 9.0]), timed(&[0.5, 1.0, 1.5, 2.25, 2.5]));
    assert_eq!(found(&few, &many, 0.25), [(0.0, 1.0), (1.0, 3.0)]);
    assert_eq!(found(&few, &many, 0.2), [(0.0, 1.0)]);
    assert_eq!(found(&many, &few, 0.25), [(1.0, 0.0), (3.0, 1.0)]);
    // The earlier of two that are equally near; one may serve twice.
    assert_eq!(found(&timed(&[1.25]), &many, 1.0), [(0.0, 1.0)]);
    assert_eq!(
        found(&timed(&[1.0, 1.125]), &timed(&[0.0, 1.1, 5.0]), 0.5),
        [(0.0, 1.0), (1.0, 1.0)]
    );
    // Without times an id is a time.
    let ids = trajectory(&[Pose2::new(0.0, 0.0, 0.0), Pose2::new(1.0, 0.0, 0.0)]);
    assert_eq!(found(&ids, &timed(&[-3.0, 1.0, 7.0]), 0.0), [(1.0, 1.0)]);
}

#[test]
fn what_cannot_be_associated_is_said() {
    let (early, late) = (timed(&[1.0, 2.0]), timed(&[11.0, 12.0]));
    let error = PosePairs::new(&early, &late, Association::TIME).unwrap_err();
    assert!(error.to_string().contains("by time to 0.01 s"), "{error}");
    for value in [-1.0, f64::NAN] {
        let by = Association::Time { max_difference: value };
        let error = PosePairs::new(&early, &late, by).unwrap_err();
        assert!(matches!(error, EvaluateError::BadSetting { .. }), "{error}");
    }
    let tum = "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n";
    let tum = Trajectory::parse("t", tum.as_bytes(), evergraph_formats::TrajectoryFormat::Tum);
    let tum = tum.unwrap();
    assert_eq!(Association::of(&early, &tum), Association::TIME);
    assert_eq!(Association::of(&early, &late), Association::Id);
    let error = PosePairs::new(&early, &tum, Association::Id).unwrap_err();
    assert!(matches!(error, EvaluateError::NoIds { .. }), "{error}");
    let pairs = PosePairs::new(&early, &tum, Association::TIME).unwrap();
    let delta = NonZeroUsize::new(2).unwrap();
    for all in [false, true] {
        let error =
            RelativeError::of(&pairs, RelativePairs::default().with_delta(delta).with_all(all))
                .unwrap_err();
        assert!(matches!(error, EvaluateError::NoPair { poses: 2, delta: 2 }), "{error}");
    }
}
