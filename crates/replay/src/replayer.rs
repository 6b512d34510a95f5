//! A file driven through a smoother, step by step, as the robot that recorded it would have.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

use evergraph_formats::{Document, Line, Record, spell_id};
use evergraph_longterm::{Needed, ThinningError, ThinningFailure};
use evergraph_model::{FactorId, Graph, Value, VariableId};
use evergraph_solver::{
    BatchSettings, Method, Reason, Report, Settings, Smoother, SmootherError, Status,
};

use crate::error::ReplayerError;
use crate::objective::Objective;
use crate::options::{ReplayOptions, Step};
use crate::state::Replay;
use crate::words;

/// One step of a replay.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Replayed {
    /// What came in.
    pub step: Step,
    /// What the smoother did.
    pub report: Report,
    /// Time for the update and the newest pose's estimate (with
    /// [`Replayer::with_full_estimate`] everyone's), without making the change.
    pub update: Duration,
}

/// Replays a document: each step is one change, its new poses start from the current estimate.
#[derive(Debug)]
pub struct Replayer {
    name: String,
    replay: Replay,
    smoother: Smoother,
    full_estimate: bool,
}

impl Replayer {
    /// Prepares a replay.
    ///
    /// # Errors
    /// [`ReplayerError::Format`] when the document is no graph, [`ReplayerError::Smoother`] when
    /// the settings cannot be.
    pub fn new(
        document: &Document,
        options: &ReplayOptions,
        settings: Settings,
    ) -> Result<Self, ReplayerError> {
        Ok(Self {
            name: document.name().to_string(),
            replay: Replay::new(document, options)?,
            smoother: Smoother::new(settings)?,
            full_estimate: false,
        })
    }

    /// Asks for all estimates after every step instead of the newest pose's, as a program does that
    /// needs the whole map each time; counted in [`Replayed::update`]. They are
    /// [`Smoother::cached_estimates`], to within [`Settings::back_substitution_tolerance`].
    #[must_use]
    pub fn with_full_estimate(mut self, full: bool) -> Self {
        self.full_estimate = full;
        self
    }

    /// Applies the next step; `None` at the end.
    ///
    /// # Errors
    /// [`ReplayerError`]; the smoother is then as it was before the step.
    pub fn step(&mut self) -> Result<Option<Replayed>, ReplayerError> {
        let mut change = self.smoother.change();
        let smoother = &self.smoother;
        let mut estimate = |variable| smoother.estimate_value(variable).ok();
        let Some(step) = self.replay.next_step(&mut change, &mut estimate) else {
            return Ok(None);
        };
        let step = step?;
        let start = Instant::now();
        let report = self.smoother.apply(change).map_err(|source| self.at(step.pose, source))?;
        if self.full_estimate {
            let tolerance = self.smoother.settings().back_substitution_tolerance;
            let all = self.smoother.cached_estimates(tolerance).map(|all| {
                std::hint::black_box(all);
            });
            all.map_err(|source| self.at(step.pose, source))?;
        } else {
            let newest = self.smoother.estimate_value(step.pose);
            std::hint::black_box(newest.map_err(|source| self.at(step.pose, source))?);
        }
        let update = start.elapsed();
        Ok(Some(Replayed { step, report, update }))
    }

    /// Applies all that is left as a single change: the start of a batch optimization.
    ///
    /// # Errors
    /// [`ReplayerError`]; the smoother is then as it was before.
    pub fn everything(&mut self) -> Result<Replayed, ReplayerError> {
        let mut change = self.smoother.change();
        let step = self.replay.everything(&mut change)?;
        let start = Instant::now();
        let report = self.smoother.apply(change).map_err(|source| self.at(step.pose, source))?;
        Ok(Replayed { step, report, update: start.elapsed() })
    }

    /// The objective over the file's factors, at the estimate: gauge priors are left out.
    ///
    /// # Errors
    /// [`SmootherError`] for users' code that panics.
    pub fn error(&self) -> Result<f64, SmootherError> {
        let priors = self.priors();
        // The sum of no terms is -0.
        Ok(self.smoother.error_of(|factor| !priors.contains(&factor))? + 0.0)
    }

