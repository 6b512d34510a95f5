//! Errors of removals on a live smoother.

use evergraph_model::VariableId;
use evergraph_removal::RemovalError;
use evergraph_solver::SmootherError;
use thiserror::Error;

use crate::thinning::Thinning;

/// Removals that stopped before their end: the reason, and what was done until then.
///
/// Each removal is a transaction of its own. Those in [`done`](Self::done) are part of the smoother's
/// state; the one that failed and those after it have changed nothing.
#[derive(Debug, Error)]
#[error("{failure}")]
#[non_exhaustive]
pub struct ThinningError {
    /// The reason.
    #[source]
    pub failure: ThinningFailure,
    /// The removals before it.
    pub done: Box<Thinning>,
}

/// The reason why removals stop.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ThinningFailure {
    /// The removal makes no sense for this graph.
    #[error(transparent)]
    Removal(#[from] RemovalError),
    /// The smoother refused a removal, and not because a direction would have become free.
    #[error("removing {variable} was refused: {source}")]
    Smoother {
        /// The node.
        variable: VariableId,
        /// The smoother's reason; boxed, so that results are small where all goes well.
        source: Box<SmootherError>,
    },
}
