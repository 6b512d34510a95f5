//! Graph files driven through a smoother, in the order in which a robot would have recorded them.
//!
//! A graph file says which poses measured each other, but seldom when. [`Replay`] plans an order in which
//! a robot would have made the measurements, and turns the document into changes, one new pose each.
//! [`Replayer`] applies these to a [`Smoother`](evergraph_solver::Smoother): each new pose starts from the
//! current estimate of the pose before it, as on the robot.
//!
//! | item | purpose |
//! |---|---|
//! | [`Replay`] | a document as changes: order, start values, gauge priors, landmarks that wait |
//! | [`Replayer`] | the changes applied step by step, or all at once; errors in the file's ids; the solution as a document |
//! | [`AuditSample`], [`Audit`] | excess of an incremental estimate over the batch optimum |
//! | [`Objective`] | error and chi2 of a map |
//! | [`Overview`] | kinds of lines, components and repeated edges of a document |
//! | [`chordal`] | start values of a document from its measurements alone |
//! | [`with_start_vertices`] | vertices for a document of edges alone |
//!
//! ```
//! use evergraph_formats::{Document, ReadOptions};
//! use evergraph_replay::{ReplayOptions, Replayer};
//! use evergraph_solver::Settings;
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let text = "EDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\nEDGE_SE2 1 2 1 0 0 9 0 0 9 0 9\nEDGE_SE2 0 2 2.3 0 0 9 0 0 9 0 9\n";
//! let document = Document::parse("three poses", text.as_bytes(), &ReadOptions::default())?;
//! let mut replayer = Replayer::new(&document, &ReplayOptions::default(), Settings::default())?;
//! while let Some(done) = replayer.step()? {
//!     println!("{:?}: {} factors", done.step.kind, done.step.factors);
//! }
//! assert_eq!(replayer.poses(), 3);
//! assert!((replayer.error()? - 0.135).abs() < 1e-3); // 0.3 m shared by three edges of sigma 1/3
//! # Ok(())
//! # }
//! ```
//!
//! Records become factors by the catalogue of `evergraph-factors`; poses that no odometry ties to the rest
//! and landmarks that only bearings or ranges see are placed by `evergraph-initialize`.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod audit;
mod bodies;
mod chordal;
mod components;
mod emit;
mod error;
mod factor;
mod finish;
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
mod recorded;
mod reduced;
mod replayer;
mod state;
mod steps;
mod vertices;
mod words;

pub use audit::{Audit, AuditSample};
pub use chordal::chordal;
pub use error::ReplayerError;
pub use finish::Compared;
pub use objective::Objective;
pub use options::{GaugePrior, Initial, Order, ReplayOptions, Step, StepKind};
pub use overview::{Component, Overview};
pub use replayer::{Replayed, Replayer};
pub use state::Replay;
pub use vertices::with_start_vertices;
