//! One clique by Cholesky: assemble the frontal matrix, factor the frontal columns, keep the rest
//! as the contribution.

use super::{CHOLESKY_PIVOT, CHOLESKY_PRODUCT, System};
use crate::dense::{BadPivot, PivotBound, partial_cholesky};
use crate::tree::{Contribution, Numeric, Structure};

/// Buffers that eliminations on one thread share. Never part of any result.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    /// The dense front.
    pub(crate) front: Vec<f64>,
    /// By variable slot: first scalar row of the variable in the current front. Entries of other
    /// fronts are left in place and never read.
    pub(crate) position: Vec<u32>,
    /// Diagonal of JᵀJ for the scalars of the current front.
    pub(crate) diagonal: Vec<f64>,
    /// Runs of scalars that are contiguous in a child and in the front: (child, front, length).
    pub(crate) runs: Vec<(usize, usize, usize)>,
}

impl Workspace {
    /// Numbers the scalars of a front and makes room for a matrix of `rows` rows, whatever it
    /// holds.
    pub(crate) fn start(&mut self, system: &System<'_>, structure: &Structure, rows: usize) {
        self.position.resize(system.graph.variable_slots(), 0);
        let mut next = 0;
        for v in structure.variables() {
            self.position[v as usize] = next;
            next += system.graph.dim_at(v as usize) as u32;
        }
        let columns = structure.front_dim();
        if self.front.len() < rows * columns {
            self.front.resize(rows * columns, 0.0);
        }
        self.diagonal.clear();
        self.diagonal.resize(columns - 1, 0.0);
    }

    /// Maps the separator of a child to the current front, in runs; the right-hand side is the
    /// last.
    pub(crate) fn map_child(&mut self, system: &System<'_>, child: &Structure, columns: usize) {
        self.runs.clear();
        let mut from = 0;
        let tail = std::iter::once((columns - 1, 1));
        let variables = child
            .separator
            .iter()
            .map(|&v| (self.position[v as usize] as usize, system.graph.dim_at(v as usize)));
        for (to, len) in variables.chain(tail) {
            match self.runs.last_mut() {
                Some(run) if run.1 + run.2 == to => run.2 += len,
                _ => self.runs.push((from, to, len)),
            }
            from += len;
        }
    }

    /// Adds a child's diagonal of JᵀJ; `map_child` has been called for it.
    pub(crate) fn add_diagonal(&mut self, child: &[f64]) {
        for &(from, to, len) in &self.runs {
            let len = len.min(child.len() - from);
            for (to, from) in self.diagonal[to..to + len].iter_mut().zip(&child[from..from + len]) {
                *to += from;
            }
        }
    }

    /// Adds the squares of a factor's Jacobian columns to the diagonal.
    pub(crate) fn add_factor_diagonal(&mut self, system: &System<'_>, factor: usize) {
        let rows = system.graph.rows_at(factor);
        let mut columns = system.blocks.get(factor).chunks_exact(rows);
        for &v in system.graph.variables_at(factor) {
            let (start, dim) =
                (self.position[v as usize] as usize, system.graph.dim_at(v as usize));
            for (diagonal, column) in self.diagonal[start..start + dim].iter_mut().zip(&mut columns)
            {
                *diagonal += column.iter().map(|x| x * x).sum::<f64>();
            }
        }
    }
}

/// Eliminates a clique from its factors and its children's contributions.
pub(super) fn eliminate(
    system: &System<'_>,
    structure: &Structure,
    children: &[(&Structure, &Numeric)],
    workspace: &mut Workspace,
) -> Result<Numeric, BadPivot> {
    let n = structure.front_dim();
    let frontal = structure.frontal_dim;
    workspace.start(system, structure, n);
    // Only the lower triangle is ever read.
    for (j, column) in workspace.front[..n * n].chunks_exact_mut(n).enumerate() {
        column[j..].fill(0.0);
    }
    for &factor in &structure.factors {
        add_factor(system, factor as usize, n, workspace);
        workspace.add_factor_diagonal(system, factor as usize);
    }
    let mut weakest = 1.0_f64;
    for (child, numeric) in children {
        // A square root has lost half as many digits.
        let root = numeric.contribution.is_root();
        weakest = weakest.min(if root { numeric.weakest.sqrt() } else { numeric.weakest });
        workspace.map_child(system, child, n);
        match &numeric.contribution {
            Contribution::Information(packed) => add_information(packed, n, workspace),
            Contribution::Root { rows, data } => add_root(data, *rows, n, workspace),
        }
        workspace.add_diagonal(&numeric.diagonal);
    }
    if let Some(damping) = system.damping {
        let scalars =
            structure.frontals.iter().flat_map(|&v| system.graph.tangent_range(v as usize));
        for (j, scalar) in scalars.enumerate() {
            workspace.front[j * n + j] += damping[scalar];
            workspace.diagonal[j] += damping[scalar];
        }
    }
    let front = &mut workspace.front[..n * n];
    let bound = PivotBound { ratio: CHOLESKY_PIVOT, product: CHOLESKY_PRODUCT, weakest };
    let pivot_ratio = partial_cholesky(system.arch, front, n, frontal, &workspace.diagonal, bound)?;
    Ok(Numeric {
        panel: panel(front, n, frontal),
        contribution: Contribution::Information(packed_lower(front, n, frontal)),
        diagonal: workspace.diagonal[frontal..].to_vec(),
        pivot_ratio,
        weakest: weakest.min(pivot_ratio),
    })
}

