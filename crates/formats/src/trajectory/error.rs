//! What can be wrong with a trajectory.

use std::sync::Arc;

use thiserror::Error;

use crate::error::{FormatError, Place};
use crate::names::spell_id;

/// Why a trajectory could not be read, made or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrajectoryError {
    /// What can be wrong with any file: it cannot be opened, a field is no number.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Too few or too many fields.
    #[error(
        "{place}: the line has {found} fields, not {expected}; is it cut off, or another format? A line of {format} is `{layout}`"
    )]
    FieldCount {
        /// Where.
        place: Place,
        /// The format.
        format: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
        /// The fields in order.
        layout: &'static str,
    },
    /// Four numbers that are no rounded unit quaternion.
    #[error(
        "{place}: the length of the quaternion is {length}, not 1; are fields 5 to 8 really `qx qy qz qw`?"
    )]
    NotUnit {
        /// Where.
        place: Place,
        /// The length.
        length: f64,
    },
    /// A 3x3 matrix that is no rounded rotation.
    #[error(
        "{place}: the left 3x3 part is no rotation (RᵀR differs from the identity by up to {deviation:.3e}, which the printed digits do not explain; the determinant is {determinant:.6}); are the 12 fields really `r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz`?"
    )]
    NotARotation {
        /// Where.
        place: Place,
        /// Largest entry of `RᵀR - I`.
        deviation: f64,
        /// Determinant.
        determinant: f64,
    },
    /// Times go back, or stand still.
    #[error(
        "{place}: time {time} does not come after {previous}, the time of the pose before; sort the lines by time and keep one pose for each time"
    )]
    NotAscending {
        /// Where.
        place: Place,
        /// The time.
        time: f64,
        /// The one before.
        previous: f64,
    },
    /// Two poses of one time, which a TUM file cannot tell apart.
    #[error(
        "{name}: poses {first} and {second} have the same time {time}, which no TUM file can hold; write each robot from a file of its own, or KITTI, which has no times"
    )]
    EqualTimes {
        /// The trajectory.
        name: Arc<str>,
        /// Id of the first.
        first: u64,
        /// Id of the second.
        second: u64,
        /// Their time.
        time: f64,
    },
    /// There is no pose.
    #[error("{name}: holds no pose")]
    NoPose {
        /// The trajectory or file.
        name: Arc<str>,
    },
    /// An id was given twice.
    #[error("{name}: pose {id} is given twice", id = spell_id(*id))]
    DuplicatePose {
        /// The trajectory.
        name: Arc<str>,
        /// The id.
        id: u64,
    },
    /// A pose is not finite.
    #[error("{name}: pose {id} is not finite", id = spell_id(*id))]
    BadPose {
        /// The trajectory.
        name: Arc<str>,
        /// The id.
        id: u64,
    },
    /// A pose without a time among poses with times.
    #[error("{name}: pose {id} has no time in {stamps}; give every pose one, or none", id = spell_id(*id))]
    NoTime {
        /// The trajectory.
        name: Arc<str>,
        /// The id.
        id: u64,
        /// Where the times come from.
        stamps: Arc<str>,
    },
    /// Times by id for poses without ids.
    #[error("{name}: the poses have no ids, so times by id say nothing about them")]
    NoIds {
        /// The trajectory.
        name: Arc<str>,
    },
    /// The name's extension names no format of trajectories.
    #[error(
        "{file}: the extension does not say which format to write; use .tum (TUM) or .kitti (KITTI)"
    )]
    UnknownExtension {
        /// The file.
        file: Arc<str>,
    },
}

impl TrajectoryError {
    /// The line that is to blame, where it is one.
    pub fn place(&self) -> Option<&Place> {
        match self {
            Self::Format(error) => error.place(),
            Self::FieldCount { place, .. }
            | Self::NotUnit { place, .. }
            | Self::NotARotation { place, .. }
            | Self::NotAscending { place, .. } => Some(place),
            _ => None,
        }
    }
}
