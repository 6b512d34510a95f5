//! The graph store: variables, factors, who touches whom, and how their numbers are laid out.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use smallvec::SmallVec;
use thiserror::Error;

use crate::change::Change;
use crate::factor::Factor;
use crate::key::{FactorId, Key, VariableId, Version};
use crate::manifold::{Manifold, VariableType};
use crate::slots::Slots;
use crate::value::Value;

/// Why a change, or a question, does not fit the graph.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GraphError {
    /// The id was removed, or was never given.
    #[error("variable {variable} is not in the graph (it was removed, or never added)")]
    UnknownVariable {
        /// The id asked for.
        variable: VariableId,
    },
    /// The id was removed, or was never given.
    #[error("factor {factor} is not in the graph (it was dropped, or never added)")]
    UnknownFactor {
        /// The id asked for.
        factor: FactorId,
    },
    /// The id or the change was made by another graph.
    #[error(
        "{what} belongs to another graph; ids and changes are only good for the graph that made them"
    )]
    Foreign {
        /// The id, or the change.
        what: String,
    },
    /// The variable is of another type.
    #[error("variable {variable} is a {actual}, not a {expected}")]
    WrongType {
        /// The variable.
        variable: VariableId,
        /// What was asked for.
        expected: &'static str,
        /// What it is.
        actual: &'static str,
    },
    /// A factor cannot be put on a variable of this type.
    #[error(
        "factor {factor} ({name}) does not take a {actual} of dimension {dim} as its variable number {position} ({variable})"
    )]
    NotAccepted {
        /// The factor.
        factor: FactorId,
        /// Its type.
        name: String,
        /// The variable.
        variable: VariableId,
        /// Place of the variable among the factor's keys, from 0.
        position: usize,
        /// The variable's type.
        actual: &'static str,
        /// The variable's dimension.
        dim: usize,
    },
    /// A factor names a variable twice, or none at all, or has no residual.
    #[error("factor {factor} ({name}) {problem}")]
    MalformedFactor {
        /// The factor.
        factor: FactorId,
        /// Its type.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A value holds a NaN or an infinity.
    #[error("the value given for variable {variable} is not finite: {value}")]
    NonFiniteValue {
        /// The variable.
        variable: VariableId,
        /// The offending numbers.
        value: String,
    },
    /// A value has another type or dimension than the variable it is for.
    #[error(
        "the value given for variable {variable} is a {actual} of dimension {dim}, which does not fit"
    )]
    ValueMismatch {
        /// The variable.
        variable: VariableId,
        /// Type of the value.
        actual: &'static str,
        /// Dimension of the value.
        dim: usize,
    },
    /// The variable still has factors.
    #[error(
        "variable {variable} cannot be dropped while factor {factor} holds it; drop that factor in the same change, or plan a removal that keeps its information"
    )]
    StillHeld {
        /// The variable.
        variable: VariableId,
        /// One of its factors.
        factor: FactorId,
    },
    /// The same object is dropped or moved twice.
    #[error("{what} appears twice in one change")]
    Twice {
        /// The object.
        what: String,
    },
    /// Another change came first.
    #[error("the change is stale: {reason}; make it again from the graph as it is now")]
    Stale {
        /// What has moved on.
        reason: String,
    },
}

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

/// First-fit of equal lengths: freed ranges are used again for variables of the same size.
#[derive(Clone, Debug, Default)]
struct Layout {
    len: u32,
    free: Vec<(u32, Vec<u32>)>,
}

impl Layout {
    fn allocate(&mut self, size: u32) -> (u32, u32) {
        if let Some((_, starts)) = self.free.iter_mut().find(|(s, _)| *s == size)
            && let Some(start) = starts.pop()
        {
            return (start, size);
        }
        let start = self.len;
        self.len += size;
        (start, size)
    }

    fn release(&mut self, (start, size): (u32, u32)) {
        match self.free.iter_mut().find(|(s, _)| *s == size) {
            Some((_, starts)) => starts.push(start),
            None => self.free.push((size, vec![start])),
        }
    }

    /// Takes back the newest `allocate`, given the length before it.
    fn undo_allocate(&mut self, range: (u32, u32), len_before: u32) {
        if self.len > len_before {
            self.len = len_before;
        } else {
            self.release(range);
        }
    }
}

/// A change that has been checked and whose additions stand in the graph; what it drops is still
/// there. Ends in [`Graph::commit`] or [`Graph::unstage`].
#[derive(Debug)]
#[must_use = "a staged change is committed or unstaged"]
pub struct Staged {
    new_variables: Vec<(u32, bool, u32, u32)>,
    new_factors: Vec<(u32, bool)>,
    drop_factors: Vec<u32>,
    drop_variables: Vec<u32>,
    moved: Vec<u32>,
}

