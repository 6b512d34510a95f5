//! What an update did.

use evergraph_model::VariableId;
use serde::{Serialize, Serializer};
use smallvec::SmallVec;

use crate::batch::BatchReport;
use crate::error::SmootherError;

/// What [`crate::Smoother::apply`] did. Counters measure work, not time.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Variables whose cliques were eliminated for the change itself.
    pub variables_eliminated: usize,
    /// Cliques eliminated, those of relinearization included.
    pub cliques_eliminated: usize,
    /// Subtrees kept as they were, below what was eliminated.
    pub subtrees_kept: usize,
    /// Variables whose linearization point moved; in a batch step, once for each iteration.
    pub variables_relinearized: usize,
    /// The variables whose linearization point moved because of the relinearization policy, each
    /// once. Empty in a step with a batch step, which moves all of them.
    pub relinearized: Vec<VariableId>,
    /// Smallest pivot over its diagonal entry of JᵀJ among the cliques eliminated for the change
    /// (dimensionless; 1 is best, below 1e-22 is refused as singular). Infinite if there was none.
    pub smallest_pivot_ratio: f64,
    /// Rank of the information matrix: the tangent dimension of all variables that are not fixed,
    /// because anything less is an error.
    pub rank: usize,
    /// Largest component of δ, the step from linearization point to estimate (m or rad), as far as
    /// this step has looked: over the variables beyond the smallest threshold of the policy, 0 if
    /// there are none. `None` in a step without a check.
    pub largest_delta: Option<f64>,
    /// Whether nothing is left to relinearize, as far as is known: the last check, or batch step,
    /// found every linearization point within the threshold of the estimate, and no
    /// relinearization is pending. Changes since that check may have moved estimates.
    pub converged: bool,
    /// The batch step, if one was due.
    pub batch: Option<BatchReport>,
    /// A relinearization was due but was given up: it would have given a singular or non-finite
    /// system, or the code of a factor or variable type failed at the new points. The change itself
    /// was applied; the linearization points were left where they were.
    #[serde(serialize_with = "in_words")]
    pub relinearization_refused: Option<SmootherError>,
    #[serde(serialize_with = "as_sequence")]
    pub(crate) new_variables: SmallVec<[VariableId; 4]>,
}

impl Report {
    /// The variables that the change added, in its order.
    pub fn new_variables(&self) -> &[VariableId] {
        &self.new_variables
    }
}

fn in_words<S: Serializer>(
    error: &Option<SmootherError>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    error.as_ref().map(ToString::to_string).serialize(serializer)
}

fn as_sequence<S: Serializer>(
    ids: &SmallVec<[VariableId; 4]>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    ids.as_slice().serialize(serializer)
}

/// Size of the factorization.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
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
