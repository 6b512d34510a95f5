//! One clique by QR: stack the whitened rows of its factors and its children's square-root
//! contributions, triangularize, keep the rows below the frontal ones as the contribution.
//!
//! R is exact for rows whose columns are off by about ε of their norms (Higham, Accuracy and Stability
//! of Numerical Algorithms, theorem 19.4). Weights of rows are thus no matter of rank. But a column that
//! depends on others, `a_v = Σ c_k a_k`, is left with their rounding times `c_k`, which is large where
//! they nearly depend on each other. So an error of a random sign and the size of its norm is put on each
//! column of each factor and carried through the elimination; a pivot counts if it stands out from what
//! comes of these. Sums of `|R_kj / R_kk|` would be a bound, but grow exponentially along a chain of poses
//! with correlated errors.

use evergraph_model::{FactorIndex, VariableIndex};

use super::job::Failure;
use super::system::{QR_PIVOT, QR_ROUNDING, System};
use super::workspace::{Run, Workspace};
use crate::dense::triangularize;
use crate::mix::mixed;
use crate::profile::Phase;
use crate::tree::{Form, Numeric, Structure};

/// Eliminates a clique whose children all have square-root contributions.
pub(super) fn eliminate(
    system: &System<'_>,
    structure: &Structure,
    children: &[(&Structure, &Numeric)],
    workspace: &mut Workspace,
) -> Result<Numeric, Failure> {
    let layout = structure.layout();
    let (n, frontal) = (layout.columns(), layout.frontal());
    let factor_rows: usize = structure.factors.iter().map(|&f| system.graph.rows_at(f)).sum();
    let child_rows: usize = children.iter().map(|(_, numeric)| root(numeric).0).sum();
    let damping_rows = if system.damping.is_some() { frontal } else { 0 };
    let m = factor_rows + child_rows + damping_rows;
    workspace.place(system, structure);
    workspace.square.clear();
    workspace.square.resize(m * n, 0.0);
    workspace.rounding.clear();
    workspace.rounding.resize(n - 1, 0.0);

    let mut row = 0;
    for &factor in &structure.factors {
        row += place_factor(system, factor, n, m, row, workspace);
    }
    for (child, numeric) in children {
        workspace.map_child(child, n);
        let (rows, data) = root(numeric);
        let (diagonal, rounding) = (numeric.diagonal(), numeric.rounding());
        for &Run { from, to, len } in &workspace.runs {
            for j in 0..len {
                let target = (to + j) * m + row;
                let source = (from + j) * rows;
                workspace.square[target..target + rows]
                    .copy_from_slice(&data[source..source + rows]);
                // The right-hand side has none.
                if let (Some(x), Some(y)) = (diagonal.get(from + j), rounding.get(from + j)) {
                    workspace.diagonal[to + j] += x;
                    workspace.rounding[to + j] += y;
                }
            }
        }
        row += rows;
    }
    if let Some(damping) = system.damping {
        let scalars = structure.frontals.iter().flat_map(|&v| system.graph.tangent_range(v));
        for (j, scalar) in scalars.enumerate() {
            workspace.square[j * m + row + j] = damping[scalar].sqrt();
            workspace.diagonal[j] += damping[scalar];
            workspace.rounding[j] += damping[scalar].sqrt();
        }
    }
    triangularize(&mut workspace.square[..m * n], m, n);
    let weakest = children.iter().map(|(_, numeric)| numeric.weakest).fold(1.0, f64::min);
    let numeric = collect(system, structure, m, weakest, workspace);
    workspace.clock.lap(Phase::Eliminate);
    numeric
}

/// A child's square-root contribution: rows and data.
fn root(numeric: &Numeric) -> (usize, &[f64]) {
    match numeric.form {
        Form::Root { rows } => (rows as usize, numeric.contribution()),
        Form::Information => {
            unreachable!("children of a QR elimination are eliminated by QR first")
        }
    }
}

