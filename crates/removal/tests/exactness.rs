//! A single removal against plain dense algebra.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_factors::Linear;
use evergraph_model::{Value, VariableId};
use evergraph_removal::{
    Consistency, Fallback, Options, Order, Recovery, Removal, RootShift, Topology,
};
use proptest::prelude::*;

fn check_information_and_gradient(kind: Kind, count: usize, seed: u64, options: Options) {
    let scene = neighborhood(kind, count, seed);
    let node = scene.ids()[0];
    let plan = scene.plan(node, options);
    let step = &plan.steps()[0];
    let answer = answer(&scene, &[node], &step.blanket);
    let new = added(&scene, &plan, &step.blanket);
    let (lambda, eta) = normal(&new);
    assert_same_gradient(&eta, &answer.eta, &answer, 1e-9);
    let expected =
        rank(&answer.stack.0) - rank(&answer.stack.0.columns(0, answer.node_dim).into_owned());
    if !options.keep_unary {
        assert_eq!(step.rank, expected, "rank of the target");
    }
    assert_eq!(rank(&new.0), expected, "no direction is lost, none is made up: {step:#?}");
    if step.topology == Topology::Dense {
        assert_close(&lambda, &answer.lambda, &answer.scale, 1e-9, "information");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..Default::default() })]

    #[test]
    fn dense_is_the_schur_complement(kind in 0..KINDS.len(), count in 1..5usize, seed: u64) {
        for keep in [false, true] {
            let options = Options::dense().with_keep_unary(keep);
            check_information_and_gradient(KINDS[kind], count, seed, options);
        }
    }

    #[test]
    fn a_tree_keeps_gradient_and_null_space(kind in 0..KINDS.len(), count in 1..6usize, seed: u64) {
        for recovery in [Recovery::Glc, Recovery::Nonlinear] {
            let options = Options::tree().with_recovery(recovery);
            for consistency in [Consistency::None, Consistency::Conservative, Consistency::Scaled] {
                let options = options.with_consistency(consistency);
                check_information_and_gradient(KINDS[kind], count, seed, options);
                let absorbing = options.with_keep_unary(false);
                check_information_and_gradient(KINDS[kind], count, seed, absorbing);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..Default::default() })]

    /// Several nodes of any kinds in one plan: later ones read what earlier ones leave.
    #[test]
    fn no_direction_becomes_free_by_many_removals(
        kind in 0..KINDS.len(), count in 4..7usize, seed: u64, removed in 1..4usize,
    ) {
        let scene = neighborhood(KINDS[kind], count, seed);
        let ids = scene.ids();
        // Some have no factor at all.
        let nodes: Vec<VariableId> = ids
            .iter()
            .copied()
            .filter(|&id| !scene.graph.factors_of(id).unwrap().is_empty())
            .take(removed)
            .collect();
        let kept: Vec<VariableId> = ids.iter().copied().filter(|id| !nodes.contains(id)).collect();
        let order: Vec<VariableId> = nodes.iter().chain(&kept).copied().collect();
        let full = scene.stack(scene.graph.factors().map(|(_, f)| f), &order);
        let gone = nodes.iter().map(|&id| scene.graph.dim_at(scene.graph.variable_index(id).unwrap())).sum();
        let expected = rank(&full.0) - rank(&full.0.columns(0, gone).into_owned());
        for options in keeping() {
            for plan_order in [Order::Given, Order::Random(seed), Order::MinDegree] {
                let plan = Removal::new(&scene.graph, &scene.values())
                    .with_options(options)
                    .plan_many(&nodes, plan_order)
                    .unwrap();
                let mut graph = scene.graph.clone();
                let staged = graph.stage(plan.change()).unwrap();
                graph.commit(staged);
                let after = Scene { graph, data: scene.data.clone() };
                let stack = after.stack(after.graph.factors().map(|(_, f)| f), &kept);
                prop_assert_eq!(rank(&stack.0), expected);
                if options.topology == Topology::Dense {
                    let before = normal(&full);
                    let (lambda, _) = eliminated(&full, gone);
                    let floor = 1e-3 * before.0.diagonal().max().sqrt();
                    let scale: Vec<f64> = (gone..before.0.nrows())
                        .map(|i| before.0[(i, i)].sqrt().max(floor))
                        .collect();
                    assert_close(&normal(&stack).0, &lambda, &scale, 1e-9, "information");
                }
            }
        }
    }
}

