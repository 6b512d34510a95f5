//! How far a measurement can be trusted.

use nalgebra::{DMatrix, SMatrix};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Relative size of an asymmetry, or of a negative eigenvalue, that counts as rounding. Both are
/// measured on the matrix scaled to unit diagonal, so that metres and radians compare.
const ROUNDING: f64 = 1e-12;

/// How far two mirrored entries may differ, relative to the diagonal: a matrix that went through a
/// product or an inverse is symmetric to about this.
const ASYMMETRY: f64 = 1e-8;

/// Below this ratio of a Cholesky pivot to its diagonal entry the matrix counts as singular and is
/// factored through its eigenvalues.
const PIVOT: f64 = 1e-13;

/// Why numbers do not describe a noise.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NoiseError {
    /// No rows.
    #[error("a noise model needs at least one dimension")]
    Empty,
    /// The matrix is not square.
    #[error("a {what} matrix must be square, this one is {rows} by {columns}")]
    NotSquare {
        /// Which matrix.
        what: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
    },
    /// A NaN or an infinity.
    #[error("entry ({row}, {column}) of the {what} matrix is {value}; all entries must be finite")]
    NotFinite {
        /// Which matrix.
        what: &'static str,
        /// From 0.
        row: usize,
        /// From 0.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// Mirrored entries differ.
    #[error(
        "the {what} matrix is not symmetric: entry ({row}, {column}) is {upper} but ({column}, {row}) is {lower}; \
         if it is a square root, use from_sqrt_information"
    )]
    NotSymmetric {
        /// Which matrix.
        what: &'static str,
        /// From 0.
        row: usize,
        /// From 0.
        column: usize,
        /// Entry above the diagonal.
        upper: f64,
        /// Entry below the diagonal.
        lower: f64,
    },
    /// A standard deviation that is not positive, finite, and of representable inverse square.
    #[error(
        "sigma {index} is {sigma}; a standard deviation must be positive and finite \
         (leave a component out of the factor, or give zero information, if nothing is known about it)"
    )]
    BadSigma {
        /// From 0.
        index: usize,
        /// The number given.
        sigma: f64,
    },
    /// Negative information.
    #[error(
        "the information matrix is not positive semi-definite: its smallest eigenvalue is {eigenvalue:.6e}, \
         its largest {largest:.6e}; if printed digits were rounded away, use from_information_clipped"
    )]
    Indefinite {
        /// The smallest eigenvalue.
        eigenvalue: f64,
        /// The largest eigenvalue.
        largest: f64,
    },
    /// A covariance without an inverse.
    #[error(
        "the covariance matrix is not positive definite (pivot {pivot:.3e} in row {row}), which would mean \
         infinite information; add the variance that is missing, or give the information instead"
    )]
    SingularCovariance {
        /// Where the factorization broke down, from 0.
        row: usize,
        /// The pivot there.
        pivot: f64,
    },
}

/// A Gaussian of mean zero, kept as the upper triangular square root `R` of its information:
/// `Ω = RᵀR`, whitened residual `r = R e`.
///
/// Constructors say what their numbers are. Information may be singular (nothing is known in some
/// direction); covariance may not.
///
/// ```
/// use evergraph_model::Noise;
/// # fn main() -> Result<(), evergraph_model::NoiseError> {
/// // Pose2: 5 cm, 5 cm, 1 degree.
/// let odometry = Noise::from_sigmas(&[0.05, 0.05, 1_f64.to_radians()])?;
/// assert_eq!(odometry.dim(), 3);
/// assert!((odometry.information()[(0, 0)] - 400.0).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Entries", into = "Entries")]
pub struct Noise {
    sqrt_information: DMatrix<f64>,
}

impl Noise {
    /// Independent components with these standard deviations.
    ///
    /// # Errors
    /// [`NoiseError::Empty`], [`NoiseError::BadSigma`].
    pub fn from_sigmas(sigmas: &[f64]) -> Result<Self, NoiseError> {
        for (index, &sigma) in sigmas.iter().enumerate() {
            let information = (1.0 / sigma) * (1.0 / sigma);
            if !(sigma > 0.0 && sigma.is_finite() && information.is_normal()) {
                return Err(NoiseError::BadSigma { index, sigma });
            }
        }
        let n = nonempty(sigmas.len())?;
        Ok(Self {
            sqrt_information: DMatrix::from_fn(
                n,
                n,
                |i, j| if i == j { 1.0 / sigmas[i] } else { 0.0 },
            ),
        })
    }

