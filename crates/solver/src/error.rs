//! Why an update was refused.

use std::fmt;

use evergraph_model::{FactorId, GraphError, VariableId};
use thiserror::Error;

use crate::settings::SettingsError;

/// Why a call failed. Graph, estimate and factorization are then what they were before it.
///
/// # Underdetermined systems
/// [`Singular`](Self::Singular) means that the factors leave some direction free. Usual causes, and
/// what to do about them:
///
/// - *A component without a prior.* Measurements between variables say nothing about where the
///   whole lies. Put a prior (or GPS, or any absolute measurement) on one variable of it, or fix one.
/// - *A variable with too few measurements*: a landmark seen by one bearing, a heading that only
///   GPS positions speak of. Add the variable together with the measurement that completes it.
/// - *Weights of zero*: an information matrix with zero rows.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SmootherError {
    /// The change, or a key, does not fit the graph.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// A setting cannot be.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A factor's residual or Jacobian is NaN or infinite where it was linearized.
    #[error(
        "factor {factor} ({name}) on {} gives a residual or Jacobian that is not finite at the current linearization point; check its measurement and the initial values of its variables",
        list(variables)
    )]
    NonFinite {
        /// The factor.
        factor: FactorId,
        /// Its type.
        name: String,
        /// Its variables.
        variables: Vec<VariableId>,
    },
    /// The information matrix is singular.
    #[error(transparent)]
    Singular(#[from] Singular),
    /// R or its right-hand side is not finite: the numbers overflow.
    #[error(
        "the factorization at variable {variable} is not finite: measurements or weights are too large for 64-bit numbers"
    )]
    Overflow {
        /// The variable.
        variable: VariableId,
    },
    /// The batch step on another thread panicked.
    #[error(
        "the batch step in the background panicked: a factor or a manifold does so at some estimate; its message is on standard error"
    )]
    Background,
    /// The thread pool could not be started.
    #[error("could not start {threads} threads: {reason}")]
    Threads {
        /// How many were asked for.
        threads: usize,
        /// What the system said.
        reason: String,
    },
}

/// Which directions the factors leave free.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum Singular {
    /// Some variables lack constraints of their own.
    #[error("the problem is underdetermined: {}. Add measurements or priors that determine {}, or add the variable{} together with them", free_list(variables), if variables.len() == 1 { "it" } else { "them" }, if variables.len() == 1 { "" } else { "s" })]
    Variables {
        /// The variables and their free directions.
        variables: Vec<FreeVariable>,
    },
    /// All variables of a connected component can move together.
    #[error("the connected component of {} ({count} variable{}) can move as a whole in {free} direction{}: no measurement fixes its position, or only measurements far too weak relative to the rest. Put a prior, GPS or another absolute measurement on one of its variables, or fix one", list(examples), if *count == 1 { "" } else { "s" }, if *free == 1 { "" } else { "s" })]
    Component {
        /// A few of its variables.
        examples: Vec<VariableId>,
        /// How many it has.
        count: usize,
        /// How many directions are free.
        free: usize,
    },
}

/// A variable with free directions.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FreeVariable {
    /// The variable.
    pub variable: VariableId,
    /// Dimension of its tangent space.
    pub dim: usize,
    /// How many directions are free.
    pub free: usize,
    /// Names of the tangent components that take part in them.
    pub components: Vec<String>,
}

impl fmt::Display for FreeVariable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { variable, dim, free, components } = self;
        write!(f, "{variable}: {free} of {dim} directions unconstrained: {}", components.join(", "))
    }
}

fn list(variables: &[VariableId]) -> String {
    variables.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn free_list(variables: &[FreeVariable]) -> String {
    const SHOWN: usize = 5;
    let mut text =
        variables.iter().take(SHOWN).map(ToString::to_string).collect::<Vec<_>>().join("; ");
    if variables.len() > SHOWN {
        text += &format!("; and {} more variables", variables.len() - SHOWN);
    }
    text
}
