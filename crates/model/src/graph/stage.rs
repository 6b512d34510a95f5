//! Changing a graph: check and add, then commit or take back.

use std::sync::Arc;

use smallvec::SmallVec;

use super::{Graph, Partial, Term, Used, Variable};
use crate::change::Change;
use crate::error::GraphError;
use crate::factor::Factor;
use crate::key::{FactorId, FactorIndex, VariableId, VariableIndex, Version};
use crate::manifold::VariableType;
use crate::user_code::{guarded_factor, name_of};
use crate::value::Value;

/// A change that has been checked and whose additions stand in the graph; what it drops is still
/// there. Ends in [`Graph::commit`] or [`Graph::unstage`].
#[derive(Debug)]
#[must_use = "a staged change is committed or unstaged"]
pub struct Staged {
    new_variables: SmallVec<[NewVariable; 4]>,
    new_factors: SmallVec<[(FactorIndex, bool); 8]>,
    drop_factors: Vec<FactorIndex>,
    drop_variables: Vec<VariableIndex>,
    moved: Vec<VariableIndex>,
    /// Variables whose flag was turned, in that order; new ones too.
    turned: Vec<VariableIndex>,
    fixed: Vec<VariableIndex>,
    freed: Vec<VariableIndex>,
    reshaped: Vec<FactorIndex>,
}

/// A variable that was added, with what it takes to take it back.
#[derive(Debug)]
struct NewVariable {
    index: VariableIndex,
    fresh: bool,
    /// Lengths of the layouts before.
    value_len: u32,
    tangent_len: u32,
}

impl Staged {
    /// Slots of the added variables.
    pub fn new_variables(&self) -> impl Iterator<Item = VariableIndex> {
        self.new_variables.iter().map(|v| v.index)
    }

    /// Slots of the added factors.
    pub fn new_factors(&self) -> impl Iterator<Item = FactorIndex> {
        self.new_factors.iter().map(|f| f.0)
    }

    /// Slots of the factors to drop, ascending.
    pub fn dropped_factors(&self) -> &[FactorIndex] {
        &self.drop_factors
    }

    /// Slots of the variables to drop, ascending.
    pub fn dropped_variables(&self) -> &[VariableIndex] {
        &self.drop_variables
    }

    /// Slots of the variables whose linearization points move, in the order of the change.
    pub fn moved(&self) -> &[VariableIndex] {
        &self.moved
    }

    /// Slots of the variables that were unknown before and are fixed now, in the order of the change.
    pub fn fixed(&self) -> &[VariableIndex] {
        &self.fixed
    }

    /// Slots of the variables that were fixed before and are unknown now, in the order of the change.
    pub fn freed(&self) -> &[VariableIndex] {
        &self.freed
    }

    /// Slots of the factors whose unknowns have changed, ascending: neither new nor to drop.
    pub fn reshaped(&self) -> &[FactorIndex] {
        &self.reshaped
    }
}

/// The slots that a change refers to.
struct References {
    drop_factors: Vec<FactorIndex>,
    drop_variables: Vec<VariableIndex>,
    moved: Vec<VariableIndex>,
}

/// # Changes in two steps, for solvers
///
/// A solver stages a change, updates its own state, and then commits the change or takes it back.
/// Embedding programs use `Smoother::apply`, which does all of that. A graph without a solver is built
/// by [`stage`](Self::stage) and [`commit`](Self::commit).
impl Graph {
    /// Checks a change and, if all of it is good, adds its variables and factors and fixes and
    /// frees variables. What it drops stays until [`commit`](Self::commit).
    ///
    /// # Errors
    /// Any [`GraphError`]; the graph is then what it was, bit for bit.
    pub fn stage(&mut self, change: &Change) -> Result<Staged, GraphError> {
        let references = self.check_references(change)?;
        self.check_values(change)?;
        self.check_size(change)?;
        self.check_origins(change)?;
        let mut staged = Staged {
            new_variables: SmallVec::new(),
            new_factors: SmallVec::new(),
            drop_factors: references.drop_factors,
            drop_variables: references.drop_variables,
            moved: references.moved,
            turned: Vec::new(),
            fixed: Vec::new(),
            freed: Vec::new(),
            reshaped: Vec::new(),
        };
        match self.add(change, &mut staged) {
            Ok(()) => Ok(staged),
            Err(error) => {
                self.unstage(staged);
                Err(error)
            }
        }
    }

