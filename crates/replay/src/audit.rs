//! How far an incremental estimate is above the optimum.
//!
//! An incremental smoother solves for the linearization points that it has; the batch optimum is
//! what it would reach if it relinearized everything until nothing moves. The excess of its error
//! over that optimum is what is paid for speed.

use std::collections::HashSet;

use evergraph_model::FactorId;
use evergraph_solver::{BatchSettings, Smoother, SmootherError, Status};
use serde::Serialize;

use crate::replayer::Replayer;

/// An optimum below this is zero: errors are sums of squares in units of standard deviations, and
/// no measurement can tell so few.
const NEGLIGIBLE: f64 = 1e-6;

/// An estimate beside the batch optimum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
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
    /// optimum does not show. An estimate whose error over all factors is below 1e-6, as before the
    /// first loop, counts as its own optimum: nothing that could be measured is left to gain, and
    /// rounding would keep the optimization from an end.
    ///
    /// # Errors
    /// [`SmootherError`] when the copy cannot be optimized.
    pub fn take(
        smoother: &Smoother,
        settings: &BatchSettings,
        mut include: impl FnMut(FactorId) -> bool,
    ) -> Result<Self, SmootherError> {
        let error = smoother.error_of(&mut include)?;
        let (optimum, status) = if smoother.error()? < NEGLIGIBLE {
            (error, Status::Converged)
        } else {
            let mut copy = smoother.clone();
            let status = copy.optimize(settings)?.status;
            (copy.error_of(&mut include)?, status)
        };
        let excess = error - optimum;
        let relative_excess = (optimum >= NEGLIGIBLE).then(|| excess / optimum);
        Ok(Self { step: smoother.steps(), error, optimum, excess, relative_excess, status })
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

impl Replayer {
    /// Measures how far the estimate is above the batch optimum now, on the file's factors; gauge
    /// priors are left out. Works on a copy and costs a batch optimization: see
    /// [`AuditSample::take`].
    ///
    /// # Errors
    /// [`SmootherError`] when the copy cannot be optimized.
    pub fn audit_sample(&self) -> Result<AuditSample, SmootherError> {
        let priors: HashSet<FactorId> =
            self.replay().gauge_priors().iter().map(|prior| prior.factor).collect();
        AuditSample::take(self.smoother(), &BatchSettings::default(), |factor| {
            !priors.contains(&factor)
        })
    }
}

#[cfg(test)]
mod tests {
    use evergraph_simulate::Grid;
    use evergraph_solver::{Relinearization, Settings};

    use super::*;
    use crate::options::ReplayOptions;

    fn audit(relinearization: Relinearization) -> Audit {
        let mut grid = Grid::city(120, 3);
        grid.odometry = [0.1, 0.1, 0.05];
        let world = grid.generate().unwrap();
        let settings = Settings::default().with_relinearization(relinearization);
        let options = ReplayOptions::default();
        let mut replayer = Replayer::new(&world.document, &options, settings).unwrap();
        let mut audit = Audit::new();
        while replayer.step().unwrap().is_some() {
            let steps = replayer.smoother().steps();
            if steps.is_multiple_of(20) {
                let sample = replayer.audit_sample().unwrap();
                assert_eq!((sample.step, sample.error), (steps, replayer.error().unwrap()));
                audit.push(sample);
            }
        }
        audit
    }

    #[test]
    fn relinearization_is_what_keeps_a_replay_at_its_optimum() {
        let (never, both) = (audit(Relinearization::NEVER), audit(Relinearization::BOTH));
        assert_eq!((never.samples().len(), both.samples().len()), (6, 6));
        assert!(never.all_converged() && both.all_converged(), "{never:#?} {both:#?}");
        let worst = |audit: &Audit| audit.worst().unwrap().relative_excess.unwrap();
        assert!(worst(&never) > 10.0 * worst(&both), "{never:?} {both:?}");
        assert!(worst(&both) < 0.01, "{both:?}");
    }
}
