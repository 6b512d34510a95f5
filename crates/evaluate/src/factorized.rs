//! The information of a graph at a point of one's choice, some of its variables held, as a
//! factorization.

use std::collections::BTreeMap;
use std::sync::Arc;

use evergraph_factors::{Conditioned, Input};
use evergraph_model::{FactorId, Graph, GraphError, Values, VariableId};
use evergraph_solver::{FreeVariable, Settings, Singular, Smoother, SmootherError};

/// `Λ = JᵀJ = RᵀR` over the variables that are free, in a smoother of its own, whose linearization
/// points are the values it was made with.
#[derive(Debug)]
pub(crate) struct Factorized {
    pub(crate) smoother: Smoother,
    /// From the graph's variables to the smoother's.
    variables: BTreeMap<VariableId, VariableId>,
}

impl Factorized {
    /// Factorizes `graph` at `values`. Variables that are not `is_free` are held where they are, so
    /// that Λ is the block of the others in the information of all; so are fixed variables of the graph.
    ///
    /// # Errors
    /// [`SmootherError`], in the ids of `graph`.
    pub(crate) fn of(
        graph: &Graph,
        values: &Values,
        is_free: impl Fn(VariableId) -> bool,
        settings: &Settings,
    ) -> Result<Self, SmootherError> {
        let mut smoother = Smoother::new(*settings)?;
        let mut change = smoother.change();
        let mut variables = BTreeMap::new();
        for id in
            graph.unknown_indices().map(|index| graph.variable_id(index)).filter(|id| is_free(*id))
        {
            variables.insert(id, change.add_value(values.value(id)?.to_value()));
        }
        let mut factors = BTreeMap::new();
        for (id, factor) in graph.factors() {
            if factor.keys().iter().any(|key| variables.contains_key(key)) {
                let part = part(graph, id, values, &variables)?;
                factors.insert(change.add_factor(part), id);
            }
        }
        if !variables.is_empty() {
            smoother.apply(change).map_err(|error| renamed(error, graph, &variables, &factors))?;
        }
        Ok(Self { smoother, variables })
    }

    /// The smoother's id of a variable.
    pub(crate) fn variable(&self, id: VariableId) -> Option<VariableId> {
        self.variables.get(&id).copied()
    }
}

/// The factor on the smoother's variables, its other variables held at their values.
fn part(
    graph: &Graph,
    id: FactorId,
    values: &Values,
    variables: &BTreeMap<VariableId, VariableId>,
) -> Result<Conditioned, GraphError> {
    let whole = graph.factor(id)?;
    let inputs = whole.keys().iter().map(|key| match variables.get(key) {
        Some(&variable) => Ok(Input::Variable(variable)),
        None => Ok(Input::Value(values.value(*key)?.to_value())),
    });
    let inputs = inputs.collect::<Result<Vec<Input>, GraphError>>()?;
    Conditioned::with_inputs(Arc::clone(whole), inputs).ok_or_else(|| GraphError::MalformedFactor {
        factor: id,
        name: whole.name(),
        problem: "does not take the values of its variables".into(),
    })
}

/// The error in the ids of the graph that was factorized.
fn renamed(
    error: SmootherError,
    graph: &Graph,
    variables: &BTreeMap<VariableId, VariableId>,
    factors: &BTreeMap<FactorId, FactorId>,
) -> SmootherError {
    let names: BTreeMap<VariableId, VariableId> =
        variables.iter().map(|(outer, inner)| (*inner, *outer)).collect();
    let name = |id: VariableId| names.get(&id).copied().unwrap_or(id);
    match error {
        SmootherError::Singular(Singular::Variables { variables }) => {
            let variables = variables
                .into_iter()
                .map(|mut free: FreeVariable| {
                    free.variable = name(free.variable);
                    free
                })
                .collect();
            Singular::Variables { variables }.into()
        }
        SmootherError::Singular(Singular::Component { examples, count, free }) => {
            let examples = examples.into_iter().map(name).collect();
            Singular::Component { examples, count, free }.into()
        }
        SmootherError::NonFinite { factor, name: kind, variables } => {
            let whole = factors.get(&factor).copied().unwrap_or(factor);
            SmootherError::NonFinite {
                factor: whole,
                name: graph.factor(whole).map_or(kind, |factor| factor.name()),
                variables: variables.into_iter().map(name).collect(),
            }
        }
        SmootherError::Overflow { variable } => {
            SmootherError::Overflow { variable: name(variable) }
        }
        other => other,
    }
}
