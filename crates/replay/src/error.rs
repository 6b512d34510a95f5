//! Errors of a replay.

use evergraph_formats::{FormatError, spell_id};
use evergraph_model::GraphError;
use evergraph_solver::SmootherError;
use thiserror::Error;

/// Why a replay stopped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReplayerError {
    /// The file does not make sense as a graph.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The smoother refused a step.
    #[error("{file}, at pose {pose}: {message}", pose = spell_id(*pose))]
    Step {
        /// The file.
        file: String,
        /// The file's id of the newest pose of the step.
        pose: u64,
        /// Why, with variables by their ids in the file.
        message: String,
        /// Why; boxed, so that results are small where all goes well.
        source: Box<SmootherError>,
    },
    /// The chordal initialization failed.
    #[error(
        "{file}: no chordal start can be computed ({source}): the weights of its edges are too far \
         apart for 64-bit numbers. Start from the file's vertices or from odometry"
    )]
    Chordal {
        /// The file.
        file: String,
        /// Why, with the variables of a graph of its own.
        source: Box<SmootherError>,
    },
    /// A change does not fit the graph.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The smoother could not be made.
    #[error(transparent)]
    Smoother(#[from] SmootherError),
}