    /// The objective of the gauge priors alone.
    ///
    /// # Errors
    /// [`SmootherError`] for users' code that panics.
    pub fn gauge_error(&self) -> Result<f64, SmootherError> {
        let priors = self.priors();
        Ok(self.smoother.error_of(|factor| priors.contains(&factor))? + 0.0)
    }

    /// Error and chi2 over the file's factors, at the estimate.
    ///
    /// # Errors
    /// [`SmootherError`] for users' code that panics.
    pub fn objective(&self) -> Result<Objective, SmootherError> {
        let estimates = self.smoother.estimates()?;
        self.objective_at(estimates.iter().map(|(variable, value)| (variable, value.to_value())))
    }

    /// Error and chi2 over the file's factors, at the linearization points: right after
    /// [`everything`](Self::everything) without relinearization, at the start values.
    ///
    /// # Errors
    /// [`SmootherError`] for users' code that panics.
    pub fn objective_at_linearization(&self) -> Result<Objective, SmootherError> {
        let point = |variable| Some((variable, self.smoother.linearization_point(variable).ok()?));
        self.objective_at(self.graph().variables().filter_map(point))
    }

    fn objective_at(
        &self,
        values: impl Iterator<Item = (VariableId, Value)>,
    ) -> Result<Objective, SmootherError> {
        let priors = self.priors();
        let points = self.laid_out(values)?;
        Ok(Objective::at(self.graph(), &points, |factor| !priors.contains(&factor))?)
    }

    /// Values where the graph has them, as [`Graph::value_range`] says.
    fn laid_out(
        &self,
        values: impl Iterator<Item = (VariableId, Value)>,
    ) -> Result<Vec<f64>, SmootherError> {
        let mut points = vec![0.0; self.graph().value_len()];
        for (variable, value) in values {
            let range = self.graph().value_range(self.graph().variable_index(variable)?);
            points[range].copy_from_slice(value.storage());
        }
        Ok(points)
    }

