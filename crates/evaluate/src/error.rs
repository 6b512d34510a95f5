//! What can be wrong with an evaluation.

use evergraph_formats::{FormatError, TrajectoryError};
use evergraph_model::GraphError;
use evergraph_replay::ReplayerError;
use thiserror::Error;

/// Why something could not be evaluated.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EvaluateError {
    /// A graph file is bad.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The start values of a graph file cannot be composed.
    #[error(transparent)]
    Replay(#[from] ReplayerError),
    /// A trajectory is bad.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// What a file says cannot be made a graph.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The edges of a file without vertices do not fit one another.
    #[error(
        "{file}: cannot serve as truth: it has no vertices, and the poses composed from its edges contradict its other edges by {sigmas:.3} standard deviations (root mean square). Give a noise-free file, one with vertices, or a TUM or KITTI file"
    )]
    Contradiction {
        /// The file.
        file: String,
        /// Root mean square of the whitened residuals.
        sigmas: f64,
    },
    /// No pose of the estimate has a true pose.
    #[error(
        "no pose of {estimate} has a partner in {truth} by {by}; check that both speak of the same run, and give the times of the poses if only one side has times"
    )]
    NoMatch {
        /// The estimate.
        estimate: String,
        /// The truth.
        truth: String,
        /// What poses were to have in common.
        by: String,
    },
    /// One side says when, the other only which.
    #[error(
        "{timed} has time stamps and {numbered} only ids, which are no times; give the times of its poses (`--times FILE.csv`, lines of `id,timestamp`)"
    )]
    TimesAgainstIds {
        /// The trajectory with times.
        timed: String,
        /// The one with ids.
        numbered: String,
    },
    /// A map of the plane was to be measured by poses in space, or the other way round.
    #[error(
        "{planar} holds poses of the plane and {spatial} poses in space that do not lie in the plane z = 0; bring both into the same space first, for example by dropping z, roll and pitch"
    )]
    PlaneAgainstSpace {
        /// The one of the plane.
        planar: String,
        /// The one in space.
        spatial: String,
    },
    /// Ids were to be compared where one side has none.
    #[error("{name}: its poses have no ids; associate them by time")]
    NoIds {
        /// The trajectory.
        name: String,
    },
    /// A setting has no meaning.
    #[error("the {setting} is {value}, but has to be {demand}")]
    BadSetting {
        /// The setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it should be.
        demand: &'static str,
    },
    /// Too few poses for a relative error.
    #[error(
        "{poses} poses that have a partner make no pair of poses {delta} apart; choose a smaller distance"
    )]
    NoPair {
        /// Poses with a partner.
        poses: usize,
        /// How many poses apart.
        delta: usize,
    },
    /// Numbers too large for their squares.
    #[error("coordinates are so large that the errors are not finite 64-bit numbers")]
    Overflow,
}
