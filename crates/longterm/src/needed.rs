//! Nodes that have to stay.

use evergraph_removal::RemovalError;
use evergraph_solver::SmootherError;
use thiserror::Error;

/// The reason why a node stays.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Needed {
    /// Nothing could carry what is known of the node, or of the place of the map; or its blanket is too
    /// large to plan for.
    #[error(transparent)]
    Planned(RemovalError),
    /// Without the node a direction would be free.
    #[error(transparent)]
    Applied(SmootherError),
}

/// Whether a node whose removal cannot be planned stays, where any other error says that the call makes
/// no sense.
pub(crate) fn is_needed(error: &RemovalError) -> bool {
    matches!(
        error,
        RemovalError::NoBlanket { .. }
            | RemovalError::LargeBlanket { .. }
            | RemovalError::LastPose { .. }
            | RemovalError::NotRepresentable { .. }
    )
}
