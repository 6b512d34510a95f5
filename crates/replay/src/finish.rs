//! The optimum at the end of a replay.

use std::collections::HashMap;

use evergraph_formats::Document;
use evergraph_model::Value;
use evergraph_solver::{BatchReport, BatchSettings, Smoother, SmootherError, damped_then_dogleg};
use serde::Serialize;

use crate::chordal::chordal;
use crate::error::ReplayerError;
use crate::replayer::Replayer;

/// A batch optimization from two starts.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct Compared {
    /// From the estimate of the replay.
    pub from_estimate: BatchReport,
    /// From the chordal start.
    pub from_chordal: BatchReport,
    /// True if the minimum from the chordal start is lower, and was taken.
    pub took_chordal: bool,
}

impl Replayer {
    /// Optimizes everything that has been added, from the estimate: by Levenberg-Marquardt, then, if that
    /// has not converged, by dogleg. The report is of both together. The end is a *local* minimum.
    ///
    /// # Errors
    /// [`SmootherError`] as [`Smoother::optimize`](evergraph_solver::Smoother::optimize); everything is
    /// then as it was before.
    pub fn final_batch(&mut self) -> Result<BatchReport, SmootherError> {
        optimum(self.smoother_mut())
    }

    /// [`final_batch`](Self::final_batch) from the estimate and from the [chordal start](chordal) of
    /// `document`, the document that is replayed; the lower end is kept. Maps with wrong closures have
    /// several minima.
    ///
    /// # Errors
    /// [`ReplayerError`]; everything is then as it was before.
    pub fn final_batch_compared(&mut self, document: &Document) -> Result<Compared, ReplayerError> {
        /// Two ends at the same minimum differ by rounding, and by what optimizations stop at.
        const SAME: f64 = 1e-6;
        let starts = chordal(document, self.smoother().settings())?;
        let mut other = self.smoother().clone();
        self.move_to(&starts, &mut other)?;
        let from_chordal = optimum(&mut other)?;
        let from_estimate = self.final_batch()?;
        let took_chordal = from_chordal.error < from_estimate.error * (1.0 - SAME);
        if took_chordal {
            *self.smoother_mut() = other;
        }
        Ok(Compared { from_estimate, from_chordal, took_chordal })
    }

    /// Moves the linearization points of variables that have been added and are not fixed.
    fn move_to(
        &self,
        starts: &[(u64, Value)],
        smoother: &mut Smoother,
    ) -> Result<(), ReplayerError> {
        let starts: HashMap<(u64, &str), &Value> =
            starts.iter().map(|(id, value)| ((*id, value.kind().name()), value)).collect();
        let mut change = smoother.change();
        for (id, variable) in self.replay().ids() {
            let here = smoother.linearization_point(variable)?;
            let is_fixed = smoother.graph().is_fixed(variable)?;
            if let Some(start) = starts.get(&(id, here.kind().name())).filter(|_| !is_fixed) {
                change.move_value(variable, (*start).clone());
            }
        }
        smoother.apply(change)?;
        Ok(())
    }
}

/// [`damped_then_dogleg`] as precisely as [`Smoother::optimize`] is by default.
fn optimum(smoother: &mut Smoother) -> Result<BatchReport, SmootherError> {
    damped_then_dogleg(smoother, BatchSettings::default().relative_decrease)
}
