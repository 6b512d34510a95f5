//! Graphs with their estimates, and why two of them cannot be compared.

use evergraph_model::{Graph, GraphError, Values, VariableId};
use evergraph_solver::SmootherError;
use thiserror::Error;

/// A graph with its estimates.
#[derive(Clone, Copy, Debug)]
pub struct Solved<'a> {
    /// The graph.
    pub graph: &'a Graph,
    /// A value for every variable.
    pub estimates: &'a Values,
}

/// Reasons for which two graphs cannot be compared.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum DivergenceError {
    /// An id that is stale or foreign, or without an estimate.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// There is no variable that both graphs have.
    #[error("the graphs have no variable in common, so nothing can be compared")]
    NothingKept,
    /// A variable of the reduced graph that is paired with none of the full one.
    #[error(
        "variable {variable} of the reduced graph has no counterpart in the full one; a reduced graph \
         has variables of the full graph only"
    )]
    Unpaired {
        /// The variable.
        variable: VariableId,
    },
    /// A variable that is fixed in one of the graphs only.
    #[error(
        "variable {variable} of the full graph is fixed in one of the graphs and free in the other; what is \
         fixed has no covariance to compare. Fix it in both or in none"
    )]
    Fixed {
        /// The variable.
        variable: VariableId,
    },
    /// A variable in two pairs.
    #[error("variable {variable} is paired twice; pair each variable once")]
    Twice {
        /// The variable.
        variable: VariableId,
    },
    /// The two variables of a pair are of different kinds.
    #[error(
        "variable {reduced} is a {reduced_kind} where {full} of the full graph is a {full_kind}; \
         check that both graphs number their variables alike"
    )]
    WrongKind {
        /// In the full graph.
        full: VariableId,
        /// What it is there.
        full_kind: &'static str,
        /// In the reduced graph.
        reduced: VariableId,
        /// What it is there.
        reduced_kind: &'static str,
    },
    /// The full graph's information cannot be factorized at its optimum.
    #[error("the full graph has no covariance: {0}")]
    Full(#[source] SmootherError),
    /// The reduced graph's information cannot be: a direction has become free, and the divergence is
    /// infinite.
    #[error("the reduced graph does not determine what the full graph does: {0}")]
    Reduced(#[source] SmootherError),
    /// The numbers left the range of `f64`.
    #[error(
        "the {quantity} is not finite: weights are too large or too far apart for 64-bit numbers"
    )]
    NotFinite {
        /// Which.
        quantity: &'static str,
    },
}
