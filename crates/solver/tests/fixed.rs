//! Fixed variables are no unknowns of the linear system: against a dense reference, and in a map
//! that is frozen while a robot drives in it.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use evergraph_factors::{BetweenPose2, Prior, RelativePosition2};
use evergraph_model::{
    Arguments, Change, Key, LieGroup, Linearization, Noise, Point2, Pose2, Value, VariableId,
    VariableIndex,
};
use evergraph_solver::{
    Fluid, Relinearization, Report, Settings, Singular, Smoother, SmootherError,
};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn noise(sigma: f64) -> Noise {
    Noise::isotropic(3, sigma).unwrap()
}

fn smoother(relinearization: Relinearization) -> Smoother {
    Smoother::new(Settings::default().with_relinearization(relinearization)).unwrap()
}

/// Policies under which points move often.
fn policies() -> [Relinearization; 4] {
    let every = |n| NonZeroU32::new(n).unwrap();
    let fluid = Fluid::new(0.01, 0.5, every(1));
    let mut at_once = Relinearization::BOTH;
    (at_once.fluid, at_once.sweep, at_once.spread) = (Some(fluid), None, every(1));
    let mut spread = at_once;
    spread.spread = every(2);
    let mut background = Relinearization::BACKGROUND;
    (background.batch, background.background) = (Some(every(4)), Some(every(2)));
    [Relinearization::NEVER, at_once, spread, background]
}

/// The normal equations over the unknowns at the linearization points, from the factors themselves:
/// columns of fixed variables are computed and left out.
struct Dense {
    /// The first scalar of each unknown.
    starts: BTreeMap<VariableIndex, usize>,
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    error: f64,
}

impl Dense {
    fn of(smoother: &Smoother) -> Self {
        let graph = smoother.graph();
        let mut starts = BTreeMap::new();
        let mut dim = 0;
        for id in graph.variables() {
            if !graph.is_fixed(id).unwrap() {
                let index = graph.variable_index(id).unwrap();
                starts.insert(index, dim);
                dim += graph.dim_at(index);
            }
        }
        let mut dense = Self {
            starts,
            information: DMatrix::zeros(dim, dim),
            gradient: DVector::zeros(dim),
            error: 0.0,
        };
        for (_, factor) in graph.factors() {
            let points: Vec<Value> =
                factor.keys().iter().map(|&k| smoother.linearization_point(k).unwrap()).collect();
            let estimates = smoother.estimate_values(factor.keys()).unwrap();
            let mut residual = vec![0.0; factor.residual_dim()];
            let storages: Vec<&[f64]> = estimates.iter().map(Value::storage).collect();
            factor.residual(&Arguments::new(&storages), &mut residual);
            dense.error += factor.error(&residual);
            dense.add(smoother, factor.keys(), &points, factor.residual_dim(), |at, out| {
                factor.linearize(at, out);
            });
        }
        dense
    }

    fn add(
        &mut self,
        smoother: &Smoother,
        keys: &[VariableId],
        points: &[Value],
        rows: usize,
        linearize: impl Fn(&Arguments<'_>, &mut Linearization<'_>),
    ) {
        let storages: Vec<&[f64]> = points.iter().map(Value::storage).collect();
        let mut columns = vec![0_u32];
        points.iter().for_each(|p| columns.push(columns[columns.len() - 1] + p.dim() as u32));
        let width = columns[points.len()] as usize + 1;
        let mut data = vec![0.0; rows * width];
        let mut out = Linearization::new(rows, &columns, &mut data);
        linearize(&Arguments::new(&storages), &mut out);
        let block = DMatrix::from_column_slice(rows, width, &data);
        let place = |scalar: usize| {
            let position = (0..points.len()).find(|&p| scalar < columns[p + 1] as usize).unwrap();
            let index = smoother.graph().variable_index(keys[position]).unwrap();
            self.starts.get(&index).map(|start| start + scalar - columns[position] as usize)
        };
        let places: Vec<Option<usize>> = (0..width - 1).map(place).collect();
        for (i, row) in places.iter().enumerate() {
            let Some(row) = *row else { continue };
            self.gradient[row] += block.column(i).dot(&block.column(width - 1));
            for (j, column) in places.iter().enumerate() {
                if let Some(column) = *column {
                    self.information[(row, column)] += block.column(i).dot(&block.column(j));
                }
            }
        }
    }
}

