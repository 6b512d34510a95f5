//! The free directions of a singular system. Runs only on the way to an error.
//!
//! The null space of JᵀJ over the connected component of the failed variable is found by inverse
//! iteration on a slightly damped factorization, and put into words. Directions that are only known
//! far less than others look as free there; `‖J d‖` for each of the softest tells them apart.

use std::collections::BTreeSet;

use evergraph_model::{FactorIndex, Graph, VariableIndex};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};

use crate::dense::triangularize;
use crate::error::{FreeVariable, Singular};
use crate::linearization::Blocks;
use crate::mix::mixed;

/// Null directions looked for at first: more than any gauge has (7 with scale).
const DIRECTIONS: usize = 12;
/// Most null directions looked for, when all of fewer were free.
const MOST_DIRECTIONS: usize = 192;
/// Damping relative to diag(JᵀJ); far below any sound pivot ratio, far above rounding.
const DAMPING: f64 = 1e-12;
/// A direction is free if the information along it, relative to the diagonal, is below this ...
const FREE: f64 = 1e-9;
/// ... and none of the softer ones has less by this factor: from there on directions are known, if
/// little.
const GAP: f64 = 1e3;
/// Information below this is rounding.
const ROUNDING: f64 = 1e-27;
/// Rows of `J d` that are brought into a triangle at a time.
const ROWS: usize = 1024;
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
    let mut columns: Vec<Columns> = Vec::new();
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
    for (i, column) in columns.iter_mut().flatten() {
        column.iter_mut().for_each(|x| *x /= scale[*i]);
    }
    let mut triplets = Vec::new();
    for list in &columns {
        for (i, a) in list {
            for (j, b) in list {
                if i >= j {
                    let product: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                    triplets.push(Triplet::new(*i, *j, product));
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
        let Some(found) = softest(&factor, &columns, component.dim, count) else { return none() };
        let may_be_more = found.ncols() == count && count < MOST_DIRECTIONS.min(component.dim);
        if !may_be_more {
            return found;
        }
        count = (2 * count).min(component.dim);
    }
}

/// The Jacobian of a factor: the columns, each with the place of its scalar.
type Columns = Vec<(usize, Vec<f64>)>;

/// The free ones of the `count` softest directions of a factored matrix.
fn softest(
    factor: &Llt<usize, f64>,
    columns: &[Columns],
    dim: usize,
    count: usize,
) -> Option<Mat<f64>> {
    let mut x = Mat::from_fn(dim, count, |i, j| start(i as u64, j as u64));
    for _ in 0..4 {
        x = factor.solve(&x);
        x = x.qr().compute_thin_Q();
    }
    // Singular vectors of J on these directions separate free from stiff; JᵀJ would lose half of the
    // digits.
    let svd = image(columns, &x).svd().ok()?;
    let information = |j: usize| (svd.S()[j] * svd.S()[j]).max(ROUNDING);
    // Softest last.
    let mut free = 0;
    while free < count {
        let next = information(count - 1 - free);
        let is_known = free > 0 && next > GAP * information(count - free);
        if next >= FREE || is_known {
            break;
        }
        free += 1;
    }
    let directions = &x * svd.V();
    Some(Mat::from_fn(dim, free, |i, j| directions[(i, count - 1 - j)]))
}

/// A fixed start in general position, in [-1, 1). A formula that is a sum of products of a row's and a column's numbers has
/// low rank.
fn start(row: u64, column: u64) -> f64 {
    (mixed(row << 16 | column) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// A square root of `(J X)ᵀ(J X)`, by QR of a few rows at a time.
fn image(columns: &[Columns], x: &Mat<f64>) -> Mat<f64> {
    let n = x.ncols();
    let mut root = Mat::<f64>::zeros(n, n);
    let mut rest = columns;
    while !rest.is_empty() {
        let (mut rows, mut taken) = (n, 0);
        let mut starts = Vec::new();
        for list in rest {
            if rows > n + ROWS {
                break;
            }
            starts.push(rows);
            rows += list.first().map_or(0, |(_, column)| column.len());
            taken += 1;
        }
        let mut stack = vec![0.0; rows * n];
        for (j, stacked) in stack.chunks_exact_mut(rows).enumerate() {
            stacked[..n].copy_from_slice(&(0..n).map(|i| root[(i, j)]).collect::<Vec<_>>());
            for (list, &start) in rest.iter().zip(&starts) {
                for (i, column) in list {
                    for (sum, a) in stacked[start..].iter_mut().zip(column) {
                        *sum += a * x[(*i, j)];
                    }
                }
            }
        }
        triangularize(&mut stack, rows, n);
        root = Mat::from_fn(n, n, |i, j| stack[j * rows + i]);
        rest = &rest[taken..];
    }
    root
}
