//! Keys of the variables of a file, and the geometry of its coordinates.

use evergraph_formats::{Coordinates, FormatError, Kind, Place};
pub(crate) use evergraph_initialize::Geometry;
use evergraph_model::{Change, Key, LieGroup, Point2, Point3, Pose2, Pose3, Value, VariableId};
use nalgebra::Vector3;

use crate::error::ReplayerError;

/// A typed key of any of the file's kinds.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Handle {
    Pose2(Key<Pose2>),
    Pose3(Key<Pose3>),
    Point2(Key<Point2>),
    Point3(Key<Point3>),
}

impl Handle {
    /// Adds a variable that starts at a pose or a point.
    pub fn add(at: &Geometry, change: &mut Change) -> Self {
        match at {
            Geometry::Pose2(v) => Self::Pose2(change.add_variable(v)),
            Geometry::Pose3(v) => Self::Pose3(change.add_variable(v)),
            Geometry::Point2(v) => Self::Point2(change.add_variable(v)),
            Geometry::Point3(v) => Self::Point3(change.add_variable(v)),
        }
    }

    pub fn kind(self) -> Kind {
        match self {
            Self::Pose2(_) => Kind::Pose2,
            Self::Pose3(_) => Kind::Pose3,
            Self::Point2(_) => Kind::Point2,
            Self::Point3(_) => Kind::Point3,
        }
    }

    pub fn id(self) -> VariableId {
        match self {
            Self::Pose2(key) => key.id(),
            Self::Pose3(key) => key.id(),
            Self::Point2(key) => key.id(),
            Self::Point3(key) => key.id(),
        }
    }
}

/// The pose or point that coordinates name; `None` for a quaternion of length zero, which no document
/// holds.
pub(crate) fn named_by(at: &Coordinates) -> Option<Geometry> {
    at.value().and_then(|value| Geometry::of(&value))
}

/// The geometry of a value of a given kind; `None` for values of another kind.
pub(crate) fn of_kind(value: &Value, kind: Kind) -> Option<Geometry> {
    Geometry::of(value).filter(|at| {
        matches!(
            (at, kind),
            (Geometry::Pose2(_), Kind::Pose2)
                | (Geometry::Pose3(_), Kind::Pose3)
                | (Geometry::Point2(_), Kind::Point2)
                | (Geometry::Point3(_), Kind::Point3)
        )
    })
}

/// The start of a part that nothing says the place of.
pub(crate) fn origin(kind: Kind) -> Geometry {
    match kind {
        Kind::Pose2 => Geometry::Pose2(Pose2::identity()),
        Kind::Pose3 => Geometry::Pose3(Pose3::identity()),
        Kind::Point2 => Geometry::Point2(Point2::new(0.0, 0.0)),
        Kind::Point3 => Geometry::Point3(Point3::new(0.0, 0.0, 0.0)),
    }
}

/// The landmark of a kind at a position; `None` for poses.
pub(crate) fn point(kind: Kind, at: &Vector3<f64>) -> Option<Geometry> {
    match kind {
        Kind::Point2 => Some(Geometry::Point2(Point2::new(at.x, at.y))),
        Kind::Point3 => Some(Geometry::Point3(Point3::new(at.x, at.y, at.z))),
        Kind::Pose2 | Kind::Pose3 => None,
    }
}

/// A variable's id and whether it is a pose: iSAM numbers poses and landmarks apart.
pub(crate) fn slot(id: u64, kind: Kind) -> (u64, bool) {
    (id, kind.is_pose())
}

/// A measurement that cannot be used, for a reason in words.
pub(crate) fn bad(place: &Place, problem: impl ToString) -> ReplayerError {
    FormatError::BadMeasurement { place: place.clone(), problem: problem.to_string() }.into()
}
