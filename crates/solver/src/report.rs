//! What an update did.

use serde::Serialize;

use crate::batch::BatchReport;
use crate::error::SmootherError;

/// What [`crate::Smoother::apply`] did. Counters measure work, not time.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Variables whose cliques were eliminated for the change itself.
    pub variables_eliminated: usize,
    /// Cliques eliminated, those of relinearization included.
    pub cliques_eliminated: usize,
    /// Subtrees kept as they were, below what was eliminated.
    pub subtrees_kept: usize,
    /// Variables whose linearization point moved.
    pub variables_relinearized: usize,
    /// Smallest pivot over its diagonal entry of JᵀJ among the cliques eliminated for the change
    /// (dimensionless; 1 is best, below 1e-22 is refused as singular). Infinite if there was none.
    pub smallest_pivot_ratio: f64,
    /// Rank of the information matrix: the tangent dimension of all variables, because anything
    /// less is an error.
    pub rank: usize,
    /// The batch step, if one was due.
    pub batch: Option<BatchReport>,
    /// Relinearization was due but would have given a singular or non-finite system; the
    /// linearization points were left where they were.
    pub relinearization_refused: Option<SmootherError>,
}

/// Size of the factorization.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FactorizationSize {
    /// Cliques of the elimination tree.
    pub cliques: usize,
    /// Scalars in the upper triangle of R.
    pub nonzeros: usize,
    /// Columns of R.
    pub columns: usize,
}

impl FactorizationSize {
    /// `nonzeros` as a percentage of a full triangle.
    pub fn fill_percent(&self) -> f64 {
        let n = self.columns as f64;
        if n == 0.0 { 0.0 } else { 100.0 * self.nonzeros as f64 / (n * (n + 1.0) / 2.0) }
    }
}
