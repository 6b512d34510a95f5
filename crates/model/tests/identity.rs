//! An id never answers for another variable: after refused changes, in clones, after loading.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use common::Sum;
use evergraph_model::{
    Change, Factor, FactorId, Graph, GraphError, Point2, SavedGraph, VariableId, VariableType,
};
use rand::rngs::SmallRng;
use rand::{Rng, RngExt, SeedableRng};

/// A graph with the numbers of its variables, as a solver keeps them.
#[derive(Clone)]
struct World {
    graph: Graph,
    points: Vec<f64>,
    /// What each living id was given.
    values: BTreeMap<VariableId, f64>,
    factors: BTreeSet<FactorId>,
}

impl World {
    fn new() -> Self {
        let (points, values) = (Vec::new(), BTreeMap::new());
        Self { graph: Graph::new(), points, values, factors: BTreeSet::new() }
    }

    fn apply(&mut self, change: &Change) -> Result<(), GraphError> {
        let staged = self.graph.stage(change)?;
        self.points.resize(self.graph.value_len(), 0.0);
        for (id, value) in change.new_variables() {
            let range = self.graph.value_range(self.graph.variable_index(*id).unwrap());
            self.points[range].copy_from_slice(value.storage());
            self.values.insert(*id, value.storage()[0]);
        }
        self.factors.extend(change.new_factors().iter().map(|(id, _)| *id));
        self.graph.commit(staged);
        change.dropped_variables().iter().for_each(|id| _ = self.values.remove(id));
        change.dropped_factors().iter().for_each(|id| _ = self.factors.remove(id));
        Ok(())
    }

    /// Every id that was ever given, in any graph, answers for its own variable or for none.
    fn check(&self, all: &BTreeMap<VariableId, f64>) {
        for (&id, &value) in all {
            match (self.graph.variable_index(id), self.values.get(&id)) {
                (Ok(index), Some(_)) => {
                    assert_eq!(self.points[self.graph.value_range(index)][0], value, "{id}");
                    assert_eq!(self.graph.variable_id(index), id);
                }
                (Err(GraphError::UnknownVariable { .. } | GraphError::Foreign { .. }), None) => (),
                (found, known) => panic!("{id}: {found:?} where {known:?} is known"),
            }
        }
        assert_eq!(self.graph.variable_count(), self.values.len());
        assert_eq!(self.graph.factor_count(), self.factors.len());
    }

    fn pick(&self, random: &mut impl Rng) -> Option<VariableId> {
        let n = self.values.len();
        (n > 0).then(|| *self.values.keys().nth(random.random_range(0..n)).unwrap())
    }

    /// A change that adds variables with values of their own, and drops some.
    fn change(&self, random: &mut impl Rng, next_value: &mut f64) -> Change {
        let mut change = self.graph.change();
        let mut ends: Vec<VariableId> = self.pick(random).into_iter().collect();
        for _ in 0..random.random_range(0..3) {
            *next_value += 1.0;
            ends.push(change.add_variable(&Point2::new(*next_value, 0.0)).id());
        }
        if !ends.is_empty() && random.random_bool(0.7) {
            change.add_factor(Sum { keys: ends.clone() });
        }
        if let Some(id) = self.pick(random)
            && random.random_bool(0.4)
            && !ends.contains(&id)
        {
            change.drop_variable_and_factors(&self.graph, id).unwrap();
        }
        change
    }

    fn saved_and_loaded(&self) -> Self {
        let encode = |factor: &Arc<dyn Factor>| {
            let sum = factor.as_any().downcast_ref::<Sum>();
            Ok::<_, GraphError>(sum.unwrap().keys.clone())
        };
        let text = serde_json::to_string(&self.graph.save(encode).unwrap()).unwrap();
        let saved: SavedGraph<Vec<VariableId>> = serde_json::from_str(&text).unwrap();
        let point = VariableType::of::<Point2>();
        let graph = Graph::load(
            &saved,
            &self.points,
            |name| (name == point.name()).then_some(point),
            |keys| Ok::<_, GraphError>(Arc::new(Sum { keys: keys.clone() }) as Arc<dyn Factor>),
        );
        Self { graph: graph.unwrap(), ..self.clone() }
    }
}

/// Refused changes, clones, saves and loads, in any order; 10⁵ sequences.
#[test]
fn no_id_ever_answers_for_another_variable() {
    for seed in 0..100_000 {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut worlds = vec![World::new()];
        let mut all = BTreeMap::new();
        let mut kept: Vec<Change> = Vec::new();
        let mut next_value = 0.0;
        for _ in 0..8 {
            let at = random.random_range(0..worlds.len());
            match random.random_range(0..10) {
                0 if worlds.len() < 4 => worlds.push(worlds[at].clone()),
                1 if worlds.len() < 4 => worlds.push(worlds[at].saved_and_loaded()),
                2 => {
                    // Refused: it drops a variable whose factors stay, or a foreign one.
                    let mut change = worlds[at].change(&mut random, &mut next_value);
                    change
                        .drop_variable(Graph::new().change().add_variable(&Point2::new(0.0, 0.0)));
                    record(&change, &mut all);
                    let before = worlds[at].graph.ids();
                    assert!(worlds[at].apply(&change).is_err(), "seed {seed}");
                    drop(before);
                }
                3 if !kept.is_empty() => {
                    // Made earlier, perhaps for another copy, perhaps applied before.
                    let change = kept[random.random_range(0..kept.len())].clone();
                    _ = worlds[at].apply(&change);
                }
                _ => {
                    let change = worlds[at].change(&mut random, &mut next_value);
                    record(&change, &mut all);
                    kept.push(change.clone());
                    if random.random_bool(0.8) {
                        _ = worlds[at].apply(&change);
                    }
                }
            }
        }
        worlds.iter().for_each(|world| world.check(&all));
    }
}

