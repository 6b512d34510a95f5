//! Orthogonal triangularization of stacked rows, for square-root elimination.

use faer::linalg::qr::no_pivoting::factor::{
    QrParams, qr_in_place, qr_in_place_scratch, recommended_block_size,
};
use faer::{Mat, MatMut, Par, Spec};

/// From this many columns on a blocked factorization is used.
const BLOCKED: usize = 48;

/// Replaces the `m` × `n` column-major `a` by its triangular factor (upper trapezoidal, `Qᵀa`);
/// what stood below the diagonal is zero afterwards. O(m n²).
pub(crate) fn triangularize(a: &mut [f64], m: usize, n: usize) {
    if n > BLOCKED && m > BLOCKED {
        by_faer(a, m, n);
    } else {
        by_columns(a, m, n);
    }
    for j in 0..n.min(m) {
        a[j * m + j + 1..(j + 1) * m].fill(0.0);
    }
}

fn by_columns(a: &mut [f64], m: usize, n: usize) {
    for j in 0..n.min(m.saturating_sub(1)) {
        let (done, rest) = a.split_at_mut((j + 1) * m);
        let v = &mut done[j * m + j..];
        let tail: f64 = v[1..].iter().map(|x| x * x).sum();
        if tail == 0.0 {
            continue;
        }
        let norm = (v[0] * v[0] + tail).sqrt();
        // The reflection sends v to ∓norm e₁, away from v₀, so nothing cancels.
        let image = if v[0] > 0.0 { -norm } else { norm };
        v[0] -= image;
        let scale = 2.0 / (v[0] * v[0] + tail);
        for column in rest.chunks_exact_mut(m) {
            let y = &mut column[j..];
            let dot: f64 = v.iter().zip(y.iter()).map(|(v, y)| v * y).sum();
            let factor = scale * dot;
            for (y, v) in y.iter_mut().zip(v.iter()) {
                *y -= factor * v;
            }
        }
        v[0] = image;
    }
}

fn by_faer(a: &mut [f64], m: usize, n: usize) {
    let block = recommended_block_size::<f64>(m, n);
    let mut coefficients = Mat::<f64>::zeros(block, m.min(n));
    let params = Spec::<QrParams, f64>::default();
    let mut memory =
        faer::dyn_stack::MemBuffer::new(qr_in_place_scratch::<f64>(m, n, block, Par::Seq, params));
    qr_in_place(
        MatMut::from_column_major_slice_mut(a, m, n),
        coefficients.as_mut(),
        Par::Seq,
        faer::dyn_stack::MemStack::new(&mut memory),
        params,
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn keeps_the_gram_matrix() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for (m, n) in
            [(1, 1), (1, 4), (4, 1), (5, 5), (9, 4), (4, 9), (60, 50), (130, 70), (50, 70)]
        {
            let a: Vec<f64> = (0..m * n).map(|_| rng.random_range(-1.0..1.0)).collect();
            let mut r = a.clone();
            triangularize(&mut r, m, n);
            for j in 0..n {
                for i in j + 1..m {
                    assert_eq!(r[j * m + i], 0.0);
                }
                for k in 0..n {
                    let gram = |x: &[f64]| (0..m).map(|i| x[j * m + i] * x[k * m + i]).sum::<f64>();
                    assert!((gram(&a) - gram(&r)).abs() < 1e-12 * m as f64, "{m} x {n}");
                }
            }
        }
    }
}
