//! Rotations and rigid transforms in numbers that carry derivatives.

use evergraph_model::{Pose2, Pose3, Rot2, Rot3, geometry};
use nalgebra::{Matrix2, Matrix3, SVector, Vector2, Vector3, Vector6};

use super::number::Number;

/// A rotation in the plane: [`Rot2`] as a residual sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation2<T> {
    cos: T,
    sin: T,
}

/// A rotation in space: [`Rot3`] as a residual sees it, a unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation3<T> {
    imaginary: Vector3<T>,
    real: T,
}

macro_rules! transform {
    ($name:ident, $rotation:ident, $vector:ident, $pose:ident) => {
        #[doc = concat!("A rigid transform: [`", stringify!($pose), "`] as a residual sees it.")]
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name<T> {
            rotation: $rotation<T>,
            translation: $vector<T>,
        }

        impl<T: Number> $name<T> {
            /// From its parts.
            pub fn new(rotation: $rotation<T>, translation: $vector<T>) -> Self {
                Self { rotation, translation }
            }

            /// The rotation.
            pub fn rotation(&self) -> $rotation<T> {
                self.rotation
            }

            /// The translation, metres.
            pub fn translation(&self) -> $vector<T> {
                self.translation
            }

            /// `self * other`.
            #[must_use]
            pub fn compose(&self, other: &Self) -> Self {
                let rotation = self.rotation.compose(&other.rotation);
                Self { rotation, translation: self.transform_point(&other.translation) }
            }

            /// `self⁻¹`.
            #[must_use]
            pub fn inverse(&self) -> Self {
                let translation = -self.rotation.inverse_rotate(&self.translation);
                Self { rotation: self.rotation.inverse(), translation }
            }

            /// `self⁻¹ * other`.
            #[must_use]
            pub fn between(&self, other: &Self) -> Self {
                let rotation = self.rotation.between(&other.rotation);
                Self { rotation, translation: self.inverse_transform_point(&other.translation) }
            }

            /// A point of the frame in the world.
            pub fn transform_point(&self, point: &$vector<T>) -> $vector<T> {
                self.rotation.rotate(point) + self.translation
            }

            /// A point of the world in the frame.
            pub fn inverse_transform_point(&self, point: &$vector<T>) -> $vector<T> {
                self.rotation.inverse_rotate(&(point - self.translation))
            }
        }

        /// A constant.
        impl<T: Number> From<$pose> for $name<T> {
            fn from(pose: $pose) -> Self {
                let translation = pose.translation().vector().map(T::from);
                Self { rotation: pose.rotation().into(), translation }
            }
        }
    };
}
transform!(Transform2, Rotation2, Vector2, Pose2);
transform!(Transform3, Rotation3, Vector3, Pose3);

impl<T: Number> Rotation2<T> {
    /// The angle in (-π, π].
    pub fn angle(&self) -> T {
        wrap_angle(self.sin.atan2(self.cos))
    }

    /// The logarithm, which is the angle.
    pub fn log(&self) -> T {
        self.angle()
    }

    /// The rotation matrix.
    pub fn matrix(&self) -> Matrix2<T> {
        Matrix2::new(self.cos, -self.sin, self.sin, self.cos)
    }

    /// `self * other`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            cos: self.cos * other.cos - self.sin * other.sin,
            sin: self.sin * other.cos + self.cos * other.sin,
        }
    }

    /// `self⁻¹`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { cos: self.cos, sin: -self.sin }
    }

    /// `self⁻¹ * other`.
    #[must_use]
    pub fn between(&self, other: &Self) -> Self {
        self.inverse().compose(other)
    }

    /// `C v`.
    pub fn rotate(&self, v: &Vector2<T>) -> Vector2<T> {
        Vector2::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y)
    }

    /// `Cᵀ v`.
    pub fn inverse_rotate(&self, v: &Vector2<T>) -> Vector2<T> {
        self.inverse().rotate(v)
    }

    /// `self * Exp(angle)` to first order.
    pub(super) fn turned(&self, angle: T) -> Self {
        self.compose(&Self { cos: T::one(), sin: angle })
    }
}

impl<T: Number> Rotation3<T> {
    /// The rotation matrix.
    pub fn matrix(&self) -> Matrix3<T> {
        let (zero, one) = (T::zero(), T::one());
        Matrix3::from_columns(&[
            self.rotate(&Vector3::new(one, zero, zero)),
            self.rotate(&Vector3::new(zero, one, zero)),
            self.rotate(&Vector3::new(zero, zero, one)),
        ])
    }

    /// The direction of the x axis in the horizontal plane, as
    /// [`Heading3`](crate::Heading3); no number where the axis is vertical.
    pub fn heading(&self) -> T {
        let x = self.rotate(&Vector3::new(T::one(), T::zero(), T::zero()));
        wrap_angle(x.y.atan2(x.x))
    }