/// The covariance of all variables times a vector, relative to the joint covariance of `ids`.
fn check_product(smoother: &Smoother, ids: &[VariableId], joint: &DMatrix<f64>, what: &str) {
    let graph = smoother.graph();
    let ranges = ids.iter().map(|id| graph.tangent_range(graph.variable_index(*id).unwrap()));
    let scalars: Vec<usize> = ranges.flatten().collect();
    let mut b = vec![0.0; graph.tangent_len()];
    scalars.iter().enumerate().for_each(|(k, &at)| b[at] = 1.0 + (k % 7) as f64);
    let product = smoother.covariances().times(&b).unwrap();
    let gathered = DVector::from_iterator(scalars.len(), scalars.iter().map(|&at| b[at]));
    let expected = joint * gathered;
    for (&at, expected) in scalars.iter().zip(&expected) {
        let off = (product[at] - expected).abs();
        assert!(off <= 1e-6 * (1.0 + joint.amax()), "{what}: product is off by {off}");
    }
    assert_eq!(
        smoother.covariances().times(&b[..b.len().saturating_sub(1)]).is_none(),
        !b.is_empty()
    );
}

/// Estimates, covariances and error are those of the dense equations; fixed variables stay.
fn check(smoother: &mut Smoother, fixed: &BTreeMap<VariableId, Value>, what: &str) {
    let dense = Dense::of(smoother);
    let graph = smoother.graph();
    let ids: Vec<VariableId> = graph.variables().collect();
    assert_eq!(graph.dim(), dense.gradient.len(), "{what}");
    assert_eq!(ids.iter().filter(|&&id| graph.is_fixed(id).unwrap()).count(), fixed.len());
    let covariance = match dense.information.clone().cholesky() {
        Some(factor) => factor.inverse(),
        None => DMatrix::zeros(0, 0),
    };
    assert_eq!(covariance.nrows(), dense.gradient.len(), "{what}: the reference is singular");
    let delta = -(&covariance * &dense.gradient);
    let deltas = smoother.deltas(&ids).unwrap();
    let joint = smoother.joint(&ids).unwrap();
    // The reference's scalar of each row of the joint covariance.
    let mut rows: Vec<Option<usize>> = Vec::new();
    for (id, found) in ids.iter().zip(&deltas) {
        let index = graph.variable_index(*id).unwrap();
        let start = dense.starts.get(&index);
        rows.extend((0..found.len()).map(|i| start.map(|start| start + i)));
        for (i, x) in found.iter().enumerate() {
            let expected = start.map_or(0.0, |start| delta[start + i]);
            let off = (x - expected).abs();
            assert!(off <= 1e-6 * (1.0 + expected.abs()), "{what}: {id} is off by {off}");
        }
    }
    for (i, row) in rows.iter().enumerate() {
        for (j, column) in rows.iter().enumerate() {
            let (expected, scale) = match (*row, *column) {
                (Some(a), Some(b)) => {
                    (covariance[(a, b)], (covariance[(a, a)] * covariance[(b, b)]).sqrt())
                }
                _ => (0.0, 0.0),
            };
            let off = (joint[(i, j)] - expected).abs();
            assert!(off <= 1e-6 * scale, "{what}: covariance ({i}, {j}) is off by {off}");
        }
    }
    check_product(smoother, &ids, &joint, what);
    for (id, value) in fixed {
        assert_eq!(smoother.estimate_value(*id).unwrap().storage(), value.storage(), "{what}");
    }
    let error = smoother.error().unwrap();
    assert!((error - dense.error).abs() <= 1e-9 * (1.0 + error), "{what}: {error}");
    let all = smoother.estimates().unwrap();
    let one_by_one = smoother.estimate_values(&ids).unwrap();
    let cached = smoother.cached_estimates(0.0).unwrap();
    for (id, value) in ids.iter().zip(&one_by_one) {
        assert_eq!(all.value(*id).unwrap().storage(), value.storage(), "{what}");
        assert_eq!(cached.value(*id).unwrap().storage(), value.storage(), "{what}: {id}, cached");
    }
}

/// A small world of poses and landmarks, and a generator of changes.
struct World {
    poses: Vec<Key<Pose2>>,
    landmarks: Vec<Key<Point2>>,
    rng: ChaCha8Rng,
}

