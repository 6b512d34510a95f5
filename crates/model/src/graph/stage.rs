//! Changing a graph: check and add, then commit or take back.

use std::sync::Arc;

use smallvec::SmallVec;

use super::{Graph, GraphError, Term, Variable};
use crate::change::Change;
use crate::factor::Factor;
use crate::key::FactorId;

/// A change that has been checked and whose additions stand in the graph; what it drops is still
/// there. Ends in [`Graph::commit`] or [`Graph::unstage`].
#[derive(Debug)]
#[must_use = "a staged change is committed or unstaged"]
pub struct Staged {
    new_variables: SmallVec<[(u32, bool, u32, u32); 4]>,
    new_factors: SmallVec<[(u32, bool); 8]>,
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

    /// Slots of the factors that will go, ascending.
    pub fn dropped_factors(&self) -> &[u32] {
        &self.drop_factors
    }

    /// Slots of the variables that will go, ascending.
    pub fn dropped_variables(&self) -> &[u32] {
        &self.drop_variables
    }
}

impl Graph {
    /// Checks a change and, if all of it is good, adds its variables and factors. What it drops
    /// stays until [`commit`](Self::commit).
    ///
    /// # Errors
    /// Any [`GraphError`]; the graph is then what it was, bit for bit.
    pub fn stage(&mut self, change: &Change) -> Result<Staged, GraphError> {
        self.check_references(change)?;
        self.check_drops(change)?;
        self.check_size(change)?;
        let mut staged = Staged {
            new_variables: SmallVec::new(),
            new_factors: SmallVec::new(),
            drop_factors: sorted(change.drop_factors.iter().map(|f| f.index)),
            drop_variables: sorted(change.drop_variables.iter().map(|v| v.index)),
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
            let fits = variable.kind == value.kind()
                && variable.tangent.1 as usize == value.dim()
                && variable.value.1 as usize == value.storage().len();
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
        }
        let mut variables = change.drop_variables.clone();
        if let Some(id) = first_duplicate(&mut variables) {
            return Err(GraphError::Twice { what: format!("dropping variable {id}") });
        }
        for &id in &change.drop_variables {
            self.check_variable(id)?;
            for &f in self.factors_at(id.index()) {
                let factor = self.factor_id(f as usize);
                if factors.binary_search(&factor).is_err() {
                    return Err(GraphError::StillHeld { variable: id, factor });
                }
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
            rows: u32::try_from(factor.residual_dim()).unwrap_or(u32::MAX),
        };
        let mut column = 0;
        for (position, &key) in keys.iter().enumerate() {
            self.check_variable(key)?;
            if term.variables.contains(&key.index) {
                return Err(malformed(format!("names variable {key} twice")));
            }
            if staged.drop_variables.binary_search(&key.index).is_ok() {
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
        if u64::from(term.rows) * (u64::from(column) + 1) > u64::from(u32::MAX) {
            return Err(GraphError::TooLarge {
                what: format!("the Jacobian of factor {id} ({})", factor.name()),
            });
        }
        Ok(term)
    }
}

fn sorted(indices: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut indices: Vec<u32> = indices.collect();
    indices.sort_unstable();
    indices
}

/// Sorts, and returns something that stands twice.
fn first_duplicate<T: Ord + Copy>(items: &mut [T]) -> Option<T> {
    items.sort_unstable();
    items.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}
