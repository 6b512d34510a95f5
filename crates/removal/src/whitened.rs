//! New information relative to the target's, in coordinates in which the target is the identity.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::potential::Potential;
use crate::target::Target;

/// The information of new factors relative to that of the factors that they replace: the eigenvalues of Λ' with
/// respect to Λ_t, 1 where nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Certificate {
    /// Largest eigenvalue. The new factors are conservative when it is at most 1: they claim no more than the factors
    /// that they replace, in any direction.
    pub largest_eigenvalue: f64,
    /// Kullback-Leibler divergence of the new factors from the old by themselves, in nats. It is an upper bound on
    /// that of the map.
    pub divergence: f64,
    /// `ln |Λ_t| - ln |Λ'|` on the directions that are known: positive when the new factors know less.
    pub log_det_ratio: f64,
    /// With [`Consistency::Conservative`](crate::Consistency::Conservative), the most by which the divergence is above
    /// the least possible on this sparsity, in nats.
    pub gap: Option<f64>,
}

/// `B` of the terms, with `z = R_t ξ` and `R_t S = I`: `B_e = (G_e S)ᵀ`, one column for each row of a term.
///
/// Terms see no direction that the target does not see, so that `G_e = B_eᵀ R_t` and the information of all terms is
/// `Λ' = R_tᵀ B Bᵀ R_t`.
#[derive(Clone, Debug)]
pub(crate) struct Whitened {
    pub(crate) all: DMatrix<f64>,
    /// First column of each term, and their number at the end.
    pub(crate) starts: Vec<usize>,
}

impl Whitened {
    /// O(rank³).
    pub(crate) fn of(target: &Target, potentials: &[Potential]) -> Self {
        let s = target.right_inverse();
        let mut starts = vec![0];
        let count = potentials.iter().map(|potential| potential.rows.nrows()).sum();
        let mut all = DMatrix::zeros(target.rank(), count);
        for potential in potentials {
            let (start, height) = (starts[starts.len() - 1], potential.rows.nrows());
            let mut source = 0;
            for &member in &potential.members {
                let columns = target.columns(member);
                let own =
                    potential.rows.columns(source, columns.len()) * s.rows_range(columns.clone());
                let mut view = all.columns_mut(start, height);
                view += own.transpose();
                source += columns.len();
            }
            starts.push(start + height);
        }
        Self { all, starts }
    }

    /// `B Bᵀ`: Λ' in whitened coordinates.
    pub(crate) fn information(&self) -> DMatrix<f64> {
        &self.all * self.all.transpose()
    }

    /// The comparison of the terms as they are with the target.
    pub(crate) fn certificate(&self, gap: Option<f64>) -> Certificate {
        let information = self.information();
        let log_det_ratio = -log_det(&information);
        let divergence = 0.5 * (information.trace() - self.all.nrows() as f64 + log_det_ratio);
        let largest_eigenvalue = largest_eigenvalue(information);
        Certificate {
            largest_eigenvalue,
            divergence: at_least_zero(divergence),
            log_det_ratio,
            gap,
        }
    }

    /// [`Certificate::divergence`] alone.
    pub(crate) fn divergence(&self) -> f64 {
        let information = self.information();
        let excess = information.trace() - self.all.nrows() as f64;
        at_least_zero(0.5 * (excess - log_det(&information)))
    }
}

/// Rounding leaves less than nothing where nothing has changed. NaN stays, where `max` would hide it.
fn at_least_zero(x: f64) -> f64 {
    if x < 0.0 { 0.0 } else { x }
}

/// Minus infinity when the matrix is not positive definite.
fn log_det(matrix: &DMatrix<f64>) -> f64 {
    let factored = matrix.clone().cholesky();
    factored.map_or(f64::NEG_INFINITY, |c| 2.0 * c.l_dirty().diagonal().map(f64::ln).sum())
}

/// Infinite when the matrix is not finite, on which an iteration would not end.
pub(crate) fn largest_eigenvalue(matrix: DMatrix<f64>) -> f64 {
    match matrix.iter().all(|x| x.is_finite()) {
        true if matrix.is_empty() => 0.0,
        true => matrix.symmetric_eigenvalues().max(),
        false => f64::INFINITY,
    }
}
