//! The graph store: variables, factors, who touches whom, and how their numbers are laid out.

mod error;
mod layout;
mod stage;

pub use error::GraphError;
pub use stage::Staged;

use std::hash::{Hash, Hasher};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use smallvec::SmallVec;

use self::layout::Layout;
use crate::change::Change;
use crate::factor::Factor;
use crate::key::{FactorId, Key, VariableId, Version};
use crate::manifold::{Manifold, VariableType};
use crate::slots::Slots;
use crate::value::{Value, ValueRef};

/// Variables, factors and adjacency.
///
/// Objects live in dense slots; ids are generational. The numbers that belong to variables
/// (linearization points, tangent vectors) are kept by whoever solves, in flat arrays laid out by
/// [`value_range`](Self::value_range) and [`tangent_range`](Self::tangent_range).
#[derive(Clone, Debug)]
pub struct Graph {
    tag: u32,
    variables: Slots<Variable>,
    factors: Slots<Term>,
    value_layout: Layout,
    tangent_layout: Layout,
    living_variables: usize,
    living_factors: usize,
    dim: usize,
}

#[derive(Clone, Debug)]
struct Variable {
    kind: &'static VariableType,
    value: (u32, u32),
    tangent: (u32, u32),
    /// Slots of its factors, in the order they came.
    factors: SmallVec<[u32; 6]>,
    version: Version,
}

/// A factor with its variables resolved to slots.
#[derive(Clone, Debug)]
struct Term {
    factor: Arc<dyn Factor>,
    variables: SmallVec<[u32; 2]>,
    /// First column of each Jacobian block, then of the residual.
    columns: SmallVec<[u32; 3]>,
    rows: u32,
}

impl Default for Graph {
    fn default() -> Self {
        Self::new()
    }
}

impl Graph {
    /// An empty graph.
    pub fn new() -> Self {
        // The tag only tells ids of different graphs apart; no result depends on it.
        static NEXT_TAG: AtomicU32 = AtomicU32::new(1);
        Self {
            tag: NEXT_TAG.fetch_add(1, Ordering::Relaxed),
            variables: Slots::default(),
            factors: Slots::default(),
            value_layout: Layout::default(),
            tangent_layout: Layout::default(),
            living_variables: 0,
            living_factors: 0,
            dim: 0,
        }
    }

    /// An empty change, made for the graph as it is now.
    pub fn change(&self) -> Change {
        Change::new(self.tag, self.variables.plan(), self.factors.plan())
    }

    // --- Questions by id -------------------------------------------------------------------

    /// How many variables there are.
    pub fn variable_count(&self) -> usize {
        self.living_variables
    }

    /// How many factors there are.
    pub fn factor_count(&self) -> usize {
        self.living_factors
    }

    /// Tangent dimension of all variables together: the columns of the Jacobian.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// All variables, by slot.
    pub fn variables(&self) -> impl Iterator<Item = VariableId> {
        self.variables.indices().map(|i| self.variable_id(i))
    }

    /// All factors, by slot.
    pub fn factors(&self) -> impl Iterator<Item = (FactorId, &dyn Factor)> {
        self.factors.indices().map(|i| (self.factor_id(i), &*self.term(i).factor))
    }

    /// A factor.
    ///
    /// # Errors
    /// [`GraphError::UnknownFactor`], [`GraphError::Foreign`].
    pub fn factor(&self, id: FactorId) -> Result<&Arc<dyn Factor>, GraphError> {
        self.check_factor(id)?;
        Ok(&self.term(id.index()).factor)
    }

