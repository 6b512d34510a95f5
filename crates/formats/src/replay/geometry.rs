//! Poses and points of any kind a file has: their keys and their values.

use evergraph_model::{
    Change, Key, LieGroup, Point2, Point3, Pose2, Pose3, Value, VariableId, geometry::skew,
};
use nalgebra::{DMatrix, Vector3};

use crate::convert;
use crate::coordinates::{Coordinates, Kind};

/// A typed key of any of the file's kinds.
#[derive(Clone, Copy, Debug)]
pub(super) enum Handle {
    Pose2(Key<Pose2>),
    Pose3(Key<Pose3>),
    Point2(Key<Point2>),
    Point3(Key<Point3>),
}

impl Handle {
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

/// A pose or a point as the engine has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Geometry {
    Pose2(Pose2),
    Pose3(Pose3),
    Point2(Point2),
    Point3(Point3),
}

impl Geometry {
    /// What coordinates name; `None` for a quaternion of length zero, which no document holds.
    pub fn of(at: &Coordinates) -> Option<Self> {
        Some(match *at {
            Coordinates::Pose2([x, y, theta]) => Self::Pose2(Pose2::new(x, y, theta)),
            Coordinates::Point2([x, y]) => Self::Point2(Point2::new(x, y)),
            Coordinates::Point3([x, y, z]) => Self::Point3(Point3::new(x, y, z)),
            Coordinates::Pose3Quaternion(_) | Coordinates::Pose3Euler(_) => {
                Self::Pose3(convert::pose3(at)?)
            }
        })
    }

    pub fn from_value(value: &Value, kind: Kind) -> Option<Self> {
        Some(match kind {
            Kind::Pose2 => Self::Pose2(value.get()?),
            Kind::Pose3 => Self::Pose3(value.get()?),
            Kind::Point2 => Self::Point2(value.get()?),
            Kind::Point3 => Self::Point3(value.get()?),
        })
    }

    /// Where a part begins that nothing says the place of.
    pub fn origin(kind: Kind) -> Self {
        match kind {
            Kind::Pose2 => Self::Pose2(Pose2::identity()),
            Kind::Pose3 => Self::Pose3(Pose3::identity()),
            Kind::Point2 => Self::Point2(Point2::new(0.0, 0.0)),
            Kind::Point3 => Self::Point3(Point3::new(0.0, 0.0, 0.0)),
        }
    }

    pub fn value(&self) -> Value {
        match self {
            Self::Pose2(v) => Value::new(v),
            Self::Pose3(v) => Value::new(v),
            Self::Point2(v) => Value::new(v),
            Self::Point3(v) => Value::new(v),
        }
    }

    pub fn is_finite(&self) -> bool {
        self.value().storage().iter().all(|x| x.is_finite())
    }

    /// Where it is; in the plane z is zero.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Pose2(v) => Vector3::new(v.x(), v.y(), 0.0),
            Self::Pose3(v) => Vector3::new(v.x(), v.y(), v.z()),
            Self::Point2(v) => Vector3::new(v.x(), v.y(), 0.0),
            Self::Point3(v) => v.vector(),
        }
    }

    /// The landmark of a kind at a position; `None` for poses.
    pub fn point(kind: Kind, at: &Vector3<f64>) -> Option<Self> {
        match kind {
            Kind::Point2 => Some(Self::Point2(Point2::new(at.x, at.y))),
            Kind::Point3 => Some(Self::Point3(Point3::new(at.x, at.y, at.z))),
            Kind::Pose2 | Kind::Pose3 => None,
        }
    }

    /// `from⁻¹ to` of two poses of a kind.
    pub fn between(&self, to: &Self) -> Option<Self> {
        match (self, to) {
            (Self::Pose2(from), Self::Pose2(to)) => Some(Self::Pose2(from.between(to))),
            (Self::Pose3(from), Self::Pose3(to)) => Some(Self::Pose3(from.between(to))),
            _ => None,
        }
    }

    /// Where it gets when the world is moved by a pose; `None` when one of them is in the plane and
    /// the other in space.
    pub fn moved(&self, motion: &Self) -> Option<Self> {
        Some(match (motion, self) {
            (Self::Pose2(t), Self::Pose2(x)) => Self::Pose2(t.compose(x)),
            (Self::Pose3(t), Self::Pose3(x)) => Self::Pose3(t.compose(x)),
            (Self::Pose2(t), Self::Point2(p)) => Self::Point2(t.transform_point(p)),
            (Self::Pose3(t), Self::Point3(p)) => Self::Point3(t.transform_point(p)),
            _ => return None,
        })
    }

    /// The derivative of its tangent when the world is moved by a small motion, `(x, y, theta)` or
    /// `(x, y, z, rx, ry, rz)`, which turns about `center`: for a pose `Ad(X⁻¹)` with its position
    /// seen from there, for a point `[I -[p]×]`.
    pub fn by_world_motion(&self, center: &Vector3<f64>) -> DMatrix<f64> {
        let arm = self.position() - center;
        match self {
            Self::Pose2(x) => {
                let seen = Pose2::from_parts(x.rotation(), Point2::new(arm.x, arm.y));
                DMatrix::from_column_slice(3, 3, seen.inverse().adjoint().as_slice())
            }
            Self::Pose3(x) => {
                let seen = Pose3::new(x.rotation(), Point3::new(arm.x, arm.y, arm.z));
                DMatrix::from_column_slice(6, 6, seen.inverse().adjoint().as_slice())
            }
            Self::Point2(_) => {
                DMatrix::from_column_slice(2, 3, &[1.0, 0.0, 0.0, 1.0, -arm.y, arm.x])
            }
            Self::Point3(_) => {
                let mut by_motion = DMatrix::zeros(3, 6);
                by_motion.fill_with_identity();
                by_motion.view_mut((0, 3), (3, 3)).copy_from(&-skew(&arm));
                by_motion
            }
        }
    }

    pub fn add_to(&self, change: &mut Change) -> Handle {
        match self {
            Self::Pose2(v) => Handle::Pose2(change.add_variable(v)),
            Self::Pose3(v) => Handle::Pose3(change.add_variable(v)),
            Self::Point2(v) => Handle::Point2(change.add_variable(v)),
            Self::Point3(v) => Handle::Point3(change.add_variable(v)),
        }
    }
}
