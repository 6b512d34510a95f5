//! What can go wrong, and what the program says and returns then.

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::error::ErrorKind;
use evergraph::evaluate::{DivergenceError, EvaluateError, ReducedError};
use evergraph::formats::{Document, FormatError, TrajectoryError, spell_id};
use evergraph::simulate::WorldError;
use evergraph::solver::Singular;
use evergraph::{Component, Overview, Replayer, ReplayerError, SmootherError, ThinningError};
use thiserror::Error;

use crate::stderr;

/// Why the program stops.
#[derive(Debug, Error)]
pub(crate) enum Error {
    /// Nothing holds a component, as was asked for.
    #[error(
        "{file}: with `--prior none` nothing says where the connected component of pose {} lies \
         ({} poses, {} landmarks). Leave `--prior` out, or give it a standard deviation. \
         In full: {details}",
        spell_id(component.first), component.poses, component.landmarks
    )]
    NoGauge { file: String, component: Component, details: String },
    /// The file is bad.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A trajectory cannot be written, or its times are bad.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// Something cannot be evaluated.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// A step of a replay was refused.
    #[error(transparent)]
    Replay(#[from] ReplayerError),
    /// The problem cannot be solved.
    #[error("{file}: {message}")]
    Unsolvable { file: String, message: String, source: Box<SmootherError> },
    /// Nodes cannot be removed.
    #[error("{file}: {message}")]
    Removal { file: String, message: String, source: Box<ThinningError> },
    /// No node was chosen.
    #[error(
        "{file}: nothing is to be removed: of its {variables} variables the choice takes none; ask for a \
         larger share. The pose that holds the gauge stays in any case"
    )]
    NothingToRemove { file: String, variables: usize },
    /// A list of nodes is bad.
    #[error("{}:{line}: {problem}", path.display())]
    List { path: PathBuf, line: usize, problem: String },
    /// Two graphs cannot be compared.
    #[error("{file}: {message}")]
    Incomparable { file: String, message: String, source: Box<DivergenceError> },
    /// A reduced graph does not fit the full one.
    #[error(transparent)]
    NotReduced(#[from] ReducedError),
    /// Lines of a file that make no sense.
    #[error("{first}{}. `--lenient` skips such lines and lists them", and_more(*more))]
    BadLines { first: Box<FormatError>, more: usize },
    /// A file could not be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// The world that was asked for cannot be.
    #[error("the world cannot be made: {0}")]
    World(#[from] WorldError),
    /// A file could not be written.
    #[error("{}: cannot be written: {source}; nothing was put in its place", path.display())]
    Write { path: PathBuf, source: io::Error },
    /// A picture could not be drawn.
    #[cfg(feature = "png")]
    #[error("{}: cannot be drawn: {reason}; nothing was put in its place", path.display())]
    Draw { path: PathBuf, reason: String },
    /// The map costs more than a number can say.
    #[error(
        "{file}: the error of the map is not finite; most of it comes from line {line}. Check the \
         measurement and the weights there: squares above 1e308 do not fit 64-bit numbers"
    )]
    Overflow { file: String, line: usize },
    /// A report could not be expressed.
    #[error("the report cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// Standard output does not take any more.
    #[error("the result cannot be printed: {0}")]
    Print(#[source] io::Error),
    /// Options that do not go together.
    #[error("{message}")]
    Usage { command: &'static str, message: String },
}

fn and_more(lines: usize) -> String {
    match lines {
        0 => String::new(),
        1 => "; 1 more line cannot be read".into(),
        more => format!("; {more} more lines cannot be read"),
    }
}

impl Error {
    /// An error of a solver call that is no step, in the ids of the file.
    pub(crate) fn unsolvable(replayer: &Replayer, source: SmootherError) -> Self {
        let file = replayer.name().to_string();
        Self::Unsolvable { file, message: replayer.explain(&source), source: Box::new(source) }
    }

    /// Where nothing holds the gauge because none was asked for, says so.
    pub(crate) fn with_gauge(self, prior: Option<f64>, document: &Document) -> Self {
        let Self::Replay(ReplayerError::Step { pose, source, .. }) = &self else { return self };
        let (true, None) = (is_singular(source), prior) else { return self };
        let overview = Overview::of(document);
        let component = match **source {
            // Everything came in at once, and so nothing holds any of them: the first stands for all.
            SmootherError::Singular(Singular::Component { .. }) => overview.components.first(),
            _ => overview.component_of_pose(*pose),
        };
        let Some(component) = component.cloned() else { return self };
        let details = self.to_string();
        Self::NoGauge { file: document.name().into(), component, details }
    }

    /// Whether the problem is singular.
    pub(crate) fn is_singular(&self) -> bool {
        match self {
            Self::NoGauge { .. } => true,
            Self::Replay(ReplayerError::Step { source, .. }) | Self::Unsolvable { source, .. } => {
                is_singular(source)
            }
            _ => false,
        }
    }

    /// True if an update was refused for its largest clique.
    pub(crate) fn is_too_dense(&self) -> bool {
        match self {
            Self::Replay(ReplayerError::Step { source, .. }) => {
                matches!(**source, SmootherError::LargeClique { .. })
            }
            _ => false,
        }
    }

    /// Tells the user, and says how the program ends; `program` is the command line, for its usage.
    pub(crate) fn end(&self, mut program: clap::Command) -> ExitCode {
        match self {
            // Whoever read the output has seen enough, as `| head` does.
            Self::Print(source) if source.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
            Self::Usage { command, message } => {
                program.build();
                let error = match program.find_subcommand_mut(command) {
                    Some(command) => command.error(ErrorKind::ArgumentConflict, message),
                    None => program.error(ErrorKind::ArgumentConflict, message),
                };
                // Nothing is left to be done when the message cannot be printed.
                let _ = error.print();
                ExitCode::from(2)
            }
            other => {
                stderr::complain(&other.to_string());
                ExitCode::from(1)
            }
        }
    }
}

fn is_singular(error: &SmootherError) -> bool {
    matches!(error, SmootherError::Singular(_))
}
