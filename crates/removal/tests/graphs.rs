//! Removal from whole graphs: what it leaves where it was.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_factors::BetweenPose2;
use evergraph_model::{FactorId, Kernel, Key, LieGroup, Noise, Pose2, Robust, Values, VariableId};
use evergraph_removal::{MutualInformation, Options, Order, Recovery, Removal, Source};
use evergraph_solver::Smoother;
use nalgebra::{DMatrix, DVector};

#[test]
fn the_constant_closes_the_books() {
    for extras in [false, true] {
        let (smoother, keys) = drive(22, extras, 11);
        let scene = scene(smoother.graph(), &smoother.estimates().unwrap());
        let error = scene.graph.error(&scene.data).unwrap();
        let node = keys[4].id();
        for (topology, recovery, offset) in &VARIANTS[..4] {
            let options = Options::default()
                .with_topology(*topology)
                .with_recovery(*recovery)
                .with_offset(*offset);
            let plan = scene.plan(node, options);
            let after = reduced(&scene, &plan);
            let left = after.graph.error(&after.data).unwrap();
            assert!((error - left - plan.constant()).abs() < 1e-9 * error, "{options:?}");
            let freedom = |s: &Scene| {
                let rows: usize = s.graph.factors().map(|(_, f)| f.residual_dim()).sum();
                rows as i64 - s.graph.dim() as i64
            };
            assert_eq!(freedom(&scene) - freedom(&after), plan.degrees_of_freedom());
        }
    }
}

fn largest_move(before: &Values, after: &Values) -> f64 {
    let mut largest = 0.0_f64;
    for (id, now) in after.iter() {
        let then = before.value(id).unwrap();
        let mut local = vec![0.0; now.dim()];
        now.kind().local(then.storage(), now.storage(), &mut local);
        largest = local.iter().fold(largest, |m, x| m.max(x.abs()));
    }
    largest
}

#[test]
fn removal_at_the_optimum_moves_nothing() {
    for extras in [false, true] {
        let (smoother, keys) = drive(40, extras, 5);
        let before = smoother.estimates().unwrap();
        let nodes: Vec<VariableId> =
            keys.iter().enumerate().filter(|(k, _)| k % 2 == 1).map(|(_, key)| key.id()).collect();
        for options in keeping() {
            for order in [Order::Given, Order::Random(3), Order::MinDegree] {
                let mut after = smoother.clone();
                let plan = Removal::new(after.graph(), &before)
                    .with_options(options)
                    .plan_many(&nodes, order)
                    .unwrap();
                assert_eq!(plan.removed().count(), nodes.len());
                after.apply(plan.into_change()).unwrap();
                assert!(
                    largest_move(&before, &after.estimates().unwrap()) < 1e-6,
                    "{options:?} {order:?}"
                );
                optimum(&mut after);
                let moved = largest_move(&before, &after.estimates().unwrap());
                assert!(moved < 1e-6, "{moved:e} {options:?} {order:?}");
                assert_eq!(after.graph().variable_count(), before.len() - nodes.len());
            }
        }
        // The paper's offset does move: the test can fail.
        let mut after = smoother.clone();
        let plan = Removal::new(after.graph(), &before)
            .with_options(Options::paper())
            .plan_many(&nodes, Order::Given)
            .unwrap();
        after.apply(plan.into_change()).unwrap();
        optimum(&mut after);
        assert!(largest_move(&before, &after.estimates().unwrap()) > 1e-3);
    }
}

/// Moves linearization points away from the estimates: those of every second pose by up to one, of the
/// others by up to another distance.
fn move_points(smoother: &mut Smoother, keys: &[Key<Pose2>], far: [f64; 2]) {
    let mut draw = Draw::new(1);
    let mut change = smoother.change();
    for (k, &key) in keys.iter().enumerate() {
        let away = Pose2::exp(&draw.vector(far[k % 2]));
        let away = smoother.estimate(key).unwrap().compose(&away);
        change.move_linearization_point(key, &away);
    }
    smoother.apply(change).unwrap();
}