    /// The factors on a variable, in the order they came.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn factors_of(&self, id: VariableId) -> Result<Vec<FactorId>, GraphError> {
        self.check_variable(id)?;
        Ok(self.factors_at(id.index()).iter().map(|&f| self.factor_id(f as usize)).collect())
    }

    /// How often the variable was changed: factors added or dropped, linearization point moved by
    /// a change.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn version(&self, id: VariableId) -> Result<Version, GraphError> {
        self.check_variable(id)?;
        Ok(self.variable(id.index()).version)
    }

    /// The typed key of a variable.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`], [`GraphError::WrongType`].
    pub fn key<V: Manifold>(&self, id: VariableId) -> Result<Key<V>, GraphError> {
        self.check_variable(id)?;
        let kind = self.kind_at(id.index());
        if kind.is::<V>() {
            Ok(Key::new(id))
        } else {
            Err(GraphError::WrongType { variable: id, expected: V::NAME, actual: kind.name() })
        }
    }

    /// Whether the variable is alive here.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`], [`GraphError::Foreign`].
    pub fn check_variable(&self, id: VariableId) -> Result<(), GraphError> {
        if id.graph != self.tag {
            return Err(GraphError::Foreign { what: format!("variable {id}") });
        }
        match self.variables.get(id.index, id.generation) {
            Some(_) => Ok(()),
            None => Err(GraphError::UnknownVariable { variable: id }),
        }
    }

    /// Whether the factor is alive here.
    ///
    /// # Errors
    /// [`GraphError::UnknownFactor`], [`GraphError::Foreign`].
    pub fn check_factor(&self, id: FactorId) -> Result<(), GraphError> {
        if id.graph != self.tag {
            return Err(GraphError::Foreign { what: format!("factor {id}") });
        }
        match self.factors.get(id.index, id.generation) {
            Some(_) => Ok(()),
            None => Err(GraphError::UnknownFactor { factor: id }),
        }
    }

    // --- Questions by slot, for solvers ----------------------------------------------------
    // These panic on slots that hold nothing: a slot comes from this graph's own lists.

    /// Length of the variable slot array, living or not.
    pub fn variable_slots(&self) -> usize {
        self.variables.capacity()
    }

    /// Length of the factor slot array, living or not.
    pub fn factor_slots(&self) -> usize {
        self.factors.capacity()
    }

    /// Slots of the living variables, ascending.
    pub fn variable_indices(&self) -> impl Iterator<Item = usize> {
        self.variables.indices()
    }

    /// Slots of the living factors, ascending.
    pub fn factor_indices(&self) -> impl Iterator<Item = usize> {
        self.factors.indices()
    }

    /// Whether the variable slot holds a living variable.
    pub fn is_variable_at(&self, index: usize) -> bool {
        self.variables.at(index).is_some()
    }

    /// The id of the variable in a slot.
    pub fn variable_id(&self, index: usize) -> VariableId {
        VariableId {
            index: index as u32,
            generation: self.variables.generation(index),
            graph: self.tag,
        }
    }

    /// The id of the factor in a slot.
    pub fn factor_id(&self, index: usize) -> FactorId {
        FactorId {
            index: index as u32,
            generation: self.factors.generation(index),
            graph: self.tag,
        }
    }

    /// The manifold of the variable in a slot.
    pub fn kind_at(&self, index: usize) -> &'static VariableType {
        self.variable(index).kind
    }

    /// The tangent dimension of the variable in a slot.
    pub fn dim_at(&self, index: usize) -> usize {
        self.variable(index).tangent.1 as usize
    }

    /// The value of the variable in a slot from its stored numbers.
    pub fn value(&self, index: usize, storage: &[f64]) -> Value {
        Value::from_storage(self.kind_at(index), self.dim_at(index), storage)
    }

    /// The value of the variable in a slot, which stays where its stored numbers are.
    pub fn value_ref<'a>(&self, index: usize, storage: &'a [f64]) -> ValueRef<'a> {
        ValueRef::from_storage(self.kind_at(index), self.dim_at(index), storage)
    }

    /// Slots of the factors on the variable in a slot, in the order they came.
    pub fn factors_at(&self, index: usize) -> &[u32] {
        &self.variable(index).factors
    }

    /// The factor in a slot.
    pub fn factor_at(&self, index: usize) -> &dyn Factor {
        &*self.term(index).factor
    }

    /// Slots of the variables of the factor in a slot, in the order of its keys.
    pub fn variables_at(&self, factor: usize) -> &[u32] {
        &self.term(factor).variables
    }

    /// First column of each Jacobian block of the factor in a slot, then of its residual.
    pub fn columns_at(&self, factor: usize) -> &[u32] {
        &self.term(factor).columns
    }

    /// Rows of the factor in a slot.
    pub fn rows_at(&self, factor: usize) -> usize {
        self.term(factor).rows as usize
    }

    /// Length of `[J₁ … Jₖ | r]` of the factor in a slot.
    pub fn linearization_len(&self, factor: usize) -> usize {
        let term = self.term(factor);
        term.rows as usize * (term.columns[term.columns.len() - 1] as usize + 1)
    }

    /// Length of an array that holds a value for every variable slot.
    pub fn value_len(&self) -> usize {
        self.value_layout.len as usize
    }

    /// Length of an array that holds a tangent vector for every variable slot.
    pub fn tangent_len(&self) -> usize {
        self.tangent_layout.len as usize
    }

    /// Where the value of the variable in a slot stands.
    pub fn value_range(&self, index: usize) -> Range<usize> {
        let (start, len) = self.variable(index).value;
        start as usize..(start + len) as usize
    }

    /// Where the tangent vector of the variable in a slot stands.
    pub fn tangent_range(&self, index: usize) -> Range<usize> {
        let (start, len) = self.variable(index).tangent;
        start as usize..(start + len) as usize
    }

    /// Feeds everything but the factors' own contents and the graph's tag to a hash: equal graphs
    /// give equal ids to equal changes.
    pub fn hash_state(&self, hash: &mut impl Hasher) {
        self.variables.hash_state(hash);
        self.factors.hash_state(hash);
        (&self.value_layout, &self.tangent_layout, self.dim).hash(hash);
        for index in self.variables.indices() {
            let Variable { kind, value, tangent, factors, version } = self.variable(index);
            (kind.name(), value, tangent, factors.as_slice(), version).hash(hash);
        }
        for index in self.factors.indices() {
            let Term { variables, columns, rows, .. } = self.term(index);
            (variables.as_slice(), columns.as_slice(), rows).hash(hash);
        }
    }

    // --- Evaluation ------------------------------------------------------------------------

    /// Linearizes the factor in a slot at `values` (laid out by [`value_range`](Self::value_range))
    /// into `out`, `[J₁ … Jₖ | r]` column-major.
    pub fn linearize(&self, factor: usize, values: &[f64], out: &mut [f64]) {
        let term = self.term(factor);
        out.fill(0.0);
        self.with_arguments(term, values, |arguments| {
            let mut linearization =
                crate::Linearization::new(term.rows as usize, &term.columns, out);
            term.factor.linearize(arguments, &mut linearization);
        });
    }

    /// The term of the objective of the factor in a slot at `values`.
    pub fn factor_error(&self, factor: usize, values: &[f64]) -> f64 {
        let term = self.term(factor);
        with_scratch(term.rows as usize, 0.0, |residual: &mut [f64]| {
            self.with_arguments(term, values, |arguments| {
                term.factor.residual(arguments, residual)
            });
            term.factor.error(residual)
        })
    }

    /// The objective at `values`: the sum of all factors' terms, in the order of their slots.
    pub fn error(&self, values: &[f64]) -> f64 {
        self.factors.indices().map(|f| self.factor_error(f, values)).sum()
    }

    fn with_arguments<R>(
        &self,
        term: &Term,
        values: &[f64],
        f: impl FnOnce(&crate::Arguments<'_>) -> R,
    ) -> R {
        with_scratch(term.variables.len(), &values[..0], |storages| {
            for (storage, &variable) in storages.iter_mut().zip(&term.variables) {
                *storage = &values[self.value_range(variable as usize)];
            }
            f(&crate::Arguments::new(storages))
        })
    }

    fn variable(&self, index: usize) -> &Variable {
        self.variables.at(index).expect("the slot holds a living variable")
    }

    fn variable_mut(&mut self, index: usize) -> &mut Variable {
        self.variables.at_mut(index).expect("the slot holds a living variable")
    }

    fn term(&self, index: usize) -> &Term {
        self.factors.at(index).expect("the slot holds a living factor")
    }
}

/// A slice of `len` for the time of `f`: on the stack, unless a factor is unusually large.
fn with_scratch<T: Copy, R>(len: usize, fill: T, f: impl FnOnce(&mut [T]) -> R) -> R {
    match [fill; 6].get_mut(..len) {
        Some(scratch) => f(scratch),
        None => f(&mut vec![fill; len]),
    }
}
