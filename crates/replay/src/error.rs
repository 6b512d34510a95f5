//! Errors of a replay.

use std::sync::Arc;

use evergraph_formats::{FormatError, Place, spell_id};
use evergraph_model::{GraphError, VariableId};
use evergraph_solver::SmootherError;
use thiserror::Error;

/// The reason for which a document cannot be replayed, or a replay stopped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReplayerError {
    /// The file does not make sense as a graph.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A document without poses, or a replay without steps that are left.
    #[error("{file}: holds no pose, so there is nothing to replay")]
    NoPose {
        /// The file.
        file: Arc<str>,
    },
    /// A setting outside of its range.
    #[error("the {setting} is {value}, but has to be {demand}")]
    BadSetting {
        /// The setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it should be.
        demand: &'static str,
    },
    /// A variable without an estimate, from which the next one starts.
    #[error(
        "{place}: {id} starts from variable {variable}, of which there is no estimate; apply each step's change before the next step is asked for", id = spell_id(*id)
    )]
    NoEstimate {
        /// Where.
        place: Place,
        /// The id that was to be added.
        id: u64,
        /// The variable that it starts from.
        variable: VariableId,
    },
    /// A start value grows beyond all numbers.
    #[error(
        "{place}: the start value of {id} is not finite; the measurements that lead to it are too large", id = spell_id(*id)
    )]
    StartNotFinite {
        /// Where.
        place: Place,
        /// The id.
        id: u64,
    },
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