/// Points that move alone make the linear models of all factors between them and others inconsistent:
/// a removal leaves that to the smoother.
#[test]
fn linearization_points_stay_where_they_are() {
    let (mut smoother, keys) = drive(30, true, 6);
    let node = keys[13].id();
    // All in the linear model, none, and every second.
    for far in [[1e-3, 1e-3], [0.1, 0.1], [1e-3, 0.1]] {
        move_points(&mut smoother, &keys, far);
        let nonlinear = Options::default().with_recovery(Recovery::Nonlinear);
        for options in [Options::default(), Options::dense(), nonlinear] {
            let mut reduced = smoother.clone();
            let before = reduced.estimates().unwrap();
            let plan = Removal::new(reduced.graph(), &reduced).with_options(options).plan(node);
            let plan = plan.unwrap();
            assert!(plan.drift(&reduced).unwrap() < 1e-14);
            reduced.apply(plan.into_change()).unwrap();
            for id in reduced.graph().variables() {
                let point = reduced.linearization_point(id).unwrap();
                assert_eq!(point, smoother.linearization_point(id).unwrap());
            }
            // In the linear model nothing moves at all; away from it, as far as it is wrong there.
            let far = far[0].max(far[1]);
            let moved = largest_move(&before, &reduced.estimates().unwrap());
            let within = if far < options.linear_within { 1e-10 } else { 0.1 * far };
            assert!(moved < within, "{moved:e} {far} {options:?}");
        }
    }
}

/// The smoother relinearizes after a plan has been made: it holds all the same, and `drift` tells by how
/// much the estimate has changed.
#[test]
fn plans_hold_when_the_smoother_relinearizes() {
    let (mut smoother, keys) = drive(30, true, 6);
    move_points(&mut smoother, &keys, [5e-3; 2]);
    let plan = Removal::new(smoother.graph(), &smoother).plan(keys[13]).unwrap();
    optimum(&mut smoother);
    let before = smoother.estimates().unwrap();
    assert!(plan.drift(&smoother).unwrap() > 0.0);
    smoother.apply(plan.into_change()).unwrap();
    let moved = largest_move(&before, &smoother.estimates().unwrap());
    assert!(moved < 1e-3, "{moved:e}");
}

/// The error of the full graph is that of the reduced graph and the constant, in the linear model too.
#[test]
fn constants_are_of_the_estimate() {
    let (mut smoother, keys) = drive(30, true, 6);
    move_points(&mut smoother, &keys, [1e-3; 2]);
    for options in [Options::default(), Options::dense()] {
        let mut reduced = smoother.clone();
        let plan =
            Removal::new(reduced.graph(), &reduced).with_options(options).plan(keys[13].id());
        let plan = plan.unwrap();
        let constant = plan.constant();
        reduced.apply(plan.into_change()).unwrap();
        let (before, after) = (smoother.error().unwrap(), reduced.error().unwrap() + constant);
        assert!((before - after).abs() < 1e-5 * before, "{before} {after}");
    }
}

#[test]
fn groups_are_eliminated_exactly() {
    for extras in [false, true] {
        let (smoother, keys) = drive(36, extras, 7);
        let scene = scene(smoother.graph(), &smoother.estimates().unwrap());
        // A group of many, a pair, and one alone.
        let nodes: Vec<VariableId> = (2..16).chain([20, 21, 30]).map(|k| keys[k].id()).collect();
        let plan = priced(&scene, &nodes, Order::Given, Options::dense());
        assert!(plan.steps().len() < nodes.len(), "groups");
        let kept: Vec<_> = scene.ids().into_iter().filter(|id| !nodes.contains(id)).collect();
        let after = reduced(&scene, &plan);
        let order: Vec<_> = nodes.iter().chain(&kept).copied().collect();
        let full = system(&scene, &order);
        let (lambda, eta) = schur(&full, 3 * nodes.len());
        let (mine, gradient) = system(&after, &kept);
        let scale: Vec<f64> = lambda.diagonal().iter().map(|x| x.sqrt()).collect();
        assert_close(&mine, &lambda, &scale, 1e-9, "information");
        assert!((gradient - eta).amax() < 1e-9 * scale.iter().copied().fold(0.0, f64::max));
        assert!(plan.price().unwrap() < 1e-9);
        let constant =
            scene.graph.error(&scene.data).unwrap() - after.graph.error(&after.data).unwrap();
        assert!((constant - plan.constant()).abs() < 1e-9 * constant.abs());
    }
}

