//! How far an incremental estimate is above the optimum.
//!
//! An incremental smoother solves for the linearization points that it has; the batch optimum is
//! what it would reach if it relinearized everything until nothing moves. The excess of its error
//! over that optimum is what is paid for speed.

use evergraph_model::FactorId;
use evergraph_solver::{BatchSettings, Smoother, SmootherError, Status};
use serde::Serialize;

/// An optimum below this is zero: errors are sums of squares in units of standard deviations, and
/// no measurement can tell so few.
const NEGLIGIBLE: f64 = 1e-6;

/// An estimate beside the batch optimum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AuditSample {
    /// Changes that the smoother had applied.
    pub step: u64,
    /// Error of the estimate over the factors that count.
    pub error: f64,
    /// Error of the optimum over the same factors.
    pub optimum: f64,
    /// `error - optimum`. Below zero by rounding only, where all factors count and the optimization
    /// converged.
    pub excess: f64,
    /// `(error - optimum) / optimum`; `None` where the optimum is below 1e-6, of which shares say
    /// nothing.
    pub relative_excess: Option<f64>,
    /// How the optimization ended. Where it did not converge, the optimum is at most what is given
    /// here, and the excess at least.
    #[serde(flatten)]
    pub status: Status,
}

impl AuditSample {
    /// Optimizes a copy of the smoother and compares. Only factors that `include` names count in the
    /// errors (such as all but gauge priors); the optimum is that of all factors.
    ///
    /// The optimum is the one that the estimate leads to: an estimate in the basin of another, worse
    /// optimum does not show.
    ///
    /// # Errors
    /// [`SmootherError`] when the copy cannot be optimized.
    pub fn take(
        smoother: &Smoother,
        settings: &BatchSettings,
        mut include: impl FnMut(FactorId) -> bool,
    ) -> Result<Self, SmootherError> {
        let error = smoother.error_of(&mut include);
        let mut copy = smoother.clone();
        let report = copy.optimize(settings)?;
        let optimum = copy.error_of(&mut include);
        let excess = error - optimum;
        let relative_excess = (optimum >= NEGLIGIBLE).then(|| excess / optimum);
        let (step, status) = (smoother.steps(), report.status);
        Ok(Self { step, error, optimum, excess, relative_excess, status })
    }
}

/// Samples along a replay.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Audit {
    samples: Vec<AuditSample>,
}

impl Audit {
    /// No samples yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a sample.
    pub fn push(&mut self, sample: AuditSample) {
        self.samples.push(sample);
    }

    /// The samples, in the order in which they were added.
    pub fn samples(&self) -> &[AuditSample] {
        &self.samples
    }

    /// Mean of the relative excesses; `None` when there is none.
    pub fn mean(&self) -> Option<f64> {
        let (count, sum) = self.relative().fold((0, 0.0), |(n, sum), (x, _)| (n + 1, sum + x));
        (count > 0).then(|| sum / f64::from(count))
    }

    /// The sample of the largest relative excess, the first of equals; `None` when there is none.
    pub fn worst(&self) -> Option<&AuditSample> {
        let larger = |worst: (f64, &'_ AuditSample), next: (f64, &'_ AuditSample)| {
            next.0.total_cmp(&worst.0).is_gt()
        };
        let mut all = self.relative();
        let first = all.next()?;
        Some(all.fold(first, |worst, next| if larger(worst, next) { next } else { worst }).1)
    }

    /// Whether every optimization converged.
    pub fn all_converged(&self) -> bool {
        self.samples.iter().all(|sample| sample.status == Status::Converged)
    }

    fn relative(&self) -> impl Iterator<Item = (f64, &AuditSample)> {
        self.samples.iter().filter_map(|sample| Some((sample.relative_excess?, sample)))
    }
}
