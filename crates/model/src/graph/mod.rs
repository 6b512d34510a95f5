//! The graph store: variables, factors, who touches whom, and how their numbers are laid out.

mod evaluate;
mod layout;
mod saved;
mod stage;

pub use saved::{SavedFactor, SavedGraph, SavedVariable};
pub use stage::Staged;

use std::hash::{Hash, Hasher};
use std::ops::Range;
use std::sync::Arc;

use smallvec::SmallVec;

use self::layout::Layout;
use crate::change::Change;
use crate::error::GraphError;
use crate::factor::Factor;
use crate::ids::{Ids, UsedNumbers};
use crate::key::{FactorId, FactorIndex, Key, VariableId, VariableIndex, Version};
use crate::manifold::{Manifold, VariableType};
use crate::slots::Slots;
use crate::value::{Value, ValueRef};

/// Variables, factors and adjacency.
///
/// Every object has an id, which is never given twice, and while it lives a dense slot. The numbers
/// that belong to variables (linearization points, tangent vectors) are kept by the solver, in flat
/// arrays laid out by [`value_range`](Self::value_range) and [`tangent_range`](Self::tangent_range).
///
/// A clone is an independent graph with the same identity: it understands the ids and the changes
/// of the original, and neither ever mints an id that the other has minted.
#[derive(Clone, Debug)]
pub struct Graph {
    ids: Ids,
    used: Vec<Used>,
    variables: Slots<VariableId, Variable>,
    factors: Slots<FactorId, Term>,
    value_layout: Layout,
    tangent_layout: Layout,
    /// How many variables there are of each type.
    kinds: Vec<(&'static VariableType, usize)>,
    /// Unknown variables, and their tangent dimensions together.
    unknowns: usize,
    dim: usize,
}

/// The ids of one source that have entered the graph.
#[derive(Clone, Debug)]
struct Used {
    origin: u64,
    variables: UsedNumbers,
    factors: UsedNumbers,
}

impl Used {
    fn nothing(origin: u64) -> Self {
        Self { origin, variables: UsedNumbers::default(), factors: UsedNumbers::default() }
    }
}

#[derive(Clone, Debug)]
struct Variable {
    kind: &'static VariableType,
    value: (u32, u32),
    tangent: (u32, u32),
    /// Its factors, in the order they were added.
    factors: SmallVec<[FactorIndex; 6]>,
    version: Version,
    fixed: bool,
}

/// A factor with its variables resolved to slots.
#[derive(Clone, Debug)]
struct Term {
    factor: Arc<dyn Factor>,
    variables: SmallVec<[VariableIndex; 2]>,
    /// First column of each variable's Jacobian block, then of the residual.
    columns: SmallVec<[u32; 3]>,
    rows: u32,
    /// Of a factor with fixed variables.
    partial: Option<Box<Partial>>,
}

/// The part of a factor that the linear system sees.
#[derive(Clone, Debug)]
struct Partial {
    unknowns: SmallVec<[VariableIndex; 2]>,
    /// First column of each unknown's Jacobian block, then of the residual.
    columns: SmallVec<[u32; 3]>,
}

impl Term {
    fn unknowns(&self) -> &[VariableIndex] {
        self.partial.as_ref().map_or(&self.variables, |partial| &partial.unknowns)
    }

    fn columns(&self) -> &[u32] {
        self.partial.as_ref().map_or(&self.columns, |partial| &partial.columns)
    }
}

impl Default for Graph {
    fn default() -> Self {
        Self::new()
    }
}

impl Graph {
    /// An empty graph.
    pub fn new() -> Self {
        let ids = Ids::new();
        Self {
            used: vec![Used::nothing(ids.origin())],
            ids,
            variables: Slots::default(),
            factors: Slots::default(),
            value_layout: Layout::default(),
            tangent_layout: Layout::default(),
            kinds: Vec::new(),
            unknowns: 0,
            dim: 0,
        }
    }

