//! Options that several subcommands share.

use std::ffi::OsString;
use std::num::NonZeroU32;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::{ArgAction, Args, ValueEnum};
use evergraph::model::Kernel;
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::{Elimination, Relinearization, Settings};

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

/// The gauge prior, as an option.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior(pub Option<f64>);

fn prior(text: &str) -> Result<Prior, String> {
    if text == "none" {
        return Ok(Prior(None));
    }
    match text.parse::<f64>() {
        Ok(sigma) if SIGMAS.contains(&sigma) => Ok(Prior(Some(sigma))),
        _ => Err("give `none` or a standard deviation between 1e-75 and 1e75 (m and rad)".into()),
    }
}

/// Whose fourth powers, and their inverses, are numbers.
const SIGMAS: RangeInclusive<f64> = 1e-75..=1e75;

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

/// A kernel that stands apart from its option, as in `--robust huber FILE`: it would be taken for the file.
pub(crate) fn detached_kernel(arguments: impl Iterator<Item = OsString>) -> Option<String> {
    let arguments: Vec<OsString> = arguments.collect();
    let after = arguments.windows(2).find(|pair| pair[0] == "--robust")?[1].to_str()?;
    (kernel(after).is_ok() && !Path::new(after).exists()).then(|| after.into())
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
    /// For ill-conditioned graphs; weights may be up to 1e22 apart
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
    /// Relinearize large moves at a check every 10 steps, all moves at a sweep every 100, spread over 10
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
