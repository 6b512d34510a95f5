//! Options that several subcommands share.

use std::io::{self, Read};
use std::num::NonZeroU32;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{ArgAction, Args, ValueEnum};
use evergraph::evaluate::Map;
use evergraph::formats::{
    Dialect, Document, G2oRotation, ReadOptions, TrajectoryFormat, WeightKind,
};
use evergraph::model::Kernel;
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::{Elimination, Relinearization, Settings};
use tracing::info;

use crate::error::Error;
use crate::output::Output;

/// What every subcommand takes.
#[derive(Args, Clone, Debug)]
pub(crate) struct Common {
    /// Write what happened as JSON
    #[arg(long, value_name = "FILE.json", help_heading = "Output")]
    pub report: Option<PathBuf>,
    /// Say nothing but errors: no bar, no table, no warnings
    #[arg(long, short, help_heading = "Output")]
    pub quiet: bool,
    /// Say what happens, on standard error; twice for details. RUST_LOG=evergraph_solver=debug and
    /// the like choose what
    #[arg(long, short, action = ArgAction::Count, conflicts_with = "quiet", help_heading = "Output")]
    pub verbose: u8,
    /// Threads; results do not depend on it [default: the cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Skip bad lines, count and list them, instead of stopping at the first
    #[arg(long, help_heading = "Reading")]
    pub lenient: bool,
}

impl Common {
    /// Results and warnings, as far as they are asked for.
    pub(crate) fn output(&self) -> Output {
        Output::new(self.quiet, self.verbose > 0)
    }

    pub(crate) fn threads(&self) -> usize {
        let cores = || std::thread::available_parallelism().map_or(1, usize::from).min(1024);
        self.threads.map_or_else(cores, usize::from)
    }
}

/// The path of a graph. The name of a kernel in its place was meant for the option before it.
pub(crate) fn graph_path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match path.to_str() {
        Some(text) if kernel(text).is_ok() && !path.exists() => Err(format!(
            "there is no such file; a kernel is joined to its option by `=`: --robust={text}"
        )),
        _ => Ok(path),
    })
}

/// How files are read.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Reading")]
pub(crate) struct Reading {
    /// The format; told by content if not given
    #[arg(long, value_name = "g2o|toro|isam|pyfg")]
    pub format: Option<Dialect>,
    /// What the matrices of an iSAM file are: nothing in the file says so
    #[arg(long, value_name = "sqrt|information|covariance", default_value = "sqrt", value_parser = weight_kind)]
    pub isam_matrix: WeightKind,
    /// The unit of rotation weights in 3D g2o files: of the angle, or g2o's own, of the
    /// quaternion's vector part
    #[arg(long, value_name = "angle|quaternion", default_value = "angle", value_parser = rotation)]
    pub g2o_rotation: G2oRotation,
}

fn weight_kind(name: &str) -> Result<WeightKind, String> {
    name.parse()
}

fn rotation(name: &str) -> Result<G2oRotation, String> {
    name.parse()
}

impl Reading {
    /// Reads a map to be measured, or to measure by, and warns about what is odd in it.
    pub(crate) fn read_map(&self, path: &Path, common: &Common) -> Result<Map, Error> {
        match TrajectoryFormat::of_content(path)? {
            Some(format) => Ok(Map::read(path, Some(format), &self.options(common))?),
            None => Ok(Map::of_document(&self.read(path, common)?)?),
        }
    }

    /// Reads a file and warns about what is odd in it.
    pub(crate) fn read(&self, path: &Path, common: &Common) -> Result<Document, Error> {
        let document = self.parse(path, &self.options(common))?;
        let (name, summary) = (document.name(), document.summary());
        let (lines, poses, landmarks) = (summary.lines, summary.poses, summary.landmarks);
        info!(lines, poses, landmarks, "read {name} ({})", document.dialect());
        tell(&document, common.output());
        Ok(document)
    }

    /// Reads a file, or standard input for `-`. After an error of a line the others are counted.
    fn parse(&self, path: &Path, options: &ReadOptions) -> Result<Document, Error> {
        let piped = if path == Path::new(STANDARD_INPUT) {
            let mut bytes = Vec::new();
            let failed = |source| Error::Read { path: "standard input".into(), source };
            io::stdin().lock().read_to_end(&mut bytes).map_err(failed)?;
            Some(bytes)
        } else {
            None
        };
        let read = |options: &ReadOptions| match &piped {
            Some(bytes) => Document::read_stream("standard input", &**bytes, options),
            None => Document::read(path, options),
        };
        let error = match read(options) {
            Ok(document) => return Ok(document),
            Err(error) => error,
        };
        // A pipe that has a name, as of `<(...)`, cannot be read twice.
        let again = piped.is_some() || path.is_file();
        let lenient = options.clone().with_lenient(true);
        let bad = match again && error.place().is_some() && !options.lenient {
            true => read(&lenient).map_or(0, |document| document.summary().skipped),
            false => 0,
        };
        match bad {
            0 => Err(error.into()),
            bad => Err(Error::BadLines { first: Box::new(error), more: bad - 1 }),
        }
    }

