//! The graph store: variables, factors, who touches whom, and how their numbers are laid out.

mod by_slot;
mod evaluate;
mod layout;
mod saved;
mod stage;

pub use saved::{SavedFactor, SavedGraph, SavedVariable};
pub use stage::Staged;

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

/// Variables, factors and adjacency.
///
/// Every object has an id, which is never given twice, and while it lives a dense slot. The numbers
/// that belong to variables (linearization points, tangent vectors) are kept by the solver, in flat
/// arrays laid out by [`value_range`](Self::value_range) and [`tangent_range`](Self::tangent_range).
///
/// Embedding programs ask by id and alter the graph of a smoother with `Smoother::apply`. The methods
/// that take a [`VariableIndex`] or [`FactorIndex`], and those that stage a change, are for solvers.
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
