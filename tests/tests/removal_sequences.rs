//! A thousand random sequences of adding, removing, dropping, moving and relinearizing, with stale
//! plans and other refusals among them, each operation checked against dense references.
//!
//! The same sequences each time; `PROPTEST_CASES` sets another number of them, `PROPTEST_RNG_SEED` names
//! others.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::cell::Cell;
use std::env;

use evergraph::model::Value;
use evergraph::prelude::*;
use evergraph_tests::world::{Operation, Removals, World};
use evergraph_tests::{check_against_batch, dim_of, stack};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use proptest::test_runner::{FileFailurePersistence, RngSeed, TestRunner};

fn operation() -> impl Strategy<Value = Operation> {
    let choice = any::<usize>;
    prop_oneof![
        8 => (any::<u8>(), choice(), -0.6..0.6_f64)
            .prop_map(|(kind, from, turn)| Operation::Extend { kind, from, turn }),
        2 => (choice(), choice()).prop_map(|(maker, pick)| Operation::Weak { maker, pick }),
        8 => (choice(), choice(), any::<bool>())
            .prop_map(|(maker, pick, robust)| Operation::Measure { maker, pick, robust }),
        5 => (choice(), any::<u8>(), any::<u8>())
            .prop_map(|(which, more, how)| Operation::Remove { which, more, how }),
        1 => (choice(), any::<u8>()).prop_map(|(which, how)| Operation::Stale { which, how }),
        1 => (choice(), any::<u8>()).prop_map(|(which, how)| Operation::FailRemoval { which, how }),
        1 => choice().prop_map(Operation::DropFactor),
        1 => choice().prop_map(Operation::Move),
        1 => any::<u8>().prop_map(Operation::Fail),
        1 => Just(Operation::Relinearize),
        1 => Just(Operation::Optimize),
    ]
}

#[test]
fn a_thousand_sequences() {
    let cases = env::var("PROPTEST_CASES").map_or(1000, |cases| cases.parse().unwrap());
    let persistence = FileFailurePersistence::Direct(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/proptest-regressions/removal_sequences.txt"
    ));
    let default = ProptestConfig::default();
    let rng_seed = match default.rng_seed {
        RngSeed::Random => RngSeed::Fixed(1),
        named => named,
    };
    let config = ProptestConfig {
        cases,
        rng_seed,
        failure_persistence: Some(Box::new(persistence)),
        ..default
    };
    let total = Cell::new(Removals::default());
    let number = Cell::new(0);
    let sequences = prop::collection::vec(operation(), 1..100);
    let outcome = TestRunner::new(config).run(&sequences, |operations| {
        number.set(number.get() + 1);
        let elimination = [Elimination::Cholesky, Elimination::Qr][number.get() % 2];
        let mut world = World::new(elimination);
        let mut on_two = number.get().is_multiple_of(8).then(|| World::on_threads(elimination, 2));
        for (step, operation) in operations.iter().enumerate() {
            let at = format!("step {step}, {operation:?}");
            world.run(operation);
            check_estimate(&world.smoother, &at);
            check_against_batch(&world.smoother, &at);
            if let Some(other) = &mut on_two {
                other.run(operation);
                assert_eq!(world.smoother.fingerprint(), other.smoother.fingerprint(), "{at}");
            }
        }
        let mut sum = total.get();
        sum += world.removals;
        total.set(sum);
        Ok(())
    });
    outcome.unwrap_or_else(|error| panic!("{error}"));
    let total = total.get();
    println!("{total:?}");
    if cases >= 1000 {
        let Removals { nodes, deficient, fallbacks, linear, beyond, stale, refused, lost } = total;
        assert!(nodes > 4000 && deficient > 1000 && fallbacks > 30, "{total:?}");
        assert!(linear > 500 && beyond > 200, "{total:?}");
        assert!(stale > 500 && refused > 500 && lost > 20, "{total:?}");
    }
}

/// The estimate of everybody is a dense Gauss-Newton step from the linearization points, with
/// Jacobians taken afresh from the factors of the present graph.
fn check_estimate(smoother: &Smoother, at: &str) {
    let graph = smoother.graph();
    // Fresh from an optimization the estimate is the point that it found.
    let at_optimum =
        |id| smoother.estimate_value(id).unwrap() == smoother.linearization_point(id).unwrap();
    if graph.variables().all(at_optimum) {
        return;
    }
    let order: Vec<VariableId> = graph.variables().collect();
    let (mut jacobian, residual) =
        stack(graph, &order, |id| smoother.linearization_point(id).unwrap());
    let scale: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
    for (mut column, scale) in jacobian.column_iter_mut().zip(&scale) {
        column /= *scale;
    }
    let length = residual.norm();
    let qr = jacobian.qr();
    let (q, r) = (qr.q(), qr.r());
    let solution = r.solve_upper_triangular(&-q.tr_mul(&residual)).unwrap();
    let rounding = 10.0 * f64::EPSILON * condition(&r);
    let tolerance = (rounding.max(1e-9) * solution.norm()).max(rounding * length).max(1e-290);
    let mut start = 0;
    for id in order {
        let dim = dim_of(graph, id);
        let delta: Vec<f64> = (start..start + dim).map(|i| solution[i] / scale[i]).collect();
        let point: Value = smoother.linearization_point(id).unwrap();
        let expected = point.retract(&delta).unwrap();
        let found = smoother.estimate_value(id).unwrap();
        let mut off = vec![0.0; dim];
        point.kind().local(expected.storage(), found.storage(), &mut off);
        // A turn by a large δ magnifies what the other components are off by.
        let reach = 1.0 + delta.iter().map(|d| d.abs()).fold(0.0, f64::max);
        for (i, off) in off.iter().enumerate() {
            let least = scale[start..start + dim].iter().copied().fold(f64::INFINITY, f64::min);
            assert!(
                off.abs() <= 10.0 * reach * (tolerance / least + f64::EPSILON * 1e3),
                "{at}: {id} is off by {off:e} in {i}, {tolerance:e} of {scale:?} allowed"
            );
        }
        start += dim;
    }
}

/// Of `RᵀR`, by power and inverse iteration.
fn condition(r: &DMatrix<f64>) -> f64 {
    let mut largest = DVector::from_fn(r.ncols(), |i, _| (i as f64 * 7919.0 + 13.0).sin());
    let mut smallest = largest.clone();
    let (mut high, mut low) = (0.0, 0.0);
    for _ in 0..15 {
        largest.normalize_mut();
        largest = r.tr_mul(&(r * largest));
        high = largest.norm();
        smallest.normalize_mut();
        let half = r.tr_solve_upper_triangular(&smallest).unwrap();
        smallest = r.solve_upper_triangular(&half).unwrap();
        low = smallest.norm();
    }
    high * low
}