    pub(crate) fn options(&self, common: &Common) -> ReadOptions {
        ReadOptions::default()
            .with_format(self.format)
            .with_isam_matrix(self.isam_matrix)
            .with_g2o_rotation(self.g2o_rotation)
            .with_lenient(common.lenient)
    }

    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "format": self.format.map(Dialect::name),
            "isam_matrix": self.isam_matrix.name(),
            "g2o_rotation": self.g2o_rotation.name(),
        })
    }
}

/// Names standard input where a file is asked for.
pub(crate) const STANDARD_INPUT: &str = "-";

/// Bad lines that are listed without `--verbose`.
const LISTED: usize = 10;

fn tell(document: &Document, output: Output) {
    for warning in document.summary().warnings() {
        output.warn(&format!("{}: {warning}", document.name()));
    }
    for (at, skipped) in document.skipped().iter().enumerate() {
        if at < LISTED {
            output.warn(&format!("skipped {}", skipped.error));
        } else {
            info!("skipped {}", skipped.error);
        }
    }
    if document.skipped().len() > LISTED {
        let more = document.summary().skipped - LISTED;
        output.warn(&format!("{more} more bad lines were skipped; --verbose lists them"));
    }
    let summary = document.summary();
    let factors = summary.pose_edges + summary.landmark_edges + summary.measurements;
    if factors == 0 {
        output.warn(&format!("{}: there are no measurements in it", document.name()));
    }
    for (tag, count) in &document.summary().ignored {
        output.warn(&format!(
            "{}: {count} {tag} lines were passed over; Evergraph has no factor for them",
            document.name()
        ));
    }
}

/// The gauge prior, as an option.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior(pub Option<f64>);

fn prior(text: &str) -> Result<Prior, String> {
    if text == "none" {
        return Ok(Prior(None));
    }
    match text.parse::<f64>() {
        Ok(sigma) if SIGMAS.contains(&sigma) => Ok(Prior(Some(sigma))),
        _ => Err("give `none` or a standard deviation between 1e-150 and 1e150 (m and rad)".into()),
    }
}

/// Whose squares, and their inverses, are numbers.
const SIGMAS: RangeInclusive<f64> = 1e-150..=1e150;

/// Where the linear part of a kernel begins when not told: 95 % of the efficiency of least squares
/// on noise without outliers (Huber 1981).
const THRESHOLD: f64 = 1.345;

fn kernel(text: &str) -> Result<Kernel, String> {
    let (name, threshold) = match text.split_once(':') {
        Some((name, threshold)) => {
            (name, threshold.parse().map_err(|_| format!("`{threshold}` is no number"))?)
        }
        None => (text, THRESHOLD),
    };
    let kernel = match name {
        "huber" => Kernel::huber(threshold),
        "pseudo-huber" => Kernel::pseudo_huber(threshold),
        _ => return Err(format!("`{name}` is no kernel; there are huber and pseudo-huber")),
    };
    kernel.map_err(|error| error.to_string())
}

/// A kernel as the option spells it.
fn spelled(kernel: &Kernel) -> String {
    let name = match kernel {
        Kernel::Huber { .. } => "huber",
        Kernel::PseudoHuber { .. } => "pseudo-huber",
    };
    format!("{name}:{}", kernel.threshold())
}

/// Where variables start.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum StartFrom {
    /// Composed along the edges
    Odometry,
    /// The file's vertices; where it has none, odometry
    File,
}

impl StartFrom {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::File => "file",
        }
    }

    pub(crate) fn initial(self) -> Initial {
        match self {
            Self::Odometry => Initial::FromOdometry,
            Self::File => Initial::FromFile,
        }
    }
}

/// How cliques are eliminated.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum EliminationName {
    /// Fast; falls back to QR where a pivot has lost its digits
    Cholesky,
    /// For ill-conditioned graphs
    Qr,
}

/// How the problem is posed and solved.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Solving")]
pub(crate) struct Solving {
    /// How cliques are eliminated
    #[arg(long, value_enum, default_value = "cholesky")]
    pub elimination: EliminationName,
    /// Robust kernel around every edge that has none of its own in the file: huber or pseudo-huber,
    /// with a threshold in standard deviations if not 1.345, as in --robust=huber:1.0. Never around
    /// linear factors (FACTOR_LINEAR), which stand for many edges at the weights that those had
    /// [without a value: huber]
    #[arg(long, value_name = "KERNEL", num_args = 0..=1, require_equals = true, default_missing_value = "huber", value_parser = kernel)]
    pub robust: Option<Kernel>,
    /// Former name of --robust
    #[arg(long, value_name = "KERNEL", hide = true, conflicts_with = "robust", value_parser = kernel)]
    pub kernel: Option<Kernel>,
    /// Standard deviation (m, rad) of the prior that holds the first pose of each component, or
    /// `none`
    #[arg(long, value_name = "none|SIGMA", default_value = "0.01", allow_negative_numbers = true, value_parser = prior)]
    pub prior: Prior,
}