    /// `dim` independent components of standard deviation `sigma`.
    ///
    /// # Errors
    /// [`NoiseError::Empty`], [`NoiseError::BadSigma`].
    pub fn isotropic(dim: usize, sigma: f64) -> Result<Self, NoiseError> {
        Self::from_sigmas(&vec![sigma; dim])
    }

    /// From a covariance, symmetric and positive definite.
    ///
    /// # Errors
    /// [`NoiseError::SingularCovariance`] and those of the matrix's shape and numbers.
    pub fn from_covariance(covariance: &DMatrix<f64>) -> Result<Self, NoiseError> {
        let symmetric = symmetric("covariance", covariance)?;
        let n = symmetric.nrows();
        // Σ = U Uᵀ with U upper triangular is Cholesky from the last row up; then R = U⁻¹.
        let reversed = reverse(&symmetric);
        let lower = cholesky(&reversed, 1e-15)
            .map_err(|(row, pivot)| NoiseError::SingularCovariance { row: n - 1 - row, pivot })?;
        let upper = reverse(&lower);
        let mut inverse = DMatrix::zeros(n, n);
        for j in 0..n {
            inverse[(j, j)] = 1.0 / upper[(j, j)];
            for i in (0..j).rev() {
                let sum: f64 = (i + 1..=j).map(|k| upper[(i, k)] * inverse[(k, j)]).sum();
                inverse[(i, j)] = -sum / upper[(i, i)];
            }
        }
        finite("inverse square-root covariance", &inverse)?;
        Ok(Self { sqrt_information: inverse })
    }

    /// From an information matrix, symmetric and positive semi-definite.
    ///
    /// # Errors
    /// [`NoiseError::Indefinite`] when an eigenvalue is negative beyond rounding, and those of the
    /// matrix's shape and numbers.
    pub fn from_information(information: &DMatrix<f64>) -> Result<Self, NoiseError> {
        Ok(Self::from_information_clipped(information, ROUNDING)?.0)
    }

    /// [`from_information`](Self::from_information) for a matrix whose printed digits were cut:
    /// negative eigenvalues down to `-relative_tolerance` times the largest, of the matrix scaled
    /// to unit diagonal, are taken as zero. The flag says whether one was clipped that is more
    /// than rounding.
    ///
    /// # Errors
    /// As for [`from_information`](Self::from_information), with that tolerance.
    pub fn from_information_clipped(
        information: &DMatrix<f64>,
        relative_tolerance: f64,
    ) -> Result<(Self, bool), NoiseError> {
        let symmetric = symmetric("information", information)?;
        if let Ok(lower) = cholesky(&symmetric, PIVOT) {
            return Ok((Self { sqrt_information: lower.transpose() }, false));
        }
        let n = symmetric.nrows();
        let largest_entry = symmetric.amax();
        if largest_entry == 0.0 {
            return Ok((Self { sqrt_information: symmetric }, false));
        }
        let scales: Vec<f64> = (0..n)
            .map(|i| if symmetric[(i, i)] > 0.0 { symmetric[(i, i)] } else { largest_entry }.sqrt())
            .collect();
        let scaled = DMatrix::from_fn(n, n, |i, j| symmetric[(i, j)] / scales[i] / scales[j]);
        let eigen = scaled.symmetric_eigen();
        let (smallest, largest) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
        if smallest < -relative_tolerance.max(ROUNDING) * largest {
            // Congruence keeps signs, so the matrix as given has a negative eigenvalue too.
            let eigenvalues = symmetric.symmetric_eigenvalues();
            return Err(NoiseError::Indefinite {
                eigenvalue: eigenvalues.min(),
                largest: eigenvalues.max(),
            });
        }
        let mut root = eigen.eigenvectors.transpose();
        for i in 0..n {
            let weight = eigen.eigenvalues[i].max(0.0).sqrt();
            for j in 0..n {
                root[(i, j)] *= weight * scales[j];
            }
        }
        Ok((Self { sqrt_information: upper_triangular(root) }, smallest < -ROUNDING * largest))
    }

