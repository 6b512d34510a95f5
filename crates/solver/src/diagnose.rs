//! The free directions of a singular system. Runs only on the way to an error.
//!
//! The null space of JᵀJ over the connected component of the failed variable is found by inverse
//! iteration on a slightly damped factorization, and put into words.

use std::collections::BTreeSet;

use evergraph_model::{FactorIndex, Graph, VariableIndex};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};

use crate::error::{FreeVariable, Singular};
use crate::linearization::Blocks;

/// Null directions looked for at first: more than any gauge has (7 with scale).
const DIRECTIONS: usize = 12;
/// Most null directions looked for, when all of fewer were free.
const MOST_DIRECTIONS: usize = 192;
/// Damping relative to diag(JᵀJ); far below any sound pivot ratio, far above rounding.
const DAMPING: f64 = 1e-12;
/// A direction is free if the information along it, relative to the diagonal, is below this.
const FREE: f64 = 1e-9;
/// Components of the null space below this share of its largest are rounding.
const TAKES_PART: f64 = 1e-6;

/// Factors and variables, ascending, that a change drops: they do not count.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Dropped<'a> {
    pub(crate) factors: &'a [FactorIndex],
    pub(crate) variables: &'a [VariableIndex],
}

/// Explains why the pivot of `variable` is zero. Costs one factorization of the variable's connected component.
pub(crate) fn singular(
    graph: &Graph,
    blocks: &Blocks,
    dropped: Dropped<'_>,
    variable: VariableIndex,
) -> Singular {
    let component = component_of(graph, dropped, variable);
    let null = null_space(graph, blocks, dropped, &component);
    let mut free = free_variables(graph, &component, &null);
    let whole = component.variables.len();
    if free.is_empty() {
        // No direction is free to working precision, but this pivot was lost: name it alone.
        let kind = graph.kind_at(variable);
        let dim = graph.dim_at(variable);
        free.push(FreeVariable {
            variable: graph.variable_id(variable),
            dim,
            free: 1,
            components: (0..dim).map(|i| kind.component(i)).collect(),
        });
    }
    if whole > 1 && free.len() == whole {
        return Singular::Component {
            examples: component.variables.iter().take(5).map(|&v| graph.variable_id(v)).collect(),
            count: whole,
            free: null.ncols(),
        };
    }
    Singular::Variables { variables: free }
}

/// The variables that the null space moves, those that it moves most first.
///
/// Norms of rows do not depend on the basis, so that a variable is not mixed up with others that are free
/// by themselves.
fn free_variables(graph: &Graph, component: &Component, null: &Mat<f64>) -> Vec<FreeVariable> {
    let norms: Vec<f64> = (0..null.nrows()).map(|i| null.row(i).norm_l2()).collect();
    let enough = TAKES_PART * norms.iter().fold(0.0, |most: f64, norm| most.max(*norm));
    let mut found: Vec<(f64, FreeVariable)> = Vec::new();
    for (&v, &start) in component.variables.iter().zip(&component.starts) {
        let dim = graph.dim_at(v);
        let moved: Vec<usize> = (0..dim).filter(|i| norms[start + i] > enough).collect();
        if moved.is_empty() {
            continue;
        }
        // One by one, since a row of many directions is as long as one of few.
        let block = Mat::from_fn(dim, null.ncols(), |i, j| null[(start + i, j)]);
        let singular = block.singular_values().unwrap_or_default();
        let free = singular.iter().filter(|&&value| value > enough).count().max(1);
        let kind = graph.kind_at(v);
        let free = FreeVariable {
            variable: graph.variable_id(v),
            dim,
            free: free.min(moved.len()),
            components: moved.iter().map(|&i| kind.component(i)).collect(),
        };
        found.push((singular.first().copied().unwrap_or(0.0), free));
    }
    // Equal shares in the order of their slots, whatever rounding makes of them.
    let share = |of: f64| (1e3 * of).round();
    found.sort_by(|a, b| share(b.0).total_cmp(&share(a.0)));
    found.into_iter().map(|(_, free)| free).collect()
}

/// Unknowns that are connected, and the first of each one's scalars among those of the component. A
/// fixed variable connects nothing: it is given.
struct Component {
    variables: Vec<VariableIndex>,
    starts: Vec<usize>,
    dim: usize,
}