    /// Everything that `stage` alters; on error, `staged` says how far it has come.
    fn add(&mut self, change: &Change, staged: &mut Staged) -> Result<(), GraphError> {
        for (id, value) in &change.new_variables {
            staged.new_variables.push(self.add_variable(*id, value)?);
        }
        self.turn_variables(change, staged)?;
        for (id, factor) in &change.new_factors {
            let term = self.resolve(*id, factor, &staged.drop_variables)?;
            staged.new_factors.push(self.add_factor(*id, term)?);
        }
        Ok(())
    }

    /// Takes a staged change back; the graph is then what it was, bit for bit.
    ///
    /// # Panics
    /// May panic when the change was staged by another graph.
    pub fn unstage(&mut self, staged: Staged) {
        for &(index, fresh) in staged.new_factors.iter().rev() {
            let id = self.factor_id(index);
            self.used_by(id.origin).factors.remove(id.number);
            if let Some(term) = self.factors.undo_insert(index.index() as u32, fresh) {
                for &v in &term.variables {
                    let popped = self.variable_mut(v).factors.pop();
                    debug_assert_eq!(popped, Some(index));
                }
            }
        }
        for &index in staged.turned.iter().rev() {
            self.turn(index);
        }
        for &factor in &staged.reshaped {
            self.reshape(factor);
        }
        for new in staged.new_variables.iter().rev() {
            let id = self.variable_id(new.index);
            self.used_by(id.origin).variables.remove(id.number);
            let undone = self.variables.undo_insert(new.index.index() as u32, new.fresh);
            if let Some(variable) = undone {
                self.count(variable.kind, -1);
                self.unknowns -= 1;
                self.dim -= variable.tangent.1 as usize;
                self.tangent_layout.undo_allocate(variable.tangent, new.tangent_len);
                self.value_layout.undo_allocate(variable.value, new.value_len);
            }
        }
    }

    /// Makes a staged change final: drops what is to be dropped and stamps versions.
    ///
    /// # Panics
    /// May panic when the change was staged by another graph.
    pub fn commit(&mut self, staged: Staged) {
        for &(index, _) in &staged.new_factors {
            self.stamp_variables_of(index);
        }
        for &index in &staged.drop_factors {
            self.stamp_variables_of(index);
            if let Some(term) = self.factors.remove(index.index()) {
                for &v in &term.variables {
                    self.variable_mut(v).factors.retain(|f| *f != index);
                }
            }
        }
        for &index in staged.moved.iter().chain(&staged.fixed).chain(&staged.freed) {
            self.variable_mut(index).version += 1;
        }
        for &index in &staged.drop_variables {
            if let Some(variable) = self.variables.remove(index.index()) {
                self.count(variable.kind, -1);
                if !variable.fixed {
                    self.unknowns -= 1;
                    self.dim -= variable.tangent.1 as usize;
                }
                self.tangent_layout.release(variable.tangent);
                self.value_layout.release(variable.value);
            }
        }
        for used in &mut self.used {
            used.variables.compact();
            used.factors.compact();
        }
    }

    // --- Additions -------------------------------------------------------------------------

    fn add_variable(&mut self, id: VariableId, value: &Value) -> Result<NewVariable, GraphError> {
        if !self.used_by(id.origin).variables.insert(id.number) {
            return Err(GraphError::AddedBefore { what: format!("variable {id}") });
        }
        let (value_len, tangent_len) = (self.value_layout.len, self.tangent_layout.len);
        let variable = Variable {
            kind: value.kind(),
            value: self.value_layout.allocate(value.storage().len() as u32),
            tangent: self.tangent_layout.allocate(value.dim() as u32),
            factors: SmallVec::new(),
            version: 0,
            fixed: false,
        };
        let (value_range, tangent_range) = (variable.value, variable.tangent);
        let Some((index, fresh)) = self.variables.insert(id, variable) else {
            self.used_by(id.origin).variables.remove(id.number);
            self.tangent_layout.undo_allocate(tangent_range, tangent_len);
            self.value_layout.undo_allocate(value_range, value_len);
            return Err(GraphError::TooLarge { what: "the list of all variables".into() });
        };
        self.count(value.kind(), 1);
        self.unknowns += 1;
        self.dim += value.dim();
        let index = VariableIndex::new(index as usize);
        Ok(NewVariable { index, fresh, value_len, tangent_len })
    }

