//! The one way to alter a graph.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::error::GraphError;
use crate::factor::Factor;
use crate::ids::Ids;
use crate::key::{FactorId, Key, VariableId, Version};
use crate::manifold::Manifold;
use crate::value::Value;

/// New variables with their initial values, new factors, factors and variables to drop, variables
/// to fix and to free.
///
/// A change names what it will add ([`Ids`]) and does nothing until it is applied, whole or not at
/// all. It can be made steps ahead of its use and on any thread: it is refused only if something
/// that it refers to is gone, or a [required version](Self::require) has moved on. Two changes
/// [merge](Self::merge) into one.
#[derive(Clone, Debug)]
#[must_use = "a change does nothing until it is applied"]
pub struct Change {
    ids: Ids,
    pub(crate) new_variables: Vec<(VariableId, Value)>,
    pub(crate) new_factors: Vec<(FactorId, Arc<dyn Factor>)>,
    pub(crate) drop_factors: Vec<FactorId>,
    /// `drop_factors` as a set, to look things up.
    dropped: BTreeSet<FactorId>,
    pub(crate) drop_variables: Vec<VariableId>,
    pub(crate) moves: Vec<(VariableId, Value)>,
    pub(crate) fixes: Vec<VariableId>,
    pub(crate) frees: Vec<VariableId>,
    pub(crate) requires: Vec<(VariableId, Version)>,
}

impl Ids {
    /// An empty change.
    pub fn change(&self) -> Change {
        Change::new(self.clone())
    }
}

impl Change {
    fn new(ids: Ids) -> Self {
        Self {
            ids,
            new_variables: Vec::new(),
            new_factors: Vec::new(),
            drop_factors: Vec::new(),
            dropped: BTreeSet::new(),
            drop_variables: Vec::new(),
            moves: Vec::new(),
            fixes: Vec::new(),
            frees: Vec::new(),
            requires: Vec::new(),
        }
    }

    /// Adds a variable that starts at `initial`; the key may be used in factors of this change and
    /// of later ones.
    pub fn add_variable<V: Manifold>(&mut self, initial: &V) -> Key<V> {
        Key::new(self.add_value(Value::new(initial)))
    }

    /// [`add_variable`](Self::add_variable) for a type known only at run time.
    pub fn add_value(&mut self, initial: Value) -> VariableId {
        let id = self.ids.variable();
        self.new_variables.push((id, initial));
        id
    }

    /// Adds a factor on variables of the graph or of this change.
    pub fn add_factor(&mut self, factor: impl Factor) -> FactorId {
        self.add_shared_factor(Arc::new(factor))
    }

    /// [`add_factor`](Self::add_factor) for a factor that is shared already.
    pub fn add_shared_factor(&mut self, factor: Arc<dyn Factor>) -> FactorId {
        let id = self.ids.factor();
        self.new_factors.push((id, factor));
        id
    }

    /// Takes a factor out of the graph, its information with it.
    pub fn drop_factor(&mut self, factor: FactorId) -> &mut Self {
        self.dropped.insert(factor);
        self.drop_factors.push(factor);
        self
    }

    /// Whether the change drops a factor.
    #[must_use]
    pub fn drops_factor(&self, factor: FactorId) -> bool {
        self.dropped.contains(&factor)
    }

    /// Takes a variable out of the graph. All of its factors must be dropped in the same change;
    /// [`drop_variable_and_factors`](Self::drop_variable_and_factors) does so.
    pub fn drop_variable(&mut self, variable: impl Into<VariableId>) -> &mut Self {
        self.drop_variables.push(variable.into());
        self
    }

    /// Moves a variable's linearization point. A fixed variable moves to that value.
    pub fn move_linearization_point<V: Manifold>(&mut self, variable: Key<V>, to: &V) -> &mut Self {
        self.move_value(variable.id(), Value::new(to))
    }

