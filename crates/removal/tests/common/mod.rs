//! Random graphs with factors of every kind, and what a removal should do by plain dense algebra.
// Each test file uses a part of it; what fails here fails a test.
#![allow(dead_code, clippy::unwrap_used)]

use evergraph_factors::*;
use evergraph_model::*;
use evergraph_removal::{Options, Plan, Removal};
use nalgebra::{DMatrix, DVector, SVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A graph with a point for every variable.
pub struct Scene {
    pub graph: Graph,
    pub data: Vec<f64>,
}

impl Scene {
    pub fn of(build: impl FnOnce(&mut Change)) -> Self {
        let mut graph = Graph::new();
        let mut change = graph.change();
        build(&mut change);
        let mut scene = Self { graph: graph.clone(), data: Vec::new() };
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
        scene.data.resize(graph.value_len(), 0.0);
        for (id, value) in change.new_variables() {
            scene.data[graph.value_range(id.index())].copy_from_slice(value.storage());
        }
        scene.graph = graph;
        scene
    }

    pub fn values(&self) -> Values {
        Values::from_arena(&self.graph, &self.data)
    }

    pub fn ids(&self) -> Vec<VariableId> {
        self.graph.variables().collect()
    }

    pub fn plan(&self, node: VariableId, options: Options) -> Plan {
        Removal::new(&self.graph, &self.values()).with_options(options).plan(node).unwrap()
    }

    /// `J`, `r` of some factors over the variables in `order`.
    pub fn stack<'a>(
        &self,
        factors: impl IntoIterator<Item = &'a dyn Factor>,
        order: &[VariableId],
    ) -> (DMatrix<f64>, DVector<f64>) {
        let values = self.values();
        let dims: Vec<usize> = order.iter().map(|id| self.graph.dim_at(id.index())).collect();
        let start = |k: usize| dims[..k].iter().sum::<usize>();
        let width = start(order.len());
        let (mut rows, mut residual) = (Vec::<DMatrix<f64>>::new(), Vec::new());
        for factor in factors {
            let places: Vec<usize> = factor
                .keys()
                .iter()
                .map(|key| order.iter().position(|id| id == key).unwrap())
                .collect();
            let storages: Vec<&[f64]> =
                places.iter().map(|&k| values.value(order[k]).unwrap().storage()).collect();
            let mut columns = vec![0];
            for &k in &places {
                columns.push(columns.last().unwrap() + dims[k] as u32);
            }
            let own = *columns.last().unwrap() as usize;
            let m = factor.residual_dim();
            let mut block = DMatrix::zeros(m, own + 1);
            factor.linearize(
                &Arguments::new(&storages),
                &mut Linearization::new(m, &columns, block.as_mut_slice()),
            );
            let mut wide = DMatrix::zeros(m, width);
            let mut source = 0;
            for &k in &places {
                wide.columns_mut(start(k), dims[k]).copy_from(&block.columns(source, dims[k]));
                source += dims[k];
            }
            rows.push(wide);
            residual.extend(block.column(own).iter().copied());
        }
        let count = rows.iter().map(DMatrix::nrows).sum();
        let mut jacobian = DMatrix::zeros(count, width);
        let mut top = 0;
        for block in rows {
            jacobian.rows_mut(top, block.nrows()).copy_from(&block);
            top += block.nrows();
        }
        (jacobian, DVector::from_vec(residual))
    }

    /// The factors of the paper's `Z_m`: on the removed nodes and their blanket only.
    pub fn z_m(&self, removed: &[VariableId], blanket: &[VariableId]) -> Vec<&dyn Factor> {
        self.graph
            .factors()
            .filter(|(_, f)| f.keys().iter().all(|k| removed.contains(k) || blanket.contains(k)))
            .map(|(_, f)| f)
            .collect()
    }
}

/// `(J, r)` to `(JᵀJ, -Jᵀr)`.
pub fn normal((jacobian, residual): &(DMatrix<f64>, DVector<f64>)) -> (DMatrix<f64>, DVector<f64>) {
    (jacobian.tr_mul(jacobian), -jacobian.tr_mul(residual))
}

/// The pseudo-inverse of a positive semi-definite matrix, scaled to unit diagonal before its
/// eigenvalues are told from zero.
pub fn pseudo_inverse(m: &DMatrix<f64>) -> DMatrix<f64> {
    let n = m.nrows();
    let scale = |i: usize| if m[(i, i)] > 0.0 { m[(i, i)].sqrt() } else { 1.0 };
    let scaled = DMatrix::from_fn(n, n, |i, j| m[(i, j)] / scale(i) / scale(j));
    let eigen = scaled.symmetric_eigen();
    let mut inverse = DMatrix::zeros(n, n);
    for k in 0..n {
        if eigen.eigenvalues[k] > 1e-12 {
            let v = eigen.eigenvectors.column(k);
            inverse += v * v.transpose() / eigen.eigenvalues[k];
        }
    }
    DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / scale(i) / scale(j))
}

