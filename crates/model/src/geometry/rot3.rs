//! Rotations in space, SO(3).

use std::fmt;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::coefficients::{inverse_jacobian, jacobian, sinc, small_arctangent};
use super::rot2::principal;
use super::{GeometryError, Point3, acts_on};
use crate::manifold::LieGroup;

/// `[v]×`, with `[v]× w = v × w`.
#[inline]
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// How far `MᵀM` may be from the identity for [`Rot3::from_matrix`]: matrices printed with six
/// digits pass, matrices with scale or shear do not.
const ORTHOGONALITY: f64 = 1e-5;

/// A rotation in space, stored as a unit quaternion `(x, y, z, w)`.
///
/// The tangent is the rotation vector `(rx, ry, rz)`, axis times angle. A quaternion and its
/// negative are the same rotation and [`local`](crate::Manifold::local) sees none between them,
/// but `==` compares the stored numbers.
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rot3 {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Rot3 {
    /// From a quaternion of any length but zero; `w` is the real part.
    ///
    /// # Errors
    /// [`GeometryError::NotFinite`], [`GeometryError::ZeroNorm`].
    pub fn from_quaternion(x: f64, y: f64, z: f64, w: f64) -> Result<Self, GeometryError> {
        let numbers = [x, y, z, w];
        // Scaled by the largest entry, so that no square overflows or vanishes.
        let largest = numbers.iter().fold(0.0_f64, |m, q| m.max(q.abs()));
        if numbers.iter().any(|q| !q.is_finite()) {
            return Err(GeometryError::NotFinite { numbers: numbers.into() });
        }
        if largest < f64::MIN_POSITIVE {
            return Err(GeometryError::ZeroNorm { numbers: numbers.into() });
        }
        let scaled = numbers.map(|q| q / largest);
        let norm = scaled.iter().map(|q| q * q).sum::<f64>().sqrt();
        Ok(Self::from_storage(scaled.map(|q| q / norm)))
    }

    /// `Rz(yaw) Ry(pitch) Rx(roll)`, angles in radians.
    pub fn from_roll_pitch_yaw(roll: f64, pitch: f64, yaw: f64) -> Self {
        let (sr, cr) = (0.5 * roll).sin_cos();
        let (sp, cp) = (0.5 * pitch).sin_cos();
        let (sy, cy) = (0.5 * yaw).sin_cos();
        Self::renormalized(
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
    }

    /// From a rotation matrix.
    ///
    /// # Errors
    /// [`GeometryError::NotFinite`], [`GeometryError::NotARotation`] when `MᵀM` is farther than
    /// 1e-5 from the identity in some entry, or the determinant is negative.
    pub fn from_matrix(m: &Matrix3<f64>) -> Result<Self, GeometryError> {
        if m.iter().any(|x| !x.is_finite()) {
            return Err(GeometryError::NotFinite { numbers: m.as_slice().into() });
        }
        let deviation = (m.transpose() * m - Matrix3::identity()).amax();
        let determinant = m.determinant();
        if deviation > ORTHOGONALITY || determinant < 0.0 {
            return Err(GeometryError::NotARotation { deviation, determinant });
        }
        // Shepperd: divide by the largest component of the quaternion.
        let (a, b, c) = (m[(0, 0)], m[(1, 1)], m[(2, 2)]);
        let trace = a + b + c;
        let (x, y, z) = (m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]);
        let (xy, xz, yz) = (m[(1, 0)] + m[(0, 1)], m[(0, 2)] + m[(2, 0)], m[(2, 1)] + m[(1, 2)]);
        if trace >= a && trace >= b && trace >= c {
            Self::from_quaternion(x, y, z, 1.0 + trace)
        } else if a >= b && a >= c {
            Self::from_quaternion(1.0 + a - b - c, xy, xz, x)
        } else if b >= c {
            Self::from_quaternion(xy, 1.0 - a + b - c, yz, y)
        } else {
            Self::from_quaternion(xz, yz, 1.0 - a - b + c, z)
        }
    }

    /// The unit quaternion `[x, y, z, w]`.
    #[inline]
    pub fn quaternion(&self) -> [f64; 4] {
        self.to_storage()
    }

    /// The rotation matrix.
    #[inline]
    pub fn matrix(&self) -> Matrix3<f64> {
        let (x, y, z, w) = (self.x, self.y, self.z, self.w);
        Matrix3::new(
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        )
    }

    /// `[roll, pitch, yaw]` with `R = Rz(yaw) Ry(pitch) Rx(roll)`, pitch in [-π/2, π/2], the others
    /// in (-π, π]. Where pitch is ±π/2 (to 1e-12) only one of the others is determined and roll is
    /// given as zero.
    pub fn roll_pitch_yaw(&self) -> [f64; 3] {
        let m = self.matrix();
        let cos_pitch = m[(0, 0)].hypot(m[(1, 0)]);
        let pitch = (-m[(2, 0)]).atan2(cos_pitch);
        if cos_pitch < 1e-12 {
            return [0.0, pitch, principal(-m[(0, 1)], m[(1, 1)])];
        }
        [principal(m[(2, 1)], m[(2, 2)]), pitch, principal(m[(1, 0)], m[(0, 0)])]
    }

    /// `R v`.
    #[inline]
    pub fn rotate(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let q = self.imaginary();
        let t = 2.0 * q.cross(v);
        v + self.w * t + q.cross(&t)
    }

    /// `Rᵀ v`.
    #[inline]
    pub fn inverse_rotate(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let q = self.imaginary();
        let t = 2.0 * q.cross(v);
        v - self.w * t + q.cross(&t)
    }

    /// `R p`.
    #[inline]
    pub fn transform_point(&self, point: &Point3) -> Point3 {
        self.rotate(&point.vector()).into()
    }

    #[inline]
    fn imaginary(&self) -> Vector3<f64> {
        Vector3::new(self.x, self.y, self.z)
    }

    /// From a quaternion that has drifted from unit length by rounding only: one Newton step of
    /// the inverse square root at one, whose error is of the order of the drift squared.
    #[inline]
    fn renormalized(x: f64, y: f64, z: f64, w: f64) -> Self {
        let scale = 1.5 - 0.5 * (x * x + y * y + z * z + w * w);
        Self { x: x * scale, y: y * scale, z: z * scale, w: w * scale }
    }

    #[inline]
    pub(super) fn to_storage(self) -> [f64; 4] {
        [self.x, self.y, self.z, self.w]
    }

    #[inline]
    pub(super) fn from_storage([x, y, z, w]: [f64; 4]) -> Self {
        Self { x, y, z, w }
    }
}

acts_on!(Rot3, Point3, transform_point);
acts_on!(Rot3, Vector3<f64>, rotate);

impl LieGroup<3> for Rot3 {
    #[inline]
    fn identity() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }

    #[inline]
    fn compose(&self, o: &Self) -> Self {
        Self::renormalized(
            self.w * o.x + self.x * o.w + self.y * o.z - self.z * o.y,
            self.w * o.y - self.x * o.z + self.y * o.w + self.z * o.x,
            self.w * o.z + self.x * o.y - self.y * o.x + self.z * o.w,
            self.w * o.w - self.x * o.x - self.y * o.y - self.z * o.z,
        )
    }

    #[inline]
    fn inverse(&self) -> Self {
        Self { x: -self.x, y: -self.y, z: -self.z, w: self.w }
    }

    #[inline]
    fn exp(tangent: &Vector3<f64>) -> Self {
        let half = 0.5 * tangent.norm();
        let v = 0.5 * sinc(half) * tangent;
        Self { x: v.x, y: v.y, z: v.z, w: half.cos() }
    }

    /// `2 atan(|v|/w) v/|v|`, which is the same for the quaternion and its negative: the short way
    /// round. Unlike the arc cosine of the trace this is exact near zero and near half a turn.
    #[inline]
    fn log(&self) -> Vector3<f64> {
        let (v, w) = (self.imaginary(), self.w);
        let inverse = 1.0 / w;
        if let Some(ratio) = small_arctangent(v.norm_squared() * (inverse * inverse)) {
            return 2.0 * inverse * ratio * v;
        }
        let norm = v.norm();
        let angle = if w < 0.0 { -2.0 * norm.atan2(-w) } else { 2.0 * norm.atan2(w) };
        angle / norm * v
    }

    #[inline]
    fn adjoint(&self) -> Matrix3<f64> {
        self.matrix()
    }

    #[inline]
    fn right_jacobian(tangent: &Vector3<f64>) -> Matrix3<f64> {
        let (b, c) = jacobian(tangent.norm_squared());
        quadratic(tangent, -b, c)
    }

    #[inline]
    fn right_jacobian_inverse(tangent: &Vector3<f64>) -> Matrix3<f64> {
        let gamma = inverse_jacobian(tangent.norm_squared());
        quadratic(tangent, 0.5, gamma)
    }
}

