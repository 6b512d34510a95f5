//! Prices against the divergence by its definition, over everything that is kept.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_model::{Key, LieGroup, Pose2, VariableId};
use evergraph_removal::{Offset, Options, Order, Recovery, Removal, Topology};
use evergraph_solver::Smoother;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

#[test]
fn the_price_is_the_divergence_of_everything_kept() {
    for extras in [false, true] {
        for seed in 0..4 {
            let (smoother, keys) = drive(22, extras, seed);
            let scene = scene(smoother.graph(), &smoother.estimates().unwrap());
            for node in [keys[3], keys[8], keys[14]].map(Key::id) {
                let kept: Vec<_> = scene.ids().into_iter().filter(|&id| id != node).collect();
                let before = marginal(&scene, &kept);
                for (topology, recovery, offset) in VARIANTS {
                    if extras && recovery == Recovery::Composition {
                        continue;
                    }
                    let options = Options::default()
                        .with_topology(topology)
                        .with_recovery(recovery)
                        .with_offset(offset);
                    let plan = priced(&scene, &[node], Order::Given, options);
                    let after = marginal(&reduced(&scene, &plan), &kept);
                    let expected = divergence(&before, &after);
                    let price = plan.price().unwrap();
                    assert!(
                        (price - expected).abs() < 1e-6 * expected.max(1.0),
                        "{topology:?} {recovery:?} {offset:?}: {price} for {expected}"
                    );
                    match topology {
                        Topology::Dense => assert!(price < 1e-9, "{price}"),
                        Topology::ChowLiu if scene.graph.factors_of(node).unwrap().len() > 3 => {
                            assert!(price > 1e-6, "{price}")
                        }
                        _ => {}
                    }
                }
            }
        }
    }
}

#[test]
fn many_prices_are_close_to_the_divergence_of_all_of_it() {
    let (smoother, keys) = drive(40, false, 9);
    let scene = scene(smoother.graph(), &smoother.estimates().unwrap());
    let nodes: Vec<VariableId> = (5..35).step_by(3).map(|k| keys[k].id()).collect();
    let kept: Vec<_> = scene.ids().into_iter().filter(|id| !nodes.contains(id)).collect();
    let before = marginal(&scene, &kept);
    let mut totals = Vec::new();
    for order in [Order::Given, Order::MinDegree, Order::MinLoss, Order::Random(1)] {
        let plan = priced(&scene, &nodes, order, tree());
        let exact = divergence(&before, &marginal(&reduced(&scene, &plan), &kept));
        let price = plan.price().unwrap();
        assert!((price / exact - 1.0).abs() < 0.3, "{order:?}: {price} for {exact}");
        let again = priced(&scene, &nodes, order, tree());
        assert_eq!(plan.steps(), again.steps(), "the same plan each time");
        totals.push(exact);
    }
    assert!(totals[2] < 1.2 * totals[0], "least loss first: {totals:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..Default::default() })]

    /// Random cliques of every kind and rank, each a part of a map.
    #[test]
    fn a_clique_costs_what_all_marginals_lose(
        kind in 0..KINDS.len(), count in 1..6usize, seed: u64,
    ) {
        let bare = neighborhood(KINDS[kind], count, seed);
        let mut draw = Draw::new(seed ^ 1);
        let scene = bare.in_a_map(&mut draw);
        let node = scene.ids()[0];
        let (kept, full) = without_node(&scene, node);
        // The estimate is where the map as it is has its mean: what is left of the gradient there
        // counts as something else's, before and after.
        let moments = |(lambda, eta): &(DMatrix<f64>, DVector<f64>)| {
            let sigma = lambda.clone().cholesky().unwrap().inverse();
            let mean = &sigma * (eta - &full.1);
            (sigma, mean)
        };
        let before = moments(&full);
        let place = |id: VariableId| -> usize {
            let upto = kept.iter().take_while(|&&other| other != id);
            upto.map(|other| scene.graph.dim_at(scene.graph.variable_index(*other).unwrap())).sum()
        };
        let mut joint = |ids: &[VariableId]| {
            let scalars: Vec<usize> = ids
                .iter()
                .flat_map(|id| place(*id)..place(*id) + scene.graph.dim_at(scene.graph.variable_index(*id).unwrap()))
                .collect();
            Ok::<_, String>(before.0.select_rows(&scalars).select_columns(&scalars))
        };
        let others = [
            Options::dense().with_offset(Offset::Zero),
            Options::default().with_recovery(Recovery::Drop),
            Options::paper(),
            Options::isam(),
        ];
        for options in keeping().into_iter().chain(others) {
            let plan = Removal::new(&scene.graph, &scene.values())
                .with_options(options)
                .priced_by(&mut joint)
                .plan(node)
                .unwrap();
            let expected = divergence(&before, &moments(&system(&reduced(&scene, &plan), &kept)));
            let price = plan.price().unwrap();
            prop_assert!(
                (price - expected).abs() < 1e-6 * expected.max(1.0),
                "{price} for {expected}, {options:?}: {plan:#?}"
            );
            if options.topology == Topology::Dense && options.offset == Offset::KeepGradient {
                prop_assert!(price < 1e-9, "{price}");
            }
        }
    }
}

/// All linearization points turned and shifted by one motion: covariances of poses that come from
/// them are those at the estimate as they stand, because tangents move along.
#[test]
fn a_motion_in_common_changes_no_price() {
    let (at_optimum, keys) = drive(30, false, 3);
    let motion = Pose2::new(3.0, -2.0, 0.7);
    let mut smoother = at_optimum.clone();
    let mut change = smoother.change();
    for &key in &keys {
        let estimate = at_optimum.estimate(key).unwrap();
        change.move_linearization_point(key, &motion.compose(&estimate));
    }
    smoother.apply(change).unwrap();
    for k in [4, 9, 17, 22] {
        let point: Pose2 = smoother.linearization_point(keys[k].id()).unwrap().get().unwrap();
        let turn = point.between(&smoother.estimate(keys[k]).unwrap()).theta();
        assert!(turn.abs() > 0.6, "the estimate is far from the point: {turn}");
        let price = |smoother: &Smoother| {
            let plan = Removal::new(smoother.graph(), smoother)
                .with_options(tree())
                .priced_by(&mut smoother.covariances())
                .plan(keys[k])
                .unwrap();
            plan.price().unwrap()
        };
        let (here, there) = (price(&smoother), price(&at_optimum));
        assert!((here - there).abs() < 1e-6 * there.max(1e-3), "{here} and {there}");
        assert!(there > 1e-6, "{there}");
    }
}
