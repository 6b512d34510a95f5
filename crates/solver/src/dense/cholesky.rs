//! Partial Cholesky factorization of a frontal matrix.
//!
//! With the symmetric front split into frontal and other columns,
//!
//! ```text
//! F = | A  Bᵀ |      A = L Lᵀ,   P = B L⁻ᵀ,   S = C − P Pᵀ
//!     | B  C  |
//! ```
//!
//! the kernel leaves `L` and `P` in the first `frontal` columns and `S`, the contribution to the
//! parent, in the trailing square; only the lower triangle is read or meaningful.

use faer::linalg::cholesky::llt::factor::{
    LltParams, LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, Par, Spec};
use pulp::{Arch, Simd, WithSimd};

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
    fn allows(self, pivot: f64, diagonal: f64, smallest: f64) -> bool {
        pivot > self.ratio * diagonal
            && pivot * self.weakest.min(smallest) > self.product * diagonal
            && pivot.is_finite()
    }
}

/// The widest instruction set of this machine.
pub(crate) fn select_arch() -> Arch {
    Arch::new()
}

/// Eliminates the first `frontal` columns of the `n` × `n` column-major `front`.
///
/// `diagonal[j]` is the diagonal entry of JᵀJ that belongs to frontal column `j`; a pivot that is
/// below `bound` of it has lost its digits and ends the elimination. Returns the smallest pivot
/// ratio. O(frontal · n²).
pub(crate) fn partial_cholesky(
    arch: Arch,
    front: &mut [f64],
    n: usize,
    frontal: usize,
    diagonal: &[f64],
    bound: PivotBound,
) -> Result<f64, BadPivot> {
    let kernel = PartialCholesky { front, n, frontal, diagonal, bound };
    if n > super::LARGE && frontal > 32 { kernel.by_faer() } else { arch.dispatch(kernel) }
}

struct PartialCholesky<'a> {
    front: &'a mut [f64],
    n: usize,
    frontal: usize,
    diagonal: &'a [f64],
    bound: PivotBound,
}

/// Columns eliminated together; their multiples are subtracted from the rest in one pass.
const PANEL: usize = 8;

impl WithSimd for PartialCholesky<'_> {
    type Output = Result<f64, BadPivot>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { front, n, frontal, diagonal, bound } = self;
        let mut smallest = f64::INFINITY;
        let mut start = 0;
        while start < frontal {
            let width = PANEL.min(frontal - start);
            let (panel, rest) = front[start * n..].split_at_mut(width * n);
            for j in 0..width {
                let (done, column) = panel.split_at_mut(j * n);
                let column = &mut column[start + j..n];
                for done in done.chunks_exact(n) {
                    let row = &done[start + j..];
                    subtract_multiple(simd, column, row, row[0]);
                }
                let pivot = column[0];
                let scale = diagonal[start + j];
                if !bound.allows(pivot, scale, smallest) {
                    return Err(BadPivot { column: start + j });
                }
                smallest = smallest.min(pivot / scale);
                let root = pivot.sqrt();
                column[0] = root;
                scale_by(simd, &mut column[1..], 1.0 / root);
            }
            if width == PANEL {
                subtract_panel(simd, panel, rest, n, start + PANEL);
            } else {
                for (k, column) in rest.chunks_exact_mut(n).enumerate() {
                    let row = start + width + k;
                    for done in panel.chunks_exact(n) {
                        subtract_multiple(simd, &mut column[row..], &done[row..], done[row]);
                    }
                }
            }
            start += width;
        }
        Ok(smallest)
    }
}

/// `y *= a`.
#[inline(always)]
fn scale_by<S: Simd>(simd: S, y: &mut [f64], a: f64) {
    let (head, tail) = S::as_mut_simd_f64s(y);
    let factor = simd.splat_f64s(a);
    for y in head {
        *y = simd.mul_f64s(*y, factor);
    }
    for y in tail {
        *y *= a;
    }
}

/// `y -= a x`.
#[inline(always)]
fn subtract_multiple<S: Simd>(simd: S, y: &mut [f64], x: &[f64], a: f64) {
    let x = &x[..y.len()];
    let (y_head, y_tail) = S::as_mut_simd_f64s(y);
    let (x_head, x_tail) = S::as_simd_f64s(x);
    let factor = simd.splat_f64s(-a);
    for (y, x) in y_head.iter_mut().zip(x_head) {
        *y = simd.mul_add_e_f64s(factor, *x, *y);
    }
    for (y, x) in y_tail.iter_mut().zip(x_tail) {
        *y -= a * x;
    }
}