impl Staged {
    /// Slots of the variables that came in.
    pub fn new_variables(&self) -> impl Iterator<Item = usize> {
        self.new_variables.iter().map(|v| v.0 as usize)
    }

    /// Slots of the factors that came in.
    pub fn new_factors(&self) -> impl Iterator<Item = usize> {
        self.new_factors.iter().map(|f| f.0 as usize)
    }

    /// Slots of the factors that will go.
    pub fn dropped_factors(&self) -> &[u32] {
        &self.drop_factors
    }

    /// Slots of the variables that will go.
    pub fn dropped_variables(&self) -> &[u32] {
        &self.drop_variables
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
        let mut residual: SmallVec<[f64; 8]> = SmallVec::from_elem(0.0, term.rows as usize);
        self.with_arguments(term, values, |arguments| {
            term.factor.residual(arguments, &mut residual)
        });
        term.factor.error(&residual)
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
        let storages: SmallVec<[&[f64]; 4]> =
            term.variables.iter().map(|&v| &values[self.value_range(v as usize)]).collect();
        f(&crate::Arguments::new(&storages))
    }

    // --- Changing --------------------------------------------------------------------------

    /// Checks a change and, if all of it is good, adds its variables and factors. What it drops
    /// stays until [`commit`](Self::commit).
    ///
    /// # Errors
    /// Any [`GraphError`]; the graph is then what it was, bit for bit.
    pub fn stage(&mut self, change: &Change) -> Result<Staged, GraphError> {
        self.check_references(change)?;
        let mut staged = Staged {
            new_variables: Vec::with_capacity(change.new_variables.len()),
            new_factors: Vec::with_capacity(change.new_factors.len()),
            drop_factors: change.drop_factors.iter().map(|f| f.index).collect(),
            drop_variables: change.drop_variables.iter().map(|v| v.index).collect(),
            moved: change.moves.iter().map(|(v, _)| v.index).collect(),
        };
        for (id, value) in &change.new_variables {
            let before =
                (self.variables.capacity(), self.value_layout.len, self.tangent_layout.len);
            let variable = Variable {
                kind: value.kind(),
                value: self.value_layout.allocate(value.storage().len() as u32),
                tangent: self.tangent_layout.allocate(value.dim() as u32),
                factors: SmallVec::new(),
                version: 0,
            };
            self.variables.insert_planned(id.index, variable);
            self.living_variables += 1;
            self.dim += value.dim();
            staged.new_variables.push((id.index, id.index() == before.0, before.1, before.2));
        }
        for (id, factor) in &change.new_factors {
            match self.resolve(*id, factor, &staged) {
                Ok(term) => {
                    let fresh = id.index() == self.factors.capacity();
                    for &v in &term.variables {
                        self.variable_mut(v as usize).factors.push(id.index);
                    }
                    self.factors.insert_planned(id.index, term);
                    self.living_factors += 1;
                    staged.new_factors.push((id.index, fresh));
                }
                Err(error) => {
                    self.unstage(staged);
                    return Err(error);
                }
            }
        }
        if let Err(error) = self.check_drops(change) {
            self.unstage(staged);
            return Err(error);
        }
        Ok(staged)
    }

    /// Takes a staged change back; the graph is then what it was, bit for bit.
    pub fn unstage(&mut self, staged: Staged) {
        for &(index, fresh) in staged.new_factors.iter().rev() {
            if let Some(term) = self.factors.undo_insert(index, fresh) {
                for &v in &term.variables {
                    let popped = self.variable_mut(v as usize).factors.pop();
                    debug_assert_eq!(popped, Some(index));
                }
                self.living_factors -= 1;
            }
        }
        for &(index, fresh, value_len, tangent_len) in staged.new_variables.iter().rev() {
            if let Some(variable) = self.variables.undo_insert(index, fresh) {
                self.dim -= variable.tangent.1 as usize;
                self.tangent_layout.undo_allocate(variable.tangent, tangent_len);
                self.value_layout.undo_allocate(variable.value, value_len);
                self.living_variables -= 1;
            }
        }
    }

    /// Makes a staged change final: drops what is to go and stamps versions.
    pub fn commit(&mut self, staged: Staged) {
        for &(index, _) in &staged.new_factors {
            self.stamp_variables_of(index as usize);
        }
        for &index in &staged.drop_factors {
            self.stamp_variables_of(index as usize);
            if let Some(term) = self.factors.remove(index) {
                for &v in &term.variables {
                    self.variable_mut(v as usize).factors.retain(|f| *f != index);
                }
                self.living_factors -= 1;
            }
        }
        for &index in &staged.moved {
            self.variable_mut(index as usize).version += 1;
        }
        for &index in &staged.drop_variables {
            if let Some(variable) = self.variables.remove(index) {
                self.dim -= variable.tangent.1 as usize;
                self.tangent_layout.release(variable.tangent);
                self.value_layout.release(variable.value);
                self.living_variables -= 1;
            }
        }
    }