    fn add_factor(&mut self, id: FactorId, term: Term) -> Result<(FactorIndex, bool), GraphError> {
        if !self.used_by(id.origin).factors.insert(id.number) {
            return Err(GraphError::AddedBefore { what: format!("factor {id}") });
        }
        let variables = term.variables.clone();
        let Some((index, fresh)) = self.factors.insert(id, term) else {
            self.used_by(id.origin).factors.remove(id.number);
            return Err(GraphError::TooLarge { what: "the list of all factors".into() });
        };
        let index = FactorIndex::new(index as usize);
        for &v in &variables {
            self.variable_mut(v).factors.push(index);
        }
        Ok((index, fresh))
    }

    /// Fixes and frees variables, and gives their factors new shapes.
    fn turn_variables(&mut self, change: &Change, staged: &mut Staged) -> Result<(), GraphError> {
        let fixes = change.fixes.iter().map(|id| (*id, true));
        let frees = change.frees.iter().map(|id| (*id, false));
        for (id, fix) in fixes.chain(frees) {
            let index = self.variable_index(id)?;
            let word = if fix { "fixed" } else { "freed" };
            if staged.drop_variables.binary_search(&index).is_ok() {
                let (variable, first, second) = (id, word, "dropped");
                return Err(GraphError::Contradiction { variable, first, second });
            }
            if !fix && change.fixes.contains(&id) {
                let (variable, first, second) = (id, "fixed", "freed");
                return Err(GraphError::Contradiction { variable, first, second });
            }
            if self.is_fixed_at(index) == fix {
                continue;
            }
            self.turn(index);
            staged.turned.push(index);
            if staged.new_variables.iter().any(|new| new.index == index) {
                continue;
            }
            let list = if fix { &mut staged.fixed } else { &mut staged.freed };
            list.push(index);
            let factors = self.factors_at(index).iter().copied();
            let dropped = &staged.drop_factors;
            staged.reshaped.extend(factors.filter(|f| dropped.binary_search(f).is_err()));
        }
        staged.reshaped.sort_unstable();
        staged.reshaped.dedup();
        for &factor in &staged.reshaped {
            self.reshape(factor);
        }
        Ok(())
    }

    /// Fixes an unknown variable, or frees a fixed one.
    fn turn(&mut self, index: VariableIndex) {
        let variable = self.variable_mut(index);
        variable.fixed = !variable.fixed;
        let (fixed, dim) = (variable.fixed, variable.tangent.1 as usize);
        if fixed {
            self.unknowns -= 1;
            self.dim -= dim;
        } else {
            self.unknowns += 1;
            self.dim += dim;
        }
    }

    /// Finds the unknowns of a factor again.
    fn reshape(&mut self, factor: FactorIndex) {
        let partial = self.partial(&self.term(factor).variables);
        self.factors.at_mut(factor.index()).expect("the slot holds a living factor").partial =
            partial;
    }

    /// The part of a factor on `variables` that is not fixed; `None` when nothing is.
    fn partial(&self, variables: &[VariableIndex]) -> Option<Box<Partial>> {
        variables.iter().any(|&v| self.is_fixed_at(v)).then(|| {
            let unknowns: SmallVec<[VariableIndex; 2]> =
                variables.iter().copied().filter(|&v| !self.is_fixed_at(v)).collect();
            let columns = columns_of(unknowns.iter().map(|&v| self.dim_at(v)));
            Box::new(Partial { unknowns, columns })
        })
    }

