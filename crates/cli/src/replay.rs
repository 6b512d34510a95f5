//! `evergraph replay`.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use evergraph::Replayer;
use evergraph::formats::{Document, spell_id};
use evergraph::solver::{Settings, Status as BatchStatus};
use serde_json::json;
use tracing::info;

use crate::error::Error;
use crate::final_batch::{FinalBatch, Finish, describe, finish};
use crate::fit;
use crate::options::{Common, Policy, Solving, StartFrom};
use crate::output::Output;
use crate::outputs::Outputs;
use crate::progress::Progress;
use crate::reading::Reading;
use crate::report::{self, Report, Run, Status, Times};
use crate::steps::{StepLog, StepName, Totals};
use crate::warnings::{warn_of_landmarks, warn_of_weak_priors};

const EXAMPLES: &str = "\
Examples:
  evergraph replay                                  the sample that is compiled in
  evergraph replay manhattan.g2o --output map.g2o
  evergraph replay city10000.txt --report out.json --steps steps.csv
  evergraph replay sphere2500.g2o --relinearize every --relinearize-every 50
  evergraph replay noisy.g2o --robust=huber:1.0 --final-batch=best
  evergraph replay city10000.txt --plot city.png

Status:
  converged      to a local minimum, the one next to the estimates on the way. Without
                 --final-batch: one more Gauss-Newton step with everything relinearized would
                 lower the error by no more than 0.1 %
  not_converged  neither
  stopped        --max-steps ended the replay before the file did
  too_dense      a step would cost more than --largest-clique allows; the report is of the steps before
  singular       a step leaves some variable undetermined; the message says which";

/// A sample of the kind of Olson's M3500, made by `evergraph simulate`; see data/README.md.
const SAMPLE: &[u8] = include_bytes!("../../../data/manhattan3500.g2o");
const SAMPLE_NAME: &str = "manhattan3500.g2o";

/// By how much of the error a Gauss-Newton step may lower it where a replay counts as converged.
/// Linearization points lag behind by design, and three digits are what the default policy keeps.
const SETTLED: f64 = 1e-3;

/// Drive a file through the smoother step by step, as the robot recorded it.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file; without it, a sample that is compiled into the program
    file: Option<PathBuf>,
    #[command(flatten)]
    policy: Policy,
    #[command(flatten)]
    solving: Solving,
    /// Where new variables start
    #[arg(long, value_enum, default_value = "odometry", help_heading = "Solving")]
    initial: StartFrom,
    /// Solve everything to convergence at the end; `best` also from a chordal start, and the lower of the
    /// two minima is kept
    #[arg(
        long, value_enum, num_args = 0..=1, require_equals = true, default_missing_value = "estimate",
        value_name = "FROM", help_heading = "Solving"
    )]
    final_batch: Option<FinalBatch>,
    /// Ask for all estimates after every step, as a program does that needs the whole map each time;
    /// they are computed again where they have moved by more than 1e-3 (m or rad)
    #[arg(long, help_heading = "Solving")]
    full_estimate: bool,
    /// Stop before a step that would eliminate a clique of more than N scalars, or `none`. The time of a
    /// step grows with the cube of it, 2000 take about 0.4 s; wrong loop closures make such cliques
    #[arg(long, value_name = "none|N", default_value = "2000", value_parser = bound, help_heading = "Solving")]
    largest_clique: Bound,
    /// Stop after N steps
    #[arg(long, value_name = "N")]
    max_steps: Option<usize>,
    #[command(flatten)]
    outputs: Outputs,
    /// Write a line for each step
    #[arg(long, value_name = "FILE.csv", help_heading = "Output")]
    steps: Option<PathBuf>,
    /// Fill in the error column of --steps, which costs a look at every factor in every step
    #[arg(long, requires = "steps", help_heading = "Output")]
    step_errors: bool,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// The most scalars of a clique.
#[derive(Clone, Copy, Debug)]
struct Bound(Option<usize>);

fn bound(text: &str) -> Result<Bound, String> {
    match text {
        "none" => Ok(Bound(None)),
        _ => match text.parse() {
            Ok(scalars) if scalars > 0 => Ok(Bound(Some(scalars))),
            _ => Err("give a whole number above 0, or none".into()),
        },
    }
}

