//! The engine: keeps the best estimate current while changes come in.

use std::sync::Arc;

use evergraph_model::{Change, Graph, Staged};
use tracing::trace;

use crate::dense::Instructions;
use crate::diagnose;
use crate::eliminate::{self, Eliminated, Failure, Job, System, Workspace};
use crate::error::SmootherError;
use crate::kept::Kept;
use crate::linearization::Blocks;
use crate::profile::{Phase, Profile};
use crate::relinearize::{Ahead, Background, Checked};
use crate::report::Report;
use crate::settings::Settings;
use crate::solve;
use crate::tree::{Clique, NONE, Tree};
use crate::undo::Undo;
use crate::update::Planner;

/// An incremental smoother: a factor graph, its square-root information matrix as a tree of
/// cliques, and the estimate.
///
/// [`apply`](Self::apply) is the only way to alter it. It is `Send`. A clone is an independent
/// smoother that understands the keys made before it was cloned; keys made later are good for the
/// one that made them only.
#[derive(Clone, Debug)]
pub struct Smoother {
    pub(crate) settings: Settings,
    pub(crate) graph: Graph,
    /// Linearization points, by [`Graph::value_range`].
    pub(crate) points: Vec<f64>,
    pub(crate) blocks: Blocks,
    pub(crate) tree: Tree,
    pub(crate) solution: solve::State,
    /// What was told to whoever asked for everyone's estimate; no part of the state.
    pub(crate) kept: Kept,
    /// Relinearization in progress.
    pub(crate) ahead: Ahead,
    pub(crate) checked: Checked,
    /// A batch step on another thread.
    pub(crate) background: Option<Background>,
    /// Slot of the variable that is eliminated last.
    pub(crate) newest: u32,
    /// Changes applied.
    pub(crate) steps: u64,
    /// Right after an optimization the estimate is the point it found, which is the linearization
    /// point: where it did not converge, the next Gauss-Newton step would lead away from it.
    pub(crate) at_optimum: bool,
    pub(crate) scratch: Scratch,
}

/// Buffers and helpers that are not part of the state.
#[derive(Debug)]
pub(crate) struct Scratch {
    pub(crate) planner: Planner,
    pub(crate) job: Job,
    pub(crate) eliminated: Eliminated,
    pub(crate) undo: Undo,
    /// Variables that this step relinearizes.
    pub(crate) due: Vec<u32>,
    /// Factors to linearize again.
    again: Vec<u32>,
    pub(crate) workspace: Workspace,
    /// The clique of each node of a job that is installed.
    pub(crate) installed: Vec<u32>,
    /// Cliques taken out of the tree whose first frontals stay.
    pub(crate) shortened: Vec<Option<Clique>>,
    pub(crate) instructions: Instructions,
    pub(crate) pool: Option<Arc<rayon::ThreadPool>>,
}

impl Scratch {
    fn new(instructions: Instructions, pool: Option<Arc<rayon::ThreadPool>>) -> Self {
        Self {
            planner: Planner::default(),
            job: Job::default(),
            eliminated: Eliminated::default(),
            undo: Undo::default(),
            due: Vec::new(),
            again: Vec::new(),
            workspace: Workspace::default(),
            installed: Vec::new(),
            shortened: Vec::new(),
            instructions,
            pool,
        }
    }
}

impl Clone for Scratch {
    fn clone(&self) -> Self {
        Self::new(self.instructions, self.pool.clone())
    }
}

/// Why a change could not be eliminated.
pub(crate) enum Refusal {
    /// What was done ahead of time has to be done otherwise.
    Ahead,
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
            Refusal::Ahead => unreachable!("without points that are due nothing was done ahead"),
        }
    }
}

