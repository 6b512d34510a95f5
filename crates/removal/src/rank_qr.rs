//! Householder reflections on small dense matrices, with ranks.

use nalgebra::{DMatrix, DVector};

/// What is left of a column once all earlier columns are taken out of it counts as nothing below
/// this share of the column's norm in the whitened Jacobian stack.
///
/// Rounding leaves about 1e-15, and what the solver can still tell from a free direction is 1e-11
/// (a pivot ratio of 1e-22 of `JᵀJ`). Measuring every column by its own norm makes the test free of
/// units and of the size of the clique.
pub(crate) const RANK_TOLERANCE: f64 = 1e-10;

/// A column of which less than this share of its norm is left waits for the others: dividing by what
/// is left would magnify rounding in all that comes after.
const WAITS: f64 = 0.1;

/// Brings the first `columns` of `a` into row echelon form by reflections from the left, which all
/// further columns take part in; returns the pivot columns in the order of their rows. Their number
/// is the rank of those columns.
///
/// ```text
/// Qᵀ A = [ R  * ]    R: one row per pivot, upper triangular in the order of the pivots
///        [ 0  * ]
/// ```
///
/// Columns are taken as they come while most of them is left ([`WAITS`]), the others after that by
/// the largest share of their `scale` that is left. Once that is below [`RANK_TOLERANCE`], the rest
/// is set to zero: a backward error of that size in those columns alone. Nothing is squared, so ranks
/// down to that tolerance are told, where the eigenvalues of `AᵀA` end at the root of the rounding
/// error. Pivoting where it matters only keeps columns that end in zeros cheap.
///
/// O(rows · columns²), less where columns end in zeros.
pub(crate) fn echelon(a: &mut DMatrix<f64>, columns: usize, scales: &[f64]) -> Vec<usize> {
    let rows = a.nrows();
    let mut pivots = Vec::with_capacity(columns.min(rows));
    let mut waiting = Vec::new();
    let mut reflector = Vec::with_capacity(rows);
    for (column, scale) in scales.iter().enumerate().take(columns) {
        let left = norm(&a.column(column).as_slice()[pivots.len()..]);
        if left > WAITS * scale {
            reflect(a, pivots.len(), column, left, &waiting, column + 1, &mut reflector);
            pivots.push(column);
        } else {
            waiting.push(column);
        }
    }
    while !waiting.is_empty() {
        let top = pivots.len();
        let share = |&column: &usize| {
            let left = norm(&a.column(column).as_slice()[top..]);
            let share = if left > 0.0 { left / scales[column] } else { 0.0 };
            (share, left)
        };
        let shares = waiting.iter().map(share).enumerate();
        let best = shares.rev().max_by(|a, b| a.1.0.total_cmp(&b.1.0));
        let Some((place, (share, left))) = best else { break };
        if share <= RANK_TOLERANCE {
            for &column in &waiting {
                a.column_mut(column).rows_mut(top, rows - top).fill(0.0);
            }
            break;
        }
        let column = waiting.remove(place);
        reflect(a, top, column, left, &waiting, columns, &mut reflector);
        pivots.push(column);
    }
    pivots
}

/// `U` upper triangular with `UᵀU = AᵀA`, of a tall matrix, columns in their order.
pub(crate) fn triangle(mut a: DMatrix<f64>) -> DMatrix<f64> {
    let n = a.ncols();
    let mut reflector = Vec::with_capacity(a.nrows());
    for column in 0..n.min(a.nrows()) {
        let left = norm(&a.column(column).as_slice()[column..]);
        if left > 0.0 {
            reflect(&mut a, column, column, left, &[], column + 1, &mut reflector);
        }
    }
    a.resize_vertically(n, 0.0)
}

/// Reflects the rows from `top` on so that of `column`, whose norm there is `norm`, only the first
/// entry stays; columns in `others` and from `from` on take part.
fn reflect(
    a: &mut DMatrix<f64>,
    top: usize,
    column: usize,
    norm: f64,
    others: &[usize],
    from: usize,
    reflector: &mut Vec<f64>,
) {
    let (rows, width) = a.shape();
    let data = a.as_mut_slice();
    let own = &mut data[column * rows + top..(column + 1) * rows];
    // Rows below the last entry take no part.
    let len = own.iter().rposition(|&x| x != 0.0).map_or(0, |last| last + 1);
    if len < 2 {
        return;
    }
    reflector.clear();
    reflector.extend_from_slice(&own[..len]);
    // v = x + sign(x₀) ‖x‖ e₀ does not cancel; H = I - 2 v vᵀ / vᵀv, with 2 / vᵀv = 1 / (‖x‖ |v₀|).
    let diagonal = if own[0] > 0.0 { -norm } else { norm };
    reflector[0] -= diagonal;
    own[..len].fill(0.0);
    own[0] = diagonal;
    let weight = 1.0 / (norm * reflector[0].abs());
    for k in others.iter().copied().chain(from..width) {
        let target = &mut data[k * rows + top..k * rows + top + len];
        let dot = dot(reflector, target);
        if dot != 0.0 {
            let step = -weight * dot;
            target.iter_mut().zip(&*reflector).for_each(|(t, v)| *t += step * v);
        }
    }
}

/// `xᵀy` in eight sums side by side, which a processor adds at once.
fn dot(x: &[f64], y: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let (x, x_rest) = x.as_chunks::<LANES>();
    let (y, y_rest) = y.as_chunks::<LANES>();
    for (x, y) in x.iter().zip(y) {
        for lane in 0..LANES {
            sums[lane] += x[lane] * y[lane];
        }
    }
    let rest: f64 = x_rest.iter().zip(y_rest).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f64>() + rest
}

