//! The optimization at the end of a replay.

use std::time::Duration;

use clap::ValueEnum;
use evergraph::Replayer;
use evergraph::formats::Document;
use evergraph::replay::Compared;
use evergraph::solver::BatchReport;
use serde::Serialize;

use crate::error::Error;
use crate::table::number;

/// The start of the final batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FinalBatch {
    /// The estimate at the end of the replay
    Estimate,
    /// That and the chordal start
    Best,
}

/// A final batch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Finish {
    /// Of the estimate that was kept.
    pub report: BatchReport,
    pub compared: Option<Compared>,
    pub took: Duration,
}

/// Optimizes, from the start that is asked for.
pub(crate) fn finish(
    replayer: &mut Replayer,
    document: &Document,
    from: FinalBatch,
) -> Result<(BatchReport, Option<Compared>), Error> {
    match from {
        FinalBatch::Estimate => {
            let report = replayer.final_batch();
            Ok((report.map_err(|source| Error::unsolvable(replayer, source))?, None))
        }
        FinalBatch::Best => {
            let compared = replayer.final_batch_compared(document)?;
            let kept =
                if compared.took_chordal { compared.from_chordal } else { compared.from_estimate };
            Ok((kept, Some(compared)))
        }
    }
}

/// The two minima of a comparison.
pub(crate) fn describe(compared: &Compared) -> String {
    let (chordal, estimate) = (compared.from_chordal, compared.from_estimate);
    let error = number(chordal.error);
    if compared.took_chordal {
        return format!("error {error}, kept; from the estimate {}", number(estimate.error));
    }
    if chordal.error > estimate.error * (1.0 + 1e-6) {
        return format!("error {error}, higher: not kept");
    }
    format!("error {error}, the same minimum")
}
