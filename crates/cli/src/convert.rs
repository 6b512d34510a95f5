//! `evergraph convert`.

use std::path::{Path, PathBuf};

use clap::Args;
use evergraph::formats::WriteOptions;
use serde_json::json;

use crate::error::Error;
use crate::files::{self, Saved};
use crate::options::Common;
use crate::output::Output;
use crate::reading::Reading;
use crate::report::{self, SCHEMA};

const EXAMPLES: &str = "\
Examples:
  evergraph convert manhattan.txt manhattan.g2o
  evergraph convert killian.g2o killian.graph
  evergraph convert victoria_park_gtsam.txt park.g2o --isam-matrix covariance

The format that is written goes by the extension: .g2o, .graph and .toro (TORO), .txt (iSAM),
.pyfg (PyFactorGraph). The same format as read gives the same numbers, bit for bit.";

/// Write a file in another format.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    input: PathBuf,
    /// What to write; the format goes by the extension
    output: PathBuf,
    /// Leave out what other readers of the format do not know: lines of our own, robust kernels
    #[arg(long, help_heading = "Output")]
    plain: bool,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let common = &arguments.common;
    let output = common.output();
    let document = arguments.reading.read(&arguments.input, common)?;
    let options = WriteOptions::default().with_plain(arguments.plain);
    let saved = files::write_document(&arguments.output, &document, options)?;
    tell(&saved, &arguments.output, output);
    let written = &saved.written;
    let report = json!({
        "schema": SCHEMA,
        "command": "convert",
        "dataset": report::file_name(&arguments.input),
        "output": arguments.output.display().to_string(),
        "from": document.dialect().to_string(),
        "lines": written.lines,
        "dropped_vertices": written.dropped_vertices,
        "added_vertices": saved.added_vertices,
        "renumbered_landmarks": written.renumbered_landmarks,
        "named": written.named,
        "added_times": written.added_times,
        "dropped_times": written.dropped_times,
        "left_out": written.left_out,
        "skipped_lines": document.summary().skipped,
    });
    report::save(common.report.as_deref(), &report)?;
    output.result(&format!(
        "{}: {} lines, from {} ({})",
        arguments.output.display(),
        written.lines,
        arguments.input.display(),
        document.dialect()
    ))
}

/// Warns about what a written file does not hold as its source does.
pub(crate) fn tell(saved: &Saved, path: &Path, output: Output) {
    let (path, written) = (path.display(), &saved.written);
    if written.dropped_vertices > 0 {
        let count = written.dropped_vertices;
        output.warn(&format!("{path}: the format has no lines for {count} vertices; left out"));
    }
    if saved.added_vertices > 0 {
        let count = saved.added_vertices;
        output.warn(&format!(
            "{path}: {count} vertices that the format needs were composed from the measurements"
        ));
    }
    if written.renumbered_landmarks > 0 {
        let count = written.renumbered_landmarks;
        output.warn(&format!(
            "{path}: {count} landmarks whose ids are poses', too, got ids after all others"
        ));
    }
    if written.named > 0 {
        let count = written.named;
        output.warn(&format!(
            "{path}: {count} ids became names, as A5 for pose 5, L5 for landmark 5"
        ));
    }
    if written.added_times > 0 {
        let count = written.added_times;
        output.warn(&format!("{path}: {count} lines got a time, the rank of their pose"));
    }
    if written.dropped_times > 0 {
        let count = written.dropped_times;
        output.warn(&format!("{path}: the format has no times; {count} were left out"));
    }
    for (tag, count) in &written.left_out {
        output.warn(&format!("{path}: {count} {tag} left out, which --plain does without"));
    }
}
