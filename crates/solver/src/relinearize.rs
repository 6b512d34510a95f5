//! Moving linearization points to the estimate, as the policy asks.

use evergraph_model::{Change, Staged};
use tracing::debug;

use crate::batch::{BatchReport, BatchSettings};
use crate::error::SmootherError;
use crate::report::Report;
use crate::smoother::{Scratch, Smoother};

/// Variables that a check found too far from their linearization points.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pending {
    pub(crate) variables: Vec<u32>,
    /// How many of them are done.
    done: usize,
}

impl Pending {
    fn left(&self) -> &[u32] {
        &self.variables[self.done..]
    }

    pub(crate) fn advance(&mut self, count: usize) {
        self.done += count;
    }

    pub(crate) fn clear(&mut self) {
        self.variables.clear();
        self.done = 0;
    }
}

fn env(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|x| x.parse().ok()).unwrap_or(default)
}

impl Smoother {
    /// Chooses from the pending variables those that this step relinearizes, and marks the cliques
    /// that this changes in place.
    pub(crate) fn choose_due(&mut self, change: &Change, staged: &Staged, with_due: bool) {
        let Scratch { planner, due, considered, .. } = &mut self.scratch;
        due.clear();
        *considered = 0;
        if !with_due {
            // They have been tried.
            *considered = self.pending.left().len();
            return;
        }
        thread_local!(static B: (f64, f64) = (env("EG_C", 4e5), env("EG_R", 1.0)));
        let (c, r) = B.with(|b| *b);
        let limit = planner.cost() * (1.0 + r) + c;
        for &variable in self.pending.left() {
            if planner.cost() > limit {
                break;
            }
            *considered += 1;
            let moves = change.moves().iter().any(|(v, _)| v.index() as u32 == variable);
            let dropped = staged.dropped_variables().binary_search(&variable).is_ok();
            if !moves && !dropped && self.graph.is_variable_at(variable as usize) {
                planner.touch_variable(&self.graph, &self.tree, variable);
                due.push(variable);
            }
        }
    }

    /// After every so many steps, looks which variables have moved too far; or takes a batch step.
    pub(crate) fn look_for_due(&mut self, report: &mut Report) {
        let policy = self.settings.relinearization;
        let steps = self.steps;
        let due = |every: std::num::NonZeroU32| steps.is_multiple_of(u64::from(every.get()));
        if policy.batch.is_some_and(due) {
            match self.optimize(&BatchSettings::periodic()) {
                Ok(batch) => {
                    report.variables_relinearized +=
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
        thread_local!(static F: f64 = env("EG_F", 0.0));
        let (threshold, smallest) =
            F.with(|f| if *f > 0.0 { (*f, *f) } else { (threshold, smallest) });
        thread_local!(static TOL: f64 = env("EG_TOL", 0.0));
        let tolerance = TOL.with(|t| if *t > 0.0 { *t } else { tolerance });
        self.solution.refresh(
            self.scratch.instructions,
            &self.graph,
            &mut self.tree,
            tolerance,
            smallest,
        );
        self.pending.clear();
        self.pending.variables = self.solution.moved_beyond(&self.graph, threshold, smallest);
        thread_local!(static T: f64 = env("EG_TAU", 0.0));
        let tau = T.with(|b| *b);
        if tau > 0.0 && !self.pending.variables.is_empty() {
            let trial =
                crate::quadratic::retract_all(&self.graph, &self.points, &self.solution.delta);
            let mut block = vec![0.0; 4096];
            let (graph, blocks, delta) = (&self.graph, &self.blocks, &self.solution.delta);
            let mut miss = |f: u32| {
                let f = f as usize;
                let len = graph.linearization_len(f);
                let rows = graph.rows_at(f);
                graph.linearize(f, &trial, &mut block[..len]);
                let old = blocks.get(f);
                let mut r: Vec<f64> = old[len - rows..].to_vec();
                let scalars =
                    graph.variables_at(f).iter().flat_map(|&v| graph.tangent_range(v as usize));
                for (s, c) in scalars.zip(old.chunks_exact(rows)) {
                    for (r, c) in r.iter_mut().zip(c) {
                        *r += c * delta[s];
                    }
                }
                let e: f64 =
                    r.iter().zip(&block[len - rows..]).map(|(a, b)| (a - b) * (a - b)).sum();
                e.sqrt()
            };
            self.pending
                .variables
                .retain(|&v| graph.factors_at(v as usize).iter().any(|&f| miss(f) > tau));
        }
        debug!(step = steps, variables = self.pending.variables.len(), threshold, "due");
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
