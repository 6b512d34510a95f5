//! Dense removal against inversion, cropping and inversion in twice the precision: on every kind
//! of factor and variable, one node or half of them, whatever the rank of the target.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;

use evergraph::factors::RootShift;
use evergraph::model::{Graph, VariableId};
use evergraph::removal::{Options, Order, Plan, Recovery, Removal, RemovalError, Step, Topology};
use evergraph::solver::{BatchSettings, Elimination};
use evergraph_tests::dim_of;
use evergraph_tests::double::{Double, Normal};
use evergraph_tests::world::{MAKERS, Operation, World};
use nalgebra::DMatrix;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What the bound is times the condition number.
const PRECISION: f64 = 1e-14;

/// A graph with a point for every variable.
#[derive(Clone)]
struct Scene {
    graph: Graph,
    points: Vec<f64>,
}

impl Scene {
    /// At least `count` variables, joined by at least three factors of every kind, some robust.
    fn every_factor(count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut world = World::new(Elimination::Cholesky);
        let mut next = 0;
        while world.smoother.graph().variable_count() < count
            || world.applied.iter().any(|&applied| applied < 3)
        {
            let mut any = || rng.random::<u64>() as usize;
            let (what, pick, other) = (any(), any(), any());
            world.run(&match what % 6 {
                0 => Operation::Extend { kind: pick as u8, from: other, turn: 0.4 },
                1 => Operation::Weak { maker: other, pick },
                // Every kind in turn: at random some would hardly ever come.
                _ => Operation::Measure { maker: next, pick, robust: other % 4 == 0 },
            });
            next += 1;
        }
        world.smoother.optimize(&BatchSettings::default()).unwrap();
        let (graph, estimates) = (world.smoother.graph(), world.smoother.estimates().unwrap());
        let mut points = vec![0.0; graph.value_len()];
        for (id, value) in estimates.iter() {
            points[graph.value_range(graph.variable_index(id).unwrap())]
                .copy_from_slice(value.storage());
        }
        Self { graph: graph.clone(), points }
    }

    fn ids(&self) -> Vec<VariableId> {
        self.graph.variables().collect()
    }