fn record(change: &Change, all: &mut BTreeMap<VariableId, f64>) {
    for (id, value) in change.new_variables() {
        assert!(all.insert(*id, value.storage()[0]).is_none(), "{id} was given twice");
    }
}

fn grow(world: &mut World, pulled: f64) -> VariableId {
    let mut change = world.graph.change();
    let id = change.add_variable(&Point2::new(pulled, 0.0)).id();
    world.apply(&change).unwrap();
    id
}

#[test]
fn two_clones_and_a_loaded_copy_give_different_ids() {
    let mut first = World::new();
    let shared = grow(&mut first, 1.0);
    let (mut second, mut loaded) = (first.clone(), first.saved_and_loaded());
    let (a, b, c) = (grow(&mut first, 2.0), grow(&mut second, 3.0), grow(&mut loaded, 4.0));
    assert!(a != b && a != c && b != c);
    for world in [&first, &second, &loaded] {
        assert!(world.graph.check_variable(shared).is_ok());
    }
    assert!(matches!(second.graph.check_variable(a), Err(GraphError::UnknownVariable { .. })));
    assert!(matches!(first.graph.check_variable(c), Err(GraphError::Foreign { .. })));
    assert!(matches!(Graph::new().check_variable(a), Err(GraphError::Foreign { .. })));
}

#[test]
fn a_change_is_applied_once() {
    let mut world = World::new();
    let mut change = world.graph.change();
    let id = change.add_variable(&Point2::new(1.0, 0.0));
    world.apply(&change).unwrap();
    assert!(matches!(world.apply(&change), Err(GraphError::AddedBefore { .. })));
    let mut drop = world.graph.change();
    drop.drop_variable(id);
    world.apply(&drop).unwrap();
    assert!(matches!(world.apply(&change), Err(GraphError::AddedBefore { .. })));
    assert!(matches!(world.apply(&drop), Err(GraphError::UnknownVariable { .. })));
}

#[test]
fn changes_made_ahead_of_each_other_are_applied_in_any_order() {
    let mut world = World::new();
    let ids = world.graph.ids();
    let (mut first, mut second, mut third) = (ids.change(), ids.change(), ids.change());
    let a = first.add_variable(&Point2::new(1.0, 0.0)).id();
    let b = second.add_variable(&Point2::new(2.0, 0.0)).id();
    third.add_factor(Sum { keys: vec![a, b] });
    assert!(matches!(world.apply(&third), Err(GraphError::UnknownVariable { .. })));
    world.apply(&second).unwrap();
    world.apply(&first).unwrap();
    world.apply(&third).unwrap();
    // Slots follow the order in which changes were applied.
    assert_eq!(world.graph.variable_index(b).unwrap().index(), 0);
    assert_eq!(world.graph.degree(a).unwrap(), 1);
}

#[test]
fn merged_changes_are_one() {
    let mut world = World::new();
    let old = grow(&mut world, 1.0);
    let version = world.graph.version(old).unwrap();
    let mut removal = world.graph.change();
    removal.drop_variable(old).require(old, version);
    let mut measurement = world.graph.change();
    let new = measurement.add_variable(&Point2::new(2.0, 0.0)).id();
    measurement.add_factor(Sum { keys: vec![new] });
    let mut merged = measurement.clone();
    merged.merge(removal.clone()).unwrap();
    world.apply(&merged).unwrap();
    assert_eq!(world.values.keys().copied().collect::<Vec<_>>(), [new]);
    let mut late = world.graph.change();
    late.require(old, version);
    assert!(matches!(world.apply(&late), Err(GraphError::Stale { .. })));
    let foreign = Graph::new().change();
    assert!(matches!(merged.merge(foreign), Err(GraphError::Foreign { .. })));
    // Both drop the same.
    let mut world = World::new();
    let old = grow(&mut world, 1.0);
    let mut twice = world.graph.change();
    twice.drop_variable(old);
    twice.merge(twice.clone()).unwrap();
    assert!(matches!(world.apply(&twice), Err(GraphError::Twice { .. })));
}

#[test]
fn an_empty_change_does_nothing() {
    let graph = Graph::new();
    let id = graph.change().add_variable(&Point2::new(0.0, 0.0)).id();
    let mut change = graph.change();
    assert!(change.is_empty());
    change.require(id, 0);
    assert!(change.is_empty());
    assert!(!graph.change().fix(id).is_empty());
    assert!(!graph.change().free(id).is_empty());
    assert!(!graph.change().drop_variable(id).is_empty());
}