/// Equations 12 and 13 of the laser paper: the first `m` scalars eliminated from `(Λ, η)`.
pub fn schur(
    (lambda, eta): &(DMatrix<f64>, DVector<f64>),
    m: usize,
) -> (DMatrix<f64>, DVector<f64>) {
    let k = lambda.nrows() - m;
    let (mm, km) = (lambda.view((0, 0), (m, m)).into_owned(), lambda.view((m, 0), (k, m)));
    let gain = km * pseudo_inverse(&mm);
    (lambda.view((m, m), (k, k)) - &gain * km.transpose(), eta.rows(m, k) - gain * eta.rows(0, m))
}

/// A scene with the node, its blanket and the dense answer.
pub struct Answer {
    pub blanket: Vec<VariableId>,
    pub lambda: DMatrix<f64>,
    pub eta: DVector<f64>,
    /// Square roots of the diagonal before the node was eliminated: what errors are relative to.
    pub scale: Vec<f64>,
    /// Of Z_m, the node's columns first.
    pub stack: (DMatrix<f64>, DVector<f64>),
    pub node_dim: usize,
}

pub fn answer(scene: &Scene, removed: &[VariableId], blanket: &[VariableId]) -> Answer {
    let order: Vec<VariableId> = removed.iter().chain(blanket).copied().collect();
    let stack = scene.stack(scene.z_m(removed, blanket), &order);
    let full = normal(&stack);
    let node_dim = removed.iter().map(|id| scene.graph.dim_at(id.index())).sum();
    let (lambda, eta) = schur(&full, node_dim);
    // A column that is zero in the tangent of a variable is only zero to rounding after a shift.
    let floor = 1e-3 * full.0.diagonal().max().sqrt();
    let scale = (node_dim..full.0.nrows()).map(|i| full.0[(i, i)].sqrt().max(floor)).collect();
    Answer { blanket: blanket.to_vec(), lambda, eta, scale, stack, node_dim }
}

/// `(J, r)` of what a plan adds, over a blanket.
pub fn added(scene: &Scene, plan: &Plan, blanket: &[VariableId]) -> (DMatrix<f64>, DVector<f64>) {
    scene.stack(plan.change().new_factors().iter().map(|(_, f)| &**f), blanket)
}

pub fn assert_close(a: &DMatrix<f64>, b: &DMatrix<f64>, scale: &[f64], tolerance: f64, what: &str) {
    for i in 0..a.nrows() {
        for j in 0..a.ncols() {
            let error = (a[(i, j)] - b[(i, j)]).abs();
            let allowed = tolerance * scale[i] * scale[j];
            assert!(
                error <= allowed,
                "{what} ({i}, {j}): {} {} off by {error:e}, {allowed:e} allowed",
                a[(i, j)],
                b[(i, j)]
            );
        }
    }
}

/// Entries of a gradient, relative to the column's size times that of the residuals.
pub fn assert_same_gradient(a: &DVector<f64>, b: &DVector<f64>, answer: &Answer, tolerance: f64) {
    let size = answer.stack.1.norm().max(1.0);
    for i in 0..a.len() {
        let error = (a[i] - b[i]).abs();
        let allowed = tolerance * answer.scale[i] * size;
        assert!(error <= allowed, "gradient {i}: {} {} off by {error:e}, {allowed:e}", a[i], b[i]);
    }
}

/// Rank of a stack by the singular values of its column-scaled form.
pub fn rank(stack: &DMatrix<f64>) -> usize {
    let mut scaled = stack.clone();
    // Columns that are rounding alone count as nothing.
    let floor = 1e-4 * scaled.column_iter().map(|c| c.norm()).fold(0.0, f64::max);
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm().max(floor);
        if norm > 0.0 {
            column /= norm;
        }
    }
    if scaled.is_empty() {
        return 0;
    }
    scaled.singular_values().iter().filter(|s| **s > 1e-9).count()
}