/// Subtracts a full panel's products from the columns `first..n`, four columns at a time, so that
/// each value of the panel is loaded once for four of them.
#[inline(always)]
fn subtract_panel<S: Simd>(simd: S, panel: &[f64], rest: &mut [f64], n: usize, first: usize) {
    let mut columns: [&[f64]; PANEL] = [&[]; PANEL];
    for (slot, column) in columns.iter_mut().zip(panel.chunks_exact(n)) {
        *slot = column;
    }
    let mut row = first;
    let mut quads = rest.chunks_exact_mut(4 * n);
    for quad in &mut quads {
        let (c0, quad) = quad.split_at_mut(n);
        let (c1, quad) = quad.split_at_mut(n);
        let (c2, c3) = quad.split_at_mut(n);
        let mut factors = [[simd.splat_f64s(0.0); 4]; PANEL];
        for (f, column) in factors.iter_mut().zip(columns) {
            *f = [0, 1, 2, 3].map(|k| simd.splat_f64s(-column[row + k]));
        }
        let (h0, t0) = S::as_mut_simd_f64s(&mut c0[row..]);
        let (h1, t1) = S::as_mut_simd_f64s(&mut c1[row..]);
        let (h2, t2) = S::as_mut_simd_f64s(&mut c2[row..]);
        let (h3, t3) = S::as_mut_simd_f64s(&mut c3[row..]);
        let heads = columns.map(|column| S::as_simd_f64s(&column[row..]).0);
        let length = h0.len();
        let heads = heads.map(|head| &head[..length]);
        let (h1, h2, h3) = (&mut h1[..length], &mut h2[..length], &mut h3[..length]);
        for i in 0..length {
            let (mut a, mut b, mut c, mut d) = (h0[i], h1[i], h2[i], h3[i]);
            for p in 0..PANEL {
                let x = heads[p][i];
                a = simd.mul_add_e_f64s(factors[p][0], x, a);
                b = simd.mul_add_e_f64s(factors[p][1], x, b);
                c = simd.mul_add_e_f64s(factors[p][2], x, c);
                d = simd.mul_add_e_f64s(factors[p][3], x, d);
            }
            (h0[i], h1[i], h2[i], h3[i]) = (a, b, c, d);
        }
        let tail = row + length * S::F64_LANES;
        for column in columns {
            let x = &column[tail..n];
            let f = [0, 1, 2, 3].map(|k| column[row + k]);
            for (i, x) in x.iter().enumerate() {
                t0[i] -= f[0] * x;
                t1[i] -= f[1] * x;
                t2[i] -= f[2] * x;
                t3[i] -= f[3] * x;
            }
        }
        row += 4;
    }
    for column in quads.into_remainder().chunks_exact_mut(n) {
        for done in columns {
            subtract_multiple(simd, &mut column[row..], &done[row..], done[row]);
        }
        row += 1;
    }
}

