//! The rigid motions of a world: nalgebra's isometries, whose products are additions and
//! multiplications only, with the exponential and the angles taken from `libm`.
//!
//! Why not the poses of `evergraph-model`: they use the platform's sine and arc tangent, which are
//! free to differ in the last bit, and a seed would not name the same bytes everywhere.

use evergraph_formats::{Coordinates, EntryOrder, Weight, WeightKind};
use nalgebra::{
    Isometry2, Isometry3, Quaternion, Translation2, Translation3, UnitComplex, UnitQuaternion,
    Vector3,
};
use smallvec::SmallVec;

/// A pose in `D` dimensions with `N` degrees of freedom.
pub(crate) trait Pose<const N: usize, const D: usize>: Copy {
    /// The exponential, translation first.
    fn exp(tangent: &[f64; N]) -> Self;
    /// `self * other`, rotation normalized.
    fn compose(&self, other: &Self) -> Self;
    /// `self⁻¹ * other`.
    fn between(&self, other: &Self) -> Self;
    /// Where it is.
    fn position(&self) -> [f64; D];
    /// Cosine of the rotation's angle.
    fn cosine(&self) -> f64;
    /// The numbers of a file.
    fn coordinates(&self) -> Coordinates;
}

impl Pose<3, 2> for Isometry2<f64> {
    fn exp(&[x, y, theta]: &[f64; 3]) -> Self {
        // V = [a -b; b a], a = sin θ / θ, b = (1 - cos θ) / θ = 2 sin²(θ/2) / θ.
        let (a, b) = if theta == 0.0 {
            (1.0, 0.0)
        } else {
            let half = libm::sin(0.5 * theta);
            (libm::sin(theta) / theta, 2.0 * half * half / theta)
        };
        let translation = Translation2::new(a * x - b * y, b * x + a * y);
        Self::from_parts(translation, unit_complex(libm::cos(theta), libm::sin(theta)))
    }

    fn compose(&self, other: &Self) -> Self {
        let mut product = self * other;
        product.rotation = unit_complex(product.rotation.re, product.rotation.im);
        product
    }

    fn between(&self, other: &Self) -> Self {
        self.inverse() * other
    }

    fn position(&self) -> [f64; 2] {
        self.translation.vector.into()
    }

    fn cosine(&self) -> f64 {
        self.rotation.re
    }

    fn coordinates(&self) -> Coordinates {
        let [x, y] = self.position();
        Coordinates::Pose2([x, y, libm::atan2(self.rotation.im, self.rotation.re)])
    }
}

impl Pose<6, 3> for Isometry3<f64> {
    fn exp(tangent: &[f64; 6]) -> Self {
        let [x, y, z, rx, ry, rz] = *tangent;
        let (rho, phi) = (Vector3::new(x, y, z), Vector3::new(rx, ry, rz));
        let squared = phi.norm_squared();
        let angle = libm::sqrt(squared);
        let half = libm::sin(0.5 * angle);
        // V = I + b [φ] + c [φ]², b = (1 - cos θ) / θ², c = (θ - sin θ) / θ³.
        let (s, b, c) = if angle < 0.03 {
            // Closed forms cancel; the first terms left out are below 1e-15 here.
            (
                0.5 - squared / 48.0 + squared * squared / 3840.0,
                0.5 - squared / 24.0 + squared * squared / 720.0,
                1.0 / 6.0 - squared / 120.0 + squared * squared / 5040.0,
            )
        } else {
            (
                half / angle,
                2.0 * half * half / squared,
                (angle - libm::sin(angle)) / (angle * squared),
            )
        };
        let turned = phi.cross(&rho);
        let translation = rho + turned * b + phi.cross(&turned) * c;
        let w = libm::cos(0.5 * angle);
        let rotation = unit_quaternion(Quaternion::from_parts(w, phi * s));
        Self::from_parts(Translation3::from(translation), rotation)
    }

    fn compose(&self, other: &Self) -> Self {
        let mut product = self * other;
        product.rotation = unit_quaternion(*product.rotation.quaternion());
        product
    }

    fn between(&self, other: &Self) -> Self {
        self.inverse() * other
    }

    fn position(&self) -> [f64; 3] {
        self.translation.vector.into()
    }

    fn cosine(&self) -> f64 {
        2.0 * self.rotation.w * self.rotation.w - 1.0
    }