/// Draws for random graphs.
pub struct Draw(pub ChaCha8Rng);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn number(&mut self, size: f64) -> f64 {
        self.0.random_range(-size..size)
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.0.random_range(0..n)
    }

    pub fn vector<const N: usize>(&mut self, size: f64) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.number(size))
    }

    pub fn pose2(&mut self) -> Pose2 {
        let [x, y, theta] = [8.0, 8.0, 3.0].map(|size| self.number(size));
        Pose2::new(x, y, theta)
    }

    pub fn pose3(&mut self) -> Pose3 {
        let mut d = self.vector::<6>(6.0);
        for k in 3..6 {
            d[k] *= 0.25;
        }
        Pose3::exp(&d)
    }

    /// A full noise with sigmas of quite different size.
    pub fn noise(&mut self, n: usize) -> Noise {
        let root = DMatrix::from_fn(n, n, |i, j| match i.cmp(&j) {
            std::cmp::Ordering::Less => self.number(3.0),
            std::cmp::Ordering::Equal => 5.0 + self.number(4.0),
            std::cmp::Ordering::Greater => 0.0,
        });
        Noise::from_sqrt_information(&root).unwrap()
    }
}

/// What a random neighborhood is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Full relative poses in the plane.
    Plane,
    /// Full relative poses in space.
    Space,
    /// Poses and points in the plane, all relative, of any rank.
    RelativePlane,
    /// Anything in the plane.
    AnyPlane,
    /// Anything in space.
    AnySpace,
    /// Poses in the plane and in space.
    Mixed,
}

pub const KINDS: [Kind; 6] =
    [Kind::Plane, Kind::Space, Kind::RelativePlane, Kind::AnyPlane, Kind::AnySpace, Kind::Mixed];

/// A node (the first variable) with `count` others around it; every factor is on it or on two of
/// the others, and a few intra-clique ones close loops.
pub fn neighborhood(kind: Kind, count: usize, seed: u64) -> Scene {
    let mut draw = Draw::new(seed);
    Scene::of(|change| match kind {
        Kind::Plane => {
            let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
            let keys: Vec<Key<Pose2>> = values.iter().map(|x| change.add_variable(x)).collect();
            for (i, j) in pairs(count, &mut draw) {
                between2(change, &mut draw, (keys[i], values[i]), (keys[j], values[j]));
            }
        }
        Kind::Space => {
            let values: Vec<Pose3> = (0..=count).map(|_| draw.pose3()).collect();
            let keys: Vec<Key<Pose3>> = values.iter().map(|x| change.add_variable(x)).collect();
            for (i, j) in pairs(count, &mut draw) {
                between3(change, &mut draw, (keys[i], values[i]), (keys[j], values[j]));
            }
        }
        Kind::RelativePlane | Kind::AnyPlane => plane(change, &mut draw, kind, count),
        Kind::AnySpace => space(change, &mut draw, count),
        Kind::Mixed => mixed(change, &mut draw, count),
    })
}

/// The node with each other, and some of the others with each other.
fn pairs(count: usize, draw: &mut Draw) -> Vec<(usize, usize)> {
    let mut pairs: Vec<(usize, usize)> = (1..=count).map(|k| (0, k)).collect();
    for _ in 0..draw.below(count + 1) {
        let (i, j) = (1 + draw.below(count), 1 + draw.below(count));
        if i != j {
            pairs.push((i, j));
        }
    }
    pairs
}

fn between2(
    change: &mut Change,
    draw: &mut Draw,
    (i, from): (Key<Pose2>, Pose2),
    (j, to): (Key<Pose2>, Pose2),
) {
    let z = from.between(&to).compose(&Pose2::exp(&draw.vector(0.03)));
    change.add_factor(Between::new(i, j, z, draw.noise(3)).unwrap());
}

fn between3(
    change: &mut Change,
    draw: &mut Draw,
    (i, from): (Key<Pose3>, Pose3),
    (j, to): (Key<Pose3>, Pose3),
) {
    let z = from.between(&to).compose(&Pose3::exp(&draw.vector(0.03)));
    change.add_factor(Between::new(i, j, z, draw.noise(6)).unwrap());
}

