//! Why a removal cannot be planned.

use evergraph_factors::FactorError;
use evergraph_model::belief::BeliefError;
use evergraph_model::{EvaluationError, GraphError, NoiseError, VariableId};
use thiserror::Error;

/// Why a removal cannot be planned. Nothing has been altered.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RemovalError {
    /// An id that is stale, foreign, or without an estimate.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// No node was named.
    #[error("no variable was named; name at least one to remove")]
    Nothing,
    /// The same node twice.
    #[error("variable {variable} is named twice; name each variable to remove once")]
    Twice {
        /// The variable.
        variable: VariableId,
    },
    /// A whole component would be removed, of more than one variable: no kept variable could carry its
    /// information.
    #[error(
        "variable {variable} shares no factor with a variable that stays, so nothing can carry what is known \
         of its component; keep one variable of it, or drop all of them with their factors"
    )]
    NoBlanket {
        /// The variable, or the first of its group.
        variable: VariableId,
    },
    /// A blanket that would take too long.
    #[error(
        "variable {variable} shares factors with variables of {dim} dimensions in all, and planning is cubic \
         in them; raise `Options::largest_blanket`, {largest} now, or keep it"
    )]
    LargeBlanket {
        /// The variable, or the first of its group.
        variable: VariableId,
        /// Tangent dimensions of the blanket.
        dim: usize,
        /// The limit.
        largest: usize,
    },
    /// A graph of poses must keep one.
    #[error("removing {variable} would take the last pose out of the graph; keep at least one")]
    LastPose {
        /// The variable.
        variable: VariableId,
    },
    /// An estimate with a NaN or an infinity.
    #[error("the estimate of variable {variable} is not finite: {numbers:?}")]
    NonFiniteEstimate {
        /// The variable.
        variable: VariableId,
        /// The stored numbers.
        numbers: Vec<f64>,
    },
    /// An estimate that does not fit its variable.
    #[error(
        "the estimate of variable {variable} is a {actual} of dimension {dim}, which does not fit"
    )]
    EstimateMismatch {
        /// The variable.
        variable: VariableId,
        /// Type of the estimate.
        actual: &'static str,
        /// Its dimension.
        dim: usize,
    },
    /// Estimates that are not as many as variables were asked for.
    #[error("{expected} estimates were asked for and {actual} came")]
    EstimateCount {
        /// How many variables there were.
        expected: usize,
        /// How many estimates.
        actual: usize,
    },
    /// A factor that cannot be evaluated, for example because its code panics.
    #[error(
        "factor {factor} cannot be linearized: {source}; its variables cannot be removed before it is dropped"
    )]
    Factor {
        /// The factor's id, or `planned` for one that an earlier step of the plan adds.
        factor: String,
        /// The failure.
        source: EvaluationError,
    },
    /// A factor whose residual or Jacobian is not finite where it is linearized.
    #[error(
        "factor {factor} ({name}) on {variables:?} has a residual or Jacobian that is not finite where it is \
         linearized; its variables cannot be removed before it is dropped or they move"
    )]
    NonFiniteFactor {
        /// The factor's id, or `planned` for one that an earlier step of the plan adds.
        factor: String,
        /// Its type.
        name: String,
        /// Its variables.
        variables: Vec<VariableId>,
    },
    /// Composition knows relative poses only.
    #[error(
        "factor {factor} ({name}) on {variables:?} cannot be composed: composition takes full relative poses \
         of regular information only; use generic linear constraints (Recovery::Glc) to remove {removed}"
    )]
    NotComposable {
        /// The node.
        removed: VariableId,
        /// The factor's id, or `planned`.
        factor: String,
        /// Its type.
        name: String,
        /// Its variables.
        variables: Vec<VariableId>,
    },
    /// Composition makes edges of trees.
    #[error(
        "composition makes edges on a tree, there is no dense one; use Topology::ChowLiu, or another recovery"
    )]
    DenseComposition,
    /// An order by loss without covariances.
    #[error(
        "removing by least loss needs the joint covariance of blankets; give one with `priced_by`"
    )]
    NeedsCovariance,
    /// The covariance of a blanket that cannot be had.
    #[error("the joint covariance of {variables:?} cannot be had: {source}")]
    Covariance {
        /// The variables asked for.
        variables: Vec<VariableId>,
        /// The failure.
        source: BeliefError,
    },
    /// An option without meaning.
    #[error("option {option} is {value}; it must be {expected}")]
    Option {
        /// The field's name.
        option: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A new factor could not be made: its numbers left the range of `f64`.
    #[error("the factor that would replace {removed:?} cannot be made: {reason}")]
    NotRepresentable {
        /// The removed variables.
        removed: Vec<VariableId>,
        /// Why.
        reason: String,
    },
}

/// Why a factor cannot be made, before it is known which removal it is for.
#[derive(Debug, Error)]
pub(crate) enum MakeError {
    #[error(transparent)]
    Factor(#[from] FactorError),
    #[error(transparent)]
    Noise(#[from] NoiseError),
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error("{0} is not finite")]
    NotFinite(&'static str),
}
