//! How far a replay is above the optimum.

use std::collections::HashSet;

use evergraph_evaluate::AuditSample;
use evergraph_model::FactorId;
use evergraph_solver::{BatchSettings, SmootherError};

use crate::replayer::Replayer;

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
    use evergraph_evaluate::Audit;
    use evergraph_formats::ReplayOptions;
    use evergraph_simulate::Grid;
    use evergraph_solver::{Relinearization, Settings};

    use super::*;

    fn audit(relinearization: Relinearization) -> Audit {
        let mut grid = Grid::city(120, 3);
        grid.odometry = [0.1, 0.1, 0.05];
        let world = grid.generate().unwrap();
        let settings = Settings { relinearization, ..Settings::default() };
        let options = ReplayOptions::default();
        let mut replayer = Replayer::new(&world.document, &options, settings).unwrap();
        let mut audit = Audit::new();
        while replayer.step().unwrap().is_some() {
            let steps = replayer.smoother().steps();
            if steps.is_multiple_of(20) {
                let sample = replayer.audit_sample().unwrap();
                assert_eq!((sample.step, sample.error), (steps, replayer.error()));
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