    /// From any square root of the information, `Ω = AᵀA`, of any shape that is square.
    ///
    /// An upper triangular one is kept, with rows negated where the diagonal is negative; any other
    /// is rotated into that form by QR. Neither changes the information.
    ///
    /// # Errors
    /// Those of the matrix's shape and numbers.
    pub fn from_sqrt_information(root: &DMatrix<f64>) -> Result<Self, NoiseError> {
        square("square-root information", root)?;
        finite("square-root information", root)?;
        Ok(Self { sqrt_information: upper_triangular(root.clone()) })
    }

    /// The dimension of residuals that it whitens.
    pub fn dim(&self) -> usize {
        self.sqrt_information.nrows()
    }

    /// `R`, upper triangular with a diagonal that is not negative.
    pub fn sqrt_information(&self) -> &DMatrix<f64> {
        &self.sqrt_information
    }

    /// `Ω = RᵀR`.
    pub fn information(&self) -> DMatrix<f64> {
        self.sqrt_information.tr_mul(&self.sqrt_information)
    }

    /// `R` as a matrix of fixed size, if it has that size.
    pub fn fixed<const N: usize>(&self) -> Option<SMatrix<f64, N, N>> {
        (self.dim() == N).then(|| SMatrix::from_column_slice(self.sqrt_information.as_slice()))
    }

    /// Replaces each column `e` of a column-major matrix of [`dim`](Self::dim) rows by `R e`.
    pub fn whiten_columns(&self, columns: &mut [f64]) {
        let n = self.dim();
        debug_assert_eq!(columns.len() % n, 0, "the matrix has {n} rows");
        let root = self.sqrt_information.as_slice();
        // Loops of known length for the dimensions of rotations, points and poses.
        match n {
            1 => whiten_fixed::<1>(root, columns),
            2 => whiten_fixed::<2>(root, columns),
            3 => whiten_fixed::<3>(root, columns),
            6 => whiten_fixed::<6>(root, columns),
            _ => columns.chunks_exact_mut(n).for_each(|column| whiten(root, column)),
        }
    }
}

/// `R e` in the place of each column of `N` rows.
fn whiten_fixed<const N: usize>(root: &[f64], columns: &mut [f64]) {
    let (root, _) = root.as_chunks::<N>();
    for column in columns.as_chunks_mut::<N>().0 {
        // The zeros below the diagonal join in: whole columns are vectors.
        let mut whitened = [0.0; N];
        for (root, x) in root.iter().zip(*column) {
            for (sum, r) in whitened.iter_mut().zip(root) {
                *sum += r * x;
            }
        }
        *column = whitened;
    }
}

/// `R e` in the place of `e`, of any length.
fn whiten(root: &[f64], column: &mut [f64]) {
    let n = column.len();
    // Row i of R reads entries i.. only, so the column can be overwritten from the top.
    for i in 0..n {
        column[i] = (i..n).map(|j| root[j * n + i] * column[j]).sum();
    }
}

/// What is saved: the rows of R from the diagonal on.
#[derive(Serialize, Deserialize)]
struct Entries {
    dim: usize,
    upper: Vec<f64>,
}

impl From<Noise> for Entries {
    fn from(noise: Noise) -> Self {
        let (dim, r) = (noise.dim(), &noise.sqrt_information);
        Self { dim, upper: (0..dim).flat_map(|i| (i..dim).map(move |j| r[(i, j)])).collect() }
    }
}

impl TryFrom<Entries> for Noise {
    type Error = NoiseError;

    fn try_from(entries: Entries) -> Result<Self, NoiseError> {
        let n = nonempty(entries.dim)?;
        let expected = n.checked_add(1).and_then(|next| n.checked_mul(next)).map(|twice| twice / 2);
        if expected != Some(entries.upper.len()) {
            return Err(NoiseError::NotSquare {
                what: "saved square-root information",
                rows: n,
                columns: entries.upper.len() / n,
            });
        }
        let mut numbers = entries.upper.into_iter();
        let mut root = DMatrix::zeros(n, n);
        for i in 0..n {
            for j in i..n {
                root[(i, j)] = numbers.next().unwrap_or(f64::NAN);
            }
        }
        Self::from_sqrt_information(&root)
    }
}