#[test]
fn what_is_relative_has_no_trace_of_the_world() {
    for kind in [Kind::Plane, Kind::Space] {
        for seed in 0..10 {
            let scene = neighborhood(kind, 5, seed);
            for options in [Options::default(), Options::dense()] {
                for root_shift in [RootShift::Root, RootShift::InverseRoot] {
                    let plan = scene.plan(scene.ids()[0], options.with_root_shift(root_shift));
                    for (_, factor) in plan.change().new_factors() {
                        let (linear, _) = factor.downcast::<Linear>().unwrap();
                        assert_eq!(linear.root_shift(), root_shift);
                        let dim = linear.linearization_points()[0].dim();
                        assert_eq!(linear.sqrt_information().columns(0, dim).amax(), 0.0);
                    }
                }
            }
        }
    }
}

#[test]
fn a_relative_tree_is_the_same_with_linear_and_ordinary_factors() {
    for (kind, count) in [(Kind::Plane, 2), (Kind::Plane, 6), (Kind::Space, 4)] {
        for seed in 0..10 {
            let scene = neighborhood(kind, count, seed);
            let node = scene.ids()[0];
            let [linear, ordinary] = [Recovery::Glc, Recovery::Nonlinear]
                .map(|recovery| scene.plan(node, tree().with_recovery(recovery)));
            let blanket = &linear.steps()[0].blanket;
            let ordinary_step = &ordinary.steps()[0];
            let all_between = ordinary_step.added.iter().all(|f| f.name.starts_with("Between"));
            assert!(all_between, "{ordinary_step:#?}");
            let answer = answer(&scene, &[node], blanket);
            let [(a, g), (b, h)] =
                [&linear, &ordinary].map(|plan| normal(&added(&scene, plan, blanket)));
            assert_close(&a, &b, &answer.scale, 1e-9, "information");
            assert_same_gradient(&g, &h, &answer, 1e-9);
            let difference = linear.constant() - ordinary.constant();
            assert!(difference.abs() < 1e-9 * linear.constant().abs().max(1.0));
        }
    }
}

#[test]
fn ranges_from_three_poses_need_the_whole_blanket() {
    use evergraph_factors::Range;
    use evergraph_model::{Point2, Pose2};
    let mut draw = Draw::new(3);
    let scene = Scene::of(|change| {
        let point = Point2::new(1.0, 2.0);
        let landmark = change.add_variable(&point);
        for pose in
            [Pose2::new(0.0, 0.0, 0.3), Pose2::new(4.0, 0.0, 1.0), Pose2::new(1.0, 5.0, 0.0)]
        {
            let key = change.add_variable(&pose);
            let z = (pose.translation().vector() - point.vector()).norm() + 0.1;
            change.add_factor(Range::new(key, landmark, z, draw.noise(1)).unwrap());
        }
    });
    for recovery in [Recovery::Glc, Recovery::Nonlinear] {
        let plan = scene.plan(scene.ids()[0], Options::default().with_recovery(recovery));
        let step = &plan.steps()[0];
        assert_eq!((step.rank, step.topology), (1, Topology::Dense));
        assert_eq!(step.fallback, Some(Fallback::DenseForRank));
        assert_eq!(step.added.len(), 1);
    }
}