/// What the steps left behind.
#[derive(Default)]
struct Driven {
    kinds: Vec<StepName>,
    updates: Vec<Duration>,
    relinearizations: usize,
    refused: usize,
    batches: usize,
}

impl Driven {
    /// Kind and milliseconds of each step.
    fn times(&self) -> Vec<(StepName, f64)> {
        let ms = self.updates.iter().map(|it| 1e3 * it.as_secs_f64());
        self.kinds.iter().copied().zip(ms).collect()
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let begun = Instant::now();
    let common = &arguments.common;
    let output = common.output();
    let settings =
        arguments.solving.settings(arguments.policy.relinearization("replay")?, common.threads());
    let settings = settings.with_largest_clique(arguments.largest_clique.0);

    let (document, dataset) = read(arguments)?;
    let others = [common.report.as_deref(), arguments.steps.as_deref()];
    let outputs = arguments.outputs.prepare("replay", &document, others)?;
    let options = arguments.solving.replay_options(arguments.initial);
    let mut replayer =
        Replayer::new(&document, &options, settings)?.with_full_estimate(arguments.full_estimate);
    let total = replayer.replay().len();
    let progress =
        Progress::new(total.min(arguments.max_steps.unwrap_or(total)), output.is_interactive());

    let mut driven = Driven::default();
    let outcome = drive(&mut replayer, &document, arguments, &mut driven, progress)
        .map_err(|error| error.with_gauge(arguments.solving.prior.0, &document));
    let (cut, batch) = match &outcome {
        Ok((cut, batch)) => (*cut, *batch),
        Err(error) if error.is_singular() || error.is_too_dense() => (false, None),
        Err(_) => return outcome.map(drop),
    };
    let time = Times::of(&driven.updates, begun.elapsed());
    let peak_rss_mb = report::peak_rss_mb();
    let status = match (&outcome, cut, &batch) {
        (Err(error), ..) if error.is_too_dense() => Status::TooDense,
        (Err(_), ..) => Status::Singular,
        (_, true, _) => Status::Stopped,
        (.., Some(batch)) if batch.report.status == BatchStatus::Converged => Status::Converged,
        (.., Some(_)) => Status::NotConverged,
        // A system that cannot be solved once it is relinearized is no optimum either.
        (.., None) if replayer.is_settled(SETTLED).unwrap_or(false) => Status::Converged,
        (.., None) => Status::NotConverged,
    };
    let run = Run {
        command: "replay",
        dataset,
        settings: settings_json(arguments, &settings)?,
        time,
        relinearizations: driven.relinearizations
            + batch.map_or(0, |batch| {
                batch.report.iterations as usize * replayer.graph().variable_count()
            }),
        status,
        peak_rss_mb,
    };
    let mut report = Report::new(&replayer, &document, run)?;
    report.add("order", replayer.replay().order().to_string());
    report.add("updates", driven.updates.len());
    report.add("batches", driven.batches);
    if let Some(Finish { report: batch, compared, took }) = &batch {
        let mut value = serde_json::to_value(batch)?;
        value["compared"] = serde_json::to_value(compared)?;
        value["seconds"] = json!(took.as_secs_f64());
        report.add("final_batch", value);
    }
    if let Err(error) = &outcome {
        report.add("message", error.to_string());
    }
    if outcome.is_ok() {
        outputs.write(&replayer, &document, &report, Some(driven.times()), output)?;
    }
    report.save(common.report.as_deref())?;
    outcome?;
    warn(&replayer, &driven, output);
    let mut rows = report.table(&in_words(&report, cut, &batch));
    rows.add("order", replayer.replay().order());
    if let Some(compared) = batch.and_then(|batch| batch.compared) {
        rows.add("chordal start", describe(&compared));
    }
    output.result(&rows)?;
    fit::tell(&report.fit, common.verbose > 0, output)
}

fn read(arguments: &Arguments) -> Result<(Document, String), Error> {
    match &arguments.file {
        Some(path) => {
            Ok((arguments.reading.read(path, &arguments.common)?, report::file_name(path)))
        }
        None => {
            if is_piped_in() {
                arguments.common.output().warn(
                    &"standard input is not read: the sample is replayed. Name `-` as the file to replay \
                     what is piped in",
                );
            }
            let options = arguments.reading.options(&arguments.common);
            Ok((Document::parse(SAMPLE_NAME, SAMPLE, &options)?, SAMPLE_NAME.into()))
        }
    }
}

/// True if something is piped into the program.
#[cfg(unix)]
fn is_piped_in() -> bool {
    use std::os::unix::fs::FileTypeExt;
    let kind = std::fs::metadata("/dev/stdin").map(|input| input.file_type());
    kind.is_ok_and(|kind| kind.is_fifo() || kind.is_file())
}

#[cfg(not(unix))]
fn is_piped_in() -> bool {
    false
}

/// True if steps are left, and the final batch.
type Finished = (bool, Option<Finish>);

/// Applies the steps and, if asked for, the final batch. Says whether steps are left.
fn drive(
    replayer: &mut Replayer,
    document: &Document,
    arguments: &Arguments,
    driven: &mut Driven,
    mut progress: Progress,
) -> Result<Finished, Error> {
    let mut log = arguments.steps.as_deref().map(StepLog::create).transpose()?;
    let outcome = apply_steps(replayer, arguments, driven, &mut progress, log.as_mut());
    if outcome.is_err() {
        progress.finish();
    }
    // A replay that was refused a step leaves the steps before it.
    log.map_or(Ok(()), StepLog::finish)?;
    let cut = outcome?;
    let batch = if let Some(from) = arguments.final_batch {
        progress.say("final batch");
        let start = Instant::now();
        let result = finish(replayer, document, from);
        progress.finish();
        let (report, compared) = result?;
        Some(Finish { report, compared, took: start.elapsed() })
    } else {
        None
    };
    progress.finish();
    Ok((cut, batch))
}

fn apply_steps(
    replayer: &mut Replayer,
    arguments: &Arguments,
    driven: &mut Driven,
    progress: &mut Progress,
    mut log: Option<&mut StepLog>,
) -> Result<bool, Error> {
    let total = replayer.replay().len();
    let limit = arguments.max_steps.unwrap_or(total).min(total);
    let mut totals = Totals { step: 0, variables: 0, factors: 0 };
    while totals.step < limit {
        let Some(done) = replayer.step()? else { break };
        totals.step += 1;
        totals.variables += done.step.variables;
        totals.factors += done.step.factors;
        driven.kinds.push(StepName::of(&done));
        driven.updates.push(done.update);
        driven.relinearizations += done.report.variables_relinearized;
        driven.refused += usize::from(done.report.relinearization_refused.is_some());
        driven.batches += usize::from(done.report.batch.is_some());
        if let Some(log) = log.as_deref_mut() {
            let error = arguments.step_errors.then(|| replayer.error()).transpose();
            let error = error.map_err(|source| Error::unsolvable(replayer, source))?;
            log.add(&done, totals, error)?;
        }
        progress.step(|| replayer.error());
    }
    Ok(totals.step < total)
}

fn settings_json(arguments: &Arguments, settings: &Settings) -> Result<serde_json::Value, Error> {
    let mut value = arguments.solving.json(arguments.initial, settings)?;
    value["reading"] = arguments.reading.json();
    value["full_estimate"] = json!(arguments.full_estimate);
    value["final_batch"] = json!(arguments.final_batch);
    value["max_steps"] = json!(arguments.max_steps);
    Ok(value)
}

fn warn(replayer: &Replayer, driven: &Driven, output: Output) {
    if driven.refused > 0 {
        output.warn(&format!(
            "{} relinearizations would have given a system that cannot be solved and were left out",
            driven.refused
        ));
    }
    warn_of_landmarks(replayer, output);
    warn_of_weak_priors(replayer, output);
    for prior in replayer.replay().gauge_priors() {
        info!(
            "gauge prior on pose {} (first of its component), sigma {}",
            spell_id(prior.id),
            prior.sigma
        );
    }
}

fn in_words(report: &Report, cut: bool, batch: &Option<Finish>) -> String {
    match (cut, batch) {
        (true, _) => "stopped (--max-steps)".into(),
        (_, Some(Finish { report: batch, took, .. })) => {
            let how = report::ended(batch.status);
            format!(
                "{how} in {} iterations of the final batch, {:.3} s",
                batch.iterations,
                took.as_secs_f64()
            )
        }
        _ if report.status == Status::Converged => {
            "converged to a local minimum, one step gains < 0.1 %".into()
        }
        _ => "not converged (one more step gains > 0.1 %): use --final-batch".into(),
    }
}