fn plane(change: &mut Change, draw: &mut Draw, kind: Kind, count: usize) {
    let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
    let keys: Vec<Key<Pose2>> = values.iter().map(|x| change.add_variable(x)).collect();
    let point = Point2::new(draw.number(8.0), draw.number(8.0));
    let landmark = change.add_variable(&point);
    let local = |x: &Pose2| x.inverse_transform_point(&point);
    change.add_factor(
        RelativePosition2::new(keys[0], landmark, local(&values[0]), draw.noise(2)).unwrap(),
    );
    let mut known = false;
    for (i, j) in pairs(count, draw) {
        let ((ki, xi), (kj, xj)) = ((keys[i], values[i]), (keys[j], values[j]));
        let distance = (xj.translation().vector() - xi.translation().vector()).norm();
        match draw.below(6) {
            0 | 1 => between2(change, draw, (ki, xi), (kj, xj)),
            2 => {
                let z = (distance + draw.number(0.1)).abs();
                change.add_factor(Range::new(ki, kj, z, draw.noise(1)).unwrap());
            }
            3 => {
                let seen = xi.inverse_transform_point(&xj.translation());
                let angle = seen.y().atan2(seen.x()) + draw.number(0.05);
                change.add_factor(Bearing2::new(ki, kj, angle, draw.noise(1)).unwrap());
            }
            4 => {
                let z = xi.between(&xj);
                change.add_factor(
                    PartialBetweenPose2::new(ki, kj, z, &[0, 2], draw.noise(2)).unwrap(),
                );
            }
            _ if kind == Kind::AnyPlane => {
                known = true;
                let z = Point2::new(xi.x() + draw.number(0.2), xi.y());
                change.add_factor(
                    GpsPosition2::with_lever_arm(ki, z, Point2::new(0.3, 0.1), draw.noise(2))
                        .unwrap(),
                );
                change.add_factor(Heading2::new(kj, xj.theta(), draw.noise(1)).unwrap());
                between2(change, draw, (ki, xi), (kj, xj));
            }
            _ => between2(change, draw, (ki, xi), (kj, xj)),
        }
        if draw.below(3) == 0 {
            let z = (local(&xj).vector()).norm();
            change.add_factor(Range::new(kj, landmark, z, draw.noise(1)).unwrap());
        }
    }
    if kind == Kind::AnyPlane && !known && draw.below(2) == 0 {
        let z = values[1].compose(&Pose2::exp(&draw.vector(0.03)));
        change.add_factor(Prior::new(keys[1], z, draw.noise(3)).unwrap());
    }
}

fn space(change: &mut Change, draw: &mut Draw, count: usize) {
    let values: Vec<Pose3> = (0..=count).map(|_| draw.pose3()).collect();
    let keys: Vec<Key<Pose3>> = values.iter().map(|x| change.add_variable(x)).collect();
    let point = Point3::new(draw.number(8.0), draw.number(8.0), draw.number(8.0));
    let landmark = change.add_variable(&point);
    let local = |x: &Pose3| x.inverse_transform_point(&point);
    change.add_factor(
        Bearing3::new(keys[0], landmark, local(&values[0]).vector(), draw.noise(2)).unwrap(),
    );
    for (i, j) in pairs(count, draw) {
        let ((ki, xi), (kj, xj)) = ((keys[i], values[i]), (keys[j], values[j]));
        match draw.below(7) {
            0..=2 => between3(change, draw, (ki, xi), (kj, xj)),
            3 => {
                change.add_factor(
                    RelativePosition3::new(kj, landmark, local(&xj), draw.noise(3)).unwrap(),
                );
                between3(change, draw, (ki, xi), (kj, xj));
            }
            4 => {
                let z = (xj.translation().vector() - xi.translation().vector()).norm();
                change.add_factor(Range::new(ki, kj, z, draw.noise(1)).unwrap());
            }
            5 => {
                change
                    .add_factor(Depth::new(kj, xj.z() + draw.number(0.1), draw.noise(1)).unwrap());
                change.add_factor(
                    DepthDifference::new(ki, kj, xj.z() - xi.z(), draw.noise(1)).unwrap(),
                );
            }
            _ => {
                let z = Point3::new(xj.x(), xj.y() + draw.number(0.1), xj.z());
                let lever = Point3::new(0.2, 0.0, -0.1);
                change
                    .add_factor(GpsPosition3::with_lever_arm(kj, z, lever, draw.noise(3)).unwrap());
                between3(change, draw, (ki, xi), (kj, xj));
            }
        }
    }
}

/// Poses of both kinds around a pose in the plane, joined by linear factors.
fn mixed(change: &mut Change, draw: &mut Draw, count: usize) {
    let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
    let keys: Vec<Key<Pose2>> = values.iter().map(|x| change.add_variable(x)).collect();
    for (i, j) in pairs(count, draw) {
        between2(change, draw, (keys[i], values[i]), (keys[j], values[j]));
    }
    let above: Vec<Pose3> = (0..2).map(|_| draw.pose3()).collect();
    let others: Vec<Key<Pose3>> = above.iter().map(|x| change.add_variable(x)).collect();
    between3(change, draw, (others[0], above[0]), (others[1], above[1]));
    for (k, other) in others.iter().enumerate() {
        let rows = 2 + draw.below(4);
        let root = DMatrix::from_fn(rows, 9, |_, _| draw.number(4.0));
        let offset = DVector::from_fn(9, |_, _| draw.number(0.05));
        let variables =
            [(keys[0].id(), Value::new(&values[0])), (other.id(), Value::new(&above[k]))];
        change.add_factor(Linear::new(&variables, RootShift::None, root, offset).unwrap());
    }
}