/// `I + a [φ]× + b [φ]×²`, with `[φ]×² = φφᵀ - θ² I`.
#[inline]
pub(super) fn quadratic(phi: &Vector3<f64>, a: f64, b: f64) -> Matrix3<f64> {
    symmetric_and_skew(&(0.5 * b * phi), phi, 1.0 - b * phi.norm_squared(), &(a * phi))
}

/// `u vᵀ + v uᵀ + d I + [w]×`.
#[inline]
pub(super) fn symmetric_and_skew(
    u: &Vector3<f64>,
    v: &Vector3<f64>,
    d: f64,
    w: &Vector3<f64>,
) -> Matrix3<f64> {
    let (xy, xz, yz) = (u.x * v.y + u.y * v.x, u.x * v.z + u.z * v.x, u.y * v.z + u.z * v.y);
    Matrix3::new(
        2.0 * u.x * v.x + d,
        xy - w.z,
        xz + w.y,
        xy + w.z,
        2.0 * u.y * v.y + d,
        yz - w.x,
        xz - w.y,
        yz + w.x,
        2.0 * u.z * v.z + d,
    )
}

impl fmt::Debug for Rot3 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Rot3(x {:?}, y {:?}, z {:?}, w {:?})", self.x, self.y, self.z, self.w)
    }
}
