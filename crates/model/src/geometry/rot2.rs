//! Rotations in the plane, SO(2).

use std::f64::consts::PI;
use std::fmt;

use nalgebra::{Matrix1, Matrix2, Vector1, Vector2};
use serde::{Deserialize, Serialize};

use super::coefficients::small_arctangent;
use super::{GeometryError, Point2, acts_on};
use crate::manifold::LieGroup;

/// The same angle in (-π, π].
#[inline]
pub fn wrap_angle(angle: f64) -> f64 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let (sin, cos) = angle.sin_cos();
    principal(sin, cos)
}

/// `atan2` in (-π, π].
#[inline]
pub(super) fn principal(sin: f64, cos: f64) -> f64 {
    let angle = sin.atan2(cos);
    if angle == -PI { PI } else { angle }
}

/// A rotation in the plane, stored as cosine and sine.
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rot2 {
    pub(super) cos: f64,
    pub(super) sin: f64,
}

impl Rot2 {
    /// The rotation by `angle` radians, counterclockwise.
    #[inline]
    pub fn from_angle(angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { cos, sin }
    }

    /// The rotation that turns the x axis into the direction `(cos, sin)`, of any length.
    ///
    /// # Errors
    /// [`GeometryError::NotFinite`], [`GeometryError::ZeroNorm`].
    pub fn from_direction(cos: f64, sin: f64) -> Result<Self, GeometryError> {
        let norm = cos.hypot(sin);
        if !norm.is_finite() {
            return Err(GeometryError::NotFinite { numbers: vec![cos, sin] });
        }
        if norm < f64::MIN_POSITIVE {
            return Err(GeometryError::ZeroNorm { numbers: vec![cos, sin] });
        }
        Ok(Self { cos: cos / norm, sin: sin / norm })
    }

    /// The angle in (-π, π].
    #[inline]
    pub fn angle(&self) -> f64 {
        principal(self.sin, self.cos)
    }

    /// Cosine of the angle.
    #[inline]
    pub fn cos(&self) -> f64 {
        self.cos
    }

    /// Sine of the angle.
    #[inline]
    pub fn sin(&self) -> f64 {
        self.sin
    }

    /// The rotation matrix.
    #[inline]
    pub fn matrix(&self) -> Matrix2<f64> {
        Matrix2::new(self.cos, -self.sin, self.sin, self.cos)
    }

    /// `R v`.
    #[inline]
    pub fn rotate(&self, v: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y)
    }

    /// `Rᵀ v`.
    #[inline]
    pub fn inverse_rotate(&self, v: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x)
    }

    /// `R p`.
    #[inline]
    pub fn transform_point(&self, point: &Point2) -> Point2 {
        self.rotate(&point.vector()).into()
    }

    /// [`angle`](Self::angle), faster where it is small, to within the rounding of cosine and sine.
    #[inline]
    pub(super) fn log_angle(&self) -> f64 {
        let tangent = self.sin / self.cos;
        match small_arctangent(tangent * tangent) {
            Some(ratio) if self.cos > 0.0 => tangent * ratio,
            _ => self.angle(),
        }
    }

    /// From a cosine and sine that have drifted from unit length by rounding only: one Newton step
    /// of the inverse square root at one, whose error is of the order of the drift squared.
    #[inline]
    fn renormalized(cos: f64, sin: f64) -> Self {
        let scale = 1.5 - 0.5 * (cos * cos + sin * sin);
        Self { cos: cos * scale, sin: sin * scale }
    }

    #[inline]
    pub(super) fn to_storage(self) -> [f64; 2] {
        [self.cos, self.sin]
    }

    #[inline]
    pub(super) fn from_storage([cos, sin]: [f64; 2]) -> Self {
        Self { cos, sin }
    }
}

acts_on!(Rot2, Point2, transform_point);
acts_on!(Rot2, Vector2<f64>, rotate);

impl LieGroup<1> for Rot2 {
    #[inline]
    fn identity() -> Self {
        Self { cos: 1.0, sin: 0.0 }
    }

    #[inline]
    fn compose(&self, other: &Self) -> Self {
        Self::renormalized(
            self.cos * other.cos - self.sin * other.sin,
            self.sin * other.cos + self.cos * other.sin,
        )
    }

    #[inline]
    fn inverse(&self) -> Self {
        Self { cos: self.cos, sin: -self.sin }
    }

    #[inline]
    fn exp(tangent: &Vector1<f64>) -> Self {
        Self::from_angle(tangent.x)
    }

    #[inline]
    fn log(&self) -> Vector1<f64> {
        Vector1::new(self.log_angle())
    }

    #[inline]
    fn adjoint(&self) -> Matrix1<f64> {
        Matrix1::new(1.0)
    }

    #[inline]
    fn right_jacobian(_: &Vector1<f64>) -> Matrix1<f64> {
        Matrix1::new(1.0)
    }

    #[inline]
    fn right_jacobian_inverse(_: &Vector1<f64>) -> Matrix1<f64> {
        Matrix1::new(1.0)
    }
}

impl fmt::Debug for Rot2 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Rot2({:?} rad)", self.angle())
    }
}
