//! Moving linearization points to the estimate, as the policy asks.

mod ahead;
mod background;

use evergraph_model::Change;
use tracing::debug;

use crate::batch::{BatchReport, BatchSettings};
use crate::eliminate::System;
use crate::error::SmootherError;
use crate::profile::Phase;
use crate::report::Report;
use crate::settings::Fluid;
use crate::smoother::{Refusal, Scratch, Smoother};
use crate::solve::Pass;
pub(crate) use ahead::Ahead;
pub(crate) use background::Background;

/// Between sweeps, δ is passed down the tree where it changes by more than this share of the
/// threshold.
const COARSE_SHARE: f64 = 0.4;

/// The steps of the last checks.
#[derive(Clone, Copy, Debug, Default, Hash)]
pub(crate) struct Checked {
    /// Any check. Where points have just moved, the next one comes at once: after a large loop
    /// closure it takes more than one.
    pub(crate) fluid: u64,
    pub(crate) sweep: u64,
}

impl Smoother {
    /// If there are points ready to move, and `change` moves none of its own: marks what that
    /// changes, and lists the variables as due.
    pub(crate) fn choose_due(&mut self, change: &Change, with_due: bool) {
        let Scratch { planner, due, .. } = &mut self.scratch;
        due.clear();
        if with_due && self.ahead.is_ready() && change.moves().is_empty() {
            due.extend(self.ahead.variables(&self.graph));
            if !due.is_empty() {
                planner.touch_ahead(&self.graph, &self.tree, &self.ahead);
            }
        }
    }

    /// Deals with points that could not move: what was done ahead of time is done otherwise, and what
    /// cannot be solved is given up, until the next check. The error, if it is one.
    pub(crate) fn set_aside(&mut self, refusal: Option<Refusal>) -> Option<SmootherError> {
        match refusal {
            Some(Refusal::Error(error)) => {
                self.ahead.clear(&mut self.blocks, &mut self.scratch.workspace.pool);
                Some(error)
            }
            Some(Refusal::Ahead) => {
                self.ahead.make_direct();
                None
            }
            None => None,
        }
    }

    /// Step 4 of `apply`: goes on with what is in progress, looks for variables that have moved too
    /// far, or takes a batch step, as the policy says.
    pub(crate) fn relinearize(&mut self, change: Change, report: &mut Report) {
        let policy = self.settings.relinearization;
        let steps = self.steps;
        if policy.background.is_some() {
            if self.batch_in_background(change, report) {
                return;
            }
        } else if policy.batch.is_some_and(|every| steps.is_multiple_of(u64::from(every.get()))) {
            return self.batch_step(report);
        }
        if self.ahead.is_active() && self.ahead.variables(&self.graph).next().is_none() {
            // All of them have been dropped.
            self.ahead.clear(&mut self.blocks, &mut self.scratch.workspace.pool);
        }
        if self.ahead.is_active() {
            return self.advance();
        }
        // The step that moved points has had enough to do.
        if !self.scratch.due.is_empty() {
            return;
        }
        let since = |last: u64, check: Option<Fluid>| {
            check.filter(|check| steps >= last + u64::from(check.every.get()))
        };
        let sweep = since(self.checked.sweep, policy.sweep);
        let Some(check) = sweep.or_else(|| since(self.checked.fluid, policy.fluid)) else { return };
        self.checked.fluid = steps;
        if sweep.is_some() {
            self.checked.sweep = steps;
        }
        let smallest = [policy.fluid, policy.sweep]
            .into_iter()
            .flatten()
            .map(|check| check.reach())
            .fold(f64::INFINITY, f64::min);
        let fine = self.settings.back_substitution_tolerance.min(smallest);
        let coarse = fine.max(COARSE_SHARE * check.threshold);
        let pass = Pass { fine, coarse, is_fine: sweep.is_some(), threshold: smallest };
        let instructions = self.scratch.instructions;
        self.solution.refresh(instructions, &self.graph, &mut self.tree, pass);
        let moved =
            self.solution.moved_beyond(&self.graph, check.threshold, check.reach(), smallest);
        self.lap(Phase::Solve);
        if moved.is_empty() {
            return;
        }
        let cliques = self.scratch.planner.changed_by(&self.graph, &self.tree, &moved);
        debug!(
            step = steps,
            variables = moved.len(),
            cliques = cliques.0.len(),
            threshold = check.threshold,
            "relinearization begins"
        );
        let now = (&self.graph, &self.tree, &*self.points);
        let work = self.ahead.start(now, &self.solution, &moved, cliques, policy.spread.get());
        self.lap(Phase::Detach);
        if policy.spread.get() == 1 || work <= ahead::SMALLEST_SLICE {
            self.relinearize_at_once(report);
        }
    }

    /// Moves the points that are about to move, as a change that does nothing else would.
    fn relinearize_at_once(&mut self, report: &mut Report) {
        self.ahead.make_direct();
        let nothing = self.graph.change();
        let staged = self.graph.stage(&nothing).expect("an empty change of this graph fits it");
        match self.eliminate_change(&nothing, &staged, self.newest, true) {
            Ok(()) => {
                report.variables_relinearized += self.scratch.due.len();
                report.cliques_eliminated += self.scratch.job.nodes.len();
                self.install();
                self.commit(staged, &nothing);
            }
            Err(refusal) => {
                self.graph.unstage(staged);
                report.relinearization_refused = self.set_aside(Some(refusal));
            }
        }
    }

    /// Does a slice of the relinearization in progress.
    fn advance(&mut self) {
        let left = self.ahead.linearize(&self.graph, &mut self.points, &mut self.blocks);
        self.lap(Phase::Linearize);
        let (elimination, instructions) = (self.settings.elimination, self.scratch.instructions);
        let system = System::new(&self.graph, &self.blocks, &self.tree, elimination, instructions);
        self.ahead.eliminate(left, &system, &mut self.scratch.workspace);
    }

    fn batch_step(&mut self, report: &mut Report) {
        match self.optimize(&BatchSettings::periodic()) {
            Ok(batch) => {
                report.variables_relinearized +=
                    batch.iterations as usize * self.graph.variable_count();
                report.cliques_eliminated += self.tree.len();
                report.batch = Some(batch);
            }
            Err(error) => report.relinearization_refused = Some(error),
        }
    }

    /// Relinearizes every variable and solves to convergence, by Gauss-Newton damped where it must
    /// be. What a robot calls when it has time.
    ///
    /// # Errors
    /// As [`optimize`](Self::optimize).
    pub fn relinearize_batch(&mut self) -> Result<BatchReport, SmootherError> {
        self.optimize(&BatchSettings::default())
    }
}
