//! Measurements beyond poses and points seen from poses, in the numbers of a line.

use evergraph_factors::RootShift;
use smallvec::SmallVec;

use crate::record::{Coordinates, Kind};
use crate::weight::Weight;

/// A measurement of one variable or of two.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// What is measured.
    pub quantity: Quantity,
    /// Of what: the file's ids, and what kind of variable each names.
    pub ends: SmallVec<[(u64, Kind); 2]>,
    /// The measured numbers, as [`Quantity`] lists them.
    pub numbers: SmallVec<[f64; 4]>,
    /// How much it is worth; rows as [`Quantity`] lists them.
    pub weight: Weight,
    /// `EDGE_SE3_PRIOR`, `EDGE_SE3_XYZ_PRIOR`: id of the sensor offset.
    pub parameter: Option<u64>,
}

/// What a [`Measurement`] measures: its numbers, and the rows of its matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// The whole variable: the coordinates of a vertex line of its kind (a quaternion for a pose in
    /// space). Rows: its tangent.
    Prior,
    /// Where a pose is in the world: `x y` or `x y z` (m). 2 or 3 rows.
    Position,
    /// Where an antenna on a pose is in the world, then where it sits on the robot (m): `x y ax ay`
    /// or `x y z ax ay az`. 2 or 3 rows.
    AntennaPosition,
    /// Height of a pose in space (m). 1 row.
    Depth,
    /// Heading of a pose (rad). 1 row.
    Heading,
    /// `roll pitch` of a pose in space (rad), as in `Rz(yaw) Ry(pitch) Rx(roll)`. 2 rows.
    RollPitch,
    /// A world direction `gx gy gz` and where the robot sees it, `mx my mz`. 2 rows.
    Attitude,
    /// Height of a plane, parallel to the world's xy plane, that a pose in space moves in (m).
    /// 3 rows: height, and the two components of the tilt.
    PlanarMotion,
    /// The second of two points minus the first: `x y` or `x y z` (m). 2 or 3 rows.
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
    /// Linear combinations of the tangent of a relative pose: the relative pose as in a vertex line,
    /// then the combinations, `k` rows of 3 or 6 numbers. `k` rows.
    Partial,
}

/// A linear (GLC) factor: `e = G (Local(x', r(x)) - d')`.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearMeasurement {
    /// The variables, with their linearization points.
    pub points: Vec<(u64, Coordinates)>,
    /// The coordinates that it is linear in.
    pub root_shift: RootShift,
    /// Rows of `G`.
    pub rows: usize,
    /// `G`, row by row; the columns follow the variables, each in the order of its tangent.
    pub sqrt_information: Vec<f64>,
    /// `d'`, an entry for each column.
    pub offset: Vec<f64>,
}

impl Measurement {
    /// What the variables are.
    pub fn kinds(&self) -> SmallVec<[Kind; 2]> {
        self.ends.iter().map(|(_, kind)| *kind).collect()
    }

    /// Rows of the matrix; `None` where ends and numbers are none that the quantity has.
    pub fn rows(&self) -> Option<usize> {
        let kinds = self.kinds();
        let (numbers, rows) = self.quantity.shape(&kinds)?;
        if self.quantity != Quantity::Partial {
            return (self.numbers.len() == numbers).then_some(rows);
        }
        let dim = kinds[0].dim();
        let combinations = self.numbers.len().checked_sub(numbers - dim)?;
        let rows = combinations / dim;
        (combinations == rows * dim && (1..=dim).contains(&rows)).then_some(rows)
    }
}

impl Quantity {
    /// What such measurements are, in words: `ranges`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Prior => "priors",
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
        }
    }

    /// How many numbers are measured on variables of these kinds, and how many rows the matrix has;
    /// `None` where the quantity is not measured on them. For [`Partial`](Self::Partial) the numbers
    /// are those of one combination, of one row.
    pub fn shape(self, kinds: &[Kind]) -> Option<(usize, usize)> {
        use Kind::{Point2, Point3, Pose2, Pose3};
        Some(match (self, kinds) {
            (Self::Prior, [Pose2 | Point3]) => (3, 3),
            (Self::Prior, [Pose3]) => (7, 6),
            (Self::Prior, [Point2]) => (2, 2),
            (Self::Position, [Pose2]) => (2, 2),
            (Self::Position, [Pose3]) => (3, 3),
            (Self::AntennaPosition, [Pose2]) => (4, 2),
            (Self::AntennaPosition, [Pose3]) => (6, 3),
            (Self::Depth, [Pose3]) => (1, 1),
            (Self::Heading, [Pose2 | Pose3]) => (1, 1),
            (Self::RollPitch, [Pose3]) => (2, 2),
            (Self::Attitude, [Pose3]) => (6, 2),
            (Self::PlanarMotion, [Pose3]) => (1, 3),
            (Self::Between, [Point2, Point2]) => (2, 2),
            (Self::Between, [Point3, Point3]) => (3, 3),
            (Self::Range, [Pose2 | Point2, Pose2 | Point2]) => (1, 1),
            (Self::Range, [Pose3 | Point3, Pose3 | Point3]) => (1, 1),
            (Self::Bearing, [Pose2, Pose2 | Point2]) => (1, 1),
            (Self::Bearing, [Pose3, Pose3 | Point3]) => (3, 2),
            (Self::BearingRange, [Pose2, Pose2 | Point2]) => (2, 2),
            (Self::BearingRange, [Pose3, Pose3 | Point3]) => (4, 3),
            (Self::DepthDifference | Self::HeadingDifference, [Pose3, Pose3]) => (1, 1),
            (Self::TranslationDifference, [Pose2, Pose2]) => (2, 2),
            (Self::TranslationDifference, [Pose3, Pose3]) => (3, 3),
            (Self::Partial, [Pose2, Pose2]) => (3 + 3, 1),
            (Self::Partial, [Pose3, Pose3]) => (7 + 6, 1),
            _ => return None,
        })
    }
}
