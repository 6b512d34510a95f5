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
    /// A factor's residual or Jacobian is NaN, infinite, or so large that squares overflow, where it was
    /// linearized.
    #[error(
        "factor {factor} ({name}) on {} gives a residual or Jacobian that is not finite, or beyond 1e77, where squares overflow; check its measurement, its noise and the initial values of its variables",
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
    /// The update would eliminate a clique beyond [`Settings::largest_clique`](crate::Settings::largest_clique).
    #[error(
        "the update would eliminate a clique of {scalars} scalars, and `Settings::largest_clique` is {largest}: \
         too many loop closures tie distant places together. Check them for wrong ones, remove nodes, or raise \
         the bound"
    )]
    LargeClique {
        /// Frontals and separator.
        scalars: usize,
        /// The bound.
        largest: usize,
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

/// The directions that the factors leave free.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Singular {
    /// Some variables lack constraints of their own.
    Variables {
        /// The variables and their free directions.
        variables: Vec<FreeVariable>,
    },
    /// All variables of a connected component can move together.
    Component {
        /// A few of its variables.
        examples: Vec<VariableId>,
        /// How many it has.
        count: usize,
        /// How many directions are free.
        free: usize,
    },
}

impl Singular {
    /// The free directions in words, without advice; `name` gives the name of a variable, for example its
    /// id in a file. At most five variables are listed.
    pub fn describe(&self, name: impl Fn(VariableId) -> String) -> String {
        match self {
            Self::Variables { variables } => {
                let shown = variables.iter().take(Self::SHOWN);
                let mut list: Vec<String> = shown.map(|free| free.describe(&name)).collect();
                if variables.len() > Self::SHOWN {
                    list.push(format!("and {} more", variables.len() - Self::SHOWN));
                }
                format!("the problem is underdetermined: {}", list.join("; "))
            }
            Self::Component { examples, count, free } => {
                let names: Vec<String> = examples.iter().map(|variable| name(*variable)).collect();
                format!(
                    "the connected component of {} ({}) can move as a whole in {}",
                    names.join(", "),
                    plural(*count, "variable"),
                    plural(*free, "direction")
                )
            }
        }
    }

    /// Variables that a message lists.
    const SHOWN: usize = 5;
}

impl fmt::Display for Singular {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.describe(|variable| variable.to_string()))?;
        match self {
            Self::Variables { variables } => {
                let (them, s) = if variables.len() == 1 { ("it", "") } else { ("them", "s") };
                write!(
                    f,
                    ". Add measurements or priors that determine {them}, or add the variable{s} together with them. \
                     Measurements whose standard deviations or distances differ by more than 1e11 are lost in the rounding of \
                     the others"
                )
            }
            Self::Component { .. } => f.write_str(
                ": no measurement fixes its position, or only measurements far too weak relative to the rest. \
                 Put a prior, GPS or another absolute measurement on one of its variables, or fix one",
            ),
        }
    }
}

impl std::error::Error for Singular {}

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

impl FreeVariable {
    fn describe(&self, name: &impl Fn(VariableId) -> String) -> String {
        let Self { variable, dim, free, components } = self;
        let (name, components) = (name(*variable), components.join(", "));
        format!("{name}: {free} of {dim} directions unconstrained: {components}")
    }
}

impl fmt::Display for FreeVariable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.describe(&|variable: VariableId| variable.to_string()))
    }
}

fn list(variables: &[VariableId]) -> String {
    variables.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn plural(count: usize, what: &str) -> String {
    if count == 1 { format!("{count} {what}") } else { format!("{count} {what}s") }
}

#[cfg(test)]
mod tests {
    use evergraph_model::{Graph, Point2};

    use super::*;

    #[test]
    fn singular_systems_are_told_in_names_of_the_callers_choice() {
        let mut change = Graph::new().change();
        let ids: Vec<VariableId> =
            (0..7).map(|_| change.add_variable(&Point2::new(0.0, 0.0)).id()).collect();
        let place = |id: VariableId| ids.iter().position(|known| *known == id).unwrap();
        let name = |id: VariableId| format!("P{}", place(id));
        let free = |count: usize| Singular::Variables {
            variables: ids[..count]
                .iter()
                .map(|id| FreeVariable {
                    variable: *id,
                    dim: 2,
                    free: 1,
                    components: vec!["x".into()],
                })
                .collect(),
        };
        let one = "the problem is underdetermined: P0: 1 of 2 directions unconstrained: x";
        assert_eq!(free(1).describe(name), one);
        let advice = ". Add measurements or priors that determine it, or add the variable together with them. \
                      Measurements whose standard deviations or distances differ by more than 1e11 are lost in the rounding of \
                      the others";
        assert_eq!(free(1).to_string(), format!("{}{advice}", one.replace('P', "x")));
        let many = free(7).describe(name);
        assert!(many.ends_with("; P4: 1 of 2 directions unconstrained: x; and 2 more"), "{many}");

        let component = Singular::Component { examples: ids[..2].to_vec(), count: 2, free: 1 };
        let told = component.describe(name);
        let expected =
            "the connected component of P0, P1 (2 variables) can move as a whole in 1 direction";
        assert_eq!(told, expected);
        let own = expected.replace('P', "x");
        assert!(component.to_string().starts_with(&format!("{own}: no measurement fixes")));
    }
}
