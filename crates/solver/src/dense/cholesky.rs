//! Partial Cholesky factorization of a frontal matrix.
//!
//! With the symmetric front split into frontal and other columns,
//!
//! ```text
//! F = | A  Bᵀ |      A = L Lᵀ,   P = B L⁻ᵀ,   S = C − P Pᵀ
//!     | B  C  |
//! ```
//!
//! the kernel leaves `L` and `P` in the frontal columns and `S`, the contribution to the parent,
//! in the triangle ([`FrontLayout`]). It looks left: a block of up to eight columns takes in all
//! columns before it, is factored, and `C` takes in all frontal columns in a single pass, four
//! columns by a few vectors of rows at a time, which stay in registers.

use pulp::{Simd, WithSimd};

use super::layout::FrontLayout;

/// A pivot that is not safely positive: its column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BadPivot {
    pub(crate) column: usize,
}

/// What a pivot must exceed, relative to its diagonal entry of JᵀJ.
///
/// A pivot of ratio ρ leaves noise of about ε/ρ relative in what it passes on, where a later pivot
/// that should be zero would then hide. So no two pivots of a subtree may lose more than `product`
/// together.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PivotBound {
    /// For any pivot.
    pub(crate) ratio: f64,
    /// For the product of any pivot's ratio with the smallest before it.
    pub(crate) product: f64,
    /// The smallest ratio in the subtrees below.
    pub(crate) weakest: f64,
}

impl PivotBound {
    /// Whether `pivot` is sound beside its diagonal entry, once the smallest ratio of the same
    /// front is `smallest`. Written so that NaN is not.
    #[inline(always)]
    pub(super) fn allows(self, pivot: f64, diagonal: f64, smallest: f64) -> bool {
        pivot > self.ratio * diagonal
            && pivot * self.weakest.min(smallest) > self.product * diagonal
            && pivot.is_finite()
    }
}

/// A front to factor; see [`super::partial_cholesky`].
pub(crate) struct PartialCholesky<'a> {
    pub(crate) layout: FrontLayout,
    /// The frontal columns.
    pub(crate) panel: &'a mut [f64],
    /// The other columns.
    pub(crate) triangle: &'a mut [f64],
    /// Diagonal of JᵀJ for the frontal columns.
    pub(crate) diagonal: &'a [f64],
    pub(crate) bound: PivotBound,
}

/// Columns factored together.
const BLOCK: usize = 8;

impl WithSimd for PartialCholesky<'_> {
    type Output = Result<f64, BadPivot>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { layout, panel, triangle, diagonal, bound } = self;
        let (frontal, rows) = (layout.frontal(), layout.rows());
        let mut smallest = f64::INFINITY;
        for start in (0..frontal).step_by(BLOCK) {
            let end = frontal.min(start + BLOCK);
            let (done, block) = panel[..end * rows].split_at_mut(start * rows);
            if start > 0 {
                let source = Source { columns: done, rows, count: start };
                source.subtract_from(simd, block, rows, start, start);
            }
            let bound = PivotBound { weakest: bound.weakest.min(smallest), ..bound };
            let diagonal = &diagonal[start..end];
            let factored = match end - start {
                1 => factor_block::<S, 1>(simd, block, rows, start, diagonal, bound),
                2 => factor_block::<S, 2>(simd, block, rows, start, diagonal, bound),
                3 => factor_block::<S, 3>(simd, block, rows, start, diagonal, bound),
                4 => factor_block::<S, 4>(simd, block, rows, start, diagonal, bound),
                5 => factor_block::<S, 5>(simd, block, rows, start, diagonal, bound),
                6 => factor_block::<S, 6>(simd, block, rows, start, diagonal, bound),
                7 => factor_block::<S, 7>(simd, block, rows, start, diagonal, bound),
                _ => factor_block::<S, 8>(simd, block, rows, start, diagonal, bound),
            };
            smallest = smallest.min(factored?);
        }
        subtract_outer(simd, layout, panel, triangle);
        Ok(smallest)
    }
}

/// `S = C − P Pᵀ` alone, for a front whose frontal columns are known.
pub(crate) struct SubtractOuter<'a> {
    pub(crate) layout: FrontLayout,
    /// The frontal columns, at least.
    pub(crate) panel: &'a [f64],
    /// The other columns.
    pub(crate) triangle: &'a mut [f64],
}

