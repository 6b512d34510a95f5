//! `evergraph audit`.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use evergraph::Replayer;
use evergraph::replay::{Audit, AuditSample};
use evergraph::solver::Status as BatchStatus;
use serde_json::json;

use crate::error::Error;
use crate::files;
use crate::options::{Common, Policy, Solving, StartFrom};
use crate::progress::Progress;
use crate::reading::Reading;
use crate::report::{self, SCHEMA};
use crate::table::{CONVENTION, Rows, milliseconds, number};
use crate::warnings::warn_of_landmarks;

const EXAMPLES: &str = "\
Examples:
  evergraph audit manhattan.g2o
  evergraph audit city10000.txt --every 500 --steps excess.csv
  evergraph audit sphere2500.g2o --relinearize fluid --relinearize-threshold 0.1 --report out.json

At every N-th step, and at the last, a copy is optimized from the estimate to convergence. The
relative excess is (error - optimum) / optimum over the file's factors: what the estimate of that
moment lacks. An estimate in the basin of another, worse optimum does not show.";

/// Replay a file and compare with the batch optimum along the way.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    file: PathBuf,
    /// Compare at every N-th step, and at the last
    #[arg(long, value_name = "N", default_value = "100")]
    every: NonZeroUsize,
    #[command(flatten)]
    policy: Policy,
    #[command(flatten)]
    solving: Solving,
    /// Where new variables start
    #[arg(long, value_enum, default_value = "odometry", help_heading = "Solving")]
    initial: StartFrom,
    /// Write a line for each comparison
    #[arg(long, value_name = "FILE.csv", help_heading = "Output")]
    steps: Option<PathBuf>,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let begun = Instant::now();
    let common = &arguments.common;
    let output = common.output();
    let settings =
        arguments.solving.settings(arguments.policy.relinearization("audit")?, common.threads());
    let document = arguments.reading.read(&arguments.file, common)?;
    let targets = || [&arguments.steps, &common.report].into_iter().flatten();
    files::check_distinct("audit", targets().map(PathBuf::as_path))?;
    for path in targets() {
        files::check_writable(path)?;
    }
    let options = arguments.solving.replay_options(arguments.initial);
    let mut replayer = Replayer::new(&document, &options, settings)?;
    let progress = Progress::new(replayer.replay().len(), output.is_interactive());
    let audit = compare(&mut replayer, arguments.every.get(), progress)
        .map_err(|error| error.with_gauge(arguments.solving.prior.0, &document))?;

    let total_s = begun.elapsed().as_secs_f64();
    if let Some(path) = &arguments.steps {
        write_steps(path, &audit)?;
    }
    let unfinished = audit.samples().iter().filter(|it| it.status != BatchStatus::Converged);
    let unfinished = unfinished.count();
    let dataset = report::file_name(&arguments.file);
    let mut settings_json = arguments.solving.json(arguments.initial, &settings)?;
    settings_json["reading"] = arguments.reading.json();
    let report = json!({
        "schema": SCHEMA,
        "command": "audit",
        "dataset": dataset,
        "steps": replayer.poses(),
        "every": arguments.every,
        "settings": settings_json,
        "convention": CONVENTION,
        "mean_relative_excess": audit.mean(),
        "worst": audit.worst(),
        "not_converged": unfinished,
        "samples": audit.samples(),
        "time": { "total_s": total_s },
    });
    report::save(common.report.as_deref(), &report)?;
    warn_of_landmarks(&replayer, output);

    let mut rows = Rows::new("data set", &dataset);
    rows.add("steps (poses)", replayer.poses());
    rows.add(
        "compared",
        format!("{} times, every {} steps", audit.samples().len(), arguments.every),
    );
    rows.add("excess, mean", audit.mean().map_or_else(|| "none".into(), percent));
    rows.add("excess, worst", audit.worst().map_or_else(|| "none".into(), describe));
    rows.add("excess, last", audit.samples().last().map_or_else(|| "none".into(), describe));
    rows.add("convention", "(error - optimum) / optimum over the file's factors,");
    rows.add("", "error = 1/2 sum |r|^2 (robust: sum rho), r = whitened Log(z^-1 xi^-1 xj)");
    if unfinished > 0 {
        rows.add(
            "not converged",
            format!("{unfinished} optimizations; there the excess is a lower bound"),
        );
    }
    rows.add("total time", milliseconds(1e3 * total_s));
    output.result(&rows)
}

/// Replays to the end; compares at every `every`-th step and at the last.
fn compare(replayer: &mut Replayer, every: usize, mut progress: Progress) -> Result<Audit, Error> {
    let mut audit = Audit::new();
    let outcome = (|| {
        let total = replayer.replay().len();
        let mut step = 0;
        while replayer.step()?.is_some() {
            step += 1;
            if step % every == 0 || step == total {
                let sample = replayer.audit_sample();
                audit.push(sample.map_err(|source| Error::unsolvable(replayer, source))?);
            }
            progress.step(|| replayer.error());
        }
        Ok(())
    })();
    progress.finish();
    outcome.map(|()| audit)
}

fn write_steps(path: &Path, audit: &Audit) -> Result<(), Error> {
    let mut text = String::from("step,error,optimum,relative_excess,status\n");
    for sample in audit.samples() {
        let AuditSample { step, error, optimum, relative_excess, status, .. } = sample;
        let excess = relative_excess.map_or_else(String::new, |it| it.to_string());
        let status = report::status_name(status);
        text.push_str(&format!("{step},{error},{optimum},{excess},{status}\n"));
    }
    files::write_text(path, &text)
}

fn describe(sample: &AuditSample) -> String {
    let AuditSample { step, error, optimum, relative_excess, .. } = sample;
    let excess = relative_excess.map_or_else(|| "none".into(), percent);
    format!("{excess} at step {step}: error {}, optimum {}", number(*error), number(*optimum))
}

fn percent(share: f64) -> String {
    format!("{} %", number(100.0 * share))
}
