//! Options of a replay, and the description of a step.

use std::fmt;

use evergraph_model::{FactorId, Kernel, VariableId};

/// Where the start value of a new variable comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Initial {
    /// A pose from the current estimate of the other end of its odometry edge, a landmark from the
    /// first pose that sees it: what a robot knows at that moment.
    #[default]
    FromOdometry,
    /// The file's vertex; for a variable without one as [`FromOdometry`](Self::FromOdometry).
    FromFile,
}

/// How a document is replayed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ReplayOptions {
    /// Standard deviation of the gauge priors, in metres and radians alike; `None` adds none, and
    /// the caller has to hold the gauge. Default: 0.01, firm beside the loop closures of a file and
    /// soft enough to keep the system well scaled.
    pub prior: Option<f64>,
    /// Where start values come from. Default: odometry.
    pub initial: Initial,
    /// Put around *every* measurement between two variables that has no kernel in the file, odometry
    /// included, since which edges may be wrong is not written there. Absolute measurements (priors,
    /// positions, attitudes) stay as they are, since they may be all that holds the map, and so do
    /// linear factors, which stand for many measurements. Default: none.
    pub kernel: Option<Kernel>,
}

impl Default for ReplayOptions {
    fn default() -> Self {
        Self { prior: Some(0.01), initial: Initial::FromOdometry, kernel: None }
    }
}

impl ReplayOptions {
    /// Sets [`prior`](Self::prior).
    #[must_use]
    pub const fn with_prior(mut self, prior: Option<f64>) -> Self {
        self.prior = prior;
        self
    }

    /// Sets [`initial`](Self::initial).
    #[must_use]
    pub const fn with_initial(mut self, initial: Initial) -> Self {
        self.initial = initial;
        self
    }

    /// Sets [`kernel`](Self::kernel).
    #[must_use]
    pub const fn with_kernel(mut self, kernel: Option<Kernel>) -> Self {
        self.kernel = kernel;
        self
    }
}

/// The order in which a document is replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Order {
    /// By time stamps.
    Times,
    /// By lines: each pose comes with the lines up to the next new pose.
    Lines,
    /// By ids, as the dialect has no order: pose k comes with every edge whose larger pose is k.
    Ids,
    /// By ids although the dialect has an order: most loop closures and sightings stand behind poses that
    /// were added after all of theirs, so that the lines are not in the order of recording.
    IdsForLateEdges,
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Times => "by time stamps",
            Self::Lines => "by lines",
            Self::Ids => "by ids",
            Self::IdsForLateEdges => "by ids: most closures or sightings stand behind later poses",
        })
    }
}

/// What a step does to the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum StepKind {
    /// The new pose comes in by one edge (or repetitions of it) and sees only new landmarks.
    Explore,
    /// Some edge ties together what was connected before: a loop closure, a landmark seen again.
    Loop,
}

/// A prior that holds the gauge; it is none of the file's factors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct GaugePrior {
    /// The pose's id in the file.
    pub id: u64,
    /// The pose.
    pub variable: VariableId,
    /// The prior.
    pub factor: FactorId,
    /// Its standard deviation, in metres and radians.
    pub sigma: f64,
    /// Directions that the pose has: 3 or 6.
    pub dim: usize,
    /// How many directions of the pose it holds: all, or those that absolute measurements leave
    /// free.
    pub directions: usize,
    /// True if the pose is part of a component that is held elsewhere, and no measurement informs these
    /// directions of it: the heading of a robot that only ranges see, and that does not move.
    pub weak: bool,
}

/// What a step's change holds.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Step {
    /// The newest pose.
    pub pose: VariableId,
    /// What the step does to the map.
    pub kind: StepKind,
    /// Factors of the file that it adds; gauge priors are not counted.
    pub factors: usize,
    /// Variables that it adds.
    pub variables: usize,
    /// Gauge priors that it adds.
    pub gauge_priors: Vec<GaugePrior>,
}

impl Step {
    /// Makes one step of two in a row.
    pub(crate) fn append(&mut self, next: Self) {
        self.pose = next.pose;
        self.factors += next.factors;
        self.variables += next.variables;
        self.gauge_priors.extend(next.gauge_priors);
        if next.kind == StepKind::Loop {
            self.kind = StepKind::Loop;
        }
    }
}