impl WithSimd for SubtractOuter<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        subtract_outer(simd, self.layout, self.panel, self.triangle);
    }
}

#[inline(always)]
fn subtract_outer<S: Simd>(simd: S, layout: FrontLayout, panel: &[f64], triangle: &mut [f64]) {
    let (frontal, group) = (layout.frontal(), layout.group());
    let source = Source { columns: panel, rows: layout.rows(), count: frontal };
    let mut rest = triangle;
    let mut column = frontal;
    while column < layout.columns() {
        let first_row = column / group * group;
        let height = layout.rows() - first_row;
        let width = (first_row + group).min(layout.columns()) - column;
        let (columns, tail) = rest.split_at_mut(width * height);
        rest = tail;
        source.subtract_from(simd, columns, height, first_row, column);
        column += width;
    }
}

/// Finished frontal columns.
struct Source<'a> {
    columns: &'a [f64],
    rows: usize,
    count: usize,
}

impl Source<'_> {
    /// Subtracts the products with all finished columns from `columns`: each has `height` entries,
    /// of which the last ones, from row `first_row` of the front on (a multiple of the vector
    /// length), take part; the first of them is column `column` of the front.
    #[inline(always)]
    fn subtract_from<S: Simd>(
        &self,
        simd: S,
        columns: &mut [f64],
        height: usize,
        first_row: usize,
        mut column: usize,
    ) {
        let mut quads = columns.chunks_exact_mut(4 * height);
        for quad in &mut quads {
            self.subtract::<S, 4>(simd, quad, height, first_row, column);
            column += 4;
        }
        let last = quads.into_remainder();
        match last.len() / height {
            1 => self.subtract::<S, 1>(simd, last, height, first_row, column),
            2 => self.subtract::<S, 2>(simd, last, height, first_row, column),
            3 => self.subtract::<S, 3>(simd, last, height, first_row, column),
            _ => {}
        }
    }

    #[inline(always)]
    fn subtract<S: Simd, const W: usize>(
        &self,
        simd: S,
        columns: &mut [f64],
        height: usize,
        first_row: usize,
        column: usize,
    ) {
        let mut row = first_row;
        while row + 3 * S::F64_LANES <= self.rows {
            self.tile::<S, W, 3>(simd, columns, height, row, column);
            row += 3 * S::F64_LANES;
        }
        if row + 2 * S::F64_LANES <= self.rows {
            self.tile::<S, W, 2>(simd, columns, height, row, column);
            row += 2 * S::F64_LANES;
        }
        while row + S::F64_LANES <= self.rows {
            self.tile::<S, W, 1>(simd, columns, height, row, column);
            row += S::F64_LANES;
        }
    }

    /// `W` columns by `R` vectors of rows, which stay in registers.
    #[inline(always)]
    fn tile<S: Simd, const W: usize, const R: usize>(
        &self,
        simd: S,
        columns: &mut [f64],
        height: usize,
        row: usize,
        column: usize,
    ) {
        let length = R * S::F64_LANES;
        let mut sums = [[simd.splat_f64s(0.0); R]; W];
        for done in self.columns.chunks_exact(self.rows).take(self.count) {
            let x = &S::as_simd_f64s(&done[row..row + length]).0[..R];
            let factors = &done[column..column + W];
            for w in 0..W {
                let factor = simd.splat_f64s(factors[w]);
                for r in 0..R {
                    sums[w][r] = simd.mul_add_e_f64s(x[r], factor, sums[w][r]);
                }
            }
        }
        let first_row = self.rows - height;
        for (w, sums) in sums.iter().enumerate() {
            let start = w * height + row - first_row;
            let out = S::as_mut_simd_f64s(&mut columns[start..start + length]).0;
            for (out, sum) in out.iter_mut().zip(sums) {
                *out = simd.sub_f64s(*out, *sum);
            }
        }
    }
}

