//! The information of a graph at a point of one's choice, some of its variables held, as a
//! factorization.

use std::collections::BTreeMap;
use std::sync::Arc;

use evergraph_model::{
    Arguments, Factor, FactorId, Graph, Linearization, Value, Values, VariableId, VariableType,
};
use evergraph_solver::{FreeVariable, Settings, Singular, Smoother, SmootherError};
use smallvec::SmallVec;

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
                let part = Part::new(graph, id, values, &variables)?;
                factors.insert(change.add_factor(part), id);
            }
        }
        if !variables.is_empty() {
            smoother.apply(change).map_err(|error| renamed(error, &variables, &factors))?;
        }
        Ok(Self { smoother, variables })
    }

    /// The smoother's id of a variable.
    pub(crate) fn variable(&self, id: VariableId) -> Option<VariableId> {
        self.variables.get(&id).copied()
    }
}

/// A factor on other variables, some of its own held at values.
#[derive(Debug)]
struct Part {
    whole: Arc<dyn Factor>,
    keys: Vec<VariableId>,
    /// For each variable of the whole factor: its place among `keys`, or where it is held.
    arguments: Vec<Argument>,
    /// First columns of the whole factor's blocks.
    columns: Vec<u32>,
}

#[derive(Debug)]
enum Argument {
    Free(usize),
    Held(Value),
}

impl Part {
    fn new(
        graph: &Graph,
        id: FactorId,
        values: &Values,
        variables: &BTreeMap<VariableId, VariableId>,
    ) -> Result<Self, SmootherError> {
        let whole = Arc::clone(graph.factor(id)?);
        let mut keys = Vec::new();
        let mut arguments = Vec::new();
        for key in whole.keys() {
            arguments.push(match variables.get(key) {
                Some(&variable) => {
                    keys.push(variable);
                    Argument::Free(keys.len() - 1)
                }
                None => Argument::Held(values.value(*key)?.to_value()),
            });
        }
        let mut columns = vec![0];
        let mut width = 0;
        for key in whole.keys() {
            width += values.value(*key)?.dim() as u32;
            columns.push(width);
        }
        Ok(Self { whole, keys, arguments, columns })
    }

    /// The arguments of the whole factor.
    fn storages<'a>(&'a self, at: &Arguments<'a>) -> SmallVec<[&'a [f64]; 4]> {
        let storage = |argument: &'a Argument| match argument {
            Argument::Free(place) => at.storage(*place),
            Argument::Held(value) => value.storage(),
        };
        self.arguments.iter().map(storage).collect()
    }
}

impl Factor for Part {
    fn name(&self) -> String {
        self.whole.name()
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        self.whole.residual_dim()
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        let is_it = |argument: &Argument| matches!(argument, Argument::Free(at) if *at == position);
        let whole = self.arguments.iter().position(is_it);
        whole.is_some_and(|whole| self.whole.accepts(whole, kind, dim))
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        self.whole.residual(&Arguments::new(&self.storages(at)), out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let rows = self.residual_dim();
        let width = self.columns.last().map_or(0, |width| *width as usize);
        let mut all = vec![0.0; rows * (width + 1)];
        let mut whole = Linearization::new(rows, &self.columns, &mut all);
        self.whole.linearize(&Arguments::new(&self.storages(at)), &mut whole);
        for (position, argument) in self.arguments.iter().enumerate() {
            if let Argument::Free(place) = argument {
                out.block_mut(*place).copy_from_slice(whole.block_mut(position));
            }
        }
        out.residual_mut().copy_from_slice(whole.residual_mut());
    }

    fn error(&self, residual: &[f64]) -> f64 {
        self.whole.error(residual)
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// The error in the ids of the graph that was factorized.
fn renamed(
    error: SmootherError,
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
        SmootherError::NonFinite { factor, name: kind, variables } => SmootherError::NonFinite {
            factor: factors.get(&factor).copied().unwrap_or(factor),
            name: kind,
            variables: variables.into_iter().map(name).collect(),
        },
        SmootherError::Overflow { variable } => {
            SmootherError::Overflow { variable: name(variable) }
        }
        other => other,
    }
}
