//! Graph files driven through a smoother, in the order in which a robot would have recorded them.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod audit;
mod chordal;
mod emit;
mod error;
mod factor;
mod gather;
mod gauge;
mod geometry;
mod held;
mod known;
mod objective;
mod observation;
mod options;
mod order;
mod overview;
mod reduced;
mod replayer;
mod state;
mod steps;
mod vertices;
mod words;

pub use audit::{Audit, AuditSample};
pub use chordal::chordal;
pub use error::ReplayerError;
pub use objective::Objective;
pub use options::{GaugePrior, Initial, ReplayOptions, Step, StepKind};
pub use overview::{Component, Overview};
pub use replayer::{Replayed, Replayer};
pub use state::Replay;
pub use vertices::with_start_vertices;