    /// The quaternion with `w ≥ 0`.
    fn coordinates(&self) -> Coordinates {
        let [x, y, z] = self.position();
        let q = *self.rotation.quaternion();
        let q = if q.w < 0.0 { -q } else { q };
        Coordinates::Pose3Quaternion([x, y, z, q.i, q.j, q.k, q.w])
    }
}

/// Rotation by quarter turns to the left, exact.
pub(crate) fn quarter_turns(count: u32) -> UnitComplex<f64> {
    let (cos, sin) = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][count as usize % 4];
    UnitComplex::from_cos_sin_unchecked(cos, sin)
}

/// Rotation by `angle` about the y axis.
pub(crate) fn about_y(angle: f64) -> UnitQuaternion<f64> {
    let (sin, cos) = libm::sincos(0.5 * angle);
    unit_quaternion(Quaternion::new(cos, 0.0, sin, 0.0))
}

/// Rotation by `angle` about the z axis.
pub(crate) fn about_z(angle: f64) -> UnitQuaternion<f64> {
    let (sin, cos) = libm::sincos(0.5 * angle);
    unit_quaternion(Quaternion::new(cos, 0.0, 0.0, sin))
}

/// `diag(1/σ²)` as a file writes it.
pub(crate) fn information(sigmas: &[f64]) -> Weight {
    let n = sigmas.len();
    let mut entries: SmallVec<[f64; 6]> = SmallVec::with_capacity(n * (n + 1) / 2);
    for (row, sigma) in sigmas.iter().enumerate() {
        entries.push(1.0 / (sigma * sigma));
        entries.extend(std::iter::repeat_n(0.0, n - row - 1));
    }
    Weight {
        kind: WeightKind::Information,
        order: EntryOrder::UpperTriangle,
        entries: entries.into(),
    }
}

fn unit_complex(re: f64, im: f64) -> UnitComplex<f64> {
    let norm = libm::sqrt(re * re + im * im);
    UnitComplex::from_cos_sin_unchecked(re / norm, im / norm)
}

fn unit_quaternion(q: Quaternion<f64>) -> UnitQuaternion<f64> {
    let norm = libm::sqrt(q.w * q.w + q.i * q.i + q.j * q.j + q.k * q.k);
    UnitQuaternion::new_unchecked(Quaternion::new(q.w / norm, q.i / norm, q.j / norm, q.k / norm))
}

#[cfg(test)]
mod tests {
    use evergraph_model::{LieGroup, Pose2, Pose3};

    use super::*;

    /// Scales on both sides of the switch to the series, in directions without symmetry.
    const SCALES: [f64; 8] = [0.0, 1e-12, 1e-4, 0.01, 0.0299, 0.0301, 0.5, 3.0];

    #[test]
    fn the_exponential_of_se2_is_that_of_the_model() {
        for scale in SCALES {
            let tangent = [0.7, -0.4, scale];
            let ours: Isometry2<f64> = Pose::exp(&tangent);
            let model = Pose2::exp(&tangent.into());
            let off = [
                ours.translation.x - model.x(),
                ours.translation.y - model.y(),
                ours.rotation.re - model.rotation().cos(),
                ours.rotation.im - model.rotation().sin(),
            ];
            assert!(off.iter().all(|off| off.abs() < 1e-14), "{scale}: {off:?}");
        }
    }

    #[test]
    fn the_exponential_of_se3_is_that_of_the_model() {
        for scale in SCALES {
            let tangent = [0.7, -0.4, 0.2, 0.6 * scale, -0.48 * scale, 0.64 * scale];
            let ours: Isometry3<f64> = Pose::exp(&tangent);
            let model = Pose3::exp(&tangent.into());
            let [x, y, z, w] = model.rotation().quaternion();
            let q = ours.rotation;
            let sign = (q.w * w + q.i * x + q.j * y + q.k * z).signum();
            let off = [
                ours.translation.x - model.x(),
                ours.translation.y - model.y(),
                ours.translation.z - model.z(),
                q.i - sign * x,
                q.j - sign * y,
                q.k - sign * z,
                q.w - sign * w,
            ];
            assert!(off.iter().all(|off| off.abs() < 1e-13), "{scale}: {off:?}");
        }
    }

    #[test]
    fn information_is_the_upper_triangle_of_a_diagonal() {
        let weight = information(&[0.5, 0.1, 0.25]);
        let expected = [4.0, 0.0, 0.0, 1.0 / (0.1 * 0.1), 0.0, 16.0];
        assert_eq!(weight.entries[..], expected);
        assert_eq!(information(&[1.0; 6]).entries.len(), 21);
    }
}
