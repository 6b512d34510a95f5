//! The one way to alter a graph.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::factor::Factor;
use crate::graph::{Graph, GraphError};
use crate::key::{FactorId, Key, VariableId, Version};
use crate::manifold::Manifold;
use crate::slots::SlotPlan;
use crate::value::Value;

/// New variables with their initial values, new factors, factors and variables to drop.
///
/// A change is made from a graph by reading only ([`Graph::change`]), names what it will add, and
/// does nothing until it is applied, whole or not at all. If another change takes the same names
/// first, or a required version has moved on, it is refused as stale and has to be made again.
#[derive(Clone, Debug)]
pub struct Change {
    pub(crate) graph: u32,
    pub(crate) variable_plan: SlotPlan,
    pub(crate) factor_plan: SlotPlan,
    pub(crate) new_variables: Vec<(VariableId, Value)>,
    pub(crate) new_factors: Vec<(FactorId, Arc<dyn Factor>)>,
    pub(crate) drop_factors: Vec<FactorId>,
    /// `drop_factors` as a set, to look things up.
    dropped: BTreeSet<FactorId>,
    pub(crate) drop_variables: Vec<VariableId>,
    pub(crate) moves: Vec<(VariableId, Value)>,
    pub(crate) requires: Vec<(VariableId, Version)>,
}

impl Change {
    pub(crate) fn new(graph: u32, variable_plan: SlotPlan, factor_plan: SlotPlan) -> Self {
        Self {
            graph,
            variable_plan,
            factor_plan,
            new_variables: Vec::new(),
            new_factors: Vec::new(),
            drop_factors: Vec::new(),
            dropped: BTreeSet::new(),
            drop_variables: Vec::new(),
            moves: Vec::new(),
            requires: Vec::new(),
        }
    }

    /// Adds a variable that starts at `initial`; the key may be used in factors of this change.
    ///
    /// # Panics
    /// When 2³² variables are in use.
    pub fn add_variable<V: Manifold>(&mut self, initial: &V) -> Key<V> {
        Key::new(self.add_value(Value::new(initial)))
    }

    /// [`add_variable`](Self::add_variable) for a type known only at run time.
    ///
    /// # Panics
    /// When 2³² variables are in use.
    pub fn add_value(&mut self, initial: Value) -> VariableId {
        let (index, generation) =
            self.variable_plan.take().expect("a graph of 2^32 variables does not fit in memory");
        let id = VariableId { index, generation, graph: self.graph };
        self.new_variables.push((id, initial));
        id
    }

    /// Adds a factor on variables of the graph or of this change.
    ///
    /// # Panics
    /// When 2³² factors are in use.
    pub fn add_factor(&mut self, factor: impl Factor) -> FactorId {
        self.add_shared_factor(Arc::new(factor))
    }

    /// [`add_factor`](Self::add_factor) for a factor that is shared already.
    ///
    /// # Panics
    /// When 2³² factors are in use.
    pub fn add_shared_factor(&mut self, factor: Arc<dyn Factor>) -> FactorId {
        let (index, generation) =
            self.factor_plan.take().expect("a graph of 2^32 factors does not fit in memory");
        let id = FactorId { index, generation, graph: self.graph };
        self.new_factors.push((id, factor));
        id
    }

    /// Takes a factor out of the graph, its information with it.
    pub fn drop_factor(&mut self, factor: FactorId) -> &mut Self {
        self.dropped.insert(factor);
        self.drop_factors.push(factor);
        self
    }

    /// Takes a variable out of the graph. All of its factors must be dropped in the same change.
    pub fn drop_variable(&mut self, variable: impl Into<VariableId>) -> &mut Self {
        self.drop_variables.push(variable.into());
        self
    }

    /// Takes a variable and all of its factors in `graph` out: what they said of it, *and of their
    /// other variables*, is lost. To keep it, plan a removal instead.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn drop_variable_and_factors(
        &mut self,
        graph: &Graph,
        variable: impl Into<VariableId>,
    ) -> Result<&mut Self, GraphError> {
        let variable = variable.into();
        for factor in graph.factors_of(variable)? {
            if self.dropped.insert(factor) {
                self.drop_factors.push(factor);
            }
        }
        Ok(self.drop_variable(variable))
    }

    /// Moves a variable's linearization point.
    pub fn move_linearization_point<V: Manifold>(&mut self, variable: Key<V>, to: &V) -> &mut Self {
        self.move_value(variable.id(), Value::new(to))
    }

    /// [`move_linearization_point`](Self::move_linearization_point) for a type known only at run
    /// time.
    pub fn move_value(&mut self, variable: VariableId, to: Value) -> &mut Self {
        self.moves.push((variable, to));
        self
    }

    /// Makes the change valid only while `variable` is at `version` ([`Graph::version`]): what was
    /// planned by reading a variable is refused when that variable has changed since.
    pub fn require(&mut self, variable: impl Into<VariableId>, version: Version) -> &mut Self {
        self.requires.push((variable.into(), version));
        self
    }

    /// Whether applying it would do nothing.
    pub fn is_empty(&self) -> bool {
        self.new_variables.is_empty()
            && self.new_factors.is_empty()
            && self.drop_factors.is_empty()
            && self.drop_variables.is_empty()
            && self.moves.is_empty()
    }

    /// The variables that it adds, with their initial values.
    pub fn new_variables(&self) -> &[(VariableId, Value)] {
        &self.new_variables
    }

    /// The factors that it adds.
    pub fn new_factors(&self) -> &[(FactorId, Arc<dyn Factor>)] {
        &self.new_factors
    }

    /// The factors that it drops.
    pub fn dropped_factors(&self) -> &[FactorId] {
        &self.drop_factors
    }

    /// The variables that it drops.
    pub fn dropped_variables(&self) -> &[VariableId] {
        &self.drop_variables
    }

    /// The linearization points that it moves.
    pub fn moves(&self) -> &[(VariableId, Value)] {
        &self.moves
    }
}
