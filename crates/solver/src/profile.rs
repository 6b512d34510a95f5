//! Where the time of updates goes.

use std::time::{Duration, Instant};

use serde::Serialize;

/// What an update spends its time on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Phase {
    /// Checking changes, adding to the graph, and committing; in a batch, trying steps.
    Stage,
    /// Marking the cliques that are touched, and their ancestors.
    Detach,
    /// Moving points and evaluating Jacobians.
    Linearize,
    /// Collecting the affected variables, factors and subtrees.
    Gather,
    /// Finding an elimination order.
    Order,
    /// From the order to cliques.
    Symbolic,
    /// Adding factors and contributions to fronts.
    Assemble,
    /// Dense elimination of fronts; by QR, with its assembly.
    Eliminate,
    /// Putting the results into the tree.
    Install,
    /// Back-substitution to see what has moved.
    Solve,
}

impl Phase {
    /// All phases, in the order in which an update goes through them.
    pub const ALL: [Self; 10] = [
        Self::Stage,
        Self::Detach,
        Self::Linearize,
        Self::Gather,
        Self::Order,
        Self::Symbolic,
        Self::Assemble,
        Self::Eliminate,
        Self::Install,
        Self::Solve,
    ];

    /// The phase's name, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stage => "stage",
            Self::Detach => "detach",
            Self::Linearize => "linearize",
            Self::Gather => "gather",
            Self::Order => "order",
            Self::Symbolic => "symbolic",
            Self::Assemble => "assemble",
            Self::Eliminate => "eliminate",
            Self::Install => "install",
            Self::Solve => "solve",
        }
    }
}

/// Time by phase, of all updates since profiling was switched on; see
/// [`crate::Smoother::set_profiling`]. Work on other threads is not in it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Profile {
    times: [Duration; Phase::ALL.len()],
}

impl Profile {
    /// Time spent in a phase.
    pub fn time(&self, phase: Phase) -> Duration {
        self.times[phase as usize]
    }

    /// Time spent in all phases.
    pub fn total(&self) -> Duration {
        self.times.iter().sum()
    }
}

/// A clock that assigns the time since its last lap to a phase; it costs next to nothing while it
/// is off.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clock {
    pub(crate) profile: Profile,
    last: Option<Instant>,
    is_on: bool,
}

impl Clock {
    pub(crate) fn set(&mut self, on: bool) {
        *self = Self { is_on: on, ..Self::default() };
    }

    /// Time from now on counts.
    #[inline]
    pub(crate) fn start(&mut self) {
        if self.is_on {
            self.last = Some(Instant::now());
        }
    }

    /// The time since the last lap was spent in `phase`.
    #[inline]
    pub(crate) fn lap(&mut self, phase: Phase) {
        if let Some(last) = self.last {
            let now = Instant::now();
            self.profile.times[phase as usize] += now - last;
            self.last = Some(now);
        }
    }
}