impl World {
    fn wiggle(&mut self) -> Pose2 {
        let mut x = || self.rng.random_range(-0.3..0.3);
        Pose2::new(x(), x(), x())
    }

    fn any_pose(&mut self) -> Key<Pose2> {
        self.poses[self.rng.random_range(0..self.poses.len())]
    }

    /// Some variable, if there is one.
    fn any(&mut self) -> Option<VariableId> {
        let all: Vec<VariableId> = (self.poses.iter().map(|k| k.id()))
            .chain(self.landmarks.iter().map(|k| k.id()))
            .collect();
        (!all.is_empty()).then(|| all[self.rng.random_range(0..all.len())])
    }

    /// Adds one thing to a change. `dropped` are variables that it drops.
    fn add_to(&mut self, change: &mut Change, smoother: &Smoother, dropped: &mut Vec<VariableId>) {
        let kind = if self.poses.is_empty() { 0 } else { self.rng.random_range(0..12) };
        match kind {
            0..=2 => {
                let at = self.wiggle();
                let pose = change.add_variable(&at);
                if self.poses.is_empty() || self.rng.random_bool(0.3) {
                    change.add_factor(Prior::new(pose, at, noise(0.5)).unwrap());
                }
                if !self.poses.is_empty() {
                    let (from, z) = (self.any_pose(), self.wiggle());
                    change.add_factor(BetweenPose2::new(from, pose, z, noise(0.1)).unwrap());
                }
                if self.rng.random_bool(0.2) {
                    change.fix(pose);
                }
                self.poses.push(pose);
            }
            3 => {
                let landmark = change.add_variable(&Point2::new(1.0, 0.5));
                for _ in 0..2 {
                    let from = self.any_pose();
                    let seen = Noise::isotropic(2, 0.2).unwrap();
                    let z = Point2::new(self.rng.random_range(0.5..1.5), 0.4);
                    change.add_factor(RelativePosition2::new(from, landmark, z, seen).unwrap());
                }
                self.landmarks.push(landmark);
            }
            4 | 5 if self.poses.len() > 1 => {
                let (a, b, z) = (self.any_pose(), self.any_pose(), self.wiggle());
                if a != b {
                    change.add_factor(BetweenPose2::new(a, b, z, noise(0.1)).unwrap());
                }
            }
            6 | 7 => {
                if let Some(id) = self.any() {
                    change.fix(id);
                }
            }
            8 | 9 => {
                if let Some(id) = self.any() {
                    change.free(id);
                }
            }
            10 => {
                let (pose, at) = (self.any_pose(), self.wiggle());
                if smoother.graph().check_variable(pose.id()).is_ok() {
                    change.move_linearization_point(pose, &at);
                }
            }
            _ => {
                if let Some(id) = self.any()
                    && smoother.graph().check_variable(id).is_ok()
                {
                    change.drop_variable_and_factors(smoother.graph(), id).unwrap();
                    dropped.push(id);
                }
            }
        }
    }
}

/// The fixed variables after a change, and their values: of new and of moved ones those that the
/// change gives, of others their estimates.
fn fixed_after(
    smoother: &Smoother,
    change: &Change,
    fixed: &BTreeMap<VariableId, Value>,
) -> BTreeMap<VariableId, Value> {
    let mut after = fixed.clone();
    for &id in change.frees().iter().chain(change.dropped_variables()) {
        after.remove(&id);
    }
    for &id in change.fixes() {
        let given = change.new_variables().iter().find(|(new, _)| *new == id);
        let value = match given {
            Some((_, value)) => value.clone(),
            None => smoother.estimate_value(id).unwrap(),
        };
        after.insert(id, value);
    }
    for (id, value) in change.moves() {
        if let Some(fixed) = after.get_mut(id) {
            *fixed = value.clone();
        }
    }
    after
}

