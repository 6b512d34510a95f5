//! Kinds of variables, and the numbers that files give for them.

use evergraph_model::{Manifold, Point2, Point3, Pose2, Pose3};

/// A pose or a point in the numbers that the file used: an unwrapped angle, a quaternion of any
/// length, Euler angles. Kept so that writing the same format gives the same bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coordinates {
    /// `x y theta` (m, rad).
    Pose2([f64; 3]),
    /// `x y` (m).
    Point2([f64; 2]),
    /// `x y z qx qy qz qw` (m).
    Pose3Quaternion([f64; 7]),
    /// `x y z roll pitch yaw` (m, rad), `R = Rz(yaw) Ry(pitch) Rx(roll)`.
    Pose3Euler([f64; 6]),
    /// `x y z` (m).
    Point3([f64; 3]),
}

/// The type of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A pose in the plane.
    Pose2,
    /// A pose in space.
    Pose3,
    /// A landmark in the plane.
    Point2,
    /// A landmark in space.
    Point3,
}

impl Kind {
    /// True for poses, false for landmarks.
    pub fn is_pose(self) -> bool {
        matches!(self, Self::Pose2 | Self::Pose3)
    }

    /// True in space, false in the plane.
    pub fn is_in_space(self) -> bool {
        matches!(self, Self::Pose3 | Self::Point3)
    }

    /// The kind of pose that measures it.
    pub fn observer(self) -> Self {
        match self {
            Self::Pose2 | Self::Point2 => Self::Pose2,
            Self::Pose3 | Self::Point3 => Self::Pose3,
        }
    }

    /// Dimension of its tangent space, which is that of a measurement of it.
    pub fn dim(self) -> usize {
        match self {
            Self::Pose2 | Self::Point3 => 3,
            Self::Pose3 => 6,
            Self::Point2 => 2,
        }
    }

    /// The name of the engine's type.
    pub fn type_name(self) -> &'static str {
        match self {
            Self::Pose2 => Pose2::NAME,
            Self::Pose3 => Pose3::NAME,
            Self::Point2 => Point2::NAME,
            Self::Point3 => Point3::NAME,
        }
    }

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pose2 => "2D pose",
            Self::Pose3 => "3D pose",
            Self::Point2 => "2D landmark",
            Self::Point3 => "3D landmark",
        }
    }
}

impl Coordinates {
    /// The type of variable that they belong to.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Pose2(_) => Kind::Pose2,
            Self::Point2(_) => Kind::Point2,
            Self::Pose3Quaternion(_) | Self::Pose3Euler(_) => Kind::Pose3,
            Self::Point3(_) => Kind::Point3,
        }
    }

    /// The numbers, in the order of the line.
    pub fn numbers(&self) -> &[f64] {
        match self {
            Self::Pose2(x) | Self::Point3(x) => x,
            Self::Point2(x) => x,
            Self::Pose3Quaternion(x) => x,
            Self::Pose3Euler(x) => x,
        }
    }
}