impl PartialCholesky<'_> {
    fn by_faer(self) -> Result<f64, BadPivot> {
        let Self { front, n, frontal, diagonal, bound } = self;
        let matrix = MatMut::from_column_major_slice_mut(front, n, n);
        let (mut a, _, mut b, c) = matrix.split_at_mut(frontal, frontal);
        let params = Spec::<LltParams, f64>::default();
        let scratch = cholesky_in_place_scratch::<f64>(frontal, Par::Seq, params);
        let mut memory = faer::dyn_stack::MemBuffer::new(scratch);
        let stack = faer::dyn_stack::MemStack::new(&mut memory);
        if let Err(error) =
            cholesky_in_place(a.as_mut(), LltRegularization::default(), Par::Seq, stack, params)
        {
            let faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index } = error;
            return Err(BadPivot { column: index.min(frontal - 1) });
        }
        let mut smallest = f64::INFINITY;
        for (column, scale) in diagonal[..frontal].iter().enumerate() {
            let pivot = a[(column, column)] * a[(column, column)];
            if !bound.allows(pivot, *scale, smallest) {
                return Err(BadPivot { column });
            }
            smallest = smallest.min(pivot / scale);
        }
        // P = B L⁻ᵀ, solved as L Pᵀ = Bᵀ.
        solve_lower_triangular_in_place(a.as_ref(), b.as_mut().transpose_mut(), Par::Seq);
        matmul(
            c,
            BlockStructure::TriangularLower,
            Accum::Add,
            b.as_ref(),
            BlockStructure::Rectangular,
            b.as_ref().transpose(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
        Ok(smallest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const LENIENT: PivotBound = PivotBound { ratio: 1e-9, product: 0.0, weakest: 1.0 };

    /// A positive definite n × n matrix, column-major, and its diagonal.
    fn front(n: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
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

    /// L and P times their transposes, plus S, must give F back.
    fn check(original: &[f64], result: &[f64], n: usize, frontal: usize) {
        for j in 0..n {
            for i in j..n {
                let products: f64 =
                    (0..frontal.min(j + 1)).map(|k| result[k * n + i] * result[k * n + j]).sum();
                let rest = if j >= frontal { result[j * n + i] } else { 0.0 };
                let scale = (original[i * n + i] * original[j * n + j]).sqrt();
                let off = (products + rest - original[j * n + i]).abs();
                assert!(
                    off <= 1e-13 * n as f64 * scale,
                    "({i}, {j}) of {n}, {frontal}: off by {off}"
                );
            }
        }
    }

    #[test]
    fn every_size_and_instruction_set_reproduces_the_front() {
        let mut archs = vec![Arch::Scalar];
        #[cfg(target_arch = "x86_64")]
        {
            archs.extend(pulp::x86::V3::try_new().map(Arch::V3));
            archs.extend(pulp::x86::V4::try_new().map(Arch::V4));
        }
        for arch in archs {
            for n in (1..40_usize).chain([63, 100, 131]) {
                for frontal in [1, n / 3, n / 2, n.saturating_sub(1), n] {
                    let (original, diagonal) = front(n, n as u64);
                    let mut result = original.clone();
                    partial_cholesky(arch, &mut result, n, frontal, &diagonal, LENIENT).unwrap();
                    check(&original, &result, n, frontal);
                }
            }
        }
    }

    #[test]
    fn large_fronts_agree_with_small_ones() {
        let (n, frontal) = (super::super::LARGE + 21, 150);
        let (original, diagonal) = front(n, 7);
        let mut result = original.clone();
        partial_cholesky(select_arch(), &mut result, n, frontal, &diagonal, LENIENT).unwrap();
        check(&original, &result, n, frontal);
    }

    #[test]
    fn bad_pivots_are_named() {
        for n in [6, super::super::LARGE + 40] {
            let (mut f, mut diagonal) = front(n, 3);
            // Column 4 becomes a copy of column 1: no information of its own.
            for i in 0..n {
                f[4 * n + i] = f[n + i];
            }
            for i in 0..n {
                f[i * n + 4] = f[i * n + 1];
            }
            diagonal[4] = diagonal[1];
            let mut copy = f.clone();
            let error =
                partial_cholesky(select_arch(), &mut copy, n, n.min(60), &diagonal, LENIENT)
                    .unwrap_err();
            assert_eq!(error.column, 4);
            f[0] = f64::NAN;
            assert!(
                partial_cholesky(select_arch(), &mut f, n, n.min(60), &diagonal, LENIENT).is_err()
            );
        }
    }

    #[test]
    fn two_weak_pivots_in_a_row_are_one_too_many() {
        let f = |a, b| [a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, 1.0];
        let bound = PivotBound { ratio: 1e-9, product: 1e-13, weakest: 1.0 };
        let diagonal = [1.0, 1.0, 1.0];
        let run =
            |a, b, bound| partial_cholesky(select_arch(), &mut f(a, b), 3, 3, &diagonal, bound);
        assert_eq!(run(1e-8, 1.0, bound), Ok(1e-8));
        assert_eq!(run(1e-8, 1e-8, bound), Err(BadPivot { column: 1 }));
        let below = PivotBound { weakest: 1e-8, ..bound };
        assert_eq!(run(1e-8, 1.0, below), Err(BadPivot { column: 0 }));
    }
}
