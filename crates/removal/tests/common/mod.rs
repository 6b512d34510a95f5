//! What a removal should do, by plain dense algebra, on random graphs.
// Each test file uses a part of it; what fails here fails a test.
#![allow(dead_code, unused_imports, clippy::unwrap_used)]

mod chain;
mod draw;
mod drive;

pub use chain::{chain, sigma};
pub use draw::{Draw, KINDS, Kind, neighborhood};
pub use drive::{drive, optimum};

use evergraph_factors::{Linear, Prior};
use evergraph_model::*;
use evergraph_removal::{
    Consistency, Offset, Options, Order, Plan, Recovery, Removal, RootShift, Topology,
};
use nalgebra::{DMatrix, DVector};

/// A graph with a point for every variable.
#[derive(Clone)]
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
            scene.data[graph.value_range(graph.variable_index(*id).unwrap())]
                .copy_from_slice(value.storage());
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
        let dims: Vec<usize> = order
            .iter()
            .map(|&id| self.graph.dim_at(self.graph.variable_index(id).unwrap()))
            .collect();
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

    /// The same with a map around it: a variable that is known, and that knows something of
    /// everything but the first variable.
    pub fn in_a_map(&self, draw: &mut Draw) -> Self {
        let mut change = self.graph.change();
        let map = VectorN::zeros(4);
        let outside = change.add_variable(&map);
        change.add_factor(Prior::new(outside, map.clone(), draw.noise(4)).unwrap());
        for &id in &self.ids()[1..] {
            let value = self.values().value(id).unwrap().to_value();
            let width = value.dim() + 4;
            let rows = DMatrix::from_fn(value.dim(), width, |i, j| {
                draw.number(0.5) + if i == j { 1.0 } else { 0.0 }
            });
            let offset = DVector::from_fn(width, |_, _| draw.number(0.05));
            let ends = [(id, value), (outside.id(), Value::new(&map))];
            change.add_factor(Linear::new(&ends, RootShift::None, rows, offset).unwrap());
        }
        let mut graph = self.graph.clone();
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
        let mut data = vec![0.0; graph.value_len()];
        for id in self.graph.variables() {
            let value = self.values().value(id).unwrap().to_value();
            data[graph.value_range(graph.variable_index(id).unwrap())]
                .copy_from_slice(value.storage());
        }
        Self { graph, data }
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

/// `(Λ, η)` of the others with the first `m` columns of a stack eliminated: what of `J_k` and `r` is
/// not in the range of `J_m`. Nothing is squared before it is small, so that this is right where
/// normal equations have lost half of the digits.
pub fn eliminated(
    (jacobian, residual): &(DMatrix<f64>, DVector<f64>),
    m: usize,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut nodes = jacobian.columns(0, m).into_owned();
    let floor = 1e-4 * nodes.column_iter().map(|c| c.norm()).fold(0.0, f64::max);
    for mut column in nodes.column_iter_mut() {
        let norm = column.norm().max(floor);
        if norm > 0.0 {
            column /= norm;
        }
    }
    let mut rest = jacobian.columns(m, jacobian.ncols() - m).into_owned();
    let mut left = residual.clone();
    // Gram and Schmidt with pivots, each direction taken out twice so that nothing of it is left.
    for _ in 0..m {
        let norms: Vec<f64> = nodes.column_iter().map(|column| column.norm()).collect();
        let largest = (0..m).max_by(|&a, &b| norms[a].total_cmp(&norms[b])).unwrap();
        if norms[largest] < 1e-9 {
            break;
        }
        let q = nodes.column(largest) / norms[largest];
        nodes.column_mut(largest).fill(0.0);
        for _ in 0..2 {
            nodes -= &q * q.tr_mul(&nodes);
            rest -= &q * q.tr_mul(&rest);
            left -= &q * q.dot(&left);
        }
    }
    normal(&(rest, left))
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
    let node_dim =
        removed.iter().map(|&id| scene.graph.dim_at(scene.graph.variable_index(id).unwrap())).sum();
    let (lambda, eta) = eliminated(&stack, node_dim);
    // A column that is zero in the tangent of a variable is only zero to rounding after a shift.
    let floor = 1e-3 * full.0.diagonal().max().sqrt();
    let scale = (node_dim..full.0.nrows()).map(|i| full.0[(i, i)].sqrt().max(floor)).collect();
    Answer { blanket: blanket.to_vec(), lambda, eta, scale, stack, node_dim }
}

/// `(J, r)` of what a plan adds, over a blanket, and of the factors inside the blanket that stay.
pub fn added(scene: &Scene, plan: &Plan, blanket: &[VariableId]) -> (DMatrix<f64>, DVector<f64>) {
    let is_dropped = |id| plan.dropped().iter().any(|(dropped, _)| *dropped == id);
    let stays = scene.graph.factors().filter(|(id, factor)| {
        !is_dropped(*id) && factor.keys().iter().all(|key| blanket.contains(key))
    });
    let new = plan.change().new_factors().iter().map(|(_, f)| &**f);
    scene.stack(new.chain(stays.map(|(_, factor)| factor)), blanket)
}

/// Trees with all that is inside the blanket, as in the papers.
pub fn tree() -> Options {
    Options::tree().with_keep_unary(false)
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

pub fn scene(graph: &Graph, values: &Values) -> Scene {
    let mut data = vec![0.0; graph.value_len()];
    for id in graph.variables() {
        data[graph.value_range(graph.variable_index(id).unwrap())]
            .copy_from_slice(values.value(id).unwrap().storage());
    }
    Scene { graph: graph.clone(), data }
}

/// The scene with a plan applied.
pub fn reduced(scene: &Scene, plan: &Plan) -> Scene {
    let mut graph = scene.graph.clone();
    let staged = graph.stage(plan.change()).unwrap();
    graph.commit(staged);
    Scene { graph, data: scene.data.clone() }
}

pub fn system(scene: &Scene, order: &[VariableId]) -> (DMatrix<f64>, DVector<f64>) {
    normal(&scene.stack(scene.graph.factors().map(|(_, f)| f), order))
}

/// The marginal covariance over `kept`, and the mean's shift from the estimate.
pub fn marginal(scene: &Scene, kept: &[VariableId]) -> (DMatrix<f64>, DVector<f64>) {
    let ids = scene.ids();
    let others = ids.iter().filter(|id| !kept.contains(id));
    let order: Vec<VariableId> = kept.iter().chain(others).copied().collect();
    let (lambda, eta) = system(scene, &order);
    let sigma = lambda.cholesky().unwrap().inverse();
    let dim: usize =
        kept.iter().map(|&id| scene.graph.dim_at(scene.graph.variable_index(id).unwrap())).sum();
    let mean = &sigma * eta;
    (sigma.view((0, 0), (dim, dim)).into_owned(), mean.rows(0, dim).into_owned())
}

/// Kullback-Leibler divergence of `q` from `p`, by its definition.
pub fn divergence(p: &(DMatrix<f64>, DVector<f64>), q: &(DMatrix<f64>, DVector<f64>)) -> f64 {
    let inverse = q.0.clone().cholesky().unwrap().inverse();
    let log_det =
        |m: &DMatrix<f64>| 2.0 * m.clone().cholesky().unwrap().l().diagonal().map(f64::ln).sum();
    let shift = &q.1 - &p.1;
    0.5 * ((&inverse * &p.0).trace() - p.0.nrows() as f64
        + shift.dot(&(&inverse * &shift))
        + log_det(&q.0)
        - log_det(&p.0))
}

pub fn priced(scene: &Scene, nodes: &[VariableId], order: Order, options: Options) -> Plan {
    let mut joint = |ids: &[VariableId]| Ok::<_, String>(marginal(scene, ids).0);
    Removal::new(&scene.graph, &scene.values())
        .with_options(options)
        .priced_by(&mut joint)
        .plan_many(nodes, order)
        .unwrap()
}

/// The information and the gradient of everything but a node, which is eliminated, and the ids in that order. Directions of
/// the node that no factor knows are no loss: nothing is inverted as a whole.
pub fn without_node(
    scene: &Scene,
    node: VariableId,
) -> (Vec<VariableId>, (DMatrix<f64>, DVector<f64>)) {
    let kept: Vec<VariableId> = scene.ids().into_iter().filter(|&id| id != node).collect();
    let order: Vec<VariableId> = std::iter::once(node).chain(kept.iter().copied()).collect();
    let stack = scene.stack(scene.graph.factors().map(|(_, f)| f), &order);
    let dim = scene.graph.dim_at(scene.graph.variable_index(node).unwrap());
    (kept, eliminated(&stack, dim))
}

/// Ways that keep both the gradient and every direction.
pub fn keeping() -> [Options; 9] {
    let kept = Options::tree();
    [
        Options::default(),
        Options::dense(),
        Options::dense().with_keep_unary(false),
        kept,
        kept.with_recovery(Recovery::Nonlinear),
        kept.with_consistency(Consistency::Conservative),
        tree().with_recovery(Recovery::Nonlinear),
        tree().with_root_shift(RootShift::InverseRoot),
        tree().with_intra_clique(false),
    ]
}

/// The kinds of plans that differ in their books.
pub const VARIANTS: [(Topology, Recovery, Offset); 5] = [
    (Topology::Dense, Recovery::Glc, Offset::KeepGradient),
    (Topology::ChowLiu, Recovery::Glc, Offset::KeepGradient),
    (Topology::ChowLiu, Recovery::Nonlinear, Offset::KeepGradient),
    (Topology::ChowLiu, Recovery::Glc, Offset::Zero),
    (Topology::ChowLiu, Recovery::Composition, Offset::KeepGradient),
];