    fn remover<T>(&self, options: Options, ask: impl FnOnce(&mut Removal<'_>) -> T) -> T {
        let estimate = |id: VariableId| {
            let index = self.graph.variable_index(id)?;
            Ok(self.graph.value(index, &self.points[self.graph.value_range(index)]))
        };
        ask(&mut Removal::new(&self.graph, &estimate).with_options(options))
    }

    /// The first `count` of `nodes` that can all go: together they must leave each of them somebody
    /// who knows where it is.
    fn removable(&self, nodes: &[VariableId], count: usize) -> Vec<VariableId> {
        let mut nodes = nodes.to_vec();
        loop {
            let chosen = &nodes[..count];
            match self.remover(Options::dense(), |r| r.plan_many(chosen, Order::Given)) {
                Ok(plan) => match plan.steps().iter().find(|step| step.free_directions > 0) {
                    Some(step) => nodes.retain(|&id| id != step.removed[0]),
                    None => return chosen.to_vec(),
                },
                Err(RemovalError::NoBlanket { variable }) => nodes.retain(|&id| id != variable),
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// Without what is measured of a single variable: nobody knows where in the world all of it is.
    fn adrift(&self) -> Self {
        let mut change = self.graph.change();
        for (id, factor) in self.graph.factors() {
            if factor.keys().len() == 1 {
                change.drop_factor(id);
            }
        }
        let mut graph = self.graph.clone();
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
        Self { graph, points: self.points.clone() }
    }

    fn with(&self, plan: &Plan) -> Self {
        let mut graph = self.graph.clone();
        let staged = graph.stage(plan.change()).unwrap();
        graph.commit(staged);
        Self { graph, points: self.points.clone() }
    }

    /// `(Λ, η)` over the variables in `order`, of the factors that are on those only.
    fn normal(&self, order: &[VariableId]) -> Normal {
        let mut first = vec![usize::MAX; self.graph.variable_slots()];
        let mut dim = 0;
        for id in order {
            first[self.graph.variable_index(*id).unwrap().index()] = dim;
            dim += dim_of(&self.graph, *id);
        }
        let mut normal = Normal::zeros(dim);
        for f in self.graph.factor_indices() {
            let variables = self.graph.variables_at(f);
            if variables.iter().any(|&v| first[v.index()] == usize::MAX) {
                continue;
            }
            let mut block = vec![0.0; self.graph.linearization_len(f)];
            self.graph.linearize(f, &self.points, &mut block).unwrap();
            let (rows, columns) = (self.graph.rows_at(f), self.graph.columns_at(f));
            for i in 0..rows {
                let mut row = Vec::new();
                for (k, &v) in variables.iter().enumerate() {
                    for column in columns[k]..columns[k + 1] {
                        let place = first[v.index()] + (column - columns[k]) as usize;
                        row.push((place, block[column as usize * rows + i]));
                    }
                }
                let residual = block[*columns.last().unwrap() as usize * rows + i];
                normal.add_row(&row, residual);
            }
        }
        normal
    }

    fn dim(&self, ids: &[VariableId]) -> usize {
        ids.iter().map(|id| dim_of(&self.graph, *id)).sum()
    }
}

/// A share of what is known of each scalar of the blanket: the anchor of a target that may know
/// nothing of some direction. It is weak, so that a target that is next to singular does not look
/// better than it is.
const ANCHOR: f64 = 1e-4;

/// Condition number with the diagonal scaled to 1.
fn condition(normal: &Normal) -> f64 {
    let scale = |i: usize| normal.entry(i, i).sqrt();
    let scaled =
        DMatrix::from_fn(normal.dim, normal.dim, |i, j| normal.entry(i, j) / scale(i) / scale(j));
    let eigen = scaled.symmetric_eigenvalues();
    eigen.max() / eigen.min().max(1e-300)
}

/// Compares the marginals over what is kept (the last columns of `full`) with those of `reduced`:
/// covariance, relative to the standard deviations, and mean, relative to both standard deviations
/// and the length of the residual. Returns
/// the condition number and the worst error over it.
fn compare(full: &Normal, reduced: &Normal, what: &str) -> [f64; 2] {
    // A node that shares no factor with others has no blanket to compare.
    if reduced.dim == 0 {
        return [0.0, 0.0];
    }
    let gone = full.dim - reduced.dim;
    let (expected, expected_mean) = full.inverse().unwrap_or_else(|| panic!("{what}: singular"));
    let (found, mean) = reduced.inverse().unwrap_or_else(|| panic!("{what}: a direction is free"));
    let condition = condition(full);
    assert!(condition < 1e13, "{what}: a condition of {condition:e} shows nothing");
    let deviation = |i: usize| {
        let i = i + gone;
        expected[i * full.dim + i].value().sqrt()
    };
    // ηᵀ Λ⁻¹ η, the length of what of the residual the variables can explain.
    let explained = expected_mean.iter().zip(&full.gradient).map(|(&x, &g)| (x * g).value());
    let length = explained.sum::<f64>().sqrt().max(1.0);
    let mut worst = 0.0_f64;
    for i in 0..reduced.dim {
        for j in 0..reduced.dim {
            let difference =
                found[i * reduced.dim + j] - expected[(i + gone) * full.dim + j + gone];
            worst = worst.max(difference.value().abs() / deviation(i) / deviation(j));
        }
        let difference = mean[i] - expected_mean[i + gone];
        worst = worst.max(difference.value().abs() / deviation(i) / length);
    }
    let error = worst / condition;
    assert!(error <= PRECISION, "{what}: off by {worst:e} at a condition of {condition:e}");
    [condition, error]
}

/// Adds the same weak knowledge of what is kept to both.
fn anchor(full: &mut Normal, reduced: &mut Normal) {
    let gone = full.dim - reduced.dim;
    let largest = (0..full.dim).map(|i| full.entry(i, i)).fold(0.0, f64::max);
    for i in 0..reduced.dim {
        // What cancels within a factor leaves rounding of the size of the others.
        let known = full.entry(i + gone, i + gone).max(1e-6 * largest);
        for (normal, i) in [(&mut *full, i + gone), (&mut *reduced, i)] {
            let entry = &mut normal.information[i * normal.dim + i];
            *entry = *entry + Double::from(ANCHOR * known);
        }
    }
}

fn larger(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].max(b[0]), a[1].max(b[1])]
}

/// The forms that an exact removal can take.
fn exact() -> [Options; 3] {
    let dense = Options::dense().with_least_weight(0.0);
    [
        dense,
        dense.with_root_shift(RootShift::None),
        dense.with_recovery(Recovery::Nonlinear).with_intra_clique(false),
    ]
}

/// The target information itself, of every variable of a graph alone. Most know nothing of where in
/// the world they are, or of less: the rest of the graph is replaced by an anchor on what is kept.
#[test]
fn every_node_alone_over_its_blanket() {
    let (mut absorbed, mut deficient, mut nodes) = (BTreeSet::new(), 0, 0);
    let mut worst = [0.0; 2];
    for seed in 0..2 {
        let scene = Scene::every_factor(60, seed);
        for node in scene.ids() {
            for options in exact() {
                let plan = match scene.remover(options, |r| r.plan(node)) {
                    Ok(plan) => plan,
                    // Held by itself alone.
                    Err(RemovalError::NoBlanket { .. }) => continue,
                    Err(error) => panic!("{error}"),
                };
                let step = &plan.steps()[0];
                assert_eq!((step.topology, step.free_directions), (Topology::Dense, 0));
                let order: Vec<VariableId> =
                    std::iter::once(node).chain(step.blanket.iter().copied()).collect();
                let mut full = scene.normal(&order);
                let mut reduced = scene.with(&plan).normal(&step.blanket);
                nodes += 1;
                deficient += usize::from(step.rank < reduced.dim);
                anchor(&mut full, &mut reduced);
                let what = format!("seed {seed}, {node}, {options:?}");
                worst = larger(worst, compare(&full, &reduced, &what));
                let factors = scene.graph.factors_of(node).unwrap();
                absorbed.extend(factors.iter().map(|&f| scene.graph.factor(f).unwrap().name()));
            }
        }
    }
    println!("{nodes} removals, {deficient} rank-deficient, condition and error over it {worst:?}");
    assert!(2 * deficient > nodes && nodes > 200, "{deficient} of {nodes}");
    let all: BTreeSet<String> = absorbed;
    for maker in MAKERS {
        let name = maker.name.split([' ', '<']).next().unwrap();
        let name = if name == "AutoDiff" { "ClockRange" } else { name };
        assert!(all.iter().any(|n| n.contains(name)), "no {name} among {all:?}");
    }
}

/// 1, 10 and 50 % of all nodes; the marginals of everything that is kept, in graphs whose place in
/// the world is known and in others where nothing says it.
#[test]
fn a_share_of_the_nodes() {
    let (mut worst, mut deficient) = ([0.0; 2], 0);
    for (seed, adrift) in [(0, false), (1, false), (0, true), (1, true)] {
        let mut scene = Scene::every_factor(100, seed);
        if adrift {
            scene = scene.adrift();
        }
        let mut candidates = scene.ids();
        candidates.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        for percent in [1, 10, 50] {
            let count = scene.graph.variable_count() * percent / 100;
            let nodes = scene.removable(&candidates, count.max(1));
            let kept: Vec<VariableId> =
                scene.ids().into_iter().filter(|id| !nodes.contains(id)).collect();
            let order: Vec<VariableId> = nodes.iter().chain(&kept).copied().collect();
            let full = scene.normal(&order);
            assert_eq!(full.inverse().is_none(), adrift, "unless adrift all is known");
            for options in exact() {
                let plan = scene.remover(options, |r| r.plan_many(&nodes, Order::Given)).unwrap();
                let reduced = scene.with(&plan);
                let partial = |step: &&Step| step.rank < scene.dim(&step.blanket);
                deficient += plan.steps().iter().filter(partial).count();
                let (mut full, mut reduced) = (full.clone(), reduced.normal(&kept));
                if adrift {
                    anchor(&mut full, &mut reduced);
                }
                let what = format!("seed {seed}, {percent} %, adrift {adrift}, {options:?}");
                worst = larger(worst, compare(&full, &reduced, &what));
            }
        }
    }
    println!("{deficient} rank-deficient groups, condition and error over it {worst:?}");
    assert!(deficient > 20, "{deficient}");
}