    /// An empty change.
    pub fn change(&self) -> Change {
        self.ids.change()
    }

    /// The source of the graph's ids, with which changes can be made anywhere.
    pub fn ids(&self) -> Ids {
        self.ids.clone()
    }

    // --- Questions by id -------------------------------------------------------------------

    /// How many variables there are.
    pub fn variable_count(&self) -> usize {
        self.variables.len()
    }

    /// How many variables are not fixed.
    pub fn unknown_count(&self) -> usize {
        self.unknowns
    }

    /// How many factors there are.
    pub fn factor_count(&self) -> usize {
        self.factors.len()
    }

    /// Tangent dimension of all unknown variables together: the columns of the Jacobian.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// How many variables there are of each type that was ever added, in the order of the types'
    /// first variables.
    pub fn kinds(&self) -> impl Iterator<Item = (&'static VariableType, usize)> {
        self.kinds.iter().copied()
    }

    /// All variables, by slot.
    pub fn variables(&self) -> impl Iterator<Item = VariableId> {
        self.variable_indices().map(|i| self.variable_id(i))
    }

    /// All factors, by slot.
    pub fn factors(&self) -> impl Iterator<Item = (FactorId, &dyn Factor)> {
        self.factor_indices().map(|i| (self.factor_id(i), &*self.term(i).factor))
    }

    /// A factor.
    ///
    /// # Errors
    /// [`GraphError::UnknownFactor`], [`GraphError::Foreign`].
    pub fn factor(&self, id: FactorId) -> Result<&Arc<dyn Factor>, GraphError> {
        Ok(&self.term(self.factor_index(id)?).factor)
    }

    /// The factors on a variable, in the order they were added.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn factors_of(&self, id: impl Into<VariableId>) -> Result<Vec<FactorId>, GraphError> {
        let index = self.variable_index(id.into())?;
        Ok(self.factors_at(index).iter().map(|&f| self.factor_id(f)).collect())
    }

