//! Moving linearization points to the estimate, as the policy asks.

use evergraph_model::Graph;
use tracing::debug;

use crate::batch::{BatchReport, BatchSettings};
use crate::error::SmootherError;
use crate::report::Report;
use crate::smoother::{Scratch, Smoother};

/// When more than this share of the cliques has to be eliminated again, a fresh order for the
/// whole graph costs little more and gives better fill.
const REBUILD_SHARE: f64 = 0.6;

impl Smoother {
    /// Step 7 of `apply`.
    pub(crate) fn relinearize(&mut self, report: &mut Report) {
        let policy = self.settings.relinearization;
        let steps = self.steps;
        let due = |every: std::num::NonZeroU32| steps.is_multiple_of(u64::from(every.get()));
        if policy.batch.is_some_and(due) {
            match self.optimize(&BatchSettings::periodic()) {
                Ok(batch) => {
                    report.variables_relinearized =
                        batch.iterations as usize * self.graph.variable_count();
                    report.cliques_eliminated += self.tree.len();
                    report.batch = Some(batch);
                }
                Err(error) => report.relinearization_refused = Some(error),
            }
            return;
        }
        let due_threshold =
            |fluid: Option<crate::Fluid>| fluid.filter(|f| due(f.every)).map(|f| f.threshold);
        let Some(threshold) = due_threshold(policy.sweep).or_else(|| due_threshold(policy.fluid))
        else {
            return;
        };
        // One tolerance for both checks: what a coarse pass leaves out, a fine one does not see.
        let smallest = [policy.fluid, policy.sweep]
            .into_iter()
            .flatten()
            .map(|check| check.threshold)
            .fold(f64::INFINITY, f64::min);
        let tolerance = self.settings.back_substitution_tolerance.min(smallest);
        self.solution.refresh(&self.graph, &mut self.tree, tolerance, smallest);
        let moved = self.solution.moved_beyond(&self.graph, threshold, smallest);
        if moved.is_empty() {
            return;
        }
        match self.move_points(&moved) {
            Ok(cliques) => {
                debug!(step = steps, variables = moved.len(), cliques, threshold, "relinearized");
                report.variables_relinearized = moved.len();
                report.cliques_eliminated += cliques;
            }
            Err(error) => report.relinearization_refused = Some(error),
        }
    }

    /// Moves the linearization points of `variables` by the δ of the last check, linearizes their
    /// factors again, and eliminates what depends on them: in place, or everything in a fresh order when
    /// it is most of the tree. Returns how many cliques that were.
    ///
    /// On error nothing has changed.
    fn move_points(&mut self, variables: &[u32]) -> Result<usize, SmootherError> {
        let mut old_points = Vec::with_capacity(variables.len());
        for &v in variables {
            let range = self.graph.value_range(v as usize);
            let delta = &self.solution.delta[self.graph.tangent_range(v as usize)];
            let old = self.points[range.clone()].to_vec();
            self.graph.kind_at(v as usize).retract(&old, delta, &mut self.points[range]);
            old_points.push(old);
        }
        let factors = factors_of(&self.graph, variables);
        let mut old_blocks = Vec::with_capacity(factors.len());
        let mut result = Ok(());
        for &f in &factors {
            old_blocks.push(self.blocks.get(f as usize).to_vec());
            if !self.blocks.relinearize(&self.graph, f as usize, &self.points) {
                result = Err(self.non_finite(f as usize));
                break;
            }
        }
        let result = result.and_then(|()| self.eliminate_moved(&factors));
        match result {
            Ok(cliques) => {
                for &v in variables {
                    self.solution.reset(&self.graph, v as usize);
                }
                Ok(cliques)
            }
            Err(error) => {
                for (&f, block) in factors.iter().zip(&old_blocks) {
                    self.blocks.restore(f as usize, block);
                }
                for (&v, point) in variables.iter().zip(&old_points) {
                    self.points[self.graph.value_range(v as usize)].copy_from_slice(point);
                }
                Err(error)
            }
        }
    }

    fn eliminate_moved(&mut self, factors: &[u32]) -> Result<usize, SmootherError> {
        let Scratch { planner, job, .. } = &mut self.scratch;
        planner.gather_in_place(&self.graph, &self.tree, factors);
        let count = planner.marked();
        if count as f64 > REBUILD_SHARE * self.tree.len() as f64 {
            self.rebuild()?;
            return Ok(self.tree.len());
        }
        planner.plan(&self.graph, &self.tree, self.newest, job);
        self.eliminate(None).map_err(|failure| self.explain(failure, &[], &[]))?;
        self.install();
        Ok(count)
    }

    /// Eliminates everything in a fresh order, at the current linearization.
    pub(crate) fn rebuild(&mut self) -> Result<(), SmootherError> {
        debug!(step = self.steps, cliques = self.tree.len(), "everything in a fresh order");
        let Scratch { planner, job, .. } = &mut self.scratch;
        planner.gather_everything(&self.graph, &self.tree);
        planner.plan(&self.graph, &self.tree, self.newest, job);
        self.eliminate(None).map_err(|failure| self.explain(failure, &[], &[]))?;
        self.install();
        Ok(())
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

/// Factors on any of `variables`, each once, by slot.
fn factors_of(graph: &Graph, variables: &[u32]) -> Vec<u32> {
    let mut factors: Vec<u32> =
        variables.iter().flat_map(|&v| graph.factors_at(v as usize).iter().copied()).collect();
    factors.sort_unstable();
    factors.dedup();
    factors
}
