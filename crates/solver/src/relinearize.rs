//! Moving linearization points to the estimate, as the policy asks.

use std::collections::HashSet;
use std::ops::ControlFlow;

use evergraph_model::Change;
use tracing::debug;

use crate::background::{Background, Snapshot};
use crate::batch::{BatchReport, BatchSettings, Status};
use crate::eliminate::eliminate_pending;
use crate::error::SmootherError;
use crate::factorization::{Engine, Factorization};
use crate::pending::SMALLEST_SLICE;
use crate::profile::Phase;
use crate::report::Report;
use crate::settings::Fluid;
use crate::smoother::{Smoother, Takeover};
use crate::solve::Pass;

/// Between sweeps, δ is passed down the tree where it changes by more than this share of the
/// threshold.
const COARSE_SHARE: f64 = 0.4;

/// Variables beyond this many thresholds of the frequent check are relinearized at once. With one threshold replays
/// of sphere2500 take a quarter more instructions, and the estimates on the way are hardly better.
const FAR: f64 = 2.0;
/// Relinearizations in one step: a large loop closure takes more than one, each much less than the last.
const ROUNDS: u32 = 3;
/// Where variables are far away after these rounds too, full steps overshoot: they are then relinearized in slices for so
/// many steps, and twice as many each time it happens again ...
const FIRST_WAIT: u64 = 10;
/// ... up to so many.
const LONGEST_WAIT: u64 = 1000;
/// While a graph is small, a sweep comes after this part of its changes ...
const YOUNG: u64 = 10;
/// ... but no sooner than after so many.
const SOONEST: u64 = 10;

/// A check that is due.
#[derive(Clone, Copy, Debug)]
struct Check {
    check: Fluid,
    is_sweep: bool,
}

impl Smoother {
    /// Step 4 of `apply`: goes on with a relinearization in progress, looks for variables that have
    /// moved too far, or takes a batch step, as the policy says. An error gives the relinearization
    /// up, not the change.
    pub(crate) fn relinearize(&mut self, change: Change, report: &mut Report) {
        let policy = self.settings.relinearization;
        if policy.background.is_some() {
            if self.batch_in_background(change, report).is_break() {
                return;
            }
        } else if policy.batch.is_some_and(|every| self.steps.is_multiple_of(every.get().into())) {
            return self.batch_step(report);
        }
        let graph = &self.factorization.graph;
        if self.pending.is_active() && self.pending.variables(graph).next().is_none() {
            // All of them have been dropped.
            self.give_up();
        }
        if let Some(check) = policy.fluid
            && self.may_be_at_once()
            && self.jump() > FAR * check.threshold
        {
            // A large loop closure. What is pending was for an estimate that is far off now.
            self.give_up();
            return self.check(Check { check, is_sweep: false }, report);
        }
        if self.pending.is_active() {
            return self.advance(report);
        }
        // The step that moved points has had enough to do.
        if report.relinearized.is_empty()
            && let Some(check) = self.check_due()
        {
            self.check(check, report);
        }
    }

    /// The check that is due in this step: a sweep rather than a frequent one.
    fn check_due(&self) -> Option<Check> {
        let policy = self.settings.relinearization;
        let since = |last: u64, check: Option<Fluid>, soonest: u64| {
            check.filter(|check| self.steps >= last + u64::from(check.every.get()).min(soonest))
        };
        let soonest = (self.steps / YOUNG).max(SOONEST);
        match since(self.checked.sweep, policy.sweep, soonest) {
            Some(check) => Some(Check { check, is_sweep: true }),
            None => since(self.checked.fluid, policy.fluid, u64::MAX)
                .map(|check| Check { check, is_sweep: false }),
        }
    }

    /// The distance that the newest variable has moved since the last check, or since it was added. It stands
    /// in the root, so this costs next to nothing.
    fn jump(&mut self) -> f64 {
        let Factorization { graph, tree, solution, newest, .. } = &mut self.factorization;
        let instructions = self.engine.instructions;
        newest.map_or(0.0, |newest| solution.jump(instructions, graph, tree, newest))
    }

    /// Looks for variables that have moved too far, and relinearizes them: at once, and again, where one is
    /// beyond the threshold of the frequent check, or else in slices.
    fn check(&mut self, due: Check, report: &mut Report) {
        let mut next = Some(due);
        for round in 0..ROUNDS {
            let Some(check) = next else {
                // What was far away has settled.
                if round > 1 {
                    self.checked.wait /= 2;
                }
                return;
            };
            let is_far = self.check_once(check, report);
            let fluid = self.settings.relinearization.fluid.filter(|_| is_far);
            next = fluid.map(|check| Check { check, is_sweep: false });
        }
        if next.is_some() {
            let wait = (2 * self.checked.wait).clamp(FIRST_WAIT, LONGEST_WAIT);
            self.checked.wait = wait;
            self.checked.at_once_from = self.steps + wait;
        }
    }