    /// How many factors connect the variable with others. A factor on several others counts once.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn degree(&self, id: impl Into<VariableId>) -> Result<usize, GraphError> {
        let index = self.variable_index(id.into())?;
        Ok(self.factors_at(index).iter().filter(|&&f| self.variables_at(f).len() > 1).count())
    }

    /// How often the variable was changed: factors added or dropped, linearization point moved by
    /// a change, fixed or freed.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn version(&self, id: impl Into<VariableId>) -> Result<Version, GraphError> {
        Ok(self.variable(self.variable_index(id.into())?).version)
    }

    /// Whether the variable is fixed.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn is_fixed(&self, id: impl Into<VariableId>) -> Result<bool, GraphError> {
        Ok(self.is_fixed_at(self.variable_index(id.into())?))
    }

    /// The typed key of a variable.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`], [`GraphError::WrongType`].
    pub fn key<V: Manifold>(&self, id: VariableId) -> Result<Key<V>, GraphError> {
        let kind = self.kind_at(self.variable_index(id)?);
        if kind.is::<V>() {
            Ok(Key::new(id))
        } else {
            Err(GraphError::WrongType { variable: id, expected: V::NAME, actual: kind.name() })
        }
    }

    /// The slot of a variable.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    #[inline]
    pub fn variable_index(&self, id: VariableId) -> Result<VariableIndex, GraphError> {
        match self.variables.index_of(id) {
            Some(index) => Ok(VariableIndex::new(index)),
            None if self.knows(id.origin) => Err(GraphError::UnknownVariable { variable: id }),
            None => Err(GraphError::Foreign { what: format!("variable {id}") }),
        }
    }

    /// The slot of a factor.
    ///
    /// # Errors
    /// [`GraphError::UnknownFactor`], [`GraphError::Foreign`].
    #[inline]
    pub fn factor_index(&self, id: FactorId) -> Result<FactorIndex, GraphError> {
        match self.factors.index_of(id) {
            Some(index) => Ok(FactorIndex::new(index)),
            None if self.knows(id.origin) => Err(GraphError::UnknownFactor { factor: id }),
            None => Err(GraphError::Foreign { what: format!("factor {id}") }),
        }
    }

    /// Whether the variable is alive here.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn check_variable(&self, id: VariableId) -> Result<(), GraphError> {
        self.variable_index(id).map(|_| ())
    }

    /// Whether the factor is alive here.
    ///
    /// # Errors
    /// [`GraphError::UnknownFactor`], [`GraphError::Foreign`].
    pub fn check_factor(&self, id: FactorId) -> Result<(), GraphError> {
        self.factor_index(id).map(|_| ())
    }

    fn knows(&self, origin: u64) -> bool {
        self.used.iter().any(|used| used.origin == origin)
    }

    // --- Questions by slot, for solvers ----------------------------------------------------
    // These panic on slots that hold nothing: a slot comes from this graph's own lists.

    /// Length of the variable slot array, living or not.
    #[inline]
    pub fn variable_slots(&self) -> usize {
        self.variables.capacity()
    }

    /// Length of the factor slot array, living or not.
    #[inline]
    pub fn factor_slots(&self) -> usize {
        self.factors.capacity()
    }

    /// Slots of the living variables, ascending.
    pub fn variable_indices(&self) -> impl Iterator<Item = VariableIndex> {
        self.variables.indices().map(VariableIndex::new)
    }

    /// Slots of the living variables that are not fixed, ascending.
    pub fn unknown_indices(&self) -> impl Iterator<Item = VariableIndex> {
        self.variable_indices().filter(|&v| !self.is_fixed_at(v))
    }

    /// Slots of the living factors, ascending.
    pub fn factor_indices(&self) -> impl Iterator<Item = FactorIndex> {
        self.factors.indices().map(FactorIndex::new)
    }

    /// Whether the variable slot holds a living variable.
    #[inline]
    pub fn is_variable_at(&self, index: VariableIndex) -> bool {
        self.variables.at(index.index()).is_some()
    }

    /// Whether the factor slot holds a living factor.
    #[inline]
    pub fn is_factor_at(&self, index: FactorIndex) -> bool {
        self.factors.at(index.index()).is_some()
    }

    /// The id of the variable in a slot.
    ///
    /// # Panics
    /// When the slot holds no living variable.
    #[inline]
    pub fn variable_id(&self, index: VariableIndex) -> VariableId {
        self.variables.id_at(index.index()).expect("the slot holds a living variable")
    }

    /// The id of the factor in a slot.
    ///
    /// # Panics
    /// When the slot holds no living factor.
    #[inline]
    pub fn factor_id(&self, index: FactorIndex) -> FactorId {
        self.factors.id_at(index.index()).expect("the slot holds a living factor")
    }

    /// The manifold of the variable in a slot.
    ///
    /// # Panics
    /// When the slot holds no living variable, as all of the following.
    #[inline]
    pub fn kind_at(&self, index: VariableIndex) -> &'static VariableType {
        self.variable(index).kind
    }

    /// The tangent dimension of the variable in a slot.
    #[inline]
    pub fn dim_at(&self, index: VariableIndex) -> usize {
        self.variable(index).tangent.1 as usize
    }

    /// Whether the variable in a slot is fixed.
    #[inline]
    pub fn is_fixed_at(&self, index: VariableIndex) -> bool {
        self.variable(index).fixed
    }

    /// The value of the variable in a slot from its stored numbers.
    pub fn value(&self, index: VariableIndex, storage: &[f64]) -> Value {
        Value::from_storage(self.kind_at(index), self.dim_at(index), storage)
    }

    /// The value of the variable in a slot, which stays where its stored numbers are.
    pub fn value_ref<'a>(&self, index: VariableIndex, storage: &'a [f64]) -> ValueRef<'a> {
        ValueRef::from_storage(self.kind_at(index), self.dim_at(index), storage)
    }

    /// The factors on the variable in a slot, in the order they were added.
    #[inline]
    pub fn factors_at(&self, index: VariableIndex) -> &[FactorIndex] {
        &self.variable(index).factors
    }

    /// The factor in a slot.
    #[inline]
    pub fn factor_at(&self, index: FactorIndex) -> &dyn Factor {
        &*self.term(index).factor
    }

    /// The variables of the factor in a slot, in the order of its keys.
    #[inline]
    pub fn variables_at(&self, factor: FactorIndex) -> &[VariableIndex] {
        &self.term(factor).variables
    }

    /// The variables of the factor in a slot that are not fixed, in the order of its keys.
    #[inline]
    pub fn unknowns_at(&self, factor: FactorIndex) -> &[VariableIndex] {
        self.term(factor).unknowns()
    }

    /// First column of each unknown's Jacobian block of the factor in a slot, then of its residual.
    #[inline]
    pub fn columns_at(&self, factor: FactorIndex) -> &[u32] {
        self.term(factor).columns()
    }

    /// Rows of the factor in a slot.
    #[inline]
    pub fn rows_at(&self, factor: FactorIndex) -> usize {
        self.term(factor).rows as usize
    }

    /// Length of `[J₁ … Jₖ | r]` of the factor in a slot, a block for each of its unknowns.
    #[inline]
    pub fn linearization_len(&self, factor: FactorIndex) -> usize {
        let term = self.term(factor);
        let columns = term.columns();
        term.rows as usize * (columns[columns.len() - 1] as usize + 1)
    }

    /// Length of an array that holds a value for every variable slot.
    #[inline]
    pub fn value_len(&self) -> usize {
        self.value_layout.len as usize
    }

    /// Length of an array that holds a tangent vector for every variable slot.
    #[inline]
    pub fn tangent_len(&self) -> usize {
        self.tangent_layout.len as usize
    }

    /// Where the value of the variable in a slot stands.
    #[inline]
    pub fn value_range(&self, index: VariableIndex) -> Range<usize> {
        let (start, len) = self.variable(index).value;
        start as usize..(start + len) as usize
    }

    /// Where the tangent vector of the variable in a slot stands.
    #[inline]
    pub fn tangent_range(&self, index: VariableIndex) -> Range<usize> {
        let (start, len) = self.variable(index).tangent;
        start as usize..(start + len) as usize
    }

    /// Feeds everything that later results depend on to a hash: slots, layouts, adjacency, versions,
    /// fixed variables.
    ///
    /// Left out, with their reasons: the numbers of ids, which only name; the contents of factors,
    /// which never change and whose linearizations the solver hashes.
    pub fn hash_state(&self, hash: &mut impl Hasher) {
        self.variables.hash_state(hash);
        self.factors.hash_state(hash);
        (&self.value_layout, &self.tangent_layout, self.dim, self.unknowns).hash(hash);
        for index in self.variable_indices() {
            let Variable { kind, value, tangent, factors, version, fixed } = self.variable(index);
            (kind.name(), value, tangent, factors.as_slice(), version, fixed).hash(hash);
        }
        for index in self.factor_indices() {
            let Term { variables, columns, rows, .. } = self.term(index);
            (variables.as_slice(), columns.as_slice(), rows).hash(hash);
        }
    }

    #[inline]
    fn variable(&self, index: VariableIndex) -> &Variable {
        self.variables.at(index.index()).expect("the slot holds a living variable")
    }

    #[inline]
    fn variable_mut(&mut self, index: VariableIndex) -> &mut Variable {
        self.variables.at_mut(index.index()).expect("the slot holds a living variable")
    }

    #[inline]
    fn term(&self, index: FactorIndex) -> &Term {
        self.factors.at(index.index()).expect("the slot holds a living factor")
    }
}