/// The Euclidean norm; scaled where squares would leave the range of `f64`.
fn norm(x: &[f64]) -> f64 {
    let squared = dot(x, x);
    if squared.is_normal() {
        return squared.sqrt();
    }
    let largest = x.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    if largest == 0.0 || !largest.is_finite() {
        return largest;
    }
    largest * x.iter().map(|x| (x / largest) * (x / largest)).sum::<f64>().sqrt()
}

/// Norms of the first `columns` columns.
pub(crate) fn column_norms(a: &DMatrix<f64>, columns: usize) -> Vec<f64> {
    (0..columns).map(|j| norm(a.column(j).as_slice())).collect()
}

/// A `d` with `R d = w` for an echelon `R`; zero off the pivots.
pub(crate) fn back_substitute(r: &DMatrix<f64>, pivots: &[usize], w: &[f64]) -> DVector<f64> {
    let mut d = DVector::zeros(r.ncols());
    for (row, &column) in pivots.iter().enumerate().rev() {
        let known: f64 = pivots[row + 1..].iter().map(|&c| r[(row, c)] * d[c]).sum();
        d[column] = (w[row] - known) / r[(row, column)];
    }
    d
}

/// The `y` with `Rᵀ y = eta` in the pivot columns of an echelon `R`. Where `eta` lies in the range
/// of `Rᵀ` all other columns hold too.
pub(crate) fn forward_substitute(
    r: &DMatrix<f64>,
    pivots: &[usize],
    eta: &DVector<f64>,
) -> Vec<f64> {
    let mut y: Vec<f64> = Vec::with_capacity(pivots.len());
    for (row, &column) in pivots.iter().enumerate() {
        let known: f64 = y.iter().enumerate().map(|(k, y)| r[(k, column)] * y).sum();
        y.push((eta[column] - known) / r[(row, column)]);
    }
    y
}

/// The inverse of an upper triangular matrix without zeros on its diagonal.
pub(crate) fn upper_inverse(r: &DMatrix<f64>) -> DMatrix<f64> {
    let n = r.ncols();
    let mut inverse = DMatrix::zeros(n, n);
    for j in 0..n {
        // Column by column: x = R⁻¹ e_j, by subtracting known columns of R.
        let x = &mut inverse.as_mut_slice()[j * n..=j * n + j];
        x[j] = 1.0;
        for k in (0..=j).rev() {
            let column = &r.as_slice()[k * n..=k * n + k];
            let (above, own) = x[..=k].split_at_mut(k);
            own[0] /= column[k];
            above.iter_mut().zip(column).for_each(|(x, r)| *x -= own[0] * r);
        }
    }
    inverse
}

/// `½ ln det(A Aᵀ)` of a wide matrix of full row rank, through the QR of its transpose.
pub(crate) fn half_log_det(rows: &DMatrix<f64>) -> f64 {
    triangle(rows.transpose()).diagonal().iter().map(|u| u.abs().ln()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random(rows: usize, columns: usize, rng: &mut ChaCha8Rng) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0))
    }

    #[test]
    fn reflections_keep_the_gram_matrix_and_tell_the_rank() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for rank in 1..6 {
            // Columns of very different units.
            let mut a = random(9, rank, &mut rng) * random(rank, 6, &mut rng);
            for (j, mut column) in a.column_iter_mut().enumerate() {
                column *= 10_f64.powi(3 * j as i32 - 6);
            }
            let scales = column_norms(&a, 6);
            let mut r = a.clone();
            let pivots = echelon(&mut r, 6, &scales);
            assert_eq!(pivots.len(), rank);
            let (gram, again) = (a.tr_mul(&a), r.tr_mul(&r));
            for i in 0..6 {
                for j in 0..6 {
                    let error = (gram[(i, j)] - again[(i, j)]).abs();
                    assert!(error < 1e-13 * scales[i] * scales[j], "{i} {j}");
                }
            }
            assert!((rank..9).all(|i| r.row(i).amax() == 0.0));
        }
    }

    /// A first column that is small and parallel to the second: taken as it comes, it would leave
    /// rounding magnified by 1e8 in the last, which then counts as a third direction.
    #[test]
    fn small_columns_wait() {
        let mut a = DMatrix::from_row_slice(3, 3, &[0.1, 1.0, 0.5, 0.3, 3.0, 0.7, -0.7, -7.0, 0.9]);
        let third = a.column(1) * 0.3;
        a.column_mut(0).copy_from(&(&third * 1e-8));
        a.column_mut(2).copy_from(&(third * 2.0));
        let mut scales = column_norms(&a, 3);
        scales[0] = 1e-3;
        assert_eq!(echelon(&mut a, 3, &scales), [1]);
    }

    #[test]
    fn systems_are_solved() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let a = random(7, 3, &mut rng) * random(3, 5, &mut rng);
        let mut r = a.clone();
        let pivots = echelon(&mut r, 5, &column_norms(&a, 5));
        let d = random(5, 1, &mut rng).column(0).into_owned();
        let eta = a.tr_mul(&(&a * &d));
        let y = forward_substitute(&r, &pivots, &eta);
        let solution = back_substitute(&r, &pivots, &y);
        assert!((a.tr_mul(&(&a * solution)) - eta).amax() < 1e-13);

        let square = triangle(random(4, 4, &mut rng));
        assert!((&square * upper_inverse(&square) - DMatrix::identity(4, 4)).amax() < 1e-12);
        let wide = random(2, 5, &mut rng);
        let expected = 0.5 * (&wide * wide.transpose()).determinant().ln();
        assert!((half_log_det(&wide) - expected).abs() < 1e-12);
    }
}