/// An offset of several turns: an ordinary prior cannot hold it, because its logarithm would lose them.
#[test]
fn an_offset_of_more_than_half_a_turn_becomes_a_linear_factor() {
    use evergraph_factors::{BetweenPose2, Linear};
    use evergraph_model::{LieGroup, Noise, Pose2, Value};
    let scene = Scene::of(|change| {
        let z = Pose2::new(1.0, 0.2, 0.3);
        let keys = [Pose2::identity(), z].map(|x| change.add_variable(&x));
        let noise = Noise::isotropic(3, 0.1).unwrap();
        change.add_factor(BetweenPose2::new(keys[0], keys[1], z, noise).unwrap());
        // Next to nothing known of a heading that is said to be far off.
        let rows = nalgebra::DMatrix::from_diagonal_element(3, 3, 0.01);
        let offset = nalgebra::DVector::from_vec(vec![0.0, 0.0, 15.0]);
        let known = [(keys[0].id(), Value::new(&Pose2::identity()))];
        change.add_factor(Linear::new(&known, RootShift::None, rows, offset).unwrap());
    });
    let node = scene.ids()[0];
    let options = Options::default().with_recovery(Recovery::Nonlinear);
    let plan = scene.plan(node, options);
    let step = &plan.steps()[0];
    assert_eq!(step.fallback, None);
    assert!(step.added.len() == 1 && step.added[0].linear, "{step:?}");
    let answer = answer(&scene, &[node], &step.blanket);
    let (lambda, eta) = normal(&added(&scene, &plan, &step.blanket));
    assert_close(&lambda, &answer.lambda, &answer.scale, 1e-9, "information");
    assert_same_gradient(&eta, &answer.eta, &answer, 1e-9);
}

/// A node seen by `others` poses, of which one is said to be `turn` off, with `weight`.
fn turned_away(
    weight: f64,
    turn: f64,
    recovery: Recovery,
    others: usize,
) -> (Option<Fallback>, usize) {
    use evergraph_factors::{BetweenPose2, Linear};
    use evergraph_model::{LieGroup, Noise, Pose2, Value};
    let scene = Scene::of(|change| {
        let node = change.add_variable(&Pose2::identity());
        let noise = Noise::isotropic(3, 0.005).unwrap();
        for k in 0..others {
            let z = Pose2::new(1.0 + k as f64, 0.2, 0.3);
            let other = change.add_variable(&z);
            if k > 0 {
                change.add_factor(BetweenPose2::new(node, other, z, noise.clone()).unwrap());
                continue;
            }
            let mut rows = nalgebra::DMatrix::zeros(3, 6);
            rows.columns_mut(3, 3).fill_with_identity();
            let offset = nalgebra::DVector::from_vec(vec![0.0, 0.0, 0.0, 0.0, 0.0, turn]);
            let known = [(node.id(), Value::new(&Pose2::identity())), (other.id(), Value::new(&z))];
            let linear = Linear::new(&known, RootShift::Root, rows * weight, offset).unwrap();
            change.add_factor(linear);
        }
    });
    let node = scene.ids()[0];
    let plan = scene.plan(node, tree().with_recovery(recovery));
    let step = &plan.steps()[0];
    let answer = answer(&scene, &[node], &step.blanket);
    let (lambda, eta) = normal(&added(&scene, &plan, &step.blanket));
    if step.fallback == Some(Fallback::ShortenedOffset) {
        assert!(step.largest_length <= 100.0 * (1.0 + 1e-9) && step.topology == Topology::ChowLiu);
    } else {
        assert_same_gradient(&eta, &answer.eta, &answer, 1e-9);
    }
    if step.topology == Topology::Dense {
        assert_close(&lambda, &answer.lambda, &answer.scale, 1e-9, "information");
    }
    (step.fallback, step.added.len())
}

#[test]
fn a_tree_that_is_well_known_to_lie_far_off_becomes_one_factor() {
    let dense = (Some(Fallback::DenseForOffset), 1);
    for recovery in [Recovery::Glc, Recovery::Nonlinear] {
        // Near; far, but next to nothing is known there; far and known; near in turns, far in sigmas.
        assert_eq!(turned_away(10.0, 0.3, recovery, 3), (None, 2));
        assert_eq!(turned_away(0.01, 15.0, recovery, 3), (None, 2));
        assert_eq!(turned_away(10.0, 2.0, recovery, 3), dense);
        assert_eq!(turned_away(1000.0, 0.5, recovery, 3), dense);
    }
    // A large blanket keeps its tree, with an offset at the limit.
    for others in [16, 17, 30] {
        let (fallback, factors) = turned_away(1000.0, 2.0, Recovery::Glc, others);
        let expected = match others {
            16 => (Fallback::DenseForOffset, 1),
            _ => (Fallback::ShortenedOffset, others - 1),
        };
        assert_eq!((fallback, factors), (Some(expected.0), expected.1));
    }
    // Between two, a tree of what is relative is exact.
    for recovery in [Recovery::Glc, Recovery::Nonlinear] {
        assert_eq!(turned_away(10.0, 2.0, recovery, 2).0, None);
    }
}