/// The neighbours of what holds the gauge stay relative, and nothing is lost by that.
#[test]
fn what_is_spared_stays() {
    let (smoother, keys) = drive(20, false, 3);
    let (graph, values) = (smoother.graph(), smoother.estimates().unwrap());
    let prior = graph.factors().find(|(_, factor)| factor.keys().len() == 1).unwrap().0;
    let nodes = [keys[1].id()];
    let plan = |spared: &[FactorId]| {
        let removal =
            Removal::new(graph, &values).with_options(Options::dense().with_keep_unary(false));
        removal.sparing(spared).plan_many(&nodes, Order::Given).unwrap()
    };
    let (absorbed, spared) = (plan(&[]), plan(&[prior]));
    assert!(absorbed.steps()[0].absorbed.contains(&Source::Graph(prior)));
    assert!(!spared.steps()[0].absorbed.contains(&Source::Graph(prior)));
    assert_eq!(absorbed.steps()[0].rank, spared.steps()[0].rank + 3);
    let whole = scene(graph, &values);
    let kept: Vec<VariableId> = graph.variables().filter(|id| *id != nodes[0]).collect();
    let expected = marginal(&whole, &kept);
    for plan in [absorbed, spared] {
        let found = marginal(&reduced(&whole, &plan), &kept);
        assert!((&found.0 - &expected.0).amax() < 1e-9 * expected.0.amax());
        assert!((&found.1 - &expected.1).amax() < 1e-9);
    }
    // On the node itself there is nothing to be left alone.
    let removal =
        Removal::new(graph, &values).with_options(Options::dense().with_keep_unary(false));
    let first = removal.sparing(&[prior]).plan(keys[0].id()).unwrap();
    assert!(first.steps()[0].absorbed.contains(&Source::Graph(prior)));
}

#[test]
fn chow_liu_is_the_best_of_all_trees() {
    // Every spanning tree of three others, as the price sees them: of the pairs that a tree joins.
    for seed in 0..10 {
        let scene = neighborhood(Kind::Plane, 3, seed);
        let node = scene.ids()[0];
        let limit = MutualInformation::Limit;
        let plan = scene.plan(node, Options::default().with_mutual_information(limit));
        let blanket = plan.steps()[0].blanket.clone();
        let answer = answer(&scene, &[node], &blanket);
        // Hold the first: a regular problem with the same relative information.
        let held = |lambda: &DMatrix<f64>| lambda.view((3, 3), (6, 6)).into_owned();
        let p = held(&answer.lambda).cholesky().unwrap().inverse();
        let zero = DVector::zeros(6);
        let (mine, _) = normal(&added(&scene, &plan, &blanket));
        let of = |lambda: &DMatrix<f64>| {
            let q = held(lambda).cholesky().unwrap().inverse();
            divergence(&(p.clone(), zero.clone()), &(q, zero.clone()))
        };
        let best = of(&mine);
        for skipped in 0..3 {
            // Marginals of the two pairs other than `skipped`.
            let mut total = DMatrix::zeros(9, 9);
            for other in (0..3).filter(|&k| k != skipped) {
                let order: Vec<usize> =
                    std::iter::once(other).chain((0..3).filter(|&k| k != other)).collect();
                let at = |i: usize| 3 * order[i / 3] + i % 3;
                let turned = DMatrix::from_fn(9, 9, |i, j| answer.lambda[(at(i), at(j))]);
                let (pair, _) = schur(&(turned, DVector::zeros(9)), 3);
                for i in 0..6 {
                    for j in 0..6 {
                        total[(at(i + 3), at(j + 3))] += pair[(i, j)];
                    }
                }
            }
            assert!(best <= of(&total) + 1e-8, "seed {seed}: {best} and {}", of(&total));
        }
    }
}

