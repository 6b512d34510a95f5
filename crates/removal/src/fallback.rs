//! Why a removal has another form than the one that was asked for.

use serde::{Deserialize, Serialize};

/// Why a step did not take the form that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Fallback {
    /// Relative factors on the tree would have left a direction free that the removed factors
    /// hold; generic linear constraints on the same tree do not.
    LinearTreeForRank,
    /// No tree holds all directions that the removed factors hold; one factor on the whole blanket
    /// does.
    DenseForRank,
    /// The tree's minimum lies further from the estimate than [`Guard`](crate::Guard) allows; one
    /// factor on the whole blanket reproduces the removed factors without approximation.
    DenseForOffset,
    /// The same on a blanket that is larger than
    /// [`Guard::largest_dense`](crate::Guard::largest_dense): the tree stays and its minimum is moved towards
    /// the estimate. A part of the gradient is lost, so that other variables move.
    ShortenedOffset,
    /// The target is too badly conditioned to be compared with a tree; one factor on the whole blanket reproduces the
    /// removed factors without approximation. With [`Consistency::Conservative`](crate::Consistency::Conservative).
    DenseForConsistency,
    /// The conservative information of least divergence was not found; a common factor on the tree's takes its place.
    ScaledForConsistency,
}
