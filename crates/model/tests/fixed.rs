//! Fixed variables are no columns of the linear system, and the graph goes back exactly.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::hash::{DefaultHasher, Hasher};

use common::Sum;
use evergraph_model::{Graph, GraphError, Point2, VariableId};

fn hash(graph: &Graph) -> u64 {
    let mut hash = DefaultHasher::new();
    graph.hash_state(&mut hash);
    hash.finish()
}

fn apply(graph: &mut Graph, alter: impl FnOnce(&mut evergraph_model::Change)) {
    let mut change = graph.change();
    alter(&mut change);
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
}

/// Three points and a factor on all of them.
fn three() -> (Graph, Vec<VariableId>) {
    let mut graph = Graph::new();
    let mut ids = Vec::new();
    apply(&mut graph, |change| {
        ids.extend((0..3).map(|k| change.add_variable(&Point2::new(f64::from(k), 1.0)).id()));
        change.add_factor(Sum { keys: ids.clone() });
    });
    (graph, ids)
}

fn linearization(graph: &Graph) -> Vec<f64> {
    let factor = graph.factor_indices().next().unwrap();
    let mut values = vec![0.0; graph.value_len()];
    for v in graph.variable_indices() {
        values[graph.value_range(v)].copy_from_slice(&[v.index() as f64, 1.0]);
    }
    let mut out = vec![f64::NAN; graph.linearization_len(factor)];
    graph.linearize(factor, &values, &mut out).unwrap();
    out
}

#[test]
fn the_linear_system_has_the_unknowns_only() {
    let (mut graph, ids) = three();
    let full = linearization(&graph);
    assert_eq!((graph.dim(), graph.unknown_count(), full.len()), (6, 3, 14));
    apply(&mut graph, |change| _ = change.fix(ids[1]));
    assert!(graph.is_fixed(ids[1]).unwrap() && !graph.is_fixed(ids[0]).unwrap());
    assert_eq!((graph.dim(), graph.unknown_count()), (4, 2));
    let factor = graph.factor_indices().next().unwrap();
    assert_eq!(graph.columns_at(factor), [0, 2, 4]);
    assert_eq!(graph.variables_at(factor).len(), 3);
    let unknowns: Vec<usize> = graph.unknowns_at(factor).iter().map(|v| v.index()).collect();
    assert_eq!(unknowns, [0, 2]);
    let blocks = [&full[..4], &full[8..]].concat();
    assert_eq!(linearization(&graph), blocks);
    apply(&mut graph, |change| _ = change.fix(ids[0]).fix(ids[2]));
    assert_eq!(linearization(&graph), full[12..]);
    assert_eq!((graph.dim(), graph.unknowns_at(factor).len()), (0, 0));
    apply(&mut graph, |change| _ = change.free(ids[0]).free(ids[1]).free(ids[2]));
    assert_eq!(linearization(&graph), full);
    assert_eq!(graph.dim(), 6);
}

#[test]
fn staging_names_what_has_a_new_shape_and_goes_back() {
    let (mut graph, ids) = three();
    apply(&mut graph, |change| _ = change.fix(ids[2]));
    let before = (hash(&graph), linearization(&graph));
    let mut change = graph.change();
    let new = change.add_variable(&Point2::new(5.0, 5.0)).id();
    change.add_factor(Sum { keys: vec![new, ids[0], ids[1]] });
    change.fix(ids[1]).fix(new).free(ids[2]).fix(ids[1]);
    let staged = graph.stage(&change).unwrap();
    let slot = |id: VariableId| graph.variable_index(id).unwrap();
    assert_eq!(staged.fixed(), [slot(ids[1])]);
    assert_eq!(staged.freed(), [slot(ids[2])]);
    assert_eq!(staged.reshaped().len(), 1, "the new factor has its shape from the start");
    let added = staged.new_factors().next().unwrap();
    assert_eq!(graph.unknowns_at(added), [slot(ids[0])]);
    graph.unstage(staged);
    assert_eq!((hash(&graph), linearization(&graph)), before);
    let versions = ids.iter().map(|id| graph.version(*id).unwrap()).collect::<Vec<_>>();
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
    assert_ne!(hash(&graph), before.0);
    // Fixed or freed once, and a factor more on two of them.
    let now = ids.iter().map(|id| graph.version(*id).unwrap());
    let by: Vec<u64> = now.zip(versions).map(|(now, before)| now - before).collect();
    assert_eq!(by, [1, 2, 1]);
    assert_eq!((graph.dim(), graph.unknown_count()), (4, 2));
}

#[test]
fn contradictions_are_refused() {
    let (mut graph, ids) = three();
    let before = hash(&graph);
    let foreign = Graph::new().change().add_variable(&Point2::new(0.0, 0.0)).id();
    let mut both = graph.change();
    both.fix(ids[0]).free(ids[0]);
    let mut dropped = graph.change();
    dropped.drop_variable_and_factors(&graph, ids[0]).unwrap().fix(ids[1]).fix(ids[0]);
    let mut unknown = graph.change();
    unknown.fix(ids[0]).free(foreign);
    for (change, expected) in [
        (both, "x0 is to be fixed and freed"),
        (dropped, "x0 is to be fixed and dropped"),
        (unknown, "another graph"),
    ] {
        let error = graph.stage(&change).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert_eq!(hash(&graph), before);
    }
    // A fixed variable can be dropped with its factors.
    apply(&mut graph, |change| _ = change.fix(ids[0]));
    let change = graph.change();
    let mut change = change;
    change.drop_variable_and_factors(&graph, ids[0]).unwrap();
    let staged = graph.stage(&change).unwrap();
    assert!(staged.reshaped().is_empty());
    graph.commit(staged);
    assert_eq!((graph.dim(), graph.unknown_count(), graph.variable_count()), (4, 2, 2));
    assert!(matches!(graph.is_fixed(ids[0]), Err(GraphError::UnknownVariable { .. })));
}
