//! The graph by slot, as solvers see it.

use std::hash::{Hash, Hasher};
use std::ops::Range;

use super::{Graph, Term, Variable};
use crate::factor::Factor;
use crate::key::{FactorId, FactorIndex, VariableId, VariableIndex};
use crate::manifold::VariableType;
use crate::value::{Value, ValueRef};

/// # Access by slot, for solvers
///
/// Solvers keep numbers in dense arrays, and these methods say where they stand. Embedding programs
/// use ids instead: a slot is reused once its variable or factor is gone.
///
/// A slot comes from the lists of the same graph. Methods that ask about its content panic on a slot
/// that holds nothing.
impl Graph {
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
    /// When the slot holds no living variable.
    #[inline]
    pub fn kind_at(&self, index: VariableIndex) -> &'static VariableType {
        self.variable(index).kind
    }

    /// The tangent dimension of the variable in a slot.
    ///
    /// # Panics
    /// When the slot holds no living variable.
    #[inline]
    pub fn dim_at(&self, index: VariableIndex) -> usize {
        self.variable(index).tangent.1 as usize
    }

    /// Whether the variable in a slot is fixed.
    ///
    /// # Panics
    /// When the slot holds no living variable.
    #[inline]
    pub fn is_fixed_at(&self, index: VariableIndex) -> bool {
        self.variable(index).fixed
    }

    /// The value of the variable in a slot from its stored numbers.
    ///
    /// # Panics
    /// When the slot holds no living variable.
    pub fn value(&self, index: VariableIndex, storage: &[f64]) -> Value {
        Value::from_storage(self.kind_at(index), self.dim_at(index), storage)
    }

    /// The value of the variable in a slot, which stays where its stored numbers are.
    ///
    /// # Panics
    /// When the slot holds no living variable.
    pub fn value_ref<'a>(&self, index: VariableIndex, storage: &'a [f64]) -> ValueRef<'a> {
        ValueRef::from_storage(self.kind_at(index), self.dim_at(index), storage)
    }

    /// The factors on the variable in a slot, in the order they were added.
    ///
    /// # Panics
    /// When the slot holds no living variable.
    #[inline]
    pub fn factors_at(&self, index: VariableIndex) -> &[FactorIndex] {
        &self.variable(index).factors
    }

    /// The factor in a slot.
    ///
    /// # Panics
    /// When the slot holds no living factor.
    #[inline]
    pub fn factor_at(&self, index: FactorIndex) -> &dyn Factor {
        &*self.term(index).factor
    }

    /// The variables of the factor in a slot, in the order of its keys.
    ///
    /// # Panics
    /// When the slot holds no living factor.
    #[inline]
    pub fn variables_at(&self, factor: FactorIndex) -> &[VariableIndex] {
        &self.term(factor).variables
    }

    /// The variables of the factor in a slot that are not fixed, in the order of its keys.
    ///
    /// # Panics
    /// When the slot holds no living factor.
    #[inline]
    pub fn unknowns_at(&self, factor: FactorIndex) -> &[VariableIndex] {
        self.term(factor).unknowns()
    }

    /// First column of each unknown's Jacobian block of the factor in a slot, then of its residual.
    ///
    /// # Panics
    /// When the slot holds no living factor.
    #[inline]
    pub fn columns_at(&self, factor: FactorIndex) -> &[u32] {
        self.term(factor).columns()
    }

    /// Rows of the factor in a slot.
    ///
    /// # Panics
    /// When the slot holds no living factor.
    #[inline]
    pub fn rows_at(&self, factor: FactorIndex) -> usize {
        self.term(factor).rows as usize
    }

    /// Length of `[J₁ … Jₖ | r]` of the factor in a slot, a block for each of its unknowns.
    ///
    /// # Panics
    /// When the slot holds no living factor.
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
    ///
    /// # Panics
    /// When the slot holds no living variable.
    #[inline]
    pub fn value_range(&self, index: VariableIndex) -> Range<usize> {
        let (start, len) = self.variable(index).value;
        start as usize..(start + len) as usize
    }

    /// Where the tangent vector of the variable in a slot stands.
    ///
    /// # Panics
    /// When the slot holds no living variable.
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
    // Hidden: only the fingerprint of a smoother uses it, and the hash means nothing across versions.
    #[doc(hidden)]
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
}
