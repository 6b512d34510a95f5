//! Rigid motions of a world, as the engine sees them: functions on stored numbers.

use std::any::TypeId;
use std::fmt;

use smallvec::SmallVec;

/// A group of rigid motions that move some types of variables and not others: those of the plane
/// ([`Pose2`](crate::Pose2)), those of space ([`Pose3`](crate::Pose3)), or a Lie group of a user's own.
///
/// Two worlds are equal when their groups are the same type.
#[derive(Clone, Copy)]
pub struct World {
    pub(crate) group: TypeId,
    pub(crate) name: &'static str,
    pub(crate) dim: usize,
}

impl World {
    /// The name of the group's type.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Dimension of the group: the number of independent motions.
    pub fn dim(&self) -> usize {
        self.dim
    }
}

impl PartialEq for World {
    fn eq(&self, other: &Self) -> bool {
        self.group == other.group
    }
}

impl Eq for World {}

impl fmt::Debug for World {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("World").field(&self.name).finish()
    }
}

/// The motion of a type of variables with its world ([`Moves`](crate::Moves)), erased.
///
/// A frame is an element of the world's group as it is stored, for example a pose that others are seen from. Matrices
/// are column-major, `dim` the tangent dimension of the variable and `n` that of the world. The functions panic on
/// slices of other lengths.
#[derive(Clone, Copy)]
pub struct Motion {
    pub(crate) world: World,
    pub(crate) rotation: usize,
    pub(crate) is_seen: bool,
    pub(crate) seen_from: fn(&[f64], &[f64], &mut [f64]),
    pub(crate) seen_from_derivative: fn(&[f64], &[f64], &mut [f64]),
    pub(crate) lever: fn(&[f64], &mut [f64]),
    pub(crate) carried: fn(&[f64], &[f64], &mut [f64]),
    pub(crate) pose: Option<PoseMotion>,
}

/// What a pose can do beyond that ([`Frame`](crate::Frame)).
#[derive(Clone, Copy)]
pub(crate) struct PoseMotion {
    /// The variable's type; where it is the group itself, its tangent is that of the frame.
    pub(crate) kind: TypeId,
    pub(crate) frame: fn(&[f64]) -> SmallVec<[f64; 7]>,
    pub(crate) frame_derivative: fn(&[f64], &mut [f64]),
    pub(crate) inverted: fn(&[f64], &mut [f64]),
}

impl Motion {
    /// The world that the variable moves with.
    pub fn world(&self) -> World {
        self.world
    }

    /// The number of entries at the end of the tangent that are rotations, in radians.
    pub fn rotation(&self) -> usize {
        self.rotation
    }

    /// Whether a root shift replaces the variable by its coordinates relative to the root.
    pub fn is_seen(&self) -> bool {
        self.is_seen
    }

    /// Whether the variable is a pose: a frame of its world, from which others can be seen.
    pub fn is_pose(&self) -> bool {
        self.pose.is_some()
    }

    /// Whether the variable is a pose whose tangent is that of its frame, as for [`Pose2`](crate::Pose2).
    pub fn is_the_group(&self) -> bool {
        self.pose.is_some_and(|pose| pose.kind == self.world.group)
    }

    /// The coordinates of `x` relative to `frame`, a value of the same type ([`Moves::seen_from`](crate::Moves::seen_from)).
    pub fn seen_from(&self, x: &[f64], frame: &[f64], out: &mut [f64]) {
        (self.seen_from)(x, frame, out);
    }

    /// The derivative of [`seen_from`](Self::seen_from) by `x`: `dim × dim`.
    pub fn seen_from_derivative(&self, x: &[f64], frame: &[f64], out: &mut [f64]) {
        (self.seen_from_derivative)(x, frame, out);
    }

    /// The derivative of `exp(ξ) · x` by ξ at zero: `dim × n`.
    pub fn lever(&self, x: &[f64], out: &mut [f64]) {
        (self.lever)(x, out);
    }

    /// The motion of `x` when `frame` makes a right perturbation ξ and takes the world along: `dim × n`.
    pub fn carried(&self, x: &[f64], frame: &[f64], out: &mut [f64]) {
        (self.carried)(x, frame, out);
    }

    /// The frame of a pose; `None` for a variable that is none.
    pub fn frame(&self, x: &[f64]) -> Option<SmallVec<[f64; 7]>> {
        self.pose.map(|pose| (pose.frame)(x))
    }

    /// The right perturbation ξ of a pose's frame by the pose's tangent: `n × n`. `false`, and nothing is written, for a
    /// variable that is no pose.
    pub fn frame_derivative(&self, x: &[f64], out: &mut [f64]) -> bool {
        self.pose.is_some_and(|pose| {
            (pose.frame_derivative)(x, out);
            true
        })
    }

    /// The pose of the inverse frame. `false`, and nothing is written, for a variable that is no pose.
    pub fn inverted(&self, x: &[f64], out: &mut [f64]) -> bool {
        self.pose.is_some_and(|pose| {
            (pose.inverted)(x, out);
            true
        })
    }
}

impl fmt::Debug for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Motion")
            .field("world", &self.world)
            .field("rotation", &self.rotation)
            .field("is_seen", &self.is_seen)
            .field("is_pose", &self.is_pose())
            .finish()
    }
}