/// Copies `[J₁ … Jₖ | r]` to the rows from `row` on, and adds the squares of its columns to the
/// diagonal; returns how many rows there are.
fn place_factor(
    system: &System<'_>,
    factor: FactorIndex,
    n: usize,
    m: usize,
    row: usize,
    workspace: &mut Workspace,
) -> usize {
    let graph = system.graph;
    let rows = graph.rows_at(factor);
    let mut source = system.block(factor).chunks_exact(rows);
    let starts = graph.unknowns_at(factor).iter().flat_map(|&v| {
        let place = workspace.place[v.index()];
        (place.start..place.start + place.dim).map(|column| column as usize)
    });
    for (column, data) in starts.chain(std::iter::once(n - 1)).zip(&mut source) {
        workspace.square[column * m + row..][..rows].copy_from_slice(data);
        if let Some(diagonal) = workspace.diagonal.get_mut(column) {
            let square = data.iter().map(|x| x * x).sum::<f64>();
            *diagonal += square;
            workspace.rounding[column] += sign(factor, column) * square.sqrt();
        }
    }
    rows
}

/// A sign for a column of a factor, as good as random.
fn sign(factor: FactorIndex, column: usize) -> f64 {
    let bits = mixed((factor.index() as u64) << 16 | column as u64);
    if bits >> 63 == 0 { 1.0 } else { -1.0 }
}

/// Takes the triangular factor apart: frontal rows to the panel (with positive diagonal), the rest
/// to the contribution.
fn collect(
    system: &System<'_>,
    structure: &Structure,
    m: usize,
    mut weakest: f64,
    workspace: &mut Workspace,
) -> Result<Numeric, Failure> {
    let layout = structure.layout();
    let (n, frontal) = (layout.columns(), layout.frontal());
    let order = n - frontal;
    let rows = order.min(m.saturating_sub(frontal));
    let form = Form::Root { rows: rows as u32 };
    let mut data = workspace.pool.take(Numeric::len(layout, form));
    let Workspace { square: front, diagonal: norms, rounding, .. } = workspace;
    let mut pivot_ratio = f64::INFINITY;
    for j in 0..frontal {
        let pivot = if j < m { front[j * m + j] } else { 0.0 };
        let ratio = pivot * pivot / norms[j];
        // Written so that NaN (no information at all: 0/0) fails too.
        if !(ratio > QR_PIVOT && pivot.abs() > QR_ROUNDING * rounding[j].abs() && ratio.is_finite())
        {
            let variable = frontal_at(system, structure, j);
            // A square that is not finite says nothing about what is determined.
            let finite = (pivot * pivot).is_finite() && norms[j].is_finite();
            return Err(match finite {
                true => Failure::Undetermined { variable },
                false => Failure::Overflow { variable },
            });
        }
        pivot_ratio = pivot_ratio.min(ratio);
        weakest = weakest.min(ratio);
        let sign = pivot.signum();
        let passed = rounding[j] / pivot;
        for i in j..n {
            let x = front[i * m + j];
            data[j * layout.rows() + i] = sign * x;
            // The right-hand side has none.
            if let Some(rounding) = rounding.get_mut(i) {
                *rounding -= passed * x;
            }
        }
    }
    let contribution = &mut data[layout.panel_len()..];
    for (j, column) in contribution.chunks_exact_mut(rows.max(1)).take(order).enumerate() {
        let source = (frontal + j) * m + frontal;
        column[..rows].copy_from_slice(&front[source..source + rows]);
    }
    let tail = data.len() - 2 * (order - 1);
    let (diagonal, rest) = data[tail..].split_at_mut(order - 1);
    diagonal.copy_from_slice(&norms[frontal..]);
    rest.copy_from_slice(&rounding[frontal..]);
    Ok(Numeric { layout, form, data, pivot_ratio, weakest })
}

/// The frontal variable that scalar column `j` belongs to.
fn frontal_at(system: &System<'_>, structure: &Structure, j: usize) -> VariableIndex {
    let mut end = 0;
    for &v in &structure.frontals {
        end += system.graph.dim_at(v);
        if j < end {
            return v;
        }
    }
    structure.frontals[structure.frontals.len() - 1]
}