    pub(super) fn count(&mut self, kind: &'static VariableType, by: isize) {
        match self.kinds.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, count)) => *count = count.saturating_add_signed(by),
            None => self.kinds.push((kind, usize::from(by > 0))),
        }
    }

    fn used_by(&mut self, origin: u64) -> &mut Used {
        let at = self.used.iter().position(|used| used.origin == origin);
        let at = at.unwrap_or_else(|| {
            self.used.push(Used::nothing(origin));
            self.used.len() - 1
        });
        &mut self.used[at]
    }

    fn stamp_variables_of(&mut self, factor: FactorIndex) {
        let variables = self.term(factor).variables.clone();
        for v in variables {
            self.variable_mut(v).version += 1;
        }
    }

    // --- Checks before anything is added ---------------------------------------------------

    /// Resolves what the change refers to.
    fn check_references(&self, change: &Change) -> Result<References, GraphError> {
        if change.lineage() != self.ids.lineage() {
            return Err(GraphError::Foreign { what: "the change".into() });
        }
        change.requires.iter().try_for_each(|&(id, at)| self.check_version(id, at))?;
        let mut moved = Vec::with_capacity(change.moves.len());
        for (id, value) in &change.moves {
            moved.push(self.check_move(*id, value)?);
        }
        if let Some(index) = first_duplicate(&mut moved.clone()) {
            let id = self.variable_id(index);
            return Err(GraphError::Twice { what: format!("moving variable {id}") });
        }
        let drop_factors = self.check_factor_drops(change)?;
        let drop_variables = self.check_variable_drops(change, &drop_factors)?;
        Ok(References { drop_factors, drop_variables, moved })
    }

    /// A required version.
    fn check_version(&self, id: VariableId, planned_at: Version) -> Result<(), GraphError> {
        let stale = |reason| Err(GraphError::Stale { reason });
        match self.variable_index(id).map(|index| self.variable(index).version) {
            Ok(now) if now == planned_at => Ok(()),
            Ok(now) => stale(format!(
                "variable {id} is at version {now}, the change was planned at {planned_at}"
            )),
            Err(GraphError::UnknownVariable { .. }) => {
                stale(format!("variable {id}, which it was planned with, is not in the graph"))
            }
            Err(error) => Err(error),
        }
    }

    fn check_move(&self, id: VariableId, value: &Value) -> Result<VariableIndex, GraphError> {
        let index = self.variable_index(id)?;
        let variable = self.variable(index);
        let fits = variable.kind == value.kind()
            && variable.tangent.1 as usize == value.dim()
            && variable.value.1 as usize == value.storage().len();
        if fits {
            Ok(index)
        } else {
            Err(GraphError::ValueMismatch {
                variable: id,
                actual: value.kind().name(),
                dim: value.dim(),
            })
        }
    }

    /// The factors to drop, ascending.
    fn check_factor_drops(&self, change: &Change) -> Result<Vec<FactorIndex>, GraphError> {
        let factors = change.drop_factors.iter().map(|&id| self.factor_index(id));
        let mut factors: Vec<FactorIndex> = factors.collect::<Result<_, _>>()?;
        if let Some(index) = first_duplicate(&mut factors) {
            let id = self.factor_id(index);
            return Err(GraphError::Twice { what: format!("dropping factor {id}") });
        }
        Ok(factors)
    }

    /// The variables to drop, ascending; `factors` are those dropped with them.
    fn check_variable_drops(
        &self,
        change: &Change,
        factors: &[FactorIndex],
    ) -> Result<Vec<VariableIndex>, GraphError> {
        let variables = change.drop_variables.iter().map(|&id| self.variable_index(id));
        let mut variables: Vec<VariableIndex> = variables.collect::<Result<_, _>>()?;
        if let Some(index) = first_duplicate(&mut variables) {
            let id = self.variable_id(index);
            return Err(GraphError::Twice { what: format!("dropping variable {id}") });
        }
        for &index in &variables {
            let held = self.factors_at(index).iter().find(|f| factors.binary_search(f).is_err());
            if let Some(&factor) = held {
                let (variable, factor) = (self.variable_id(index), self.factor_id(factor));
                return Err(GraphError::StillHeld { variable, factor });
            }
        }
        Ok(variables)
    }

    fn check_values(&self, change: &Change) -> Result<(), GraphError> {
        for (id, value) in change.new_variables.iter().chain(&change.moves) {
            if value.storage().iter().any(|x| !x.is_finite()) {
                return Err(GraphError::NonFiniteValue {
                    variable: *id,
                    value: format!("{:?}", value.storage()),
                });
            }
        }
        Ok(())
    }

    /// Offsets into flat arrays are 32 bits wide.
    fn check_size(&self, change: &Change) -> Result<(), GraphError> {
        let new: usize = change
            .new_variables
            .iter()
            .map(|(_, value)| value.storage().len().max(value.dim()))
            .sum();
        let len = self.value_layout.len.max(self.tangent_layout.len);
        if new > (u32::MAX - len) as usize {
            return Err(GraphError::TooLarge {
                what: "the values of all variables together".into(),
            });
        }
        Ok(())
    }

    /// Ids of a change that was made for this graph come from a source of this graph, or from one of
    /// a saved copy of it, whose changes are no longer known here.
    fn check_origins(&self, change: &Change) -> Result<(), GraphError> {
        let variables = change.new_variables.iter().map(|(id, _)| id.origin);
        let factors = change.new_factors.iter().map(|(id, _)| id.origin);
        match variables.chain(factors).all(|origin| self.knows(origin)) {
            true => Ok(()),
            false => Err(GraphError::Foreign { what: "the change".into() }),
        }
    }

    /// Checks a new factor against the graph and resolves its keys.
    pub(super) fn resolve(
        &self,
        id: FactorId,
        factor: &Arc<dyn Factor>,
        drop_variables: &[VariableIndex],
    ) -> Result<Term, GraphError> {
        let malformed = |problem: String| GraphError::MalformedFactor {
            factor: id,
            name: name_of(&**factor),
            problem,
        };
        let (keys, rows) =
            guarded_factor(id, &**factor, || (factor.keys(), factor.residual_dim()))?;
        if keys.is_empty() || rows == 0 {
            return Err(malformed("has no variables or no residual".into()));
        }
        let mut variables: SmallVec<[VariableIndex; 2]> = SmallVec::new();
        for (position, &key) in keys.iter().enumerate() {
            let index = self.variable_index(key)?;
            if variables.contains(&index) {
                return Err(malformed(format!("names variable {key} twice")));
            }
            if drop_variables.binary_search(&index).is_ok() {
                return Err(malformed(format!(
                    "is on variable {key}, which the same change drops"
                )));
            }
            let (kind, dim) = (self.kind_at(index), self.dim_at(index));
            if !guarded_factor(id, &**factor, || factor.accepts(position, kind, dim))? {
                return Err(GraphError::NotAccepted {
                    factor: id,
                    name: name_of(&**factor),
                    variable: key,
                    position,
                    actual: kind.name(),
                    dim,
                });
            }
            variables.push(index);
        }
        let columns = columns_of(variables.iter().map(|&v| self.dim_at(v)));
        let width = u64::from(columns[columns.len() - 1]) + 1;
        let rows = u32::try_from(rows).unwrap_or(u32::MAX);
        if u64::from(rows) * width > u64::from(u32::MAX) {
            return Err(GraphError::TooLarge {
                what: format!("the Jacobian of factor {id} ({})", name_of(&**factor)),
            });
        }
        let partial = self.partial(&variables);
        Ok(Term { factor: Arc::clone(factor), variables, columns, rows, partial })
    }
}

impl Change {
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
            if !self.drops_factor(factor) {
                self.drop_factor(factor);
            }
        }
        Ok(self.drop_variable(variable))
    }
}

/// First columns of blocks of these widths, then of the residual.
fn columns_of(dims: impl Iterator<Item = usize>) -> SmallVec<[u32; 3]> {
    let mut columns = SmallVec::new();
    let mut column = 0;
    columns.push(column);
    for dim in dims {
        column += dim as u32;
        columns.push(column);
    }
    columns
}

/// Sorts, and returns something that stands twice.
fn first_duplicate<T: Ord + Copy>(items: &mut [T]) -> Option<T> {
    items.sort_unstable();
    items.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}
