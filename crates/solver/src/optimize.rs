//! Batch optimization to convergence: Gauss-Newton, Levenberg-Marquardt, Powell's dogleg.
//!
//! All three minimize `½ ‖r(x ⊕ δ)‖²` by steps from the linear model `½ ‖Jδ + r‖²`, use the same
//! clique tree as the incremental engine (ordered afresh once, then in place), and never accept a
//! step that raises the error.

use evergraph_model::GraphError;
use tracing::{debug, info};

use crate::batch::{BatchReport, BatchSettings, Method, Reason, Status};
use crate::error::SmootherError;
use crate::factorization::{Engine, Factorization};
use crate::linearization::Blocks;
use crate::planner::Mark;
use crate::profile::Phase;
use crate::quadratic::{
    decrease_of_model, diagonal, gradient, retract_all, rounding_of_error, scaled_norm,
    steepest_descent, within_radius,
};
use crate::solve;
use crate::tree::Tree;

/// Damping at the first failed step, and the factor between tries.
const FIRST_DAMPING: f64 = 1e-7;
/// Less is lost when it is added to the diagonal.
const SMALLEST_DAMPING: f64 = 1e-17;
const DAMPING_FACTOR: f64 = 10.0;
const LARGEST_DAMPING: f64 = 1e12;
/// A step that moves every number by no more than this, relative to the number or to 1, whichever is
/// larger, moves nothing: where measurements agree exactly, the error is rounding and no share of it
/// means anything.
const STILL: f64 = 1e-15;
/// A decrease of no more than this for each row of the residual is none: 3e-8 standard deviations.
const NOTHING: f64 = 1e-15;
/// A full step that promises more of the error than this is no end.
const PROMISING: f64 = 1e-6;
/// A full step may promise so many times more than the error can tell where shorter ones tell nothing.
const NEARLY: f64 = 16.0;
/// A trust region this small relative to the Gauss-Newton step moves nothing.
const SMALLEST_RADIUS: f64 = 1e-14;

/// Everything that an optimization alters, to go back to.
struct Saved {
    points: Vec<f64>,
    blocks: Blocks,
    tree: Tree,
    solution: solve::State,
}

/// Points that a step leads to, and the error there.
struct Trial {
    points: Vec<f64>,
    /// Not finite where the step cannot be taken.
    error: f64,
}

impl Factorization {
    /// Optimizes from the better of the estimate and the linearization points until convergence.
    /// Linearization points end at the optimum. On an error everything is what it was.
    pub(crate) fn optimize(
        &mut self,
        settings: &BatchSettings,
        engine: &mut Engine,
    ) -> Result<BatchReport, SmootherError> {
        engine.workspace.clock.start();
        // Start from the better of the two states that every variable has.
        let estimate = self.estimate_points(engine.instructions)?;
        let (at_estimate, at_points) =
            (self.graph.error(&estimate)?, self.graph.error(&self.points)?);
        let start = if at_estimate <= at_points { estimate } else { self.points.clone() };
        let initial_error = at_estimate.min(at_points);
        if self.graph.unknown_count() == 0 {
            // The sum of no terms is -0.
            let error = initial_error + 0.0;
            return Ok(self.finish(Status::Converged, 0, error, error));
        }
        let buffers = (engine.take_plan(), &mut engine.workspace.clock);
        let mut plan = engine.planner.plan_all(self.now(), Mark::Detached, buffers);
        // The cliques go into an empty tree; this one is kept in case of failure.
        plan.detached.clear();
        let saved = Saved {
            points: std::mem::replace(&mut self.points, start),
            blocks: self.blocks.clone(),
            tree: std::mem::take(&mut self.tree),
            solution: self.solution.clone(),
        };
        engine.workspace.clock.lap(Phase::Stage);
        let result = self.relinearize_all(engine).and_then(|()| {
            self.replace(plan, None, engine)?;
            match settings.method {
                Method::Dogleg => self.dogleg(settings, initial_error, engine),
                _ => self.damped_gauss_newton(settings, initial_error, engine),
            }
        });
        match &result {
            Ok(_) => {
                self.solution = solve::State::default();
                self.solution.resize(&self.graph);
                self.solution.is_at_points = true;
            }
            Err(_) => {
                let Saved { points, blocks, tree, solution } = saved;
                (self.points, self.blocks, self.tree, self.solution) =
                    (points, blocks, tree, solution);
            }
        }
        result
    }