fn nonempty(n: usize) -> Result<usize, NoiseError> {
    if n == 0 { Err(NoiseError::Empty) } else { Ok(n) }
}

fn square(what: &'static str, m: &DMatrix<f64>) -> Result<(), NoiseError> {
    if m.nrows() != m.ncols() {
        return Err(NoiseError::NotSquare { what, rows: m.nrows(), columns: m.ncols() });
    }
    nonempty(m.nrows()).map(|_| ())
}

fn finite(what: &'static str, m: &DMatrix<f64>) -> Result<(), NoiseError> {
    for row in 0..m.nrows() {
        for column in 0..m.ncols() {
            let value = m[(row, column)];
            if !value.is_finite() {
                return Err(NoiseError::NotFinite { what, row, column, value });
            }
        }
    }
    Ok(())
}

/// The matrix with mirrored entries averaged, if it is symmetric.
fn symmetric(what: &'static str, m: &DMatrix<f64>) -> Result<DMatrix<f64>, NoiseError> {
    square(what, m)?;
    finite(what, m)?;
    for row in 0..m.nrows() {
        for column in row + 1..m.ncols() {
            let (upper, lower) = (m[(row, column)], m[(column, row)]);
            let size =
                (m[(row, row)].abs().sqrt() * m[(column, column)].abs().sqrt()).max(upper.abs());
            if (upper - lower).abs() > ASYMMETRY * size {
                return Err(NoiseError::NotSymmetric { what, row, column, upper, lower });
            }
        }
    }
    // Halved before adding, which cannot overflow; equal entries come out as they went in.
    Ok(DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| 0.5 * m[(i, j)] + 0.5 * m[(j, i)]))
}

/// `L` with `M = L Lᵀ`, or the first row whose pivot is below `ratio` times its diagonal entry.
fn cholesky(m: &DMatrix<f64>, ratio: f64) -> Result<DMatrix<f64>, (usize, f64)> {
    let n = m.nrows();
    let mut l = DMatrix::zeros(n, n);
    for j in 0..n {
        let pivot = m[(j, j)] - (0..j).map(|k| l[(j, k)] * l[(j, k)]).sum::<f64>();
        if pivot <= ratio * m[(j, j)] || !pivot.is_normal() {
            return Err((j, pivot));
        }
        l[(j, j)] = pivot.sqrt();
        for i in j + 1..n {
            let sum: f64 = (0..j).map(|k| l[(i, k)] * l[(j, k)]).sum();
            l[(i, j)] = (m[(i, j)] - sum) / l[(j, j)];
        }
    }
    Ok(l)
}

/// Rows and columns in reverse order.
fn reverse(m: &DMatrix<f64>) -> DMatrix<f64> {
    let n = m.nrows();
    DMatrix::from_fn(n, n, |i, j| m[(n - 1 - i, n - 1 - j)])
}

/// The upper triangular `R` with `RᵀR = AᵀA` and a diagonal that is not negative.
fn upper_triangular(a: DMatrix<f64>) -> DMatrix<f64> {
    let n = a.nrows();
    let is_upper = (0..n).all(|j| (j + 1..n).all(|i| a[(i, j)] == 0.0));
    let mut r = if is_upper { a } else { a.qr().r() };
    for i in 0..n {
        if r[(i, i)] < 0.0 {
            r.row_mut(i).neg_mut();
        }
    }
    r
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitening_in_place_is_the_product_with_the_root() {
        for n in 1..9 {
            let root =
                DMatrix::from_fn(n, n, |i, j| if i <= j { 1.0 + (3 * i + j) as f64 } else { 0.0 });
            let noise = Noise::from_sqrt_information(&root).unwrap();
            let matrix = DMatrix::from_fn(n, 4, |i, j| (i as f64 - 1.5) * (j as f64 + 0.25));
            let mut whitened = matrix.clone();
            noise.whiten_columns(whitened.as_mut_slice());
            assert!((&whitened - root * matrix).amax() < 1e-12, "{n} dimensions");
        }
    }
}
