//! Panics and bad numbers from users' factors and manifolds are errors that name them.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::hash::{DefaultHasher, Hasher};

use common::{Fault, Faulty, Touchy};
use evergraph_model::{Graph, GraphError, Manifold, Point2, Value, VariableType};

fn hash(graph: &Graph) -> u64 {
    let mut hash = DefaultHasher::new();
    graph.hash_state(&mut hash);
    hash.finish()
}

#[test]
fn a_panic_while_a_change_is_checked_leaves_no_trace() {
    let mut graph = Graph::new();
    for fault in [Fault::Keys, Fault::Accepts, Fault::Name] {
        let before = hash(&graph);
        let mut change = graph.change();
        let key = change.add_variable(&Point2::new(0.0, 0.0)).id();
        change.add_factor(Faulty { key: [key], fault: Fault::None });
        change.add_factor(Faulty { key: [key], fault });
        let error = graph.stage(&change).unwrap_err();
        match fault {
            Fault::Name => assert!(
                matches!(&error, GraphError::NotAccepted { name, .. } if name.contains("without a name"))
            ),
            _ => assert!(
                matches!(&error, GraphError::FactorPanicked { name, message, .. }
                if name == "Faulty" && message.contains("the user's mistake")),
                "{error}"
            ),
        }
        assert_eq!(hash(&graph), before);
        assert_eq!((graph.variable_count(), graph.factor_count()), (0, 0));
    }
}

#[test]
fn a_panic_while_a_factor_is_evaluated_names_it() {
    for fault in [Fault::Residual, Fault::Linearize, Fault::Block] {
        let mut graph = Graph::new();
        let mut change = graph.change();
        let key = change.add_variable(&Point2::new(0.0, 0.0)).id();
        let id = change.add_factor(Faulty { key: [key], fault });
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
        let factor = graph.factor_index(id).unwrap();
        let values = vec![0.0; graph.value_len()];
        let error = match fault {
            Fault::Residual => graph.error(&values).unwrap_err(),
            _ => graph.linearize(factor, &values, &mut [0.0; 6]).unwrap_err(),
        };
        assert!(
            matches!(&error, GraphError::FactorPanicked { factor, name, .. } if *factor == id && name == "Faulty"),
            "{error}"
        );
    }
}

#[test]
fn a_manifold_that_panics_or_gives_nan_is_named() {
    let mut graph = Graph::new();
    let mut change = graph.change();
    let id = change.add_variable(&Touchy(1.0)).id();
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
    let index = graph.variable_index(id).unwrap();
    let mut out = [0.0];
    graph.retract(index, &[1.0], &[0.5], &mut out).unwrap();
    assert_eq!(out, [1.5]);
    let error = graph.retract(index, &[1.0], &[2.0], &mut out).unwrap_err();
    assert!(matches!(&error, GraphError::NonFiniteRetraction { variable, .. } if *variable == id));
    let error = graph.retract(index, &[1.0], &[20.0], &mut out).unwrap_err();
    assert!(
        error.to_string().contains("too far") && error.to_string().contains("Touchy"),
        "{error}"
    );
}

#[test]
fn stored_numbers_of_the_wrong_length_are_refused() {
    let point = VariableType::of::<Point2>();
    let value = Value::from_parts(point, &[1.0, 2.0]).unwrap();
    assert_eq!(value.get::<Point2>(), Some(Point2::new(1.0, 2.0)));
    for storage in [&[][..], &[1.0], &[1.0, 2.0, 3.0]] {
        let error = Value::from_parts(point, storage).unwrap_err();
        assert!(matches!(error, GraphError::BadStorage { .. }), "{error}");
    }
    assert_eq!(Touchy(3.0).dim(), 1);
}
