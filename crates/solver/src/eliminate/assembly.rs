//! Adding factors and contributions to a front.

use evergraph_model::FactorIndex;
use smallvec::SmallVec;

use super::system::System;
use super::workspace::{Place, Run};
use crate::tree::{Form, Numeric};

/// A front that is being assembled.
pub(super) struct Assembly<'a> {
    pub(super) data: &'a mut [f64],
    /// By column: what a row's number is added to, to find the entry.
    pub(super) base: &'a [usize],
    /// Diagonal of JᵀJ.
    pub(super) diagonal: &'a mut [f64],
    /// Columns before this one are not assembled.
    pub(super) first: usize,
}

impl Assembly<'_> {
    /// `len` entries of a column, from `row` on.
    #[inline(always)]
    fn part(&mut self, column: usize, row: usize, len: usize) -> &mut [f64] {
        let start = self.base[column].wrapping_add(row);
        &mut self.data[start..start + len]
    }
}

/// A block of columns of `[J₁ … Jₖ | r]`.
#[derive(Clone, Copy)]
struct Block {
    /// First column of the factor.
    from: usize,
    /// First scalar of the front.
    to: usize,
    width: usize,
}

/// Adds `[J | r]ᵀ[J | r]` of a factor, and the squares of its columns to the diagonal.
#[inline(always)]
pub(super) fn add_factor(
    system: &System<'_>,
    factor: FactorIndex,
    columns: usize,
    place: &[Place],
    front: &mut Assembly<'_>,
) {
    let graph = system.graph;
    let data = system.block(factor);
    // The blocks as the front has them, first eliminated first; the right-hand side is the last.
    let mut blocks: SmallVec<[Block; 4]> = SmallVec::new();
    for (&from, &v) in graph.columns_at(factor).iter().zip(graph.unknowns_at(factor)) {
        let Place { start, dim } = place[v.index()];
        let block = Block { from: from as usize, to: start as usize, width: dim as usize };
        let at = blocks.iter().take_while(|other| other.to < block.to).count();
        blocks.insert(at, block);
    }
    let rows = graph.rows_at(factor);
    let width = data.len() / rows;
    blocks.push(Block { from: width - 1, to: columns - 1, width: 1 });
    match (rows, width) {
        (3, ..=8) => add_gram::<3, 8>(data, &blocks, front),
        (6, ..=16) => add_gram::<6, 16>(data, &blocks, front),
        (2, ..=8) => add_gram::<2, 8>(data, &blocks, front),
        (1, ..=16) => add_gram::<1, 16>(data, &blocks, front),
        _ => add_any_gram(data, rows, &blocks, front),
    }
}

/// For `ROWS` rows and up to `WIDTH` columns.
#[inline(always)]
fn add_gram<const ROWS: usize, const WIDTH: usize>(
    data: &[f64],
    blocks: &[Block],
    front: &mut Assembly<'_>,
) {
    // By rows, so that a column of the product is a sum of a few whole rows.
    let mut rows = [[0.0; WIDTH]; ROWS];
    let (columns, _) = data.as_chunks::<ROWS>();
    for (c, column) in columns.iter().enumerate().take(WIDTH) {
        for (row, x) in rows.iter_mut().zip(column) {
            row[c] = *x;
        }
    }
    for (b, block) in blocks.iter().enumerate() {
        for j in 0..block.width {
            let column = &columns[block.from + j];
            let mut product = [0.0; WIDTH];
            for (row, x) in rows.iter().zip(column) {
                for (sum, y) in product.iter_mut().zip(row) {
                    *sum += x * y;
                }
            }
            add_column(&product, j, &blocks[b..], front);
        }
    }
}

fn add_any_gram(data: &[f64], rows: usize, blocks: &[Block], front: &mut Assembly<'_>) {
    let mut product = vec![0.0; data.len() / rows];
    for (b, block) in blocks.iter().enumerate() {
        for j in 0..block.width {
            let column = &data[(block.from + j) * rows..][..rows];
            for (sum, other) in product.iter_mut().zip(data.chunks_exact(rows)) {
                *sum = column.iter().zip(other).map(|(x, y)| x * y).sum();
            }
            add_column(&product, j, &blocks[b..], front);
        }
    }
}

