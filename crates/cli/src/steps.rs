//! `--steps`: a line of CSV for each step of a replay.

use std::fmt::Write;
use std::path::Path;

use evergraph::Replayed;
use evergraph::replay::StepKind;

use crate::error::Error;
use crate::files::NewFile;

/// What a step was, in a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StepName {
    Explore,
    Loop,
    Batch,
}

impl StepName {
    pub(crate) fn of(done: &Replayed) -> Self {
        match (&done.report.batch, done.step.kind) {
            (Some(_), _) => Self::Batch,
            (None, StepKind::Loop) => Self::Loop,
            (None, _) => Self::Explore,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Explore => "explore",
            Self::Loop => "loop",
            Self::Batch => "batch",
        }
    }
}

/// The file of steps.
#[derive(Debug)]
pub(crate) struct StepLog {
    file: NewFile,
    line: String,
}

/// Totals after a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Totals {
    pub step: usize,
    pub variables: usize,
    pub factors: usize,
}

impl StepLog {
    pub(crate) fn create(path: &Path) -> Result<Self, Error> {
        let mut file = NewFile::create(path)?;
        file.write(
            "step,kind,variables,factors,update_ms,cliques_eliminated,variables_relinearized,error\n",
        )?;
        Ok(Self { file, line: String::new() })
    }

    /// Appends a step; the error column is empty without `error`.
    pub(crate) fn add(
        &mut self,
        done: &Replayed,
        totals: Totals,
        error: Option<f64>,
    ) -> Result<(), Error> {
        let kind = StepName::of(done).name();
        let Totals { step, variables, factors } = totals;
        let ms = 1e3 * done.update.as_secs_f64();
        let (cliques, moved) = (done.report.cliques_eliminated, done.report.variables_relinearized);
        let error = error.map_or_else(String::new, |error| error.to_string());
        self.line.clear();
        // Writing to a string cannot fail.
        let _ = writeln!(
            self.line,
            "{step},{kind},{variables},{factors},{ms},{cliques},{moved},{error}"
        );
        self.file.write(&self.line)
    }

    pub(crate) fn finish(self) -> Result<(), Error> {
        self.file.finish()
    }
}