    /// Gauss-Newton, with Levenberg's and Marquardt's damping where a step fails.
    fn damped_gauss_newton(
        &mut self,
        settings: &BatchSettings,
        initial_error: f64,
        engine: &mut Engine,
    ) -> Result<BatchReport, SmootherError> {
        let may_damp = settings.method == Method::LevenbergMarquardt;
        let mut error = initial_error;
        let mut damping = 0.0;
        // The damping after a full step that fails. Long trajectories bend so easily that 1e-7 holds
        // them fast: where it is enough and full steps still fail, less is tried.
        let mut first = FIRST_DAMPING;
        let more =
            |damping: f64, first| if damping == 0.0 { first } else { damping * DAMPING_FACTOR };
        // True if less damping has failed at the current points, beginning with `first`.
        let mut less_failed = false;
        let mut iterations = 0;
        // Whether the tree is the factorization at the current points with the current damping.
        let mut eliminated = true;
        let status = loop {
            if iterations >= settings.max_iterations {
                break Status::NotConverged(Reason::IterationLimit);
            }
            if !eliminated {
                match self.eliminate_in_place(damping, engine) {
                    Ok(()) => eliminated = true,
                    // Damping also carries over points where the system is singular.
                    Err(SmootherError::Singular(_)) if may_damp && damping <= LARGEST_DAMPING => {
                        less_failed = damping > 0.0;
                        damping = more(damping, first);
                        debug!(damping, "singular, damped more");
                        continue;
                    }
                    Err(error) => return Err(error),
                }
            }
            let delta = solve::all(engine.instructions, &self.graph, &self.tree);
            engine.workspace.clock.lap(Phase::Solve);
            let Trial { points: trial, error: trial_error } = self.try_step(&delta)?;
            let promised = decrease_of_model(&self.graph, &self.blocks, &delta);
            let still = is_still(&self.points, &trial);
            let negligible = self.negligible(settings, error);
            engine.workspace.clock.lap(Phase::Stage);
            // Written so that NaN is a failure.
            if trial_error.is_finite() && trial_error <= error {
                let decrease = error - trial_error;
                self.points = trial;
                error = trial_error;
                iterations += 1;
                info!(iteration = iterations, error, damping, "step taken");
                self.relinearize_all(engine)?;
                eliminated = false;
                let is_small = damping <= FIRST_DAMPING;
                // A damped step may be short because of the damping. Only a full one proves the end, or one
                // beside which a tenth of the damping was too little.
                let is_longest = damping <= SMALLEST_DAMPING || (is_small && less_failed);
                if (decrease <= negligible || still) && is_longest {
                    break Status::Converged;
                }
                if damping > 0.0 {
                    first = (damping / DAMPING_FACTOR).clamp(SMALLEST_DAMPING, FIRST_DAMPING);
                }
                // Where this one tells nothing any more, a full one is to be seen next.
                damping = match is_small || decrease <= self.rounding(error) {
                    true => 0.0,
                    false => damping / DAMPING_FACTOR,
                };
                less_failed = false;
            } else if damping == 0.0
                && (promised <= negligible
                    || still
                    || self.is_rounding(trial_error, error, promised))
            {
                break Status::Converged;
            } else if !may_damp {
                break Status::NotConverged(Reason::ErrorWouldRise);
            } else if damping > LARGEST_DAMPING {
                break Status::NotConverged(Reason::NoDescent);
            } else {
                less_failed = damping > 0.0;
                damping = more(damping, first);
                eliminated = false;
                debug!(error, trial_error, damping, "step refused, damped more");
            }
        };
        if !eliminated || damping > 0.0 {
            self.eliminate_in_place(0.0, engine)?;
        }
        Ok(self.finish(status, iterations, initial_error, error))
    }