/// What is relative between a pose and landmarks has no trace of the world either.
#[test]
fn poses_and_landmarks_have_no_trace_of_the_world() {
    use evergraph_factors::{BetweenPose3, Linear, RelativePosition3};
    use evergraph_model::{LieGroup, Noise, Point3, Pose3};
    use nalgebra::Vector6;
    let scene = Scene::of(|change| {
        let pose = |k: f64| Pose3::exp(&Vector6::new(k, 0.3 * k, 0.1, 0.2 * k, -0.1, 0.4 * k));
        let keys = [0.0, 1.0, 2.0].map(|k| change.add_variable(&pose(k)));
        for k in [1, 2] {
            let z = pose(k as f64 - 1.0).between(&pose(k as f64));
            let noise = Noise::isotropic(6, 0.1).unwrap();
            change.add_factor(BetweenPose3::new(keys[k - 1], keys[k], z, noise).unwrap());
        }
        for k in 0..2 {
            let point = Point3::new(3.0, k as f64, 1.0);
            let landmark = change.add_variable(&point);
            for (key, at) in [(keys[0], pose(0.0)), (keys[1], pose(1.0))] {
                let z = at.inverse_transform_point(&point);
                let noise = Noise::isotropic(3, 0.2).unwrap();
                change.add_factor(RelativePosition3::new(key, landmark, z, noise).unwrap());
            }
        }
    });
    for options in [Options::default(), Options::dense()] {
        let plan = scene.plan(scene.ids()[1], options);
        assert!(!plan.change().new_factors().is_empty());
        for (_, factor) in plan.change().new_factors() {
            let (linear, _) = factor.downcast::<Linear>().unwrap();
            assert_eq!(linear.root_shift(), RootShift::Root);
            let dim = linear.linearization_points()[0].dim();
            assert_eq!((dim, linear.sqrt_information().columns(0, dim).amax()), (6, 0.0));
        }
    }
}

/// Where a tree goes from a landmark on to a pose that sees it, the pose is still the root of the shift.
#[test]
fn a_landmark_is_seen_from_the_pose_below_it() {
    use evergraph_factors::{BetweenPose2, Linear, Prior, RelativePosition2};
    use evergraph_model::{LieGroup, Noise, Point2, Pose2};
    let scene = Scene::of(|change| {
        let (at_a, at_b) = (Pose2::new(1.0, 0.0, 0.2), Pose2::new(3.0, 0.5, -0.4));
        let point = Point2::new(2.5, 1.0);
        let noise = |sigma: f64| Noise::isotropic(3, sigma).unwrap();
        let node = change.add_variable(&Pose2::identity());
        let [a, b] = [at_a, at_b].map(|pose| change.add_variable(&pose));
        let landmark = change.add_variable(&point);
        change.add_factor(Prior::new(a, at_a, noise(0.1)).unwrap());
        change.add_factor(BetweenPose2::new(node, a, at_a, noise(0.1)).unwrap());
        change.add_factor(BetweenPose2::new(node, b, at_b, noise(10.0)).unwrap());
        for (key, pose) in [(node, Pose2::identity()), (b, at_b)] {
            let seen = pose.inverse_transform_point(&point);
            let noise = Noise::isotropic(2, 0.01).unwrap();
            change.add_factor(RelativePosition2::new(key, landmark, seen, noise).unwrap());
        }
    });
    let plan = scene.plan(scene.ids()[0], Options::tree());
    let (b, landmark) = (scene.ids()[2], scene.ids()[3]);
    let pair = plan
        .change()
        .new_factors()
        .iter()
        .find(|(_, factor)| factor.keys().contains(&landmark) && factor.keys().contains(&b));
    let (_, factor) = pair.expect("the landmark says most of where the second pose is");
    assert_eq!(factor.keys(), [b, landmark]);
    let (linear, _) = factor.downcast::<Linear>().unwrap();
    assert_eq!(linear.root_shift(), RootShift::Root);
}

