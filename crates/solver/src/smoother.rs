//! The engine: keeps the best estimate current while changes come in.

use std::sync::Arc;

use evergraph_model::{Change, Staged};
use tracing::trace;

use crate::background::Background;
use crate::dense::Instructions;
use crate::error::SmootherError;
use crate::estimate_cache::EstimateCache;
use crate::factorization::{Engine, Factorization, Refusal, Update};
use crate::pending::Pending;
use crate::profile::{Phase, Profile};
use crate::report::Report;
use crate::settings::Settings;

/// An incremental smoother: a factor graph, its square-root information matrix as a tree of
/// cliques, and the estimate.
///
/// [`apply`](Self::apply) is the only way to alter the graph. A smoother is `Send`. A clone is an
/// independent smoother; ids made before it was cloned name the same variables in both. Buffers are
/// not cloned.
#[derive(Clone, Debug)]
pub struct Smoother {
    pub(crate) settings: Settings,
    pub(crate) factorization: Factorization,
    /// Relinearization in progress.
    pub(crate) pending: Pending,
    pub(crate) checked: Checked,
    /// A batch step on another thread.
    pub(crate) background: Option<Background>,
    /// Changes applied.
    pub(crate) steps: u64,
    /// No part of the state: no later answer depends on it.
    pub(crate) estimate_cache: EstimateCache,
    pub(crate) engine: Engine,
}

/// The last checks for variables that have moved.
#[derive(Clone, Copy, Debug, Default, Hash)]
pub(crate) struct Checked {
    /// The step of any check. Where points have just moved, the next one comes at once: after a
    /// large loop closure it takes more than one.
    pub(crate) fluid: u64,
    /// The step of a sweep.
    pub(crate) sweep: u64,
    /// Whether the last check, or batch step, found nothing to relinearize.
    pub(crate) is_settled: bool,
}

/// What became of a relinearization that was ready when a change came.
pub(crate) enum Takeover {
    /// None was ready, or the change moves points itself.
    Nothing,
    /// It takes effect together with the change.
    Complete,
    /// Together with it the change could not be eliminated, but without it.
    Refused(Refusal),
}