    fn stamp_variables_of(&mut self, factor: usize) {
        let variables = self.term(factor).variables.clone();
        for v in variables {
            self.variable_mut(v as usize).version += 1;
        }
    }

    /// Everything that can be checked before anything is added.
    fn check_references(&self, change: &Change) -> Result<(), GraphError> {
        if change.graph != self.tag {
            return Err(GraphError::Foreign { what: "the change".into() });
        }
        if !self.variables.is_current(&change.variable_plan)
            || !self.factors.is_current(&change.factor_plan)
        {
            return Err(GraphError::Stale {
                reason: "another change has taken the ids that it planned to add".into(),
            });
        }
        for &(id, version) in &change.requires {
            self.check_variable(id)?;
            let now = self.variable(id.index()).version;
            if now != version {
                return Err(GraphError::Stale {
                    reason: format!(
                        "variable {id} is at version {now}, the change was planned at {version}"
                    ),
                });
            }
        }
        for (id, value) in change.new_variables.iter().chain(&change.moves) {
            if value.storage().iter().any(|x| !x.is_finite()) {
                return Err(GraphError::NonFiniteValue {
                    variable: *id,
                    value: format!("{:?}", value.storage()),
                });
            }
        }
        let mut moved: Vec<_> = change.moves.iter().map(|m| m.0).collect();
        if let Some(id) = first_duplicate(&mut moved) {
            return Err(GraphError::Twice { what: format!("moving variable {id}") });
        }
        for (id, value) in &change.moves {
            self.check_variable(*id)?;
            let variable = self.variable(id.index());
            let fits =
                variable.kind == value.kind() && variable.value.1 as usize == value.storage().len();
            if !fits {
                return Err(GraphError::ValueMismatch {
                    variable: *id,
                    actual: value.kind().name(),
                    dim: value.dim(),
                });
            }
        }
        Ok(())
    }

    fn check_drops(&self, change: &Change) -> Result<(), GraphError> {
        let mut factors = change.drop_factors.clone();
        if let Some(id) = first_duplicate(&mut factors) {
            return Err(GraphError::Twice { what: format!("dropping factor {id}") });
        }
        for &id in &change.drop_factors {
            self.check_factor(id)?;
            if change.new_factors.iter().any(|(new, _)| *new == id) {
                return Err(GraphError::Twice {
                    what: format!("factor {id}, which is added and dropped,"),
                });
            }
        }
        let mut variables = change.drop_variables.clone();
        if let Some(id) = first_duplicate(&mut variables) {
            return Err(GraphError::Twice { what: format!("dropping variable {id}") });
        }
        for &id in &change.drop_variables {
            self.check_variable(id)?;
            if change.new_variables.iter().any(|(new, _)| *new == id) {
                return Err(GraphError::Twice {
                    what: format!("variable {id}, which is added and dropped,"),
                });
            }
            for &f in self.factors_at(id.index()) {
                let factor = self.factor_id(f as usize);
                if factors.binary_search(&factor).is_err() {
                    return Err(GraphError::StillHeld { variable: id, factor });
                }
            }
        }
        Ok(())
    }

    /// Checks a new factor against the graph and resolves its keys.
    fn resolve(
        &self,
        id: FactorId,
        factor: &Arc<dyn Factor>,
        staged: &Staged,
    ) -> Result<Term, GraphError> {
        let malformed = |problem: String| GraphError::MalformedFactor {
            factor: id,
            name: factor.name(),
            problem,
        };
        let keys = factor.keys();
        if keys.is_empty() || factor.residual_dim() == 0 {
            return Err(malformed("has no variables or no residual".into()));
        }
        let mut term = Term {
            factor: Arc::clone(factor),
            variables: SmallVec::new(),
            columns: SmallVec::new(),
            rows: factor.residual_dim() as u32,
        };
        let mut column = 0;
        for (position, &key) in keys.iter().enumerate() {
            self.check_variable(key)?;
            if term.variables.contains(&key.index) {
                return Err(malformed(format!("names variable {key} twice")));
            }
            if staged.drop_variables.contains(&key.index) {
                return Err(malformed(format!(
                    "is on variable {key}, which the same change drops"
                )));
            }
            let (kind, dim) = (self.kind_at(key.index()), self.dim_at(key.index()));
            if !factor.accepts(position, kind, dim) {
                return Err(GraphError::NotAccepted {
                    factor: id,
                    name: factor.name(),
                    variable: key,
                    position,
                    actual: kind.name(),
                    dim,
                });
            }
            term.variables.push(key.index);
            term.columns.push(column);
            column += dim as u32;
        }
        term.columns.push(column);
        Ok(term)
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

/// Sorts, and returns something that stands twice.
fn first_duplicate<T: Ord + Copy>(items: &mut [T]) -> Option<T> {
    items.sort_unstable();
    items.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}