/// Poses are added and removed beside three that stay, each with knowledge of the world: what removals put on one of the
/// three is one factor, and the map's error and gradient are kept.
#[test]
fn unary_factors_of_removals_are_merged() {
    use evergraph_factors::{BetweenPose2, Prior};
    use evergraph_model::{LieGroup, Noise, Pose2};
    for recovery in [Recovery::Glc, Recovery::Nonlinear] {
        let mut scene = Scene::of(|change| {
            for x in [0.0, 2.0, 4.0] {
                change.add_variable(&Pose2::new(x, 0.1 * x, 0.2 * x));
            }
        });
        let kept = scene.ids();
        for round in 0..6 {
            let mut change = scene.graph.change();
            let off = 0.1 * f64::from(round);
            let at = Pose2::new(1.0 + off, 1.0, 0.3);
            let node = change.add_variable(&at);
            let noise = Noise::from_sigmas(&[0.1, 0.2, 0.05]).unwrap();
            for (k, &id) in kept.iter().enumerate() {
                let key = scene.graph.key::<Pose2>(id).unwrap();
                let other = scene.values().value(id).unwrap().get::<Pose2>().unwrap();
                let z = at.between(&other).compose(&Pose2::new(0.05 * k as f64, -off, 0.02));
                change.add_factor(BetweenPose2::new(node, key, z, noise.clone()).unwrap());
            }
            let z = at.compose(&Pose2::new(0.2, off, -0.1));
            change.add_factor(Prior::new(node, z, Noise::isotropic(3, 0.5).unwrap()).unwrap());
            let staged = scene.graph.stage(&change).unwrap();
            scene.graph.commit(staged);
            scene.data.resize(scene.graph.value_len(), 0.0);
            let index = scene.graph.variable_index(node.id()).unwrap();
            let range = scene.graph.value_range(index);
            scene.data[range].copy_from_slice(Value::new(&at).storage());

            let plan = scene.plan(node.id(), Options::tree().with_recovery(recovery));
            let (_, before) = without_node(&scene, node.id());
            let after = reduced(&scene, &plan);
            let now = system(&after, &kept);
            let size = before.1.amax().max(1.0);
            assert!((&before.1 - &now.1).amax() < 1e-9 * size, "{recovery:?} {round}: gradient");
            // With the node at its best; its error above that is what the constant has.
            let unary = after.graph.factors().filter(|(_, factor)| factor.keys().len() == 1);
            assert_eq!(unary.count(), 1, "{recovery:?} {round}");
            let error = |scene: &Scene| scene.graph.error(&scene.data).unwrap();
            let best = best_error(&scene, node.id());
            let off = best - error(&after) - plan.constant();
            assert!(off.abs() < 1e-9 * best, "{recovery:?} {round}: {off}");
            scene = after;
        }
    }
}

/// The error of the linear model with a node at its best and all else where it is.
fn best_error(scene: &Scene, node: VariableId) -> f64 {
    let order = scene.ids();
    let (jacobian, residual) = scene.stack(scene.graph.factors().map(|(_, f)| f), &order);
    let place = order.iter().position(|&id| id == node).unwrap();
    let start: usize = order[..place]
        .iter()
        .map(|&id| scene.graph.dim_at(scene.graph.variable_index(id).unwrap()))
        .sum();
    let dim = scene.graph.dim_at(scene.graph.variable_index(node).unwrap());
    let own = jacobian.columns(start, dim).into_owned();
    let gradient = own.tr_mul(&residual);
    let step = own.tr_mul(&own).cholesky().unwrap().solve(&gradient);
    0.5 * residual.norm_squared() - 0.5 * gradient.dot(&step)
}
