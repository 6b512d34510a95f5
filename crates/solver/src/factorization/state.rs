//! The factorization of a graph.

use std::hash::Hasher;

use evergraph_model::{Change, Graph, GraphError, Staged, VariableIndex};

use super::engine::Engine;
use crate::dense::Instructions;
use crate::eliminate::{self, Eliminated, Failure, System};
use crate::error::SmootherError;
use crate::linearization::Blocks;
use crate::pending::Pending;
use crate::planner::{Now, Plan};
use crate::profile::Phase;
use crate::quadratic::retract_all;
use crate::solve::{self, Pass};
use crate::tree::Tree;

/// A graph, the linear system at the linearization points, its square-root information matrix as a
/// tree of cliques, and the solution.
#[derive(Clone, Debug, Default)]
pub(crate) struct Factorization {
    pub(crate) graph: Graph,
    /// Linearization points, by [`Graph::value_range`].
    pub(crate) points: Vec<f64>,
    pub(crate) blocks: Blocks,
    pub(crate) tree: Tree,
    pub(crate) solution: solve::State,
    /// The variable that is eliminated last.
    pub(crate) newest: Option<VariableIndex>,
}

impl Factorization {
    /// The factorization of a whole graph, linearized at `points`.
    pub(crate) fn from_graph(
        graph: Graph,
        points: Vec<f64>,
        newest: Option<VariableIndex>,
        engine: &mut Engine,
    ) -> Result<Self, SmootherError> {
        let mut own = Self { graph, points, newest, ..Self::default() };
        for factor in own.graph.factor_indices() {
            let inserted = own.blocks.insert(&own.graph, factor, &own.points);
            inserted.map_err(|flaw| own.flawed(factor, flaw))?;
        }
        own.solution.resize(&own.graph);
        let buffers = (engine.take_plan(), &mut engine.workspace.clock);
        let plan = engine.planner.plan_graph(own.now(), buffers);
        own.replace(plan, None, engine)?;
        Ok(own)
    }

    /// Checks a change, and adds to the graph what it adds.
    pub(crate) fn stage(&mut self, change: &Change) -> Result<Staged, GraphError> {
        self.graph.stage(change)
    }

    /// Reverts [`stage`](Self::stage).
    pub(crate) fn unstage(&mut self, staged: Staged) {
        self.graph.unstage(staged);
    }

    /// What a plan is made for.
    pub(crate) fn now(&self) -> Now<'_> {
        Now { graph: &self.graph, tree: &self.tree, last: self.newest }
    }

    /// The linear system at the linearization points.
    pub(crate) fn system(&self, engine: &Engine) -> System<'_> {
        let Engine { elimination, instructions, .. } = *engine;
        System::new(&self.graph, &self.blocks, &self.tree, elimination, instructions)
    }

    /// Eliminates the cliques of a plan, with `pending` if the plan takes it over, and `damping`
    /// added to the diagonal of the information matrix, by tangent position.
    pub(crate) fn eliminate_plan(
        &self,
        plan: &Plan,
        pending: Option<&Pending>,
        damping: Option<&[f64]>,
        engine: &mut Engine,
    ) -> Result<Eliminated, Failure> {
        let system = System { pending, damping, ..self.system(engine) };
        let buffer = std::mem::take(&mut engine.buffers.eliminated);
        let threads = engine.threads.as_deref();
        eliminate::eliminate(&system, &plan.job, buffer, &mut engine.workspace, threads)
    }

    /// Carries out a plan that changes nothing in the graph.
    pub(crate) fn replace(
        &mut self,
        plan: Plan,
        damping: Option<&[f64]>,
        engine: &mut Engine,
    ) -> Result<(), SmootherError> {
        let eliminated = self.eliminate_plan(&plan, None, damping, engine);
        let eliminated = eliminated.map_err(|failure| self.explain(failure, None))?;
        self.install(plan, eliminated, None, engine);
        engine.workspace.clock.lap(Phase::Install);
        Ok(())
    }

    /// Linearizes all factors again.
    pub(crate) fn relinearize_factors(&mut self) -> Result<(), SmootherError> {
        for factor in self.graph.factor_indices() {
            let linearized = self.blocks.relinearize(&self.graph, factor, &self.points);
            linearized.map_err(|flaw| self.flawed(factor, flaw))?;
        }
        Ok(())
    }

    /// Brings δ up to date; see [`solve::State::refresh`].
    pub(crate) fn solve(&mut self, instructions: Instructions, pass: Pass) {
        self.solution.refresh(instructions, &self.graph, &mut self.tree, pass);
    }

    /// The exact δ of some variables; zero where the estimate is the linearization point.
    pub(crate) fn deltas(
        &self,
        instructions: Instructions,
        variables: &[VariableIndex],
    ) -> Vec<Vec<f64>> {
        if self.solution.is_at_points {
            return variables.iter().map(|&v| vec![0.0; self.graph.dim_at(v)]).collect();
        }
        match variables {
            [one] => vec![solve::path(instructions, &self.graph, &self.tree, *one)],
            _ => solve::paths(instructions, &self.graph, &self.tree, variables),
        }
    }

    /// Writes the estimate of a variable with a given δ.
    pub(crate) fn moved(
        &self,
        variable: VariableIndex,
        delta: &[f64],
        out: &mut [f64],
    ) -> Result<(), GraphError> {
        let point = &self.points[self.graph.value_range(variable)];
        if self.is_at_point(variable) {
            out.copy_from_slice(point);
            return Ok(());
        }
        self.graph.retract(variable, point, delta, out)
    }

    /// Whether the estimate of a variable is its linearization point.
    pub(crate) fn is_at_point(&self, variable: VariableIndex) -> bool {
        self.solution.is_at_points || self.graph.is_fixed_at(variable)
    }

    /// All estimates, exact, laid out as the linearization points.
    pub(crate) fn estimate_points(
        &self,
        instructions: Instructions,
    ) -> Result<Vec<f64>, GraphError> {
        if self.solution.is_at_points {
            return Ok(self.points.clone());
        }
        let delta = solve::all(instructions, &self.graph, &self.tree);
        retract_all(&self.graph, &self.points, &delta)
    }

    /// Frees memory that is no longer needed, where there is much of it.
    pub(crate) fn trim(&mut self, pending: &mut Pending, engine: &mut Engine) {
        self.blocks.compact(pending.overlay_mut());
        if !pending.is_active() {
            self.tree.trim();
        }
        engine.trim(self.tree.len(), self.tree.numbers());
    }

    /// Bytes of points, blocks, tree and δ.
    pub(crate) fn memory_bytes(&self) -> usize {
        let numbers = 8 * self.points.capacity();
        numbers
            + self.blocks.memory_bytes()
            + self.tree.memory_bytes()
            + self.solution.memory_bytes()
    }

    /// Feeds everything that later answers depend on to a hash. Where blocks stand in memory does
    /// not count.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        let Self { graph, points, blocks, tree, solution, newest } = self;
        graph.hash_state(hash);
        let mut numbers = |numbers: &[f64]| {
            numbers.iter().for_each(|x| hash.write_u64(x.to_bits()));
        };
        graph.variable_indices().for_each(|v| numbers(&points[graph.value_range(v)]));
        graph.factor_indices().for_each(|f| numbers(blocks.get(f)));
        tree.hash_state(hash);
        solution.hash_state(graph, hash);
        hash.write_u64(newest.map_or(u64::MAX, |v| v.index() as u64));
    }
}
