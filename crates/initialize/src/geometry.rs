//! Poses and points of the plane and of space behind one type.

use evergraph_model::{LieGroup, Point2, Point3, Pose2, Pose3, Value, geometry::skew};
use nalgebra::{DMatrix, Vector3};

/// A pose or a point, in the plane or in space.
///
/// Poses are `world_from_body`, points are positions in the world (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Geometry {
    /// A pose of the plane.
    Pose2(Pose2),
    /// A pose in space.
    Pose3(Pose3),
    /// A point of the plane.
    Point2(Point2),
    /// A point in space.
    Point3(Point3),
}

impl Geometry {
    /// The pose or point that a value is; `None` for values of other types.
    pub fn of(value: &Value) -> Option<Self> {
        let pose2 = || value.get().map(Self::Pose2);
        let pose3 = || value.get().map(Self::Pose3);
        let point2 = || value.get().map(Self::Point2);
        let point3 = || value.get().map(Self::Point3);
        pose2().or_else(pose3).or_else(point2).or_else(point3)
    }

    /// The same as a value.
    pub fn value(&self) -> Value {
        match self {
            Self::Pose2(v) => Value::new(v),
            Self::Pose3(v) => Value::new(v),
            Self::Point2(v) => Value::new(v),
            Self::Point3(v) => Value::new(v),
        }
    }

    /// Whether it is of the plane.
    pub fn is_planar(&self) -> bool {
        matches!(self, Self::Pose2(_) | Self::Point2(_))
    }

    /// Whether it is a pose.
    pub fn is_pose(&self) -> bool {
        matches!(self, Self::Pose2(_) | Self::Pose3(_))
    }

    /// Whether all of its numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.value().storage().iter().all(|x| x.is_finite())
    }

    /// The position (m); in the plane z is zero.
    pub fn position(&self) -> Vector3<f64> {
        match self {
            Self::Pose2(v) => Vector3::new(v.x(), v.y(), 0.0),
            Self::Pose3(v) => Vector3::new(v.x(), v.y(), v.z()),
            Self::Point2(v) => Vector3::new(v.x(), v.y(), 0.0),
            Self::Point3(v) => v.vector(),
        }
    }

    /// `self⁻¹ to`, for two poses of the same type; `None` for anything else.
    pub fn between(&self, to: &Self) -> Option<Self> {
        match (self, to) {
            (Self::Pose2(from), Self::Pose2(to)) => Some(Self::Pose2(from.between(to))),
            (Self::Pose3(from), Self::Pose3(to)) => Some(Self::Pose3(from.between(to))),
            _ => None,
        }
    }

    /// The image under a rigid motion of the world, which is a pose; `None` when one of the two is of the
    /// plane and the other in space, or when `motion` is a point.
    pub fn moved(&self, motion: &Self) -> Option<Self> {
        Some(match (motion, self) {
            (Self::Pose2(t), Self::Pose2(x)) => Self::Pose2(t.compose(x)),
            (Self::Pose3(t), Self::Pose3(x)) => Self::Pose3(t.compose(x)),
            (Self::Pose2(t), Self::Point2(p)) => Self::Point2(t.transform_point(p)),
            (Self::Pose3(t), Self::Point3(p)) => Self::Point3(t.transform_point(p)),
            _ => return None,
        })
    }

    /// The derivative of the tangent by a small motion of the world, `(x, y, theta)` or
    /// `(x, y, z, rx, ry, rz)`, that turns about `center`: `Ad(X⁻¹)` of a pose whose position is taken
    /// relative to `center`, `[I -[p]×]` of a point. 3 × 3 or 6 × 6 of poses, 2 × 3 or 3 × 6 of points.
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
}
