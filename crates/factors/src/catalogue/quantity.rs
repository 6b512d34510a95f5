//! Quantities that factors measure, and the parts of their data.

/// The quantity that a factor measures; factors on different types of variables share it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Quantity {
    /// The whole variable. Rows: its tangent.
    Prior,
    /// The second variable as the first sees it: a pose, a rotation or a point.
    Relative,
    /// Position of a pose in the world (m): `x y` or `x y z`. 2 or 3 rows. In the catalogue it is
    /// an [`AntennaPosition`](Self::AntennaPosition) with a lever arm of zero.
    Position,
    /// Position of an antenna on a pose in the world, then its position on the robot (m):
    /// `x y ax ay` or `x y z ax ay az`. 2 or 3 rows.
    AntennaPosition,
    /// Height of a pose in space (m). 1 row.
    Depth,
    /// Heading of a pose (rad). 1 row.
    Heading,
    /// `roll pitch` of a pose in space (rad), as in `Rz(yaw) Ry(pitch) Rx(roll)`. 2 rows.
    RollPitch,
    /// A world direction `gx gy gz` and its direction in the robot's frame, `mx my mz`. 2 rows.
    Attitude,
    /// Height of a plane, parallel to the world's xy plane, that a pose in space moves in (m).
    /// 3 rows: height, and the two components of the tilt.
    PlanarMotion,
    /// The second of two points or rotations minus the first. Of points: `x y` or `x y z` (m).
    Between,
    /// Distance between two poses, two points, or a pose and a point (m). 1 row.
    Range,
    /// Direction from a pose to a point or a pose: an angle in the plane (rad, 1 row), a direction
    /// `bx by bz` in space (2 rows).
    Bearing,
    /// Bearing, then range. 2 rows in the plane, 3 in space.
    BearingRange,
    /// Height of the second pose in space minus that of the first (m). 1 row.
    DepthDifference,
    /// Heading of the second pose in space minus that of the first (rad). 1 row.
    HeadingDifference,
    /// Position of the second pose minus that of the first, in the world's axes (m). 2 or 3 rows.
    TranslationDifference,
    /// Linear combinations of the tangent of a relative pose: the relative pose, then the
    /// combinations, `k` rows of 3 or 6 numbers. `k` rows.
    Partial,
    /// Any number of variables of any types, linearized: a generic linear constraint.
    Linear,
}

impl Quantity {
    /// Such measurements in words: `ranges`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Prior => "priors",
            Self::Relative => "relative poses and positions",
            Self::Position => "positions (GPS)",
            Self::AntennaPosition => "positions of antennas (GPS)",
            Self::Depth => "depths",
            Self::Heading => "headings",
            Self::RollPitch => "rolls and pitches",
            Self::Attitude => "attitudes",
            Self::PlanarMotion => "planes of motion",
            Self::Between => "differences of points",
            Self::Range => "ranges",
            Self::Bearing => "bearings",
            Self::BearingRange => "bearings and ranges",
            Self::DepthDifference => "differences of depths",
            Self::HeadingDifference => "differences of headings",
            Self::TranslationDifference => "differences of positions",
            Self::Partial => "parts of relative poses",
            Self::Linear => "linear constraints",
        }
    }
}

/// A part of the numbers of a factor's data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Part {
    /// One number.
    Number,
    /// A direction in space: three numbers, of length one.
    Direction,
    /// A pose in the plane: `x y cos sin`.
    Pose2,
    /// A pose in space: `x y z qx qy qz qw`.
    Pose3,
    /// A point in the plane.
    Point2,
    /// A point in space.
    Point3,
    /// A rotation in the plane: `cos sin`.
    Rot2,
    /// A rotation in space: `qx qy qz qw`.
    Rot3,
    /// A vector: all numbers that are left.
    Vector,
    /// Combinations of 3 tangent components, row by row: all numbers that are left.
    Combinations3,
    /// Combinations of 6 tangent components, row by row: all numbers that are left.
    Combinations6,
}

impl Part {
    /// The count of its numbers; `None` for parts of any length.
    pub fn count(self) -> Option<usize> {
        match self {
            Self::Number => Some(1),
            Self::Rot2 | Self::Point2 => Some(2),
            Self::Direction | Self::Point3 => Some(3),
            Self::Pose2 | Self::Rot3 => Some(4),
            Self::Pose3 => Some(7),
            Self::Vector | Self::Combinations3 | Self::Combinations6 => None,
        }
    }
}

/// A line of the catalogue: the form of one factor type.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Description {
    /// The stable name, which is [`Factor::name`](evergraph_model::Factor::name) too.
    pub name: &'static str,
    /// The measured quantity.
    pub quantity: Quantity,
    /// The names of its variables' types; empty for any types.
    pub ends: &'static [&'static str],
    /// The parts of its numbers, in order.
    pub parts: &'static [Part],
    /// Rows of the residual, where the type says them.
    pub rows: Option<usize>,
}
