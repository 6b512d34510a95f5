//! Errors of the smoother in the words of a file: its ids instead of the graph's.

use evergraph_formats::spell_id;
use evergraph_longterm::RemovalError;
use evergraph_model::VariableId;
use evergraph_solver::{Singular, SmootherError};

/// The error as a paragraph; `id` gives a variable's id in the file.
pub(crate) fn explain(error: &SmootherError, id: &dyn Fn(VariableId) -> Option<u64>) -> String {
    let name = |variable: VariableId| id(variable).map_or_else(|| variable.to_string(), spell_id);
    match error {
        SmootherError::Singular(singular @ Singular::Component { .. }) => format!(
            "{}: no measurement fixes its position, or only measurements far too weak relative to the rest. Give one of \
             its variables a prior, GPS or another absolute measurement",
            singular.describe(name)
        ),
        SmootherError::Singular(singular @ Singular::Variables { .. }) => {
            format!(
                "{}. Add measurements or priors that determine them. Measurements whose standard deviations or \
                 distances differ by more than 1e11 are lost in the rounding of the others",
                singular.describe(name)
            )
        }
        SmootherError::NonFinite { name: factor, variables, .. } => {
            let names: Vec<String> = variables.iter().map(|v| name(*v)).collect();
            format!(
                "the {factor} between {} has a residual or Jacobian that is not finite, or so large that \
                 squares overflow, where it was linearized; check its measurement, its weights and the start values",
                names.join(" and ")
            )
        }
        SmootherError::Overflow { variable } => format!(
            "the solution for {} is not finite: measurements or weights are too large for 64-bit numbers",
            name(*variable)
        ),
        SmootherError::LargeClique { scalars, largest } => format!(
            "the update would eliminate a clique of {scalars} scalars, more than {largest}: too many loop \
             closures tie distant poses together, and further steps would take longer still. Look for wrong \
             closures, solve the file at once with `evergraph optimize`, or raise --largest-clique"
        ),
        other => other.to_string(),
    }
}

/// The error as a paragraph; `name` says what a variable is called in the file.
pub(crate) fn explain_removal(error: &RemovalError, name: &dyn Fn(VariableId) -> String) -> String {
    let list = |variables: &[VariableId]| {
        variables.iter().map(|v| name(*v)).collect::<Vec<_>>().join(", ")
    };
    match error {
        RemovalError::NoBlanket { variable } => format!(
            "{} shares no factor with a variable that stays, so nothing can carry what is known of its component",
            name(*variable)
        ),
        RemovalError::LargeBlanket { variable, dim, largest } => format!(
            "{} shares factors with variables of {dim} dimensions in all, more than {largest} (--largest-blanket), and \
             planning is cubic in them",
            name(*variable)
        ),
        RemovalError::LastPose { variable } => {
            format!("{} is the last pose of the graph, which has to keep one", name(*variable))
        }
        RemovalError::Twice { variable } => format!("{} is named twice", name(*variable)),
        RemovalError::NonFiniteEstimate { variable, numbers } => {
            format!("the estimate of {} is not finite: {numbers:?}", name(*variable))
        }
        RemovalError::NonFiniteFactor { name: kind, variables, .. } => format!(
            "the {kind} on {} has a residual or Jacobian that is not finite where it is \
             linearized; check its measurement and its weights",
            list(variables)
        ),
        RemovalError::NotComposable { removed, name: kind, variables, .. } => format!(
            "the {kind} on {} cannot be composed to remove {}: composition takes full relative poses of \
             regular information only; use generic linear constraints (glc)",
            list(variables),
            name(*removed)
        ),
        RemovalError::NotRepresentable { removed, reason } => {
            format!("the factor that would replace {} cannot be made: {reason}", list(removed))
        }
        other => other.to_string(),
    }
}
