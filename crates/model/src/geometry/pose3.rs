//! Poses in space, SE(3).

use std::fmt;

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::coefficients::{
    inverse_jacobian, inverse_jacobian_with_prime, jacobian, jacobian_prime,
};
use super::rot3::{quadratic, skew, symmetric_and_skew};
use super::{Point3, Rot3, acts_on};
use crate::manifold::LieGroup;

/// Position and orientation in space; tangent order `(x, y, z, rx, ry, rz)`.
///
/// Stored as `(x, y, z, qx, qy, qz, qw)`.
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose3 {
    x: f64,
    y: f64,
    z: f64,
    rotation: Rot3,
}

impl Pose3 {
    /// From a rotation and a translation in metres.
    #[inline]
    pub fn new(rotation: Rot3, translation: impl Into<Point3>) -> Self {
        Self::from_vector(rotation, translation.into().vector())
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

    /// Third coordinate of the origin.
    #[inline]
    pub fn z(&self) -> f64 {
        self.z
    }

    /// The rotation.
    #[inline]
    pub fn rotation(&self) -> Rot3 {
        self.rotation
    }

    /// The origin.
    #[inline]
    pub fn translation(&self) -> Point3 {
        Point3::new(self.x, self.y, self.z)
    }

    /// `world_from_robot.transform_point(point in robot) = point in world`.
    #[inline]
    pub fn transform_point(&self, point: &Point3) -> Point3 {
        (self.rotation.rotate(&point.vector()) + self.vector()).into()
    }

    /// `world_from_robot.inverse_transform_point(point in world) = point in robot`.
    #[inline]
    pub fn inverse_transform_point(&self, point: &Point3) -> Point3 {
        self.rotation.inverse_rotate(&(point.vector() - self.vector())).into()
    }

    #[inline]
    fn vector(&self) -> Vector3<f64> {
        Vector3::new(self.x, self.y, self.z)
    }

    #[inline]
    fn from_vector(rotation: Rot3, t: Vector3<f64>) -> Self {
        Self { x: t.x, y: t.y, z: t.z, rotation }
    }

    #[inline]
    pub(super) fn to_storage(self) -> [f64; 7] {
        let [qx, qy, qz, qw] = self.rotation.to_storage();
        [self.x, self.y, self.z, qx, qy, qz, qw]
    }

    #[inline]
    pub(super) fn from_storage([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Self {
        Self { x, y, z, rotation: Rot3::from_storage([qx, qy, qz, qw]) }
    }
}

acts_on!(Pose3, Point3, transform_point);

#[inline]
fn split(tangent: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let d = tangent;
    (Vector3::new(d[0], d[1], d[2]), Vector3::new(d[3], d[4], d[5]))
}

/// `[A B; 0 A]`.
#[inline]
fn block_triangular(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix6<f64> {
    // Entry by entry, which compiles to nothing; views are loops at run time.
    Matrix6::from_fn(|i, j| match (i / 3, j / 3) {
        (0, 0) | (1, 1) => a[(i % 3, j % 3)],
        (0, 1) => b[(i, j - 3)],
        _ => 0.0,
    })
}

/// The derivative of `I + a(θ) [φ]× + b(θ) [φ]×²` along `rho`, given `a`, `b`, `a'/θ`, `b'/θ`.
///
/// This is the upper right block of the same function on SE(3): the adjoint representation of
/// `(ρ, φ)` is `[φ] + ε [ρ]` with `ε² = 0`, so every power series in it carries its own derivative
/// there. It equals Barfoot's Q (7.86b), or `-J⁻¹ Q J⁻¹` for the inverse, with fewer terms and
/// fewer coefficients that cancel.
#[inline]
fn directional(
    (rho, phi): (&Vector3<f64>, &Vector3<f64>),
    (a, b): (f64, f64),
    (a_prime, b_prime): (f64, f64),
) -> Matrix3<f64> {
    let dot = phi.dot(rho);
    // [φ][ρ] + [ρ][φ] = ρφᵀ + φρᵀ - 2 (φ·ρ) I,   [φ]² = φφᵀ - θ² I
    symmetric_and_skew(
        &(b * rho + 0.5 * dot * b_prime * phi),
        phi,
        -dot * (2.0 * b + b_prime * phi.norm_squared()),
        &(a * rho + dot * a_prime * phi),
    )
}

impl LieGroup<6> for Pose3 {
    #[inline]
    fn identity() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, rotation: Rot3::identity() }
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

    /// `(Jl(φ) ρ, Exp(φ))`.
    #[inline]
    fn exp(tangent: &Vector6<f64>) -> Self {
        let (rho, phi) = split(tangent);
        let (b, c) = jacobian(phi.norm_squared());
        let cross = phi.cross(&rho);
        Self::from_vector(Rot3::exp(&phi), rho + b * cross + c * phi.cross(&cross))
    }

    /// `(Jl(φ)⁻¹ t, φ)` with `φ = Log(R)`.
    // Inlined always, so that whoever takes a Jacobian at the result shares γ with it.
    #[inline(always)]
    fn log(&self) -> Vector6<f64> {
        let phi = self.rotation.log();
        let gamma = inverse_jacobian(phi.norm_squared());
        let t = self.vector();
        let cross = phi.cross(&t);
        let rho = t - 0.5 * cross + gamma * phi.cross(&cross);
        Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
    }

    #[inline]
    fn adjoint(&self) -> Matrix6<f64> {
        let r = self.rotation.matrix();
        block_triangular(&r, &(skew(&self.vector()) * r))
    }

    #[inline]
    fn right_jacobian(tangent: &Vector6<f64>) -> Matrix6<f64> {
        let (rho, phi) = split(tangent);
        let x = phi.norm_squared();
        let ((b, c), (b_prime, c_prime)) = (jacobian(x), jacobian_prime(x));
        block_triangular(
            &quadratic(&phi, -b, c),
            &directional((&rho, &phi), (-b, c), (-b_prime, c_prime)),
        )
    }

    #[inline]
    fn right_jacobian_inverse(tangent: &Vector6<f64>) -> Matrix6<f64> {
        let (rho, phi) = split(tangent);
        let (gamma, gamma_prime) = inverse_jacobian_with_prime(phi.norm_squared());
        block_triangular(
            &quadratic(&phi, 0.5, gamma),
            &directional((&rho, &phi), (0.5, gamma), (0.0, gamma_prime)),
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

impl fmt::Debug for Pose3 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Pose3({:?}, {:?}, {:?}, {:?})", self.x, self.y, self.z, self.rotation)
    }
}
