//! From a staged change to new cliques, and back where that fails.

use evergraph_model::{Change, FactorIndex, Staged, VariableIndex};

use super::engine::Engine;
use super::state::Factorization;
use super::undo::Undo;
use crate::eliminate::{Eliminated, Failure, NodeStructure};
use crate::error::SmootherError;
use crate::pending::Pending;
use crate::planner::{Now, Plan};
use crate::profile::Phase;

/// A change that has been linearized and eliminated, ready to be [committed](Factorization::commit).
#[derive(Debug)]
#[must_use = "an update is committed"]
pub(crate) struct Update {
    pub(crate) plan: Plan,
    pub(crate) eliminated: Eliminated,
    /// Variables whose points moved with a pending relinearization.
    pub(crate) relinearized: Vec<VariableIndex>,
    newest: Option<VariableIndex>,
    undo: Undo,
}

/// The reason why a change could not be eliminated.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// The results of the pending relinearization are of no use.
    Pending,
    Error(SmootherError),
}

impl From<SmootherError> for Refusal {
    fn from(error: SmootherError) -> Self {
        Self::Error(error)
    }
}

impl From<Refusal> for SmootherError {
    fn from(refusal: Refusal) -> Self {
        match refusal {
            Refusal::Error(error) => error,
            Refusal::Pending => {
                unreachable!("without a pending relinearization nothing is pending")
            }
        }
    }
}

impl Factorization {
    /// Linearizes and eliminates what a staged change affects, together with `pending` if that is
    /// to take effect. On an error points, Jacobians and `pending` are what they were.
    pub(crate) fn eliminate(
        &mut self,
        change: &Change,
        staged: &Staged,
        mut pending: Option<&mut Pending>,
        engine: &mut Engine,
    ) -> Result<Update, Refusal> {
        engine.workspace.clock.lap(Phase::Stage);
        let newest = self.newest_after(staged);
        let relinearized = pending.as_ref().map(|it| it.variables(&self.graph).collect());
        let mut undo = std::mem::take(&mut engine.buffers.undo);
        undo.start(self.points.len());
        match self.linearize_and_eliminate(
            (change, staged, newest),
            pending.as_deref_mut(),
            &mut undo,
            engine,
        ) {
            Ok((plan, eliminated)) => {
                let relinearized = relinearized.unwrap_or_default();
                Ok(Update { plan, eliminated, relinearized, newest, undo })
            }
            Err(refusal) => {
                self.revert(&undo, pending);
                engine.buffers.undo = undo;
                Err(refusal)
            }
        }
    }

    /// Replaces the detached cliques, and drops what the change drops.
    pub(crate) fn commit(
        &mut self,
        staged: Staged,
        update: Update,
        pending: Option<&mut Pending>,
        engine: &mut Engine,
    ) {
        let Update { plan, eliminated, relinearized, newest, undo } = update;
        self.install(plan, eliminated, pending, engine);
        engine.workspace.clock.lap(Phase::Install);
        for &factor in staged.dropped_factors() {
            self.blocks.remove(factor);
        }
        undo.finish(&mut self.blocks);
        self.solution.resize(&self.graph);
        for variable in staged.new_variables() {
            self.solution.reset(&self.graph, variable);
        }
        for &variable in undo.moved().iter().chain(&relinearized) {
            self.solution.reset(&self.graph, variable);
        }
        for &variable in staged.fixed().iter().chain(staged.freed()) {
            self.solution.reset(&self.graph, variable);
        }
        self.solution.is_at_points = false;
        self.graph.commit(staged);
        self.newest = newest;
        engine.buffers.undo = undo;
    }

    /// Applies a change, whole or not at all.
    pub(crate) fn apply(
        &mut self,
        change: &Change,
        engine: &mut Engine,
    ) -> Result<(), SmootherError> {
        let staged = self.stage(change)?;
        match self.eliminate(change, &staged, None, engine) {
            Ok(update) => self.commit(staged, update, None, engine),
            Err(refusal) => {
                self.unstage(staged);
                return Err(refusal.into());
            }
        }
        Ok(())
    }

    /// The variable to eliminate last: the latest of the largest new ones (of a pose and its
    /// landmarks the pose, which the next change will continue), else the one so far.
    fn newest_after(&self, staged: &Staged) -> Option<VariableIndex> {
        let new = staged.new_variables().filter(|&v| !self.graph.is_fixed_at(v));
        let stays = |v: &VariableIndex| {
            staged.dropped_variables().binary_search(v).is_err() && !self.graph.is_fixed_at(*v)
        };
        new.max_by_key(|&v| self.graph.dim_at(v)).or(self.newest.filter(stays))
    }

