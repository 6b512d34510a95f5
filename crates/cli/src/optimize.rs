//! `evergraph optimize`.

use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, ValueEnum};
use evergraph::Replayer;
use evergraph::solver::{BatchSettings, Method, Relinearization, Status as BatchStatus};
use serde_json::json;

use crate::error::Error;
use crate::fit;
use crate::options::{Common, Solving, StartFrom};
use crate::outputs::Outputs;
use crate::reading::Reading;
use crate::report::{self, Report, Run, Status, Times};
use crate::table::number;
use crate::warnings::{warn_of_landmarks, warn_of_weak_priors};

const EXAMPLES: &str = "\
Examples:
  evergraph optimize sphere2500.g2o --output map.g2o
  evergraph optimize manhattan.g2o --method dogleg --init odometry
  evergraph optimize sphere_mednoise.graph --init chordal --plot sphere.png
  evergraph optimize noisy.g2o --robust=pseudo-huber:1.0 --report out.json

initial_error and error count the file's factors only. An optimization that does not converge is
done, too (exit code 0): the status says so, and the estimate is the best point found.";

/// How steps are chosen.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum MethodName {
    /// Gauss-Newton; stops when a step would raise the error
    Gn,
    /// Levenberg-Marquardt
    Lm,
    /// Powell's dogleg
    Dogleg,
}

/// Where variables start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Init {
    /// The file's vertices; where it has none, odometry
    File,
    /// Composed along the edges
    Odometry,
    /// The least-squares solution with relaxed rotations, from the edges alone: for files whose own
    /// start is far off
    Chordal,
}

impl Init {
    fn name(self) -> &'static str {
        match self {
            Self::File => "file",
            Self::Odometry => "odometry",
            Self::Chordal => "chordal",
        }
    }
}

/// Solve a whole file at once.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    file: PathBuf,
    /// How steps are chosen
    #[arg(long, value_enum, default_value = "lm", help_heading = "Solving")]
    method: MethodName,
    /// Where variables start
    #[arg(long, value_enum, default_value = "file", help_heading = "Solving")]
    init: Init,
    /// Most linearizations
    #[arg(long, value_name = "N", default_value_t = BatchSettings::default().max_iterations, help_heading = "Solving")]
    max_iterations: u32,
    #[command(flatten)]
    solving: Solving,
    #[command(flatten)]
    outputs: Outputs,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let begun = Instant::now();
    let common = &arguments.common;
    let output = common.output();
    let settings = arguments.solving.settings(Relinearization::NEVER, common.threads());
    let method = match arguments.method {
        MethodName::Gn => Method::GaussNewton,
        MethodName::Lm => Method::LevenbergMarquardt,
        MethodName::Dogleg => Method::Dogleg,
    };
    let batch_settings =
        BatchSettings::default().with_method(method).with_max_iterations(arguments.max_iterations);

    let document = arguments.reading.read(&arguments.file, common)?;
    let outputs =
        arguments.outputs.prepare("optimize", &document, [common.report.as_deref(), None])?;
    let begins = Instant::now();
    let (document, from) = match arguments.init {
        Init::File => (document, StartFrom::File),
        Init::Odometry => (document, StartFrom::Odometry),
        Init::Chordal => {
            let start = evergraph::chordal(&document, &settings)?;
            (document.with_vertices(start)?, StartFrom::File)
        }
    };
    let mut took = begins.elapsed();
    let options = arguments.solving.replay_options(from);
    let mut replayer = Replayer::new(&document, &options, settings)?;
    let mut settings_json = arguments.solving.json(from, &settings)?;
    settings_json["initial"] = json!(arguments.init.name());
    settings_json["batch"] = serde_json::to_value(batch_settings)?;
    settings_json["reading"] = arguments.reading.json();
    let mut run = Run {
        command: "optimize",
        dataset: report::file_name(&arguments.file),
        settings: settings_json,
        time: Times::default(),
        relinearizations: 0,
        status: Status::Singular,
        peak_rss_mb: None,
    };

    let mut initial_error = None;
    let outcome = (|| {
        took += replayer.everything()?.update;
        let initial = replayer.objective_at_linearization();
        initial_error = Some(initial.map_err(|source| Error::unsolvable(&replayer, source))?.error);
        let start = Instant::now();
        let batch = replayer.smoother_mut().optimize(&batch_settings);
        took += start.elapsed();
        batch.map_err(|source| Error::unsolvable(&replayer, source))
    })();
    run.time = Times::of(&[took], begun.elapsed());
    run.peak_rss_mb = report::peak_rss_mb();
    let batch = match outcome {
        Ok(batch) => batch,
        Err(error) => {
            let error = error.with_gauge(arguments.solving.prior.0, &document);
            if error.is_singular() {
                let mut report = Report::new(&replayer, &document, run)?;
                report.add("iterations", 0);
                report.add("initial_error", json!(initial_error));
                report.add("gradient_norm", json!(null));
                report.add("message", error.to_string());
                report.save(common.report.as_deref())?;
            }
            return Err(error);
        }
    };
    let words = report::ended(batch.status);
    run.status = match batch.status {
        BatchStatus::Converged => Status::Converged,
        _ => Status::NotConverged,
    };
    run.relinearizations = batch.iterations as usize * replayer.graph().variable_count();
    let mut report = Report::new(&replayer, &document, run)?;
    report.add("iterations", batch.iterations);
    report.add("initial_error", json!(initial_error));
    report.add("gradient_norm", batch.gradient_norm);
    outputs.write(&replayer, &document, &report, None, output)?;
    report.save(common.report.as_deref())?;
    warn_of_landmarks(&replayer, output);
    warn_of_weak_priors(&replayer, output);
    let mut rows = report.table(&format!("{words} after {} iterations", batch.iterations));
    rows.add("initial error", initial_error.map_or_else(String::new, number));
    rows.add("gradient norm", format!("{:.3e} (largest component of J^T r)", batch.gradient_norm));
    output.result(&rows)?;
    fit::tell(&report.fit, common.verbose > 0, output)
}