    /// [`move_linearization_point`](Self::move_linearization_point) for a type known only at run
    /// time.
    pub fn move_value(&mut self, variable: VariableId, to: Value) -> &mut Self {
        self.moves.push((variable, to));
        self
    }

    /// Fixes a variable: it stays at its estimate, exactly, and is given rather than unknown from
    /// then on. Its factors stay, as measurements of their other variables. With
    /// [`move_linearization_point`](Self::move_linearization_point) in the same change it is fixed
    /// at that value; a variable that this change adds is fixed at its initial value.
    ///
    /// A variable that is fixed already stays so.
    pub fn fix(&mut self, variable: impl Into<VariableId>) -> &mut Self {
        self.fixes.push(variable.into());
        self
    }

    /// Makes a fixed variable unknown again, starting where it was fixed. A variable that is not
    /// fixed stays so.
    pub fn free(&mut self, variable: impl Into<VariableId>) -> &mut Self {
        self.frees.push(variable.into());
        self
    }

    /// Makes the change valid only while `variable` is at `version` ([`crate::Graph::version`]): a
    /// plan made by reading a variable is refused when that variable has changed since.
    pub fn require(&mut self, variable: impl Into<VariableId>, version: Version) -> &mut Self {
        self.requires.push((variable.into(), version));
        self
    }

    /// Adds everything that `other` does to this change, so that both are applied in one step or
    /// not at all: a new pose and the removal of an old one, say.
    ///
    /// Versions that either requires are those before the merged change. Conflicts, such as a
    /// variable that both drop, are found when the change is applied.
    ///
    /// # Errors
    /// [`GraphError::Foreign`] when the changes were made for different graphs; this one is then
    /// as it was.
    pub fn merge(&mut self, other: Self) -> Result<(), GraphError> {
        if self.lineage() != other.lineage() {
            return Err(GraphError::Foreign { what: "the change to merge".into() });
        }
        self.new_variables.extend(other.new_variables);
        self.new_factors.extend(other.new_factors);
        self.drop_factors.extend(other.drop_factors);
        self.dropped.extend(other.dropped);
        self.drop_variables.extend(other.drop_variables);
        self.moves.extend(other.moves);
        self.fixes.extend(other.fixes);
        self.frees.extend(other.frees);
        self.requires.extend(other.requires);
        Ok(())
    }

    /// Whether it adds, drops, moves, fixes and frees nothing. Required versions do not count:
    /// they decide whether a change is applied, not what it does.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.new_variables.is_empty()
            && self.new_factors.is_empty()
            && self.drop_factors.is_empty()
            && self.drop_variables.is_empty()
            && self.moves.is_empty()
            && self.fixes.is_empty()
            && self.frees.is_empty()
    }

    /// The variables that it adds, with their initial values.
    #[must_use]
    pub fn new_variables(&self) -> &[(VariableId, Value)] {
        &self.new_variables
    }

    /// The factors that it adds.
    #[must_use]
    pub fn new_factors(&self) -> &[(FactorId, Arc<dyn Factor>)] {
        &self.new_factors
    }

    /// The factors that it drops.
    #[must_use]
    pub fn dropped_factors(&self) -> &[FactorId] {
        &self.drop_factors
    }

    /// The variables that it drops.
    #[must_use]
    pub fn dropped_variables(&self) -> &[VariableId] {
        &self.drop_variables
    }

    /// The linearization points that it moves.
    #[must_use]
    pub fn moves(&self) -> &[(VariableId, Value)] {
        &self.moves
    }

    /// The variables that it fixes.
    #[must_use]
    pub fn fixes(&self) -> &[VariableId] {
        &self.fixes
    }

    /// The variables that it frees.
    #[must_use]
    pub fn frees(&self) -> &[VariableId] {
        &self.frees
    }

    /// The versions that it requires.
    #[must_use]
    pub fn requires(&self) -> &[(VariableId, Version)] {
        &self.requires
    }

    /// The identity of the graph that it is for.
    pub(crate) fn lineage(&self) -> u64 {
        self.ids.lineage()
    }
}