    /// Whether variables far away may be relinearized at once, rather than in slices.
    fn may_be_at_once(&self) -> bool {
        self.steps >= self.checked.at_once_from
    }

    /// One round of [`check`](Self::check): whether variables far away have been relinearized.
    fn check_once(&mut self, Check { check, is_sweep }: Check, report: &mut Report) -> bool {
        let policy = self.settings.relinearization;
        self.checked.fluid = self.steps;
        if is_sweep {
            self.checked.sweep = self.steps;
        }
        let smallest = [policy.fluid, policy.sweep]
            .into_iter()
            .flatten()
            .map(|check| check.reach())
            .fold(f64::INFINITY, f64::min);
        let fine = self.settings.back_substitution_tolerance.min(smallest);
        let coarse = fine.max(COARSE_SHARE * check.threshold);
        let pass = Pass { fine, coarse, is_fine: is_sweep, threshold: smallest };
        self.factorization.solve(self.engine.instructions, pass);
        let solution = &mut self.factorization.solution;
        let graph = &self.factorization.graph;
        let moved = solution.moved_beyond(graph, check.threshold, check.reach(), smallest);
        report.largest_delta =
            Some(report.largest_delta.map_or(moved.largest, |so_far| so_far.max(moved.largest)));
        self.checked.is_settled = moved.variables.is_empty();
        self.lap(Phase::Solve);
        if moved.variables.is_empty() {
            return false;
        }
        let (factorization, engine) = (&self.factorization, &mut self.engine);
        let (graph, tree) = (&factorization.graph, &factorization.tree);
        let cliques = engine.planner.changed_by(graph, tree, &moved.variables);
        debug!(
            step = self.steps,
            variables = moved.variables.len(),
            cliques = cliques.0.len(),
            threshold = check.threshold,
            "relinearization begins"
        );
        let now = (graph, tree, &*factorization.points);
        let spread = policy.spread.get();
        let begun =
            self.pending.start(now, &factorization.solution, &moved.variables, cliques, spread);
        self.lap(Phase::Detach);
        let is_far = policy.fluid.is_some_and(|fluid| moved.largest > FAR * fluid.threshold);
        match begun {
            Ok(work)
                if is_far && self.may_be_at_once() || spread == 1 || work <= SMALLEST_SLICE =>
            {
                self.relinearize_at_once(report);
                is_far && report.relinearization_refused.is_none()
            }
            Ok(_) => false,
            Err(error) => {
                report.relinearization_refused = Some(error.into());
                false
            }
        }
    }

    /// Carries out the pending relinearization, as a change that does nothing else would.
    fn relinearize_at_once(&mut self, report: &mut Report) {
        self.pending.make_direct();
        let nothing = self.factorization.graph.change();
        let staged = self.factorization.stage(&nothing).expect("an empty change fits every graph");
        let Self { factorization, pending, engine, .. } = self;
        match factorization.eliminate(&nothing, &staged, Some(pending), engine) {
            Ok(update) => {
                let relinearized = self.report_on(&staged, &update);
                report.variables_relinearized += relinearized.variables_relinearized;
                report.cliques_eliminated += relinearized.cliques_eliminated;
                let known: HashSet<_> = report.relinearized.iter().copied().collect();
                let new = relinearized.relinearized.into_iter().filter(|v| !known.contains(v));
                report.relinearized.extend(new);
                self.commit(staged, update, Takeover::Complete);
            }
            Err(refusal) => {
                self.factorization.unstage(staged);
                self.give_up();
                report.relinearization_refused = Some(refusal.into());
            }
        }
    }

    /// Does a slice of the relinearization in progress.
    fn advance(&mut self, report: &mut Report) {
        let Self { factorization, pending, engine, .. } = self;
        let graph = &factorization.graph;
        let left = pending.linearize(graph, &mut factorization.points, &mut factorization.blocks);
        engine.workspace.clock.lap(Phase::Linearize);
        match left {
            Ok(left) => {
                let system = factorization.system(engine);
                eliminate_pending(&system, pending, left, &mut engine.workspace);
            }
            Err(error) => {
                self.give_up();
                report.relinearization_refused = Some(error.into());
            }
        }
    }