#[test]
fn random_sequences_agree_with_a_dense_reference() {
    let (mut applied, mut refused, mut fixes, mut frees, mut moved) = (0, 0, 0, 0, 0);
    for seed in 0..1000 {
        let mut smoother = smoother(policies()[seed as usize % 4]);
        let rng = ChaCha8Rng::seed_from_u64(seed);
        let mut world = World { poses: Vec::new(), landmarks: Vec::new(), rng };
        let mut fixed = BTreeMap::new();
        for step in 0..14 {
            let what = format!("seed {seed}, step {step}");
            let (poses, landmarks) = (world.poses.clone(), world.landmarks.clone());
            let mut change = smoother.change();
            let mut dropped = Vec::new();
            for _ in 0..world.rng.random_range(1..4) {
                world.add_to(&mut change, &smoother, &mut dropped);
            }
            let before = smoother.fingerprint();
            // Contradictions are the graph's to find.
            let expected = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                fixed_after(&smoother, &change, &fixed)
            }));
            let counts = (change.fixes().len(), change.frees().len());
            match smoother.apply(change) {
                Ok(report) => {
                    fixed = expected.unwrap();
                    world.poses.retain(|pose| !dropped.contains(&pose.id()));
                    world.landmarks.retain(|point| !dropped.contains(&point.id()));
                    applied += 1;
                    fixes += counts.0;
                    frees += counts.1;
                    moved += report.variables_relinearized;
                    assert_eq!(report.rank, smoother.graph().dim());
                    if report.relinearization_refused.is_none() {
                        check(&mut smoother, &fixed, &what);
                    }
                }
                Err(error) => {
                    assert_eq!(smoother.fingerprint(), before, "{what}: {error}");
                    (world.poses, world.landmarks) = (poses, landmarks);
                    refused += 1;
                }
            }
        }
    }
    println!("{applied} changes, {refused} refused, {fixes} fixes, {frees} frees, {moved} moved");
    assert!(applied > 6000 && refused > 300 && fixes > 1000 && frees > 1000 && moved > 1000);
}

#[test]
fn a_fixed_variable_holds_its_component() {
    let mut smoother = smoother(Relinearization::NEVER);
    let mut change = smoother.change();
    let a = change.add_variable(&Pose2::identity());
    let b = change.add_variable(&Pose2::identity());
    let c = change.add_variable(&Pose2::identity());
    let step = Pose2::new(1.0, 0.0, 0.0);
    change.add_factor(BetweenPose2::new(a, b, step, noise(0.1)).unwrap());
    change.add_factor(BetweenPose2::new(b, c, step, noise(0.1)).unwrap());
    change.fix(a);
    smoother.apply(change).unwrap();
    assert!((smoother.estimate(c).unwrap().x() - 2.0).abs() < 1e-9);
    assert_eq!(smoother.marginal(a).unwrap(), DMatrix::zeros(3, 3));
    // A fixed variable connects nothing: what it separates is found to be free on its own.
    let before = smoother.fingerprint();
    let mut change = smoother.change();
    change.free(a).fix(c);
    change.drop_factor(smoother.graph().factors_of(a).unwrap()[0]);
    let error = smoother.apply(change).unwrap_err();
    let SmootherError::Singular(Singular::Variables { variables }) = &error else {
        panic!("{error}")
    };
    assert_eq!((variables.len(), variables[0].variable), (1, a.id()));
    assert_eq!(smoother.fingerprint(), before);
    let mut change = smoother.change();
    change.free(a);
    let error = smoother.apply(change).unwrap_err();
    assert!(
        matches!(&error, SmootherError::Singular(Singular::Component { count: 3, .. })),
        "{error}"
    );
    assert_eq!(smoother.fingerprint(), before);
}

#[test]
fn a_graph_of_fixed_variables_only_is_solved() {
    let mut smoother = smoother(Relinearization::every(NonZeroU32::MIN));
    let mut change = smoother.change();
    let a = change.add_variable(&Pose2::identity());
    let b = change.add_variable(&Pose2::new(1.0, 0.0, 0.0));
    let z = Pose2::new(1.5, 0.0, 0.0);
    let factor = change.add_factor(BetweenPose2::new(a, b, z, noise(0.5)).unwrap());
    change.fix(a).fix(b);
    let report = smoother.apply(change).unwrap();
    assert_eq!((report.rank, smoother.size().nonzeros), (0, 0));
    let expected = smoother.error().unwrap();
    assert!(expected > 0.4);
    assert_eq!(report.batch.unwrap().error, expected);
    assert_eq!(smoother.error_of_factor(factor).unwrap(), expected);
    assert!(smoother.linearization_of(factor).unwrap().jacobians.is_empty());
    let mut change = smoother.change();
    change.free(b);
    smoother.apply(change).unwrap();
    assert!(smoother.error().unwrap() < 1e-20);
    assert_eq!(smoother.estimate(a).unwrap(), Pose2::identity());
}