fn component_of(graph: &Graph, dropped: Dropped<'_>, start: VariableIndex) -> Component {
    let Dropped { factors, variables } = dropped;
    let mut seen = BTreeSet::from([start]);
    let mut stack = vec![start];
    while let Some(v) = stack.pop() {
        for &f in graph.factors_at(v).iter().filter(|f| factors.binary_search(f).is_err()) {
            for &u in graph.unknowns_at(f).iter().filter(|u| variables.binary_search(u).is_err()) {
                if seen.insert(u) {
                    stack.push(u);
                }
            }
        }
    }
    let variables: Vec<VariableIndex> = seen.into_iter().collect();
    let mut starts = Vec::with_capacity(variables.len());
    let mut dim = 0;
    for &v in &variables {
        starts.push(dim);
        dim += graph.dim_at(v);
    }
    Component { variables, starts, dim }
}

/// An orthonormal basis of the free directions of the component, a column each, of scalars in units of
/// their information. Without columns if none can be computed.
fn null_space(
    graph: &Graph,
    blocks: &Blocks,
    dropped: Dropped<'_>,
    component: &Component,
) -> Mat<f64> {
    let none = || Mat::zeros(component.dim, 0);
    let place =
        |v: VariableIndex| component.variables.binary_search(&v).ok().map(|i| component.starts[i]);
    let factors: BTreeSet<FactorIndex> = component
        .variables
        .iter()
        .flat_map(|&v| graph.factors_at(v).iter().copied())
        .filter(|f| dropped.factors.binary_search(f).is_err())
        .collect();
    // Columns scaled to unit length, so that units do not matter.
    let mut scale = vec![0.0_f64; component.dim];
    let mut columns: Vec<Vec<(usize, Vec<f64>)>> = Vec::new();
    for &f in &factors {
        let rows = graph.rows_at(f);
        let mut chunks = blocks.get(f).chunks_exact(rows);
        let mut list = Vec::new();
        for &v in graph.unknowns_at(f) {
            let start = place(v);
            for i in 0..graph.dim_at(v) {
                if let (Some(start), Some(column)) = (start, chunks.next()) {
                    scale[start + i] += column.iter().map(|x| x * x).sum::<f64>();
                    list.push((start + i, column.to_vec()));
                }
            }
        }
        columns.push(list);
    }
    scale.iter_mut().for_each(|s| *s = if *s > 0.0 { s.sqrt() } else { 1.0 });
    let mut triplets = Vec::new();
    for list in &columns {
        for (i, a) in list {
            for (j, b) in list {
                if i >= j {
                    let product: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                    triplets.push(Triplet::new(*i, *j, product / (scale[*i] * scale[*j])));
                }
            }
        }
    }
    for i in 0..component.dim {
        triplets.push(Triplet::new(i, i, DAMPING));
    }
    let Ok(matrix) =
        SparseColMat::<usize, f64>::try_new_from_triplets(component.dim, component.dim, &triplets)
    else {
        return none();
    };
    let Ok(factor) = matrix.sp_cholesky(Side::Lower) else {
        return none();
    };
    let mut count = DIRECTIONS.min(component.dim);
    loop {
        let Some(found) = softest(&factor, component.dim, count) else { return none() };
        let may_be_more = found.ncols() == count && count < MOST_DIRECTIONS.min(component.dim);
        if !may_be_more {
            return found;
        }
        count = (2 * count).min(component.dim);
    }
}

/// The free ones of the `count` softest directions of a factored matrix.
fn softest(factor: &Llt<usize, f64>, dim: usize, count: usize) -> Option<Mat<f64>> {
    // A fixed start without symmetry; any will do.
    let mut x = Mat::from_fn(dim, count, |i, j| ((i * 7919 + j * 104_729 + 13) as f64).sin());
    for _ in 0..4 {
        x = factor.solve(&x);
        x = x.qr().compute_thin_Q();
    }
    // Rayleigh-Ritz: eigenvectors of the small projected matrix separate free from stiff.
    let solved = factor.solve(&x);
    let projected = x.transpose() * &solved;
    let eigen = projected.self_adjoint_eigen(Side::Lower).ok()?;
    let directions = &x * eigen.U();
    let free: Vec<usize> = (0..count).filter(|&j| 1.0 / eigen.S()[j] < FREE).collect();
    Some(Mat::from_fn(dim, free.len(), |i, j| directions[(i, free[j])]))
}
