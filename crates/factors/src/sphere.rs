//! Directions: the logarithm on the unit sphere that every measured direction uses.

use nalgebra::{Matrix2x3, Matrix3x2, RowVector3, Vector2, Vector3};

use crate::error::{FactorError, finite};

/// The unit sphere seen from a measured direction `m`: the plane normal to it and the logarithm
///
/// ```text
/// e = α v/|v|,   v = Bᵀ u,   α = atan2(|v|, m·u)
/// ```
///
/// of a unit vector `u`. Opposite directions have no logarithm: there `e` is half a turn along the
/// basis's first vector and the derivative zero.
#[derive(Clone, Debug)]
pub(crate) struct Sphere {
    direction: Vector3<f64>,
    basis: Matrix3x2<f64>,
}

impl Sphere {
    /// At `direction` of length one.
    pub(crate) fn at_unit(direction: Vector3<f64>) -> Self {
        // The axis farthest from m, so that the cross product is far from zero.
        let axis = Vector3::from_fn(|i, _| if i == direction.iamin() { 1.0 } else { 0.0 });
        let first = direction.cross(&axis).normalize();
        Self { direction, basis: Matrix3x2::from_columns(&[first, direction.cross(&first)]) }
    }

    /// `m`.
    pub(crate) fn direction(&self) -> &Vector3<f64> {
        &self.direction
    }

    /// `B`: `m × a` normalized with `a` the coordinate axis (the first of them) along which `m` is
    /// shortest, and `m` times that.
    pub(crate) fn basis(&self) -> &Matrix3x2<f64> {
        &self.basis
    }

    /// The logarithm of the unit vector `u`, and its derivative along the sphere.
    #[inline]
    pub(crate) fn log(&self, u: &Vector3<f64>) -> (Vector2<f64>, Matrix2x3<f64>) {
        let v = self.basis.tr_mul(u);
        let (sin, cos) = (v.norm(), self.direction.dot(u));
        let angle = sin.atan2(cos);
        if !sin.is_normal() && cos < 0.0 {
            return (Vector2::new(angle, 0.0), Matrix2x3::zeros());
        }
        // e = f v with f = α/sin α, and on the sphere df = slope (v·dv) - m·du.
        let f = if sin.is_normal() { angle / sin } else { 1.0 };
        let slope = -4.0 * f * f * f * excess(2.0 * angle);
        let tangent = self.basis.transpose();
        let df: RowVector3<f64> = slope * v.transpose() * tangent - self.direction.transpose();
        (f * v, f * tangent + v * df)
    }
}

/// `(t - sin t)/t³`, by its series where the difference would cancel.
#[inline]
fn excess(t: f64) -> f64 {
    let x = t * t;
    if x < 0.04 {
        return 1.0 / 6.0 - x / 120.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0 * (1.0 - x / 110.0)));
    }
    (t - t.sin()) / (x * t)
}

/// `v` at length one.
pub(crate) fn unit(
    factor: &'static str,
    what: &'static str,
    v: Vector3<f64>,
) -> Result<Vector3<f64>, FactorError> {
    finite(factor, what, v.as_slice())?;
    let largest = v.amax();
    if largest < f64::MIN_POSITIVE {
        return Err(FactorError::NoDirection { factor, what, numbers: v.as_slice().into() });
    }
    Ok((v / largest).normalize())
}
