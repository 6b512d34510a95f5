//! The engine: keeps the best estimate current while changes come in.

use std::sync::Arc;

use evergraph_model::{Change, Graph, Staged};
use tracing::trace;

use crate::dense::Instructions;
use crate::diagnose;
use crate::eliminate::{self, Eliminated, Failure, Job, System, Workspace};
use crate::error::SmootherError;
use crate::linearization::Blocks;
use crate::report::Report;
use crate::settings::Settings;
use crate::solve;
use crate::tree::{Clique, NONE, Tree};
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

/// What it takes to go back to before a change was linearized.
#[derive(Default)]
struct Undo {
    points_len: usize,
    old_points: Vec<(u32, Vec<f64>)>,
    old_blocks: Vec<(u32, Vec<f64>)>,
    inserted: Vec<(u32, (usize, usize))>,
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
        Ok(Self {
            settings,
            graph: Graph::new(),
            points: Vec::new(),
            blocks: Blocks::default(),
            tree: Tree::default(),
            solution: solve::State::default(),
            newest: NONE,
            steps: 0,
            at_optimum: false,
            scratch: Scratch::new(Instructions::select()?, pool),
        })
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
        // 1. Check the change, and add to the graph what it adds.
        let staged = self.graph.stage(&change)?;
        let moved: Vec<u32> = change.moves().iter().map(|(v, _)| v.index() as u32).collect();
        // 2. Linearize new factors, and those of moved variables.
        let mut undo = Undo { points_len: self.points.len(), ..Undo::default() };
        if let Err(error) = self.linearize(&change, &staged, &mut undo) {
            return Err(self.roll_back(undo, staged, error));
        }
        // 3. Detach the cliques that it touches and their ancestors; gather their factors.
        let newest = self.newest_after(&staged);
        let Scratch { planner, job, .. } = &mut self.scratch;
        planner.gather_change(&self.graph, &self.tree, &staged, &moved);
        // 4. Order the affected variables and build the new cliques.
        planner.plan(&self.graph, &self.tree, newest, job);
        let (variables_eliminated, subtrees_kept) =
            (planner.variables.len(), planner.orphans.len());
        // 5. Eliminate them, bottom-up.
        if let Err(failure) = self.eliminate(None) {
            let error = self.explain(failure, staged.dropped_factors(), staged.dropped_variables());
            return Err(self.roll_back(undo, staged, error));
        }
        // 6. Commit.
        let mut report = Report {
            variables_eliminated,
            cliques_eliminated: self.scratch.job.nodes.len(),
            subtrees_kept,
            smallest_pivot_ratio: self.scratch.eliminated.smallest_pivot_ratio(),
            ..Report::default()
        };
        self.install();
        self.commit(staged, &moved);
        self.newest = newest;
        self.steps += 1;
        self.at_optimum = false;
        // 7. Relinearize what the policy asks for.
        self.relinearize(&mut report);
        report.rank = self.graph.dim();
        trace!(
            step = self.steps,
            variables = report.variables_eliminated,
            cliques = report.cliques_eliminated,
            kept = report.subtrees_kept,
            "applied"
        );
        Ok(report)
    }

    // --- Steps of `apply` ------------------------------------------------------------------

    /// Linearizes what is new or moved, and notes in `undo` what that overwrites.
    fn linearize(
        &mut self,
        change: &Change,
        staged: &Staged,
        undo: &mut Undo,
    ) -> Result<(), SmootherError> {
        self.points.resize(self.graph.value_len(), 0.0);
        for (id, value) in change.new_variables() {
            self.points[self.graph.value_range(id.index())].copy_from_slice(value.storage());
        }
        for (id, value) in change.moves() {
            let range = self.graph.value_range(id.index());
            undo.old_points.push((id.index() as u32, self.points[range.clone()].to_vec()));
            self.points[range].copy_from_slice(value.storage());
        }
        for factor in staged.new_factors() {
            undo.inserted.push((factor as u32, self.blocks.mark()));
            if !self.blocks.insert(&self.graph, factor, &self.points) {
                return Err(self.non_finite(factor));
            }
        }
        let mut again: Vec<u32> = change
            .moves()
            .iter()
            .flat_map(|(v, _)| self.graph.factors_at(v.index()).iter().copied())
            .filter(|f| staged.dropped_factors().binary_search(f).is_err())
            .collect();
        again.sort_unstable();
        again.dedup();
        for factor in again {
            undo.old_blocks.push((factor, self.blocks.get(factor as usize).to_vec()));
            if !self.blocks.relinearize(&self.graph, factor as usize, &self.points) {
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

    fn roll_back(&mut self, undo: Undo, staged: Staged, error: SmootherError) -> SmootherError {
        for (factor, block) in undo.old_blocks {
            self.blocks.restore(factor as usize, &block);
        }
        for (factor, mark) in undo.inserted.into_iter().rev() {
            self.blocks.undo_insert(factor as usize, mark);
        }
        for (variable, point) in undo.old_points {
            self.points[self.graph.value_range(variable as usize)].copy_from_slice(&point);
        }
        self.points.truncate(undo.points_len);
        self.graph.unstage(staged);
        error
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
        let system = System {
            graph: &self.graph,
            blocks: &self.blocks,
            tree: &self.tree,
            elimination: self.settings.elimination,
            instructions: self.scratch.instructions,
            damping,
        };
        let Scratch { job, eliminated, workspace, pool, .. } = &mut self.scratch;
        eliminate::eliminate(&system, job, eliminated, workspace, pool.as_deref())
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
        }
    }

    fn commit(&mut self, staged: Staged, moved: &[u32]) {
        for &factor in staged.dropped_factors() {
            self.blocks.remove(factor as usize);
        }
        self.solution.resize(&self.graph);
        for variable in staged.new_variables() {
            self.solution.reset(&self.graph, variable);
        }
        for &variable in moved {
            self.solution.reset(&self.graph, variable as usize);
        }
        self.graph.commit(staged);
    }
}