impl Solving {
    fn kernel(&self) -> Option<Kernel> {
        self.robust.or(self.kernel)
    }

    pub(crate) fn replay_options(&self, start: StartFrom) -> ReplayOptions {
        ReplayOptions::default()
            .with_prior(self.prior.0)
            .with_initial(start.initial())
            .with_kernel(self.kernel())
    }

    pub(crate) fn settings(&self, relinearization: Relinearization, threads: usize) -> Settings {
        let elimination = match self.elimination {
            EliminationName::Cholesky => Elimination::Cholesky,
            EliminationName::Qr => Elimination::Qr,
        };
        Settings::default()
            .with_elimination(elimination)
            .with_relinearization(relinearization)
            .with_threads(threads)
    }

    pub(crate) fn json(
        &self,
        start: StartFrom,
        settings: &Settings,
    ) -> Result<serde_json::Value, Error> {
        Ok(serde_json::json!({
            "solver": serde_json::to_value(settings)?,
            "kernel": self.kernel().as_ref().map(spelled),
            "prior_sigma": self.prior.0,
            "initial": start.name(),
        }))
    }
}

/// Which relinearization policy to start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PolicyName {
    /// What moved far every 10 steps, what moved at all every 100, sweeps spread over 10
    Both,
    /// A batch to convergence every 100 steps
    Every,
    /// Only what moved far, every 10 steps
    Fluid,
    /// A batch to convergence every 50 steps on another thread, taken over 25 steps later
    Background,
    /// Linearization points stay at the start values
    Never,
}

/// When linearization points move.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Relinearization")]
pub(crate) struct Policy {
    /// The policy
    #[arg(long, value_enum, default_value = "both")]
    pub relinearize: PolicyName,
    /// A batch to convergence every N steps, besides the rest of the policy
    #[arg(long, value_name = "N", value_parser = steps)]
    pub relinearize_every: Option<NonZeroU32>,
    /// How far an estimate may move (m, rad) before it is relinearized, with all that moved about a third
    /// as far [default: 0.25]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = threshold)]
    pub relinearize_threshold: Option<f64>,
    /// Look for what moved far every N steps [default: 10]
    #[arg(long, value_name = "N", value_parser = steps)]
    pub fluid_every: Option<NonZeroU32>,
    /// Spread the work of a sweep over N steps [default: 10]
    #[arg(long, value_name = "N", value_parser = steps)]
    pub relinearize_spread: Option<NonZeroU32>,
}

fn steps(text: &str) -> Result<NonZeroU32, String> {
    let steps = text.parse::<u32>().ok().and_then(NonZeroU32::new);
    steps.ok_or_else(|| format!("give a number of steps from 1 to {}", u32::MAX))
}

fn threshold(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x >= 0.0 && x.is_finite() => Ok(x),
        _ => Err("give a number, at least 0".into()),
    }
}

/// How often `--relinearize every` relinearizes when not told, as iSAM does.
const BATCH_EVERY: NonZeroU32 = NonZeroU32::new(100).expect("100 is not 0");

impl Policy {
    /// The policy; `command` is asked for it, for messages.
    pub(crate) fn relinearization(&self, command: &'static str) -> Result<Relinearization, Error> {
        let mut policy = match self.relinearize {
            PolicyName::Both => Relinearization::BOTH,
            PolicyName::Every => Relinearization::every(BATCH_EVERY),
            PolicyName::Fluid => Relinearization::FLUID,
            PolicyName::Background => Relinearization::BACKGROUND,
            PolicyName::Never => Relinearization::NEVER,
        };
        if let Some(every) = self.relinearize_every {
            policy.batch = Some(every);
        }
        if let Some(spread) = self.relinearize_spread {
            policy.spread = spread;
        }
        let tuned = self.relinearize_threshold.is_some() || self.fluid_every.is_some();
        match &mut policy.fluid {
            Some(fluid) => {
                *fluid = fluid
                    .with_threshold(self.relinearize_threshold.unwrap_or(fluid.threshold))
                    .with_every(self.fluid_every.unwrap_or(fluid.every));
                // The sweep is the finer of the two.
                if let Some(sweep) = &mut policy.sweep {
                    sweep.threshold = sweep.threshold.min(fluid.share * fluid.threshold);
                }
            }
            None if tuned => {
                let message = "--relinearize-threshold and --fluid-every tune the policies `both` and `fluid`; \
                               the policy asked for has no such check";
                return Err(Error::Usage { command, message: message.into() });
            }
            None => {}
        }
        Ok(policy)
    }
}