    /// The line of the file's factor that costs most at the estimate, where one costs anything: where
    /// to look when the error is not finite.
    pub fn costliest_line(&self) -> Option<usize> {
        let estimates = self.smoother.estimates().ok()?;
        let points =
            self.laid_out(estimates.iter().map(|(id, value)| (id, value.to_value()))).ok()?;
        let error = |factor: FactorId| {
            let graph = self.graph();
            graph.factor_error(graph.factor_index(factor)?, &points)
        };
        let factors = self.replay.factors().iter();
        factors
            .filter_map(|(factor, line)| Some((error(*factor).ok()?, *line)))
            .filter(|(error, _)| *error > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, line)| line)
    }

    fn priors(&self) -> HashSet<FactorId> {
        self.replay.gauge_priors().iter().map(|prior| prior.factor).collect()
    }

    /// Poses that have come in.
    pub fn poses(&self) -> usize {
        self.replay.ids().filter(|(id, variable)| self.replay.pose(*id) == Some(*variable)).count()
    }

    /// Whether the estimate is at an optimum as far as `tolerance` tells: a Gauss-Newton step from
    /// it, everything relinearized, lowers the error by no more than this share of it (or by less
    /// than 1e-6, which no measurement can tell). Works on a copy and costs a batch step.
    ///
    /// An estimate of a graph that relinearizes where it must is solved exactly for its
    /// linearization points, which may lag behind; this says whether that matters.
    ///
    /// # Errors
    /// [`SmootherError`] when the relinearized system cannot be solved.
    pub fn is_settled(&self, tolerance: f64) -> Result<bool, SmootherError> {
        const NEGLIGIBLE: f64 = 1e-6;
        let mut copy = self.smoother.clone();
        let before = copy.error()?;
        let step = BatchSettings::default().with_method(Method::GaussNewton).with_max_iterations(1);
        let after = copy.optimize(&step)?;
        // A Gauss-Newton step that would raise the error proves nothing.
        if after.status == Status::NotConverged(Reason::ErrorWouldRise) {
            return Ok(false);
        }
        Ok(before - after.error <= tolerance * before + NEGLIGIBLE)
    }

    /// What an error of the smoother says, with variables by their ids in the file.
    pub fn explain(&self, error: &SmootherError) -> String {
        let ids: HashMap<VariableId, u64> =
            self.replay.ids().map(|(id, variable)| (variable, id)).collect();
        words::explain(error, &|variable| ids.get(&variable).copied())
    }

    /// What an error of a removal says, with variables by their ids in the file.
    pub fn explain_thinning(&self, error: &ThinningError) -> String {
        let name = |variable: VariableId| self.name_of(variable);
        match &error.failure {
            ThinningFailure::Removal(error) => words::explain_removal(error, &name),
            ThinningFailure::Smoother { variable, source } => {
                format!("removing {} was refused: {}", name(*variable), self.explain(source))
            }
            other => other.to_string(),
        }
    }

    /// Why a node had to stay, with variables by their ids in the file.
    pub fn explain_needed(&self, needed: &Needed) -> String {
        match needed {
            Needed::Planned(error) => {
                words::explain_removal(error, &|variable| self.name_of(variable))
            }
            Needed::Applied(error) => self.explain(error),
            other => other.to_string(),
        }
    }

    fn name_of(&self, variable: VariableId) -> String {
        let id = self.replay.ids().find(|(_, known)| *known == variable);
        id.map_or_else(|| variable.to_string(), |(id, _)| spell_id(id))
    }

    /// The file's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What has come in so far.
    pub fn replay(&self) -> &Replay {
        &self.replay
    }

    /// The smoother.
    pub fn smoother(&self) -> &Smoother {
        &self.smoother
    }

    /// The smoother, to optimize or to go on with.
    pub fn smoother_mut(&mut self) -> &mut Smoother {
        &mut self.smoother
    }

    /// The smoother, without the file that filled it.
    pub fn into_smoother(self) -> Smoother {
        self.smoother
    }

    /// The graph.
    pub fn graph(&self) -> &Graph {
        self.smoother.graph()
    }

    /// The document with the estimates as its vertices; of a replay that was not finished, or that
    /// holds landmarks back ([`Replay::held_back`]), the part that has come in.
    ///
    /// # Errors
    /// [`ReplayerError::Format`] when it is not the document that is replayed.
    pub fn solution(&self, document: &Document) -> Result<Document, ReplayerError> {
        let estimates = self.smoother.estimates()?;
        let vertices = self
            .replay
            .ids()
            .filter_map(|(id, variable)| Some((id, estimates.value(variable).ok()?.to_value())));
        let lines: HashSet<usize> = self.replay.factors().iter().map(|(_, line)| *line).collect();
        let summary = document.summary();
        // Vertices that nothing measures come in with no step; a whole file keeps them.
        let whole = lines.len()
            == summary.pose_edges + summary.landmark_edges + summary.measurements
            && self.poses() == summary.poses;
        let keep = |line: &Line| match &line.record {
            Record::Vertex { .. } => whole,
            Record::Edge { .. } | Record::Measurement(_) | Record::Linear(_) => {
                lines.contains(&line.number)
            }
            Record::Fix { id } => whole || self.replay.variable(*id).is_some(),
            Record::SensorOffset { .. } | Record::GeodeticOrigin { .. } => true,
        };
        Ok(document.part_with_vertices(keep, vertices)?)
    }

    fn at(&self, pose: VariableId, source: SmootherError) -> ReplayerError {
        let id = self
            .replay
            .ids()
            .find(|(_, variable)| *variable == pose)
            .map_or(u64::MAX, |(id, _)| id);
        ReplayerError::Step {
            file: self.name.clone(),
            pose: id,
            message: self.explain(&source),
            source: Box::new(source),
        }
    }
}