    /// `self * other`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        let (a, b) = (&self.imaginary, &other.imaginary);
        Self {
            imaginary: b * self.real + a * other.real + a.cross(b),
            real: self.real * other.real - a.dot(b),
        }
    }

    /// `self⁻¹`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { imaginary: -self.imaginary, real: self.real }
    }

    /// `self⁻¹ * other`.
    #[must_use]
    pub fn between(&self, other: &Self) -> Self {
        self.inverse().compose(other)
    }

    /// `C v`.
    pub fn rotate(&self, v: &Vector3<T>) -> Vector3<T> {
        let t = self.imaginary.cross(v) * T::from(2.0);
        v + t * self.real + self.imaginary.cross(&t)
    }

    /// `Cᵀ v`.
    pub fn inverse_rotate(&self, v: &Vector3<T>) -> Vector3<T> {
        self.inverse().rotate(v)
    }

    /// The rotation vector, of length at most π.
    pub fn log(&self) -> Vector3<T> {
        let (v, w) = self.short_way();
        v * (half_angle_over_sine(v.dot(&v), w) * 2.0)
    }

    /// `self * Exp(rotation_vector)` to first order.
    pub(super) fn turned(&self, rotation_vector: &Vector3<T>) -> Self {
        let imaginary = rotation_vector.map(|x| x * 0.5);
        self.compose(&Self { imaginary, real: T::one() })
    }

    /// The quaternion or its negative, whichever turns by half a turn or less.
    fn short_way(&self) -> (Vector3<T>, T) {
        if self.real.re() < 0.0 {
            (-self.imaginary, -self.real)
        } else {
            (self.imaginary, self.real)
        }
    }
}

impl<T: Number> Transform2<T> {
    /// The heading in (-π, π].
    pub fn heading(&self) -> T {
        self.rotation.angle()
    }

    /// The logarithm on SE(2), in tangent order.
    pub fn log(&self) -> Vector3<T> {
        let theta = self.rotation.angle();
        let half = theta * 0.5;
        let sine_squared = (-self.rotation.cos + 1.0) * 0.5;
        let excess = cotangent_excess(sine_squared, || half * half.cos() / half.sin());
        let h_cot_h = -sine_squared * excess + 1.0;
        let t = self.translation;
        Vector3::new(h_cot_h * t.x + half * t.y, h_cot_h * t.y - half * t.x, theta)
    }
}

impl<T: Number> Transform3<T> {
    /// The logarithm on SE(3), in tangent order.
    pub fn log(&self) -> Vector6<T> {
        let (v, w) = self.rotation.short_way();
        let sine_squared = v.dot(&v);
        let h_over_sine = half_angle_over_sine(sine_squared, w);
        let excess = cotangent_excess(sine_squared, || h_over_sine * w);
        // Jl⁻¹ t = t - ½ φ × t + (1 - h cot h) a × (a × t), with φ = 2h a and v = a sin h.
        let across = v.cross(&self.translation);
        let t = self.translation - across * h_over_sine + v.cross(&across) * excess;
        let r = v * (h_over_sine * 2.0);
        Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
    }
}

/// A constant.
impl<T: Number> From<Rot2> for Rotation2<T> {
    fn from(rotation: Rot2) -> Self {
        Self { cos: T::from(rotation.cos()), sin: T::from(rotation.sin()) }
    }
}

/// A constant.
impl<T: Number> From<Rot3> for Rotation3<T> {
    fn from(rotation: Rot3) -> Self {
        let [x, y, z, w] = rotation.quaternion().map(T::from);
        Self { imaginary: Vector3::new(x, y, z), real: w }
    }
}

/// The same angle in (-π, π].
pub fn wrap_angle<T: Number>(angle: T) -> T {
    let plain = angle.re();
    let wrapped = geometry::wrap_angle(plain);
    if wrapped == plain { angle } else { angle + (wrapped - plain) }
}

/// The length of a vector. It has no derivative at length zero, where that is taken as zero.
pub fn norm<T: Number, const N: usize>(v: &SVector<T, N>) -> T {
    // Scaled by the largest component, so that no square leaves the range of f64.
    if v.iter().all(|x| x.re().abs() < f64::MIN_POSITIVE) {
        return T::zero();
    }
    let largest = v.iter().map(|x| x.re().abs()).fold(0.0, f64::max);
    let scaled = v.map(|x| x / largest);
    scaled.dot(&scaled).sqrt() * largest
}

/// Below this `sin² h` series are used, whose derivative does not cancel.
const SERIES_BELOW: f64 = 0.1;
/// Terms kept; the first one left out is below 1e-17 of the sum.
const TERMS: usize = 17;

/// `h / sin h` for the unit quaternion of half angle `h` in [0, π/2].
fn half_angle_over_sine<T: Number>(sine_squared: T, cosine: T) -> T {
    if sine_squared.re() < SERIES_BELOW {
        // The arc sine: 1 + x/6 + 3x²/40 + …
        return series(sine_squared, 1.0, |n| {
            (2.0 * n + 1.0).powi(2) / ((2.0 * n + 2.0) * (2.0 * n + 3.0))
        });
    }
    let sine = sine_squared.sqrt();
    sine.atan2(cosine) / sine
}

/// `(1 - h cot h) / sin² h`; `h_cot_h` is asked where it does not cancel.
fn cotangent_excess<T: Number>(sine_squared: T, h_cot_h: impl FnOnce() -> T) -> T {
    if sine_squared.re() < SERIES_BELOW {
        // 1/3 + 2x/15 + 8x²/105 + …
        return series(sine_squared, 1.0 / 3.0, |n| (2.0 * n + 2.0) / (2.0 * n + 5.0));
    }
    (-h_cot_h() + 1.0) / sine_squared
}

/// `Σ cₙ xⁿ` from `c₀` and the ratios `cₙ₊₁/cₙ`.
fn series<T: Number>(x: T, first: f64, ratio: impl Fn(f64) -> f64) -> T {
    let nested = |inner: T, n: usize| x * inner * ratio(n as f64) + 1.0;
    (0..TERMS).rev().fold(T::one(), nested) * first
}