/// A robot in a frozen map: work and memory of a step do not grow.
#[test]
fn localization_in_a_frozen_map_costs_the_same_in_every_step() {
    const MAP: usize = 5000;
    const STEPS: usize = 20_000;
    const WINDOW: usize = 10;
    let mut smoother = smoother(Relinearization::BOTH);
    let place = |k: usize| {
        let angle = k as f64 / MAP as f64 * std::f64::consts::TAU;
        Pose2::new(800.0 * angle.cos(), 800.0 * angle.sin(), angle)
    };
    let mut change = smoother.change();
    let map: Vec<Key<Pose2>> = (0..MAP).map(|k| change.add_variable(&place(k))).collect();
    change.add_factor(Prior::new(map[0], place(0), noise(0.01)).unwrap());
    for k in 1..MAP {
        let z = place(k - 1).inverse().compose(&place(k));
        change.add_factor(BetweenPose2::new(map[k - 1], map[k], z, noise(0.01)).unwrap());
    }
    smoother.apply(change).unwrap();
    let mut change = smoother.change();
    map.iter().for_each(|&pose| _ = change.fix(pose));
    let report = smoother.apply(change).unwrap();
    assert_eq!((report.rank, smoother.size().nonzeros, smoother.size().cliques), (0, 0, 0));

    let mut window: Vec<Key<Pose2>> = Vec::new();
    let mut most = Most::default();
    let mut memory = (0, 0);
    for k in 0..STEPS {
        let truth = place(k % MAP).compose(&Pose2::new(0.1, 0.2, 0.05));
        let mut change = smoother.change();
        let pose = match window.last() {
            None => change.add_variable(&truth),
            Some(&last) => {
                let before = place((k - 1) % MAP).compose(&Pose2::new(0.1, 0.2, 0.05));
                let z = before.inverse().compose(&truth);
                let guess = smoother.estimate(last).unwrap().compose(&z);
                let pose = change.add_variable(&guess);
                change.add_factor(BetweenPose2::new(last, pose, z, noise(0.05)).unwrap());
                pose
            }
        };
        let z = place(k % MAP).inverse().compose(&truth);
        change.add_factor(BetweenPose2::new(map[k % MAP], pose, z, noise(0.1)).unwrap());
        window.push(pose);
        if window.len() > WINDOW {
            change.drop_variable_and_factors(smoother.graph(), window.remove(0)).unwrap();
        }
        let report = smoother.apply(change).unwrap();
        most.take_in(&report, &smoother);
        if k == STEPS / 10 {
            memory.0 = smoother.memory_bytes();
        }
    }
    memory.1 = smoother.memory_bytes();
    println!("{most:?}, memory {memory:?}");
    assert!(most.variables <= WINDOW + 1 && most.cliques <= WINDOW + 1, "{most:?}");
    assert!(most.nonzeros <= 9 * WINDOW * WINDOW, "{most:?}");
    assert!(most.variable_slots <= MAP + 4 * WINDOW + 32, "{most:?}");
    assert!(most.factor_slots <= MAP + 8 * WINDOW + 64, "{most:?}");
    assert!(memory.1 <= memory.0 + memory.0 / 100, "memory grows: {memory:?}");
    for &pose in map.iter().step_by(97) {
        assert!(smoother.graph().is_fixed(pose).unwrap());
    }
    let last = smoother.estimate(window[WINDOW - 1]).unwrap();
    let truth = place((STEPS - 1) % MAP).compose(&Pose2::new(0.1, 0.2, 0.05));
    assert!(truth.inverse().compose(&last).log().amax() < 1e-6);
}

/// The largest counts of any step.
#[derive(Debug, Default)]
struct Most {
    variables: usize,
    cliques: usize,
    nonzeros: usize,
    variable_slots: usize,
    factor_slots: usize,
}

impl Most {
    fn take_in(&mut self, report: &Report, smoother: &Smoother) {
        let graph = smoother.graph();
        self.variables = self.variables.max(report.variables_eliminated);
        self.cliques = self.cliques.max(report.cliques_eliminated);
        self.nonzeros = self.nonzeros.max(smoother.size().nonzeros);
        self.variable_slots = self.variable_slots.max(graph.variable_slots());
        self.factor_slots = self.factor_slots.max(graph.factor_slots());
    }
}
