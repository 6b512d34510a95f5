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
