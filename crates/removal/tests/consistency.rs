//! Conservative trees: never more information than there was, whatever the rest of the map knows.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_model::VariableId;
use evergraph_removal::{Consistency, Fallback, Options, Order};
use nalgebra::DMatrix;
use proptest::prelude::*;

fn trees(consistency: Consistency) -> Options {
    Options::tree().with_consistency(consistency)
}

/// The largest eigenvalue of the information after with respect to that before, of covariances.
fn largest_eigenvalue(before: &DMatrix<f64>, after: &DMatrix<f64>) -> f64 {
    let l = before.clone().cholesky().unwrap().l();
    let information = after.clone().cholesky().unwrap().inverse();
    (l.transpose() * information * l).symmetric_eigenvalues().max()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..Default::default() })]

    #[test]
    fn a_conservative_removal_adds_no_information_anywhere(
        kind in 0..KINDS.len(), count in 2..6usize, seed: u64,
    ) {
        let bare = neighborhood(KINDS[kind], count, seed);
        let scene = bare.in_a_map(&mut Draw::new(seed ^ 1));
        let node = scene.ids()[0];
        let (kept, (before, _)) = without_node(&scene, node);
        let divergence = |consistency| {
            let plan = scene.plan(node, trees(consistency));
            let step = &plan.steps()[0];
            let after = system(&reduced(&scene, &plan), &kept).0;
            let root = before.clone().cholesky().unwrap().l();
            let half = root.solve_lower_triangular(&after).unwrap();
            let whitened = root.solve_lower_triangular(&half.transpose()).unwrap();
            let eigenvalues = whitened.symmetric_eigenvalues();
            if consistency != Consistency::None {
                let largest = eigenvalues.max();
                prop_assert!(largest <= 1.0 + 1e-9, "{largest} {step:?}");
                prop_assert!(step.fallback != Some(Fallback::ScaledForConsistency), "{step:?}");
                if let Some(certificate) = step.certificate {
                    prop_assert!(certificate.largest_eigenvalue <= 1.0 + 1e-11, "{certificate:?}");
                    prop_assert!(certificate.log_det_ratio >= -1e-9, "{certificate:?}");
                }
            }
            Ok(step.certificate.map_or(0.0, |certificate| certificate.divergence))
        };
        let conservative = divergence(Consistency::Conservative)?;
        let scaled = divergence(Consistency::Scaled)?;
        prop_assert!(conservative <= scaled + 1e-5, "{conservative} {scaled}");
        divergence(Consistency::None)?;
    }
}

/// Step by step, and all along: the bound of each removal is one on the map.
#[test]
fn sequences_stay_conservative() {
    for (extras, seed) in [(false, 1), (false, 2), (true, 3)] {
        let (smoother, keys) = drive(40, extras, seed);
        let mut left = scene(smoother.graph(), &smoother.estimates().unwrap());
        let whole = left.clone();
        let mut optimistic = 0;
        for consistency in [Consistency::Conservative, Consistency::None] {
            left = whole.clone();
            for key in keys[2..38].iter().step_by(2).map(|key| key.id()) {
                let plan = left.plan(key, trees(consistency));
                left = reduced(&left, &plan);
                let kept: Vec<VariableId> = left.graph.variables().collect();
                let largest =
                    largest_eigenvalue(&marginal(&whole, &kept).0, &marginal(&left, &kept).0);
                match consistency {
                    Consistency::Conservative => assert!(largest <= 1.0 + 1e-9, "{key}: {largest}"),
                    _ => optimistic += usize::from(largest > 1.01),
                }
            }
        }
        assert!(optimistic > 0, "trees without a bound claim too much somewhere");
    }
    let (smoother, keys) = drive(30, false, 5);
    let scene = scene(smoother.graph(), &smoother.estimates().unwrap());
    let nodes: Vec<VariableId> = keys[3..27].iter().step_by(3).map(|key| key.id()).collect();
    let plan = priced(&scene, &nodes, Order::Given, trees(Consistency::Conservative));
    assert!(plan.steps().iter().all(|step| step.certificate.is_some() || step.blanket.len() < 3));
}