    /// Gives up what is pending, until the next check.
    fn give_up(&mut self) {
        self.pending.clear(&mut self.factorization.blocks, &mut self.engine.workspace.pool);
    }

    fn batch_step(&mut self, report: &mut Report) {
        match self.optimize(&BatchSettings::periodic()) {
            Ok(batch) => {
                report.variables_relinearized +=
                    batch.iterations as usize * self.factorization.graph.unknown_count();
                report.cliques_eliminated += self.factorization.tree.len();
                report.batch = Some(batch);
            }
            Err(error) => report.relinearization_refused = Some(error),
        }
    }

    /// Records a change that was applied, for a batch step that is under way, and takes its result
    /// over when that is due; or starts one. Breaks where it has started or ended one.
    fn batch_in_background(&mut self, change: Change, report: &mut Report) -> ControlFlow<()> {
        let policy = self.settings.relinearization;
        let (Some(every), Some(after)) = (policy.batch, policy.background) else {
            return ControlFlow::Continue(());
        };
        if let Some(mut background) = self.background.take() {
            background.record(self.with_fixed_points(change));
            if !background.is_due(self.steps) {
                self.background = Some(background);
                return ControlFlow::Continue(());
            }
            self.take_over(background, report);
            return ControlFlow::Break(());
        }
        let is_time = self.steps.is_multiple_of(u64::from(every.get()));
        if !is_time || self.factorization.graph.unknown_count() == 0 {
            return if is_time { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        }
        match self.snapshot() {
            // Without a thread there is no batch step; the next one may have more luck.
            Ok(snapshot) => {
                self.background =
                    Background::start(snapshot, self.steps + u64::from(after.get())).ok();
            }
            Err(error) => report.relinearization_refused = Some(error),
        }
        ControlFlow::Break(())
    }

    /// What a batch step on another thread starts from.
    fn snapshot(&self) -> Result<Snapshot, SmootherError> {
        let Engine { elimination, instructions, .. } = self.engine;
        Ok(Snapshot {
            graph: self.factorization.graph.clone(),
            points: self.factorization.estimate_points(instructions)?,
            newest: self.factorization.newest,
            engine: Engine::new(elimination, instructions, None),
        })
    }

    /// A change that was applied, to be applied to another estimate: variables are fixed where they
    /// were fixed here.
    fn with_fixed_points(&self, mut change: Change) -> Change {
        let graph = &self.factorization.graph;
        let fixes = change.fixes().iter().copied();
        let is_set = |id| {
            change.moves().iter().any(|(moved, _)| *moved == id)
                || change.new_variables().iter().any(|(new, _)| *new == id)
        };
        let fixed: Vec<_> = fixes
            .filter(|&id| !is_set(id))
            .filter_map(|id| graph.variable_index(id).ok().map(|v| (id, v)))
            .collect();
        for (id, v) in fixed {
            change.move_value(id, graph.value(v, &self.factorization.points[graph.value_range(v)]));
        }
        change
    }

    /// Takes over what a batch step found, with the changes since.
    fn take_over(&mut self, background: Background, report: &mut Report) {
        match background.finish(&mut self.engine) {
            Ok((fresh, batch)) => {
                self.give_up();
                self.factorization = fresh;
                self.checked.is_settled = batch.status == Status::Converged;
                report.relinearized.clear();
                report.variables_relinearized += self.factorization.graph.unknown_count();
                report.batch = Some(batch);
            }
            Err(error) => report.relinearization_refused = Some(error),
        }
    }

    /// Optimizes from the current estimate until convergence; linearization points end at the
    /// optimum.
    ///
    /// # Errors
    /// [`SmootherError::Singular`], [`SmootherError::NonFinite`]: the system at some accepted
    /// point cannot be solved. [`SmootherError::Graph`]: the code of a factor or variable type
    /// failed. Everything is then what it was before.
    pub fn optimize(&mut self, settings: &BatchSettings) -> Result<BatchReport, SmootherError> {
        let report = self.factorization.optimize(settings, &mut self.engine)?;
        self.give_up();
        self.background = None;
        self.checked.is_settled = report.status == Status::Converged;
        Ok(report)
    }

    /// Relinearizes every variable and solves to convergence, by Gauss-Newton damped where it must
    /// be. For moments when the robot has time.
    ///
    /// # Errors
    /// As [`optimize`](Self::optimize).
    pub fn relinearize_batch(&mut self) -> Result<BatchReport, SmootherError> {
        self.optimize(&BatchSettings::default())
    }
}