impl Smoother {
    /// An empty smoother.
    ///
    /// # Errors
    /// [`SmootherError::Settings`], [`SmootherError::Threads`].
    pub fn new(settings: Settings) -> Result<Self, SmootherError> {
        settings.check()?;
        let pool = match settings.threads {
            1 => None,
            threads => Some(Arc::new(
                rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|error| {
                    SmootherError::Threads { threads, reason: error.to_string() }
                })?,
            )),
        };
        let instructions = Instructions::select()?;
        Ok(Self::empty(settings, Scratch::new(instructions, pool)))
    }

    fn empty(settings: Settings, scratch: Scratch) -> Self {
        Self {
            settings,
            graph: Graph::new(),
            points: Vec::new(),
            blocks: Blocks::default(),
            tree: Tree::default(),
            solution: solve::State::default(),
            kept: Kept::default(),
            ahead: Ahead::default(),
            checked: Checked::default(),
            background: None,
            newest: NONE,
            steps: 0,
            at_optimum: false,
            scratch,
        }
    }

    /// A smoother with all of a graph, linearized at `points`, on one thread.
    pub(crate) fn from_graph(
        settings: Settings,
        graph: Graph,
        points: Vec<f64>,
        newest: u32,
        instructions: Instructions,
    ) -> Result<Self, SmootherError> {
        let mut smoother = Self::empty(settings, Scratch::new(instructions, None));
        (smoother.graph, smoother.points, smoother.newest) = (graph, points, newest);
        for factor in smoother.graph.factor_indices() {
            if !smoother.blocks.insert(&smoother.graph, factor, &smoother.points) {
                return Err(smoother.non_finite(factor));
            }
        }
        smoother.solution.resize(&smoother.graph);
        let Scratch { planner, job, workspace, .. } = &mut smoother.scratch;
        planner.gather_graph(&smoother.graph, &smoother.tree);
        planner.plan(&smoother.graph, &smoother.tree, newest, job, &mut workspace.clock);
        smoother.eliminate_and_install(None)?;
        Ok(smoother)
    }

    /// An empty change for the graph as it is now.
    pub fn change(&self) -> Change {
        self.graph.change()
    }

    /// Applies a change, whole or not at all, and relinearizes when the policy says so.
    ///
    /// The work follows the part of the tree between the touched variables and the root: the root
    /// clique alone for a pose that continues a trajectory, more when a loop closes.
    ///
    /// # Errors
    /// [`SmootherError`]; graph, estimate and factorization are then bit for bit what they were.
    pub fn apply(&mut self, change: Change) -> Result<Report, SmootherError> {
        self.scratch.workspace.clock.start();
        // 1. Check the change, and add to the graph what it adds.
        let staged = self.graph.stage(&change)?;
        let newest = self.newest_after(&staged);
        // 2. Eliminate what it affects anew, together with what is due to be relinearized.
        let mut report = Report::default();
        let mut done = self.eliminate_change(&change, &staged, newest, true);
        if done.is_err() && !self.scratch.due.is_empty() {
            // Perhaps without moving points that nobody asked to move.
            let refusal = done.err();
            done = self.eliminate_change(&change, &staged, newest, false);
            if done.is_ok() {
                report.relinearization_refused = self.set_aside(refusal);
            }
        }
        if let Err(refusal) = done {
            self.graph.unstage(staged);
            return Err(refusal.into());
        }
        // 3. Commit.
        report.variables_eliminated = self.scratch.planner.variables.len();
        report.cliques_eliminated = self.scratch.job.nodes.len();
        report.subtrees_kept = self.scratch.planner.orphans.len();
        report.variables_relinearized = self.scratch.due.len();
        report.smallest_pivot_ratio = self.scratch.eliminated.smallest_pivot_ratio();
        self.install();
        self.lap(Phase::Install);
        self.commit(staged, &change);
        self.newest = newest;
        self.steps += 1;
        self.at_optimum = false;
        self.lap(Phase::Stage);
        // 4. Relinearize: go on, or look what has moved.
        self.relinearize(change, &mut report);
        report.rank = self.graph.dim();
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
        self.scratch.workspace.clock.set(on);
    }

    /// Where the time has gone since profiling was switched on.
    pub fn profile(&self) -> &Profile {
        &self.scratch.workspace.clock.profile
    }

    pub(crate) fn lap(&mut self, phase: Phase) {
        self.scratch.workspace.clock.lap(phase);
    }

    // --- Steps of `apply` ------------------------------------------------------------------

    /// Everything that may fail. On error, points and Jacobians are what they were.
    pub(crate) fn eliminate_change(
        &mut self,
        change: &Change,
        staged: &Staged,
        newest: u32,
        with_due: bool,
    ) -> Result<(), Refusal> {
        self.lap(Phase::Stage);
        // Mark the cliques that the change touches, and their ancestors, to be detached.
        let moved = change.moves().iter().map(|(v, _)| v.index() as u32);
        self.scratch.planner.touch_change(&self.graph, &self.tree, staged, moved);
        // Mark those of variables that are due, to be eliminated again in place.
        self.choose_due(change, with_due);
        self.lap(Phase::Detach);
        // Move points and linearize.
        self.scratch.undo.start(self.points.len());
        let result = self.linearize(change, staged).map_err(Refusal::from).and_then(|()| {
            self.lap(Phase::Linearize);
            // Order the affected variables and build the new cliques.
            let Scratch { planner, job, workspace, .. } = &mut self.scratch;
            planner.gather_change(&self.graph, &self.tree, staged);
            workspace.clock.lap(Phase::Gather);
            planner.plan(&self.graph, &self.tree, newest, job, &mut workspace.clock);
            // Eliminate, bottom-up.
            let dropped = (staged.dropped_factors(), staged.dropped_variables());
            self.eliminate(None).map_err(|failure| match failure {
                Failure::Ahead => Refusal::Ahead,
                failure => self.explain(failure, dropped.0, dropped.1).into(),
            })
        });
        if result.is_err() {
            self.scratch.undo.take_back(&self.graph, &mut self.points, &mut self.blocks);
            if !self.scratch.due.is_empty() {
                self.ahead.swap(&self.graph, &mut self.points, &mut self.blocks);
            }
        }
        result
    }

    /// Moves the points that the change moves and those that are due, and linearizes what is on
    /// them and what is new.
    fn linearize(&mut self, change: &Change, staged: &Staged) -> Result<(), SmootherError> {
        let Self { graph, points, blocks, ahead, scratch, .. } = self;
        let Scratch { undo, due, again, .. } = scratch;
        points.resize(graph.value_len(), 0.0);
        for (id, value) in change.new_variables() {
            points[graph.value_range(id.index())].copy_from_slice(value.storage());
        }
        again.clear();
        for (id, value) in change.moves() {
            undo.save_point(graph, points, id.index() as u32);
            points[graph.value_range(id.index())].copy_from_slice(value.storage());
            again.extend_from_slice(graph.factors_at(id.index()));
        }
        if !due.is_empty() {
            ahead.swap(graph, points, blocks);
            let factors = due.iter().flat_map(|&v| graph.factors_at(v as usize).iter().copied());
            again.extend(factors.filter(|&f| !ahead.has(graph, f)));
        }
        for factor in staged.new_factors() {
            undo.save_insertion(blocks, factor as u32);
            if !blocks.insert(graph, factor, points) {
                return Err(self.non_finite(factor));
            }
        }
        again.sort_unstable();
        again.dedup();
        again.retain(|f| staged.dropped_factors().binary_search(f).is_err());
        for &factor in &*again {
            undo.save_block(blocks, factor);
            if !blocks.relinearize(graph, factor as usize, points) {
                return Err(self.non_finite(factor as usize));
            }
        }
        Ok(())
    }

    pub(crate) fn non_finite(&self, factor: usize) -> SmootherError {
        SmootherError::NonFinite {
            factor: self.graph.factor_id(factor),
            name: self.graph.factor_at(factor).name(),
            variables: self.graph.factor_at(factor).keys().to_vec(),
        }
    }

    /// The variable to eliminate last: the latest of the largest new ones (of a pose and its
    /// landmarks the pose, which the next change will continue), else the one so far.
    fn newest_after(&self, staged: &Staged) -> u32 {
        let new = staged.new_variables().max_by_key(|&v| self.graph.dim_at(v));
        let dropped = staged.dropped_variables().binary_search(&self.newest).is_ok();
        new.map_or(if dropped { NONE } else { self.newest }, |v| v as u32)
    }

    /// Eliminates the job at hand with the current blocks and settings.
    pub(crate) fn eliminate(&mut self, damping: Option<&[f64]>) -> Result<(), Failure> {
        let Self { graph, blocks, tree, ahead, settings, scratch, .. } = self;
        let system = System::new(graph, blocks, tree, settings.elimination, scratch.instructions);
        let system = System { ahead: Some(ahead), damping, ..system };
        let Scratch { job, eliminated, workspace, pool, .. } = scratch;
        eliminate::eliminate(&system, job, eliminated, workspace, pool.as_deref())
    }

    /// Eliminates a job that changes nothing in the graph, and puts the result into the tree.
    pub(crate) fn eliminate_and_install(
        &mut self,
        damping: Option<&[f64]>,
    ) -> Result<(), SmootherError> {
        self.eliminate(damping).map_err(|failure| self.explain(failure, &[], &[]))?;
        self.install();
        self.lap(Phase::Install);
        Ok(())
    }

    /// Puts a failure into words; factors and variables that are being dropped (ascending) do not
    /// count.
    pub(crate) fn explain(
        &self,
        failure: Failure,
        factors: &[u32],
        variables: &[u32],
    ) -> SmootherError {
        match failure {
            Failure::Undetermined { variable } => {
                diagnose::singular(&self.graph, &self.blocks, (factors, variables), variable).into()
            }
            Failure::Overflow { variable } => {
                SmootherError::Overflow { variable: self.graph.variable_id(variable as usize) }
            }
            Failure::Ahead => unreachable!("only `apply` takes over what was done ahead"),
        }
    }

    pub(crate) fn commit(&mut self, staged: Staged, change: &Change) {
        for &factor in staged.dropped_factors() {
            self.blocks.remove(factor as usize);
        }
        self.solution.resize(&self.graph);
        for variable in staged.new_variables() {
            self.solution.reset(&self.graph, variable);
        }
        for (variable, _) in change.moves() {
            self.solution.reset(&self.graph, variable.index());
        }
        for &variable in &self.scratch.due {
            self.solution.reset(&self.graph, variable as usize);
        }
        if !self.scratch.due.is_empty() {
            self.checked.fluid = 0;
        }
        // What was in progress for other points than these cannot go on.
        if !self.scratch.due.is_empty() || !change.moves().is_empty() {
            self.ahead.clear(&mut self.blocks, &mut self.scratch.workspace.pool);
        }
        self.graph.commit(staged);
    }
}