    /// Powell's dogleg in the scaled variables `D^½ δ`, `D = diag(JᵀJ)`.
    fn dogleg(
        &mut self,
        settings: &BatchSettings,
        initial_error: f64,
        engine: &mut Engine,
    ) -> Result<BatchReport, SmootherError> {
        let mut error = initial_error;
        let mut radius = f64::INFINITY;
        let mut iterations = 0;
        // Whether the tree is the factorization at the current points.
        let mut eliminated = true;
        let status = 'outer: loop {
            if iterations >= settings.max_iterations {
                break Status::NotConverged(Reason::IterationLimit);
            }
            if !eliminated {
                self.eliminate_in_place(0.0, engine)?;
                eliminated = true;
            }
            let newton = solve::all(engine.instructions, &self.graph, &self.tree);
            let scale = diagonal(&self.graph, &self.blocks);
            let gradient = gradient(&self.graph, &self.blocks);
            let steepest = steepest_descent(&self.graph, &self.blocks, &gradient, &scale);
            let newton_length = scaled_norm(&newton, &scale);
            let negligible = self.negligible(settings, error);
            loop {
                let delta = within_radius(&newton, &steepest, &scale, radius);
                let promised = decrease_of_model(&self.graph, &self.blocks, &delta);
                let Trial { points: trial, error: trial_error } = self.try_step(&delta)?;
                let still = is_still(&self.points, &trial);
                let full = radius >= newton_length;
                let decrease = error - trial_error;
                if !full {
                    // A shorter step that no error can tell from none: neither can those that follow.
                    let told = rounding_of_error(&self.graph, &self.blocks, &self.points, error);
                    if still || (promised <= told && decrease <= told) {
                        let promised = decrease_of_model(&self.graph, &self.blocks, &newton);
                        break 'outer match promised <= negligible.max(NEARLY * told) {
                            true => Status::Converged,
                            false => Status::NotConverged(Reason::NoDescent),
                        };
                    }
                }
                // Written so that NaN is a failure.
                if trial_error.is_finite() && trial_error <= error {
                    let length = scaled_norm(&delta, &scale);
                    let gain = decrease / promised;
                    if gain > 0.75 {
                        radius = radius.max(3.0 * length);
                    } else if gain < 0.25 {
                        radius = 0.5 * length;
                    }
                    self.points = trial;
                    error = trial_error;
                    iterations += 1;
                    info!(iteration = iterations, error, radius, "step taken");
                    self.relinearize_all(engine)?;
                    eliminated = false;
                    if (decrease <= negligible || still) && full {
                        break 'outer Status::Converged;
                    }
                    break;
                }
                if (promised <= negligible || still) && full {
                    break 'outer Status::Converged;
                }
                radius = 0.25 * radius.min(newton_length);
                debug!(error, trial_error, radius, "step refused, trust region made smaller");
                // Written so that an infinite or NaN length ends it too.
                if !(radius.is_finite() && radius >= SMALLEST_RADIUS * newton_length) {
                    break 'outer Status::NotConverged(Reason::NoDescent);
                }
            }
        };
        if !eliminated {
            self.eliminate_in_place(0.0, engine)?;
        }
        Ok(self.finish(status, iterations, initial_error, error))
    }

    /// A decrease of the error that is as good as none.
    fn negligible(&self, settings: &BatchSettings, error: f64) -> f64 {
        settings.relative_decrease * error + NOTHING * self.rows()
    }

    /// Whether a full step raises the error by no more than rounding, and did not promise much: where such
    /// steps overshoot, as beside false loop closures, there is no other end.
    fn is_rounding(&self, trial: f64, error: f64, promised: f64) -> bool {
        let rise = trial - error;
        let of_sum = rise <= self.rounding(error) && promised <= PROMISING * error;
        trial.is_finite()
            && (of_sum || {
                let told = rounding_of_error(&self.graph, &self.blocks, &self.points, error);
                rise <= told && promised <= told
            })
    }

    /// What the sum of so many terms is rounded by.
    fn rounding(&self, error: f64) -> f64 {
        f64::EPSILON * self.rows().sqrt() * error
    }

    /// Of all residuals.
    fn rows(&self) -> f64 {
        self.graph.factor_indices().map(|f| self.graph.rows_at(f)).sum::<usize>() as f64
    }

    fn finish(
        &self,
        status: Status,
        iterations: u32,
        initial_error: f64,
        error: f64,
    ) -> BatchReport {
        let gradient_norm =
            gradient(&self.graph, &self.blocks).iter().fold(0.0, |m: f64, g| m.max(g.abs()));
        info!(?status, iterations, initial_error, error, gradient_norm, "batch done");
        BatchReport { status, iterations, initial_error, error, gradient_norm }
    }

    fn relinearize_all(&mut self, engine: &mut Engine) -> Result<(), SmootherError> {
        self.relinearize_factors()?;
        engine.workspace.clock.lap(Phase::Linearize);
        Ok(())
    }

    /// Eliminates all cliques again with `damping · diag(JᵀJ)` added.
    fn eliminate_in_place(
        &mut self,
        damping: f64,
        engine: &mut Engine,
    ) -> Result<(), SmootherError> {
        let buffers = (engine.take_plan(), &mut engine.workspace.clock);
        let plan = engine.planner.plan_all(self.now(), Mark::InPlace, buffers);
        let added = (damping > 0.0).then(|| {
            let mut diagonal = diagonal(&self.graph, &self.blocks);
            diagonal.iter_mut().for_each(|d| *d *= damping);
            diagonal
        });
        self.replace(plan, added.as_deref(), engine)
    }

    /// The points that δ leads to, and the error there. A step to values that are not finite cannot
    /// be taken.
    fn try_step(&self, delta: &[f64]) -> Result<Trial, GraphError> {
        match retract_all(&self.graph, &self.points, delta) {
            Ok(points) => Ok(Trial { error: self.graph.error(&points)?, points }),
            Err(GraphError::NonFiniteRetraction { .. }) => {
                Ok(Trial { points: vec![f64::NAN; self.points.len()], error: f64::NAN })
            }
            Err(error) => Err(error),
        }
    }
}

/// Whether a step was lost in rounding.
fn is_still(from: &[f64], to: &[f64]) -> bool {
    from.iter().zip(to).all(|(a, b)| (a - b).abs() <= STILL * a.abs().max(1.0))
}
