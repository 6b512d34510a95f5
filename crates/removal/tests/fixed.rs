//! Fixed variables: given beside a removed node, and removed themselves.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_model::*;
use evergraph_removal::{Options, Order, Removal, RemovalError};
use nalgebra::{DMatrix, DVector};

/// The scene with some variables fixed.
fn with_fixed(scene: &Scene, fixed: &[VariableId]) -> Scene {
    let mut graph = scene.graph.clone();
    let mut change = graph.change();
    for &id in fixed {
        change.fix(id);
    }
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
    Scene { graph, data: scene.data.clone() }
}

fn dim(scene: &Scene, ids: &[VariableId]) -> usize {
    ids.iter().map(|&id| scene.graph.dim_at(scene.graph.variable_index(id).unwrap())).sum()
}

/// `(J, r)` of factors over `unknowns`, without the columns of the fixed variables.
fn unknown_stack(
    scene: &Scene,
    factors: Vec<&dyn Factor>,
    unknowns: &[VariableId],
    fixed: &[VariableId],
) -> (DMatrix<f64>, DVector<f64>) {
    let order = [unknowns, fixed].concat();
    let (jacobian, residual) = scene.stack(factors, &order);
    (jacobian.columns(0, dim(scene, unknowns)).into_owned(), residual)
}

/// Variables of the blanket of the first are fixed in turn, alone and with the next.
#[test]
fn fixed_neighbours_are_given() {
    let mut checked = 0;
    for kind in KINDS {
        for seed in 0..6 {
            let free = neighborhood(kind, 4, seed);
            let ids = free.ids();
            let node = ids[0];
            for first in 1..ids.len() {
                for more in [0, 1] {
                    let fixed: Vec<VariableId> =
                        ids[first..].iter().copied().take(1 + more).collect();
                    let scene = with_fixed(&free, &fixed);
                    for options in keeping().map(|options| options.with_least_weight(0.0)) {
                        checked += usize::from(check(&scene, node, &fixed, options));
                    }
                }
            }
        }
    }
    assert!(checked > 500, "{checked}");
}

/// Compares a removal with dense algebra. `false` where nothing is left to carry the information.
fn check(scene: &Scene, node: VariableId, fixed: &[VariableId], options: Options) -> bool {
    let values = scene.values();
    let mut removal = Removal::new(&scene.graph, &values).with_options(options);
    let plan = match removal.plan(node) {
        Ok(plan) => plan,
        Err(RemovalError::NoBlanket { .. } | RemovalError::LastPose { .. }) => return false,
        Err(error) => panic!("{error}"),
    };
    let step = &plan.steps()[0];
    let what = format!("{node} beside {fixed:?}, {options:?}");
    assert!(step.blanket.iter().all(|id| !fixed.contains(id)), "{what}");
    for (_, factor) in plan.change().new_factors() {
        assert!(factor.keys().iter().all(|key| !fixed.contains(key)), "{what}");
    }
    if step.blanket.is_empty() {
        return false;
    }
    let unknowns = [&[node][..], &step.blanket].concat();
    let absorbed = step.absorbed.iter().map(|&source| &**plan.factor(source).unwrap()).collect();
    let stack = unknown_stack(scene, absorbed, &unknowns, fixed);
    let node_dim = dim(scene, &[node]);
    let full = normal(&stack).0;
    let (lambda, eta) = eliminated(&stack, node_dim);
    let floor = 1e-3 * full.diagonal().max().sqrt();
    let scale = (node_dim..full.nrows()).map(|i| full[(i, i)].sqrt().max(floor)).collect();
    let blanket = step.blanket.clone();
    let answer = Answer { blanket, lambda, eta, scale, stack, node_dim };
    let factors = plan.change().new_factors().iter().map(|(_, factor)| &**factor);
    let (new, gradient) = normal(&scene.stack(factors, &step.blanket));
    assert_same_gradient(&gradient, &answer.eta, &answer, 1e-7);
    if step.topology == evergraph_removal::Topology::Dense {
        assert_close(&new, &answer.lambda, &answer.scale, 1e-8, &what);
    }
    true
}

/// Each fixed variable is removed: information and gradient of the others stay as they are, here and elsewhere.
#[test]
fn a_removed_fixed_variable_leaves_its_value() {
    for kind in KINDS {
        for seed in 0..6 {
            let free = neighborhood(kind, 4, seed);
            let ids = free.ids();
            for &node in &ids[1..] {
                let scene = with_fixed(&free, &[node]);
                let values = scene.values();
                let mut removal = Removal::new(&scene.graph, &values);
                let plan = match removal.plan(node) {
                    Ok(plan) => plan,
                    Err(RemovalError::LastPose { .. }) => continue,
                    Err(error) => panic!("{error}"),
                };
                let mut reduced = reduced(&scene, &plan);
                assert!(reduced.graph.check_variable(node).is_err());
                let mut scene = scene;
                let unknowns: Vec<VariableId> =
                    ids.iter().copied().filter(|&id| id != node).collect();
                for step in [0.0, 0.05] {
                    for (k, &id) in unknowns.iter().enumerate() {
                        let index = scene.graph.variable_index(id).unwrap();
                        let value = scene.values().value(id).unwrap().to_value();
                        let delta: Vec<f64> =
                            (0..value.dim()).map(|i| step * ((5 * k + i) as f64).cos()).collect();
                        let moved = value.retract(&delta).unwrap();
                        for scene in [&mut scene, &mut reduced] {
                            let range = scene.graph.value_range(index);
                            scene.data[range].copy_from_slice(moved.storage());
                        }
                    }
                    let all = scene.graph.factors().map(|(_, factor)| factor).collect();
                    let before = normal(&unknown_stack(&scene, all, &unknowns, &[node]));
                    let after = normal(
                        &reduced
                            .stack(reduced.graph.factors().map(|(_, factor)| factor), &unknowns),
                    );
                    let size = before.0.amax();
                    assert!((&before.0 - &after.0).amax() <= 1e-12 * size, "{node} {kind:?}");
                    let size = size.sqrt() * (1.0 + before.1.amax());
                    assert!((&before.1 - &after.1).amax() <= 1e-12 * size, "{node} {kind:?}");
                    let error = |scene: &Scene| scene.graph.error(&scene.data).unwrap();
                    let lost = error(&scene) - error(&reduced) - plan.constant();
                    assert!(lost.abs() <= 1e-9 * (1.0 + error(&scene)), "{lost:e}");
                }
            }
        }
    }
}

/// Fixed and free nodes in one plan: that of the others after the fixed ones are conditioned on.
#[test]
fn fixed_and_free_nodes_go_together() {
    for kind in KINDS {
        let free = neighborhood(kind, 5, 3);
        let ids = free.ids();
        let scene = with_fixed(&free, &ids[1..2]);
        for options in [Options::dense(), Options::default()] {
            let values = scene.values();
            let mut removal = Removal::new(&scene.graph, &values).with_options(options);
            let plan = removal.plan_many(&ids[..2], Order::MinDegree);
            let plan = match plan {
                Ok(plan) => plan,
                Err(RemovalError::LastPose { .. }) => continue,
                Err(error) => panic!("{error}"),
            };
            let reduced = reduced(&scene, &plan);
            assert_eq!(reduced.graph.variable_count(), ids.len() - 2);
            let drift = plan.drift(&reduced.values()).unwrap();
            assert!(drift < 1e-12, "{drift}");
        }
    }
}