/// Adds the product of all columns with column `j` of the first block; the other blocks come later
/// in the front.
#[inline(always)]
fn add_column(product: &[f64], j: usize, blocks: &[Block], front: &mut Assembly<'_>) {
    let own = blocks[0];
    let column = own.to + j;
    if let Some(diagonal) = front.diagonal.get_mut(column) {
        *diagonal += product[own.from + j];
    }
    if column < front.first {
        return;
    }
    let source = &product[own.from + j..own.from + own.width];
    add(front.part(column, column, source.len()), source);
    for block in &blocks[1..] {
        let source = &product[block.from..block.from + block.width];
        add(front.part(column, block.to, source.len()), source);
    }
}

/// `out += x`, both of the same, mostly small, length: by fours, for which one vector is enough, and
/// then one by one. A plain loop would be compiled for long ones.
#[inline(always)]
fn add(out: &mut [f64], x: &[f64]) {
    let (out_fours, out_rest) = out.as_chunks_mut::<4>();
    let (x_fours, x_rest) = x.as_chunks::<4>();
    for (out, x) in out_fours.iter_mut().zip(x_fours) {
        for k in 0..4 {
            out[k] += x[k];
        }
    }
    if let [out, rest @ ..] = out_rest
        && let [x, x_rest @ ..] = x_rest
    {
        *out += x;
        if let [out, rest @ ..] = rest
            && let [x, x_rest @ ..] = x_rest
        {
            *out += x;
            if let ([out], [x]) = (rest, x_rest) {
                *out += x;
            }
        }
    }
}

/// Adds what a child contributes; `runs` map its separator and right-hand side to the front.
#[inline(always)]
pub(super) fn add_contribution(numeric: &Numeric, runs: &[Run], front: &mut Assembly<'_>) {
    match numeric.form {
        Form::Information => add_information(numeric, runs, front),
        Form::Root { rows } => add_root(numeric.contribution(), rows as usize, runs, front),
    }
    let diagonal = numeric.diagonal();
    for &Run { from, to, len } in runs {
        let len = len.min(diagonal.len() - from);
        add(&mut front.diagonal[to..to + len], &diagonal[from..from + len]);
    }
}

/// Extend-add: scatters a child's triangle by runs.
#[inline(always)]
fn add_information(numeric: &Numeric, runs: &[Run], front: &mut Assembly<'_>) {
    let contribution = numeric.contribution();
    let mut diagonals = numeric.layout.diagonals();
    for (r, &Run { from, to, len }) in runs.iter().enumerate() {
        for (j, at) in (0..len).zip(&mut diagonals) {
            // Rows `from + j` and on of the child's column.
            let child = &contribution[at..];
            let column = to + j;
            if column >= front.first {
                let own = &child[..len - j];
                add(front.part(column, column, len - j), own);
            }
            for run in &runs[r + 1..] {
                let source = &child[run.from - (from + j)..][..run.len];
                if run.to > column {
                    if column >= front.first {
                        add(front.part(column, run.to, run.len), source);
                    }
                } else {
                    // The separator was ordered otherwise when the child was built.
                    for (k, x) in source.iter().enumerate().skip(front.first.saturating_sub(run.to))
                    {
                        front.part(run.to + k, column, 1)[0] += x;
                    }
                }
            }
        }
    }
}

/// Adds `TᵀT` of a child's square-root contribution `T`.
fn add_root(data: &[f64], rows: usize, runs: &[Run], front: &mut Assembly<'_>) {
    if rows == 0 {
        return;
    }
    let places: Vec<usize> = runs.iter().flat_map(|run| run.to..run.to + run.len).collect();
    for (j, &place_j) in places.iter().enumerate() {
        let y = &data[j * rows..(j + 1) * rows];
        for (i, &place_i) in places.iter().enumerate().skip(j) {
            let x = &data[i * rows..(i + 1) * rows];
            // Upper trapezoidal: column j ends at row j.
            let used = (j + 1).min(rows);
            let sum: f64 = x[..used].iter().zip(&y[..used]).map(|(x, y)| x * y).sum();
            let (row, column) = (place_i.max(place_j), place_i.min(place_j));
            if column >= front.first {
                front.part(column, row, 1)[0] += sum;
            }
        }
    }
}
