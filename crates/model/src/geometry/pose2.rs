//! Poses in the plane, SE(2).

use std::fmt;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::coefficients::{inverse_jacobian, jacobian};
use super::{Point2, Rot2, acts_on};
use crate::manifold::LieGroup;

/// Position and heading in the plane; tangent order `(x, y, theta)`.
///
/// Stored as `(x, y, cos, sin)`.
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    x: f64,
    y: f64,
    rotation: Rot2,
}

impl Pose2 {
    /// The pose at `(x, y)` metres, turned by `theta` radians.
    #[inline]
    pub fn new(x: f64, y: f64, theta: f64) -> Self {
        Self { x, y, rotation: Rot2::from_angle(theta) }
    }

    /// From a rotation and a translation.
    #[inline]
    pub fn from_parts(rotation: Rot2, translation: impl Into<Point2>) -> Self {
        let translation = translation.into();
        Self { x: translation.x(), y: translation.y(), rotation }
    }

    /// First coordinate of the origin.
    #[inline]
    pub fn x(&self) -> f64 {
        self.x
    }

    /// Second coordinate of the origin.
    #[inline]
    pub fn y(&self) -> f64 {
        self.y
    }

    /// The heading in (-π, π].
    #[inline]
    pub fn theta(&self) -> f64 {
        self.rotation.angle()
    }

    /// The rotation.
    #[inline]
    pub fn rotation(&self) -> Rot2 {
        self.rotation
    }

    /// The origin.
    #[inline]
    pub fn translation(&self) -> Point2 {
        Point2::new(self.x, self.y)
    }

    /// `world_from_robot.transform_point(point in robot) = point in world`.
    #[inline]
    pub fn transform_point(&self, point: &Point2) -> Point2 {
        (self.rotation.rotate(&point.vector()) + self.vector()).into()
    }

    /// `world_from_robot.inverse_transform_point(point in world) = point in robot`.
    #[inline]
    pub fn inverse_transform_point(&self, point: &Point2) -> Point2 {
        self.rotation.inverse_rotate(&(point.vector() - self.vector())).into()
    }

    #[inline]
    fn vector(&self) -> Vector2<f64> {
        Vector2::new(self.x, self.y)
    }

    #[inline]
    fn from_vector(rotation: Rot2, translation: Vector2<f64>) -> Self {
        Self { x: translation.x, y: translation.y, rotation }
    }

    #[inline]
    pub(super) fn to_storage(self) -> [f64; 4] {
        [self.x, self.y, self.rotation.cos, self.rotation.sin]
    }

    #[inline]
    pub(super) fn from_storage([x, y, cos, sin]: [f64; 4]) -> Self {
        Self { x, y, rotation: Rot2 { cos, sin } }
    }
}

acts_on!(Pose2, Point2, transform_point);

// Below, J = [0 -1; 1 0] and every 2×2 block is a multiple of a rotation, a I + b J.
impl LieGroup<3> for Pose2 {
    #[inline]
    fn identity() -> Self {
        Self { x: 0.0, y: 0.0, rotation: Rot2 { cos: 1.0, sin: 0.0 } }
    }

    #[inline]
    fn compose(&self, other: &Self) -> Self {
        Self::from_vector(
            self.rotation.compose(&other.rotation),
            self.rotation.rotate(&other.vector()) + self.vector(),
        )
    }

    #[inline]
    fn inverse(&self) -> Self {
        Self::from_vector(self.rotation.inverse(), -self.rotation.inverse_rotate(&self.vector()))
    }

    /// `V ρ` with `V = (sin θ)/θ I + (1 - cos θ)/θ J`, through the half angle, which does not
    /// cancel.
    #[inline]
    fn exp(tangent: &Vector3<f64>) -> Self {
        let half = 0.5 * tangent.z;
        let (sin, cos) = half.sin_cos();
        let sinc = if half == 0.0 { 1.0 } else { sin / half };
        let (a, b) = (cos * sinc, sin * sinc);
        Self {
            x: a * tangent.x - b * tangent.y,
            y: b * tangent.x + a * tangent.y,
            rotation: Rot2 { cos: cos * cos - sin * sin, sin: 2.0 * sin * cos },
        }
    }

    /// `V⁻¹ t` with `V⁻¹ = h cot h I - h J`, `h = θ/2`; the cotangent of the half angle is taken
    /// from whichever of `sin θ/(1 - cos θ)` and `(1 + cos θ)/sin θ` does not cancel.
    #[inline]
    fn log(&self) -> Vector3<f64> {
        let Rot2 { cos, sin } = self.rotation;
        let theta = self.rotation.log_angle();
        let half = 0.5 * theta;
        let h_cot_h = if cos < 0.0 {
            half * sin / (1.0 - cos)
        } else if sin == 0.0 {
            1.0
        } else {
            half * (1.0 + cos) / sin
        };
        Vector3::new(h_cot_h * self.x + half * self.y, h_cot_h * self.y - half * self.x, theta)
    }

    #[inline]
    fn adjoint(&self) -> Matrix3<f64> {
        let Rot2 { cos, sin } = self.rotation;
        Matrix3::new(cos, -sin, self.y, sin, cos, -self.x, 0.0, 0.0, 1.0)
    }

    #[inline]
    fn right_jacobian(tangent: &Vector3<f64>) -> Matrix3<f64> {
        let theta = tangent.z;
        let (b, c) = jacobian(theta * theta);
        let (v_a, v_b) = (1.0 - theta * theta * c, theta * b);
        let q = Matrix2::new(theta * c, -b, b, theta * c) * tangent.xy();
        Matrix3::new(v_a, v_b, q.x, -v_b, v_a, q.y, 0.0, 0.0, 1.0)
    }

    /// The last column is `-V(-θ)⁻¹ q` with the `q` of the right Jacobian, which comes down to
    /// `((1 - h cot h)/θ I - ½ J) ρ`.
    #[inline]
    fn right_jacobian_inverse(tangent: &Vector3<f64>) -> Matrix3<f64> {
        let theta = tangent.z;
        let half = 0.5 * theta;
        let slope = theta * inverse_jacobian(theta * theta);
        let h_cot_h = 1.0 - theta * slope;
        Matrix3::new(
            h_cot_h,
            -half,
            slope * tangent.x + 0.5 * tangent.y,
            half,
            h_cot_h,
            slope * tangent.y - 0.5 * tangent.x,
            0.0,
            0.0,
            1.0,
        )
    }

    #[inline]
    fn between(&self, other: &Self) -> Self {
        Self::from_vector(
            self.rotation.between(&other.rotation),
            self.rotation.inverse_rotate(&(other.vector() - self.vector())),
        )
    }
}

impl fmt::Debug for Pose2 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Pose2({:?}, {:?}, {:?} rad)", self.x, self.y, self.theta())
    }
}