    fn linearize_and_eliminate(
        &mut self,
        (change, staged, newest): (&Change, &Staged, Option<VariableIndex>),
        mut pending: Option<&mut Pending>,
        undo: &mut Undo,
        engine: &mut Engine,
    ) -> Result<(Plan, Eliminated), Refusal> {
        // Move points and linearize.
        let mut again = std::mem::take(&mut engine.buffers.factors);
        let linearized = self
            .move_points(change, staged, undo, engine)
            .and_then(|()| self.linearize(staged, pending.as_deref_mut(), undo, &mut again));
        engine.buffers.factors = again;
        linearized?;
        engine.workspace.clock.lap(Phase::Linearize);
        // Mark the affected cliques and their ancestors, order their variables, build new cliques.
        let pending = pending.map(|pending| &*pending);
        let now = Now { last: newest, ..self.now() };
        let buffers = (engine.take_plan(), &mut engine.workspace.clock);
        let plan = engine.planner.plan_change(now, staged, undo.moved(), pending, buffers);
        if let Some(error) = too_large(&plan, engine.largest_clique) {
            engine.buffers.plan = plan;
            return Err(error.into());
        }
        // Eliminate, bottom-up.
        match self.eliminate_plan(&plan, pending, None, engine) {
            Ok(eliminated) => Ok((plan, eliminated)),
            Err(failure) => {
                engine.buffers.plan = plan;
                Err(match failure {
                    Failure::Pending => Refusal::Pending,
                    failure => self.explain(failure, Some(staged)).into(),
                })
            }
        }
    }

    /// Moves the points that the change moves, and sets those of new variables. A variable that is
    /// fixed moves to its estimate.
    fn move_points(
        &mut self,
        change: &Change,
        staged: &Staged,
        undo: &mut Undo,
        engine: &Engine,
    ) -> Result<(), SmootherError> {
        self.points.resize(self.graph.value_len(), 0.0);
        for (variable, (_, value)) in staged.new_variables().zip(change.new_variables()) {
            self.points[self.graph.value_range(variable)].copy_from_slice(value.storage());
        }
        for (&variable, (_, value)) in staged.moved().iter().zip(change.moves()) {
            undo.save_point(&self.graph, &self.points, variable);
            self.points[self.graph.value_range(variable)].copy_from_slice(value.storage());
        }
        self.fix_points(staged, undo, engine)
    }

    /// Moves variables that are fixed to their estimates, unless they are new or the change moves
    /// them.
    fn fix_points(
        &mut self,
        staged: &Staged,
        undo: &mut Undo,
        engine: &Engine,
    ) -> Result<(), SmootherError> {
        if staged.fixed().is_empty() || self.solution.is_at_points {
            return Ok(());
        }
        // A new one is in no clique.
        let is_old = |v: &&VariableIndex| self.tree.clique_of(**v).some().is_some();
        let stays = |v: &&VariableIndex| !staged.moved().contains(v);
        let fixed: Vec<VariableIndex> =
            staged.fixed().iter().filter(is_old).filter(stays).copied().collect();
        let deltas = self.deltas(engine.instructions, &fixed);
        let mut estimate = Vec::new();
        for (&variable, delta) in fixed.iter().zip(&deltas) {
            let range = self.graph.value_range(variable);
            estimate.clear();
            estimate.resize(range.len(), 0.0);
            self.graph.retract(variable, &self.points[range.clone()], delta, &mut estimate)?;
            undo.save_point(&self.graph, &self.points, variable);
            self.points[range].copy_from_slice(&estimate);
        }
        Ok(())
    }

    /// Linearizes factors that are new or have other unknowns, and those on points that have moved.
    fn linearize(
        &mut self,
        staged: &Staged,
        pending: Option<&mut Pending>,
        undo: &mut Undo,
        again: &mut Vec<FactorIndex>,
    ) -> Result<(), SmootherError> {
        again.clear();
        for &variable in undo.moved() {
            again.extend_from_slice(self.graph.factors_at(variable));
        }
        if let Some(pending) = pending {
            undo.save_swap();
            pending.swap(&self.graph, &mut self.points, &mut self.blocks);
            let on_moved =
                pending.variables(&self.graph).flat_map(|v| self.graph.factors_at(v).iter());
            again.extend(on_moved.copied().filter(|&f| !pending.has(&self.graph, f)));
        }
        for factor in staged.new_factors().chain(staged.reshaped().iter().copied()) {
            undo.save_insertion(&self.blocks, factor);
            let inserted = self.blocks.insert(&self.graph, factor, &self.points);
            inserted.map_err(|flaw| self.flawed(factor, flaw))?;
        }
        again.sort_unstable();
        again.dedup();
        again.retain(|f| staged.dropped_factors().binary_search(f).is_err());
        if !staged.reshaped().is_empty() {
            again.retain(|f| staged.reshaped().binary_search(f).is_err());
        }
        for &factor in &*again {
            undo.save_block(&self.blocks, factor);
            let linearized = self.blocks.relinearize(&self.graph, factor, &self.points);
            linearized.map_err(|flaw| self.flawed(factor, flaw))?;
        }
        Ok(())
    }

    /// Restores points and Jacobians.
    fn revert(&mut self, undo: &Undo, pending: Option<&mut Pending>) {
        undo.revert(&self.graph, &mut self.points, &mut self.blocks);
        if let Some(pending) = pending.filter(|_| undo.has_swapped()) {
            pending.swap(&self.graph, &mut self.points, &mut self.blocks);
        }
    }
}

/// The largest new clique of a plan, if it is beyond the bound.
fn too_large(plan: &Plan, bound: Option<usize>) -> Option<SmootherError> {
    let largest = bound?;
    let scalars = plan.job.nodes.iter().filter_map(|node| match &node.structure {
        NodeStructure::New(structure) => {
            Some((structure.frontal_dim + structure.separator_dim) as usize)
        }
        NodeStructure::Existing(_) | NodeStructure::Prefix { .. } => None,
    });
    let scalars = scalars.max().filter(|&scalars| scalars > largest)?;
    Some(SmootherError::LargeClique { scalars, largest })
}