/// Adds `[J | r]ᵀ[J | r]` of a factor to the lower triangle.
fn add_factor(system: &System<'_>, factor: usize, n: usize, workspace: &mut Workspace) {
    let graph = system.graph;
    let rows = graph.rows_at(factor);
    let block = system.blocks.get(factor);
    let columns = graph.columns_at(factor);
    let variables = graph.variables_at(factor);
    // The right-hand side counts as one more variable of dimension 1 in the last column.
    let place = |b: usize| match variables.get(b) {
        Some(&v) => workspace.position[v as usize] as usize,
        None => n - 1,
    };
    let width = |b: usize| match columns.get(b + 1) {
        Some(&end) => (end - columns[b]) as usize,
        None => 1,
    };
    for b in 0..columns.len() {
        let (place_b, width_b) = (place(b), width(b));
        let first_b = columns[b] as usize;
        for (a, &first_a) in columns.iter().enumerate().skip(b) {
            let (place_a, width_a) = (place(a), width(a));
            let first_a = first_a as usize;
            let left = &block[first_a * rows..(first_a + width_a) * rows];
            let right = &block[first_b * rows..(first_b + width_b) * rows];
            // Rows below columns: the later variable of the front gives the rows.
            let target = if place_a >= place_b {
                Target { left, right, row: place_a, column: place_b }
            } else {
                Target { left: right, right: left, row: place_b, column: place_a }
            };
            match rows {
                3 => target.add::<3>(&mut workspace.front, n),
                6 => target.add::<6>(&mut workspace.front, n),
                2 => target.add::<2>(&mut workspace.front, n),
                _ => target.add_any(&mut workspace.front, n, rows),
            }
        }
    }
}

/// `front[row.., column..] += leftᵀ right`, both with the same number of rows.
struct Target<'a> {
    left: &'a [f64],
    right: &'a [f64],
    row: usize,
    column: usize,
}

impl Target<'_> {
    #[inline]
    fn add<const ROWS: usize>(&self, front: &mut [f64], n: usize) {
        let (left, _) = self.left.as_chunks::<ROWS>();
        let (right, _) = self.right.as_chunks::<ROWS>();
        for (j, y) in right.iter().enumerate() {
            let start = (self.column + j) * n + self.row;
            for (out, x) in front[start..start + left.len()].iter_mut().zip(left) {
                let mut sum = 0.0;
                for k in 0..ROWS {
                    sum += x[k] * y[k];
                }
                *out += sum;
            }
        }
    }

    fn add_any(&self, front: &mut [f64], n: usize, rows: usize) {
        for (j, y) in self.right.chunks_exact(rows).enumerate() {
            let start = (self.column + j) * n + self.row;
            for (out, x) in front[start..].iter_mut().zip(self.left.chunks_exact(rows)) {
                *out += x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            }
        }
    }
}

/// Extend-add: scatters a child's packed lower triangle into the front by runs.
fn add_information(packed: &[f64], n: usize, workspace: &mut Workspace) {
    let Workspace { front, runs, .. } = workspace;
    let (last_from, _, last_len) = runs[runs.len() - 1];
    let order = last_from + last_len;
    let mut start = 0;
    for (r, &(from, to, len)) in runs.iter().enumerate() {
        for j in 0..len {
            // Column `from + j` of the child; its rows from the diagonal on are contiguous.
            let column = &packed[start..start + order - (from + j)];
            start += column.len();
            let target = to + j;
            let own = &mut front[target * n + target..target * n + to + len];
            for (out, x) in own.iter_mut().zip(column) {
                *out += x;
            }
            for &(run_from, run_to, run_len) in &runs[r + 1..] {
                let source = &column[run_from - (from + j)..][..run_len];
                if run_to > target {
                    let out = &mut front[target * n + run_to..][..run_len];
                    for (out, x) in out.iter_mut().zip(source) {
                        *out += x;
                    }
                } else {
                    // The separator was ordered otherwise when the child was built.
                    for (k, x) in source.iter().enumerate() {
                        front[(run_to + k) * n + target] += x;
                    }
                }
            }
        }
    }
}

/// Adds `TᵀT` of a child's square-root contribution `T`.
fn add_root(data: &[f64], rows: usize, n: usize, workspace: &mut Workspace) {
    let Workspace { front, runs, .. } = workspace;
    let places: Vec<usize> = runs.iter().flat_map(|&(_, to, len)| to..to + len).collect();
    for (j, &place_j) in places.iter().enumerate() {
        let y = &data[j * rows..(j + 1) * rows];
        for (i, &place_i) in places.iter().enumerate().skip(j) {
            let x = &data[i * rows..(i + 1) * rows];
            // Upper trapezoidal: column j ends at row j.
            let used = (j + 1).min(rows);
            let sum: f64 = x[..used].iter().zip(&y[..used]).map(|(x, y)| x * y).sum();
            let (row, column) = (place_i.max(place_j), place_i.min(place_j));
            front[column * n + row] += sum;
        }
    }
}

/// The first `frontal` columns, zero above the diagonal.
fn panel(front: &[f64], n: usize, frontal: usize) -> Vec<f64> {
    let mut panel = front[..frontal * n].to_vec();
    for j in 1..frontal {
        panel[j * n..j * n + j].fill(0.0);
    }
    panel
}

/// The lower triangle behind the first `frontal` columns, packed by columns.
fn packed_lower(front: &[f64], n: usize, frontal: usize) -> Vec<f64> {
    let order = n - frontal;
    let mut packed = Vec::with_capacity(order * (order + 1) / 2);
    for j in frontal..n {
        packed.extend_from_slice(&front[j * n + j..(j + 1) * n]);
    }
    packed
}
