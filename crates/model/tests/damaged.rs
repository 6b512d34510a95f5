//! A saved graph that was damaged gives an error or a sound graph, never a panic.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::sync::Arc;

use common::Sum;
use evergraph_model::{Factor, Graph, GraphError, Point2, SavedGraph, VariableId, VariableType};
use proptest::prelude::*;
use serde_json::Value as Json;

/// A graph with free slots and ranges, fixed variables and several factors, as text; its values.
fn saved() -> (Json, Vec<f64>) {
    let mut graph = Graph::new();
    let mut ids: Vec<VariableId> = Vec::new();
    for k in 0..8_u32 {
        let mut change = graph.change();
        ids.push(change.add_variable(&Point2::new(f64::from(k), 0.0)).id());
        if k > 0 {
            change.add_factor(Sum { keys: ids[ids.len() - 2..].to_vec() });
        }
        if k == 5 {
            change.fix(ids[2]).fix(ids[5]);
        }
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
    }
    for k in [1, 6] {
        let mut change = graph.change();
        change.drop_variable_and_factors(&graph, ids[k]).unwrap();
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
    }
    let encode = |factor: &Arc<dyn Factor>| {
        Ok::<_, GraphError>(factor.as_any().downcast_ref::<Sum>().unwrap().keys.clone())
    };
    let values = vec![1.0; graph.value_len()];
    (serde_json::to_value(graph.save(encode).unwrap()).unwrap(), values)
}

fn load(saved: &Json, values: &[f64]) -> Result<Graph, String> {
    let saved: SavedGraph<Vec<VariableId>> =
        serde_json::from_value(saved.clone()).map_err(|error| error.to_string())?;
    let point = VariableType::of::<Point2>();
    let graph = Graph::load(
        &saved,
        values,
        |name| (name == point.name()).then_some(point),
        |keys| Ok::<_, GraphError>(Arc::new(Sum { keys: keys.clone() }) as Arc<dyn Factor>),
    );
    graph.map_err(|error| error.to_string())
}

/// Every number, list and text of a document, as paths.
fn places(json: &Json, path: &str, out: &mut Vec<String>) {
    out.push(path.to_owned());
    match json {
        Json::Array(items) => {
            for (k, item) in items.iter().enumerate() {
                places(item, &format!("{path}/{k}"), out);
            }
        }
        Json::Object(fields) => {
            for (name, item) in fields {
                places(item, &format!("{path}/{name}"), out);
            }
        }
        _ => (),
    }
}

/// Uses a graph as a solver would.
fn exercise(graph: &mut Graph, values: &[f64]) {
    graph.error(values).unwrap();
    let variables: Vec<VariableId> = graph.variables().collect();
    let mut change = graph.change();
    let new = change.add_variable(&Point2::new(0.0, 0.0)).id();
    change.add_factor(Sum { keys: vec![new, variables[0]] });
    for &id in &variables[1..] {
        change.drop_variable_and_factors(graph, id).unwrap();
    }
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
    assert_eq!((graph.variable_count(), graph.factor_count()), (2, 1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]
    #[test]
    fn one_or_two_damaged_places(damages in prop::collection::vec((any::<prop::sample::Index>(), 0_usize..9), 1..3)) {
        let (mut json, values) = saved();
        for (place, how) in damages {
            let mut paths = Vec::new();
            places(&json, "", &mut paths);
            let at = json.pointer_mut(place.get::<String>(&paths)).unwrap();
            *at = match (how, &*at) {
                (0, _) => Json::Null,
                (1, _) => Json::from(u32::MAX),
                (2, _) => Json::from(u64::MAX),
                (3, _) => Json::Array(Vec::new()),
                (4, Json::Array(items)) => items.iter().chain(items.last()).cloned().collect(),
                (5, Json::Array(items)) => items.iter().rev().cloned().collect(),
                (6, Json::Bool(flag)) => Json::Bool(!flag),
                (_, Json::Number(number)) => Json::from(number.as_u64().unwrap_or(0).wrapping_add(1)),
                (_, other) => other.clone(),
            };
        }
        if let Ok(mut graph) = load(&json, &values) {
            exercise(&mut graph, &values);
        }
    }
}

#[test]
fn damage_of_each_kind_is_named() {
    let (json, values) = saved();
    exercise(&mut load(&json, &values).unwrap(), &values);
    let with = |pointer: &str, value: Json| {
        let mut damaged = json.clone();
        *damaged.pointer_mut(pointer).unwrap() = value;
        load(&damaged, &values).map(|_| ()).unwrap_err()
    };
    for (pointer, value, expected) in [
        ("/variables/0/kind", Json::from("Pose9"), "Pose9, which is not registered"),
        ("/variables/0/value/0", Json::from(2), "overlap"),
        ("/variables/0/value/1", Json::from(1), "1 stored numbers are no value of type Point2"),
        ("/variables/0/tangent/1", Json::from(1), "another tangent dimension"),
        ("/variables/0/factors", serde_json::json!([3]), "a factor that is not on it"),
        ("/variables/3/factors", serde_json::json!([]), "missing in the list"),
        ("/variables/1", json.pointer("/variables/0").unwrap().clone(), "free variable slots"),
        ("/free_factors", serde_json::json!([]), "free factor slots"),
        ("/value_layout/len", Json::from(90), "another length"),
        ("/used/0/variables", serde_json::json!([[0, 1]]), "not among the ids that were used"),
        ("/used/0/factors", serde_json::json!([[5, 1]]), "not in order"),
    ] {
        let error = with(pointer, value);
        assert!(error.contains(expected), "{pointer}: {error}");
    }
    assert!(load(&json, &values[1..]).unwrap_err().contains("another length"));
    let mut bad = values.clone();
    bad[0] = f64::NAN;
    assert!(load(&json, &bad).unwrap_err().contains("not finite"));
}