#[test]
fn robust_factors_enter_with_their_weight() {
    let mut ids: Vec<FactorId> = Vec::new();
    let scene = Scene::of(|change| {
        let poses = [0.0, 1.0, 2.0, 3.0].map(|x| Pose2::new(x, 0.0, 0.0));
        let keys = poses.map(|x| change.add_variable(&x));
        let noise = || Noise::isotropic(3, 0.1).unwrap();
        let kernel = Kernel::huber(1.0).unwrap();
        let mut robust = |i: usize, j: usize, off: f64| {
            let z = Pose2::new(poses[j].x() - poses[i].x() + off, 0.0, 0.0);
            let factor = BetweenPose2::new(keys[i], keys[j], z, noise()).unwrap();
            ids.push(change.add_factor(Robust::new(factor, kernel)));
        };
        // Weights 1, 1/3, and 1/1000 on the node; 1/2000 between others.
        robust(0, 1, 0.0);
        robust(0, 2, 0.3);
        robust(0, 3, 0.2);
        robust(0, 3, 100.0);
        robust(1, 2, 200.0);
    });
    let node = scene.ids()[0];
    let all = Options::dense().with_least_weight(0.0);
    let plan = scene.plan(node, all);
    let blanket = plan.steps()[0].blanket.clone();
    let expected = answer(&scene, &[node], &blanket);
    let (lambda, eta) = normal(&added(&scene, &plan, &blanket));
    assert_close(&lambda, &expected.lambda, &expected.scale, 1e-9, "information");
    assert_same_gradient(&eta, &expected.eta, &expected, 1e-9);

    let plan = scene.plan(node, Options::dense());
    let step = &plan.steps()[0];
    assert_eq!(step.rejected, [Source::Graph(ids[3])], "too light to be absorbed");
    let absorbed: Vec<_> = ids[..3].iter().map(|&id| Source::Graph(id)).collect();
    assert_eq!(step.absorbed, absorbed);
    assert!(
        !plan.change().dropped_factors().contains(&ids[4]),
        "stays where it can be weighed again"
    );
}

#[test]
fn lost_on_purpose_is_lost() {
    let (smoother, keys) = drive(30, false, 2);
    let options = Options::default().with_recovery(Recovery::Drop);
    let values = smoother.estimates().unwrap();
    let node = keys[14];
    let plan = Removal::new(smoother.graph(), &values).with_options(options).plan(node).unwrap();
    assert!(plan.change().new_factors().is_empty());
    let mut dropped = plan.change().dropped_factors().to_vec();
    let mut on_node = smoother.graph().factors_of(node.id()).unwrap();
    dropped.sort_unstable();
    on_node.sort_unstable();
    assert_eq!(dropped, on_node);
}

/// Compounding two edges and merging parallel ones, by hand.
#[test]
fn composition_compounds_and_merges() {
    let sigma = |s: f64| Noise::isotropic(3, s).unwrap();
    let [a, b] = [Pose2::new(1.0, 0.5, 0.3), Pose2::new(0.7, -0.2, -0.8)];
    let scene = Scene::of(|change| {
        let m = change.add_variable(&Pose2::identity());
        let i = change.add_variable(&a.inverse());
        let j = change.add_variable(&b);
        change.add_factor(BetweenPose2::new(i, m, a, sigma(0.1)).unwrap());
        change.add_factor(BetweenPose2::new(m, j, b, sigma(0.2)).unwrap());
    });
    let options = Options::default().with_recovery(Recovery::Composition);
    let plan = scene.plan(scene.ids()[0], options);
    let (_, factor) = &plan.change().new_factors()[0];
    let (between, _) = factor.downcast::<BetweenPose2>().unwrap();
    let from_first = between.from() == scene.ids()[1];
    let expected = if from_first { a * b } else { (a * b).inverse() };
    assert!(between.measurement().between(&expected).log().norm() < 1e-12);
    let transport = b.inverse().adjoint();
    let mut covariance: nalgebra::Matrix3<f64> =
        0.01 * transport * transport.transpose() + 0.04 * nalgebra::Matrix3::<f64>::identity();
    if !from_first {
        let back = (a * b).adjoint();
        covariance = back * covariance * back.transpose();
    }
    let information = between.noise().information();
    let product = information * DMatrix::from_column_slice(3, 3, covariance.as_slice());
    assert!((product - DMatrix::identity(3, 3)).amax() < 1e-9);
}