/// Factors `W` columns, whose products with all columns before are subtracted; their diagonal
/// begins at row `start`.
#[expect(clippy::needless_range_loop, reason = "triangles read best by their indices")]
#[inline(always)]
fn factor_block<S: Simd, const W: usize>(
    simd: S,
    block: &mut [f64],
    rows: usize,
    start: usize,
    diagonal: &[f64],
    bound: PivotBound,
) -> Result<f64, BadPivot> {
    // The diagonal block in registers, as far as they go: l[j][i] is row i of column j.
    let mut l = [[0.0; W]; W];
    for (j, column) in l.iter_mut().enumerate() {
        column.copy_from_slice(&block[j * rows + start..][..W]);
    }
    let mut inverse = [0.0; W];
    let mut smallest = f64::INFINITY;
    for j in 0..W {
        let pivot = l[j][j];
        if !bound.allows(pivot, diagonal[j], smallest) {
            return Err(BadPivot { column: start + j });
        }
        smallest = smallest.min(pivot / diagonal[j]);
        let root = pivot.sqrt();
        inverse[j] = 1.0 / root;
        l[j][j] = root;
        for i in j + 1..W {
            l[j][i] *= inverse[j];
        }
        for k in j + 1..W {
            for i in k..W {
                l[k][i] -= l[j][k] * l[j][i];
            }
        }
    }
    // Whole vectors, from rows of the diagonal block on that are overwritten at the end.
    let first = start + W / S::F64_LANES * S::F64_LANES;
    let mut columns = block.chunks_exact_mut(rows);
    let below: [&mut [S::f64s]; W] = std::array::from_fn(|_| {
        let column = columns.next().expect("the block has W columns");
        S::as_mut_simd_f64s(&mut column[first..]).0
    });
    let length = below[0].len();
    for i in 0..length {
        // A loop: `array::from_fn` stays a call unless crates are optimized together.
        let mut x = [simd.splat_f64s(0.0); W];
        for j in 0..W {
            x[j] = below[j][i];
        }
        for j in 0..W {
            x[j] = simd.mul_f64s(x[j], simd.splat_f64s(inverse[j]));
            for k in j + 1..W {
                x[k] = simd.negate_mul_add_e_f64s(x[j], simd.splat_f64s(l[j][k]), x[k]);
            }
        }
        for j in 0..W {
            below[j][i] = x[j];
        }
    }
    for (j, column) in l.iter().enumerate() {
        block[j * rows + start..][..W].copy_from_slice(column);
    }
    Ok(smallest)
}

#[cfg(test)]
mod tests {
    use super::super::{Instructions, LARGE, partial_cholesky};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const LENIENT: PivotBound = PivotBound { ratio: 1e-9, product: 0.0, weakest: 1.0 };