impl Smoother {
    /// An empty smoother.
    ///
    /// # Errors
    /// [`SmootherError::Settings`], [`SmootherError::Threads`].
    pub fn new(settings: Settings) -> Result<Self, SmootherError> {
        settings.check()?;
        let threads = match settings.threads {
            1 => None,
            threads => Some(Arc::new(
                rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|error| {
                    SmootherError::Threads { threads, reason: error.to_string() }
                })?,
            )),
        };
        Ok(Self {
            settings,
            factorization: Factorization::default(),
            pending: Pending::default(),
            checked: Checked::default(),
            background: None,
            steps: 0,
            estimate_cache: EstimateCache::default(),
            engine: Engine::new(settings.elimination, Instructions::select()?, threads)
                .with_largest_clique(settings.largest_clique),
        })
    }

    /// An empty change for the graph.
    pub fn change(&self) -> Change {
        self.factorization.graph.change()
    }

    /// Applies a change, whole or not at all, and relinearizes when the policy says so.
    ///
    /// The work follows the part of the tree between the touched variables and the root: the root
    /// clique alone for a pose that continues a trajectory, more when a loop closes.
    ///
    /// # Errors
    /// [`SmootherError`]; graph, estimate and factorization are then bit for bit what they were. An
    /// error of a relinearization does not undo the change: see
    /// [`Report::relinearization_refused`].
    pub fn apply(&mut self, change: Change) -> Result<Report, SmootherError> {
        self.engine.workspace.clock.start();
        // 1. Check the change, and add to the graph what it adds.
        let staged = self.factorization.stage(&change)?;
        // 2. Linearize and eliminate what it affects, with a relinearization that is ready.
        let (update, takeover) = match self.eliminate(&change, &staged) {
            Ok(eliminated) => eliminated,
            Err(error) => {
                self.factorization.unstage(staged);
                return Err(error);
            }
        };
        // 3. Commit: replace the affected cliques, and drop what the change drops.
        let mut report = self.report_on(&staged, &update);
        report.relinearization_refused = self.commit(staged, update, takeover);
        self.steps += 1;
        self.lap(Phase::Stage);
        // 4. Relinearize: go on, or look for variables that have moved.
        self.relinearize(change, &mut report);
        report.rank = self.factorization.graph.dim();
        report.converged = self.checked.is_settled && !self.pending.is_active();
        trace!(
            step = self.steps,
            variables = report.variables_eliminated,
            cliques = report.cliques_eliminated,
            kept = report.subtrees_kept,
            relinearized = report.variables_relinearized,
            "applied"
        );
        Ok(report)
    }

    /// Starts to measure where the time of [`apply`](Self::apply) goes, from zero, or stops.
    pub fn set_profiling(&mut self, on: bool) {
        self.engine.workspace.clock.set(on);
    }

    /// Where the time has gone since profiling was switched on.
    pub fn profile(&self) -> &Profile {
        &self.engine.workspace.clock.profile
    }

    pub(crate) fn lap(&mut self, phase: Phase) {
        self.engine.workspace.clock.lap(phase);
    }

    // --- Steps of `apply` ------------------------------------------------------------------

    /// Step 2: with the pending relinearization if that is ready, or else without.
    fn eliminate(
        &mut self,
        change: &Change,
        staged: &Staged,
    ) -> Result<(Update, Takeover), SmootherError> {
        let Self { factorization, pending, engine, .. } = self;
        let is_ready = pending.is_ready()
            && !moves_points(staged)
            && pending.variables(&factorization.graph).next().is_some();
        if !is_ready {
            let update = factorization.eliminate(change, staged, None, engine)?;
            return Ok((update, Takeover::Nothing));
        }
        match factorization.eliminate(change, staged, Some(pending), engine) {
            Ok(update) => Ok((update, Takeover::Complete)),
            Err(refusal) => {
                // Perhaps without moving points that the change does not move.
                let update = factorization.eliminate(change, staged, None, engine)?;
                Ok((update, Takeover::Refused(refusal)))
            }
        }
    }

    /// The report on an update, before it is committed.
    pub(crate) fn report_on(&self, staged: &Staged, update: &Update) -> Report {
        let graph = &self.factorization.graph;
        Report {
            variables_eliminated: update.plan.variables,
            cliques_eliminated: update.plan.job.nodes.len(),
            subtrees_kept: update.plan.subtrees_kept,
            variables_relinearized: update.relinearized.len(),
            relinearized: update.relinearized.iter().map(|&v| graph.variable_id(v)).collect(),
            smallest_pivot_ratio: update.eliminated.smallest_pivot_ratio(),
            new_variables: staged.new_variables().map(|v| graph.variable_id(v)).collect(),
            ..Report::default()
        }
    }

    /// Step 3. Returns the reason why a relinearization was given up, if one was.
    pub(crate) fn commit(
        &mut self,
        staged: Staged,
        update: Update,
        takeover: Takeover,
    ) -> Option<SmootherError> {
        let Self { factorization, pending, engine, estimate_cache, .. } = self;
        let Factorization { graph, points, .. } = &*factorization;
        let set = staged.fixed().iter().chain(staged.moved()).copied();
        estimate_cache.set_fixed(graph, points, set.chain(staged.new_variables()));
        let ends = moves_points(&staged) || matches!(takeover, Takeover::Complete);
        let taken = matches!(takeover, Takeover::Complete).then_some(&mut *pending);
        factorization.commit(staged, update, taken, engine);
        if ends {
            // A relinearization in progress was for other points than these.
            pending.clear(&mut factorization.blocks, &mut engine.workspace.pool);
        }
        factorization.trim(pending, engine);
        match takeover {
            Takeover::Nothing => {}
            // Where points have just moved, the next check comes at once.
            Takeover::Complete => self.checked.fluid = 0,
            // All of it is computed again in the step that takes it over.
            Takeover::Refused(Refusal::Pending) => pending.make_direct(),
            Takeover::Refused(Refusal::Error(error)) => {
                pending.clear(&mut factorization.blocks, &mut engine.workspace.pool);
                return Some(error);
            }
        }
        None
    }
}

/// Whether a change moves points, or turns variables into unknowns or back.
fn moves_points(staged: &Staged) -> bool {
    !(staged.moved().is_empty() && staged.fixed().is_empty() && staged.freed().is_empty())
}