    /// A positive definite n × n matrix, column-major, and its diagonal.
    fn matrix(n: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let a: Vec<f64> = (0..n * (n + 3)).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut f = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                f[j * n + i] = (0..n + 3).map(|k| a[k * n + i] * a[k * n + j]).sum();
            }
        }
        let diagonal = (0..n).map(|i| f[i * n + i]).collect();
        (f, diagonal)
    }

    /// A front with what a kernel left in it.
    struct Front {
        layout: FrontLayout,
        panel: Vec<f64>,
        triangle: Vec<f64>,
    }

    impl Front {
        /// Rubbish above the diagonal, which no kernel may read into a result.
        fn new(matrix: &[f64], n: usize, frontal: usize) -> Self {
            let layout = FrontLayout::new(frontal, n - frontal);
            let mut panel = vec![0.0; layout.panel_len()];
            let mut triangle = vec![0.0; layout.triangle_len()];
            for j in 0..n {
                let column = &matrix[j * n..(j + 1) * n];
                if j < frontal {
                    let out = &mut panel[j * layout.rows()..][..layout.rows()];
                    out[..j].fill(1e3);
                    out[j..n].copy_from_slice(&column[j..]);
                } else {
                    let at = layout.diagonal_at(j);
                    triangle[at..at + n - j].copy_from_slice(&column[j..]);
                }
            }
            Self { layout, panel, triangle }
        }

        fn at(&self, i: usize, j: usize) -> f64 {
            if j < self.layout.frontal() {
                self.panel[j * self.layout.rows() + i]
            } else {
                self.triangle[self.layout.diagonal_at(j) + i - j]
            }
        }

        fn factor(
            &mut self,
            instructions: Instructions,
            diagonal: &[f64],
            bound: PivotBound,
        ) -> Result<f64, BadPivot> {
            struct Op<'a>(PartialCholesky<'a>);
            impl WithSimd for Op<'_> {
                type Output = Result<f64, BadPivot>;
                fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
                    partial_cholesky(simd, self.0, &mut Vec::new())
                }
            }
            let Self { layout, panel, triangle } = self;
            instructions.dispatch(
                *layout,
                Op(PartialCholesky { layout: *layout, panel, triangle, diagonal, bound }),
            )
        }

        /// L and P times their transposes, plus S, must give the matrix back.
        fn check(&self, original: &[f64], n: usize) {
            let frontal = self.layout.frontal();
            for j in 0..n {
                for i in j..n {
                    let products: f64 =
                        (0..frontal.min(j + 1)).map(|k| self.at(i, k) * self.at(j, k)).sum();
                    let rest = if j >= frontal { self.at(i, j) } else { 0.0 };
                    let scale = (original[i * n + i] * original[j * n + j]).sqrt();
                    let off = (products + rest - original[j * n + i]).abs();
                    assert!(
                        off <= 1e-13 * n as f64 * scale,
                        "({i}, {j}) of {n}, {frontal}: off by {off}"
                    );
                }
            }
        }
    }

    #[test]
    fn every_size_and_instruction_set_reproduces_the_front() {
        for (name, instructions) in Instructions::available() {
            for n in (1..40_usize).chain([63, 64, 65, 100, 131]) {
                let (original, diagonal) = matrix(n, n as u64);
                for frontal in [1, 2, 3, 6, n / 3, n / 2, n.saturating_sub(1), n] {
                    if frontal == 0 || frontal > n {
                        continue;
                    }
                    let mut front = Front::new(&original, n, frontal);
                    front.factor(instructions, &diagonal, LENIENT).expect(name);
                    front.check(&original, n);
                    // The products alone give the same triangle.
                    let mut again = Front::new(&original, n, frontal);
                    let Front { layout, triangle, .. } = &mut again;
                    let op = SubtractOuter { layout: *layout, panel: &front.panel, triangle };
                    instructions.dispatch(front.layout, op);
                    for j in frontal..n {
                        assert!((j..n).all(|i| again.at(i, j) == front.at(i, j)));
                    }
                }
            }
        }
    }

    #[test]
    fn large_fronts_agree_with_small_ones() {
        let (n, frontal) = (LARGE + 21, 150);
        let (original, diagonal) = matrix(n, 7);
        let mut front = Front::new(&original, n, frontal);
        front.factor(Instructions::select().unwrap(), &diagonal, LENIENT).unwrap();
        front.check(&original, n);
    }

    #[test]
    fn bad_pivots_are_named() {
        for n in [6, LARGE + 40] {
            let (mut f, mut diagonal) = matrix(n, 3);
            // Column 4 becomes a copy of column 1: no information of its own.
            for i in 0..n {
                f[4 * n + i] = f[n + i];
            }
            for i in 0..n {
                f[i * n + 4] = f[i * n + 1];
            }
            diagonal[4] = diagonal[1];
            let instructions = Instructions::select().unwrap();
            let frontal = n.min(60);
            let error =
                Front::new(&f, n, frontal).factor(instructions, &diagonal, LENIENT).unwrap_err();
            assert_eq!(error.column, 4);
            f[0] = f64::NAN;
            assert!(Front::new(&f, n, frontal).factor(instructions, &diagonal, LENIENT).is_err());
        }
    }

    #[test]
    fn two_weak_pivots_in_a_row_are_one_too_many() {
        let f = |a, b| [a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, 1.0];
        let bound = PivotBound { ratio: 1e-9, product: 1e-13, weakest: 1.0 };
        let diagonal = [1.0, 1.0, 1.0];
        let instructions = Instructions::select().unwrap();
        let run = |a, b, bound| Front::new(&f(a, b), 3, 3).factor(instructions, &diagonal, bound);
        assert_eq!(run(1e-8, 1.0, bound), Ok(1e-8));
        assert_eq!(run(1e-8, 1e-8, bound), Err(BadPivot { column: 1 }));
        let below = PivotBound { weakest: 1e-8, ..bound };
        assert_eq!(run(1e-8, 1.0, below), Err(BadPivot { column: 0 }));
    }
}
