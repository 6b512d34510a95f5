//! A world of a user's own: a straight track whose scale is unknown. Its motions are `x ↦ s x + t`.

use evergraph_model::{Frame, LieGroup, Manifold, Motion, Moves};
use nalgebra::{Matrix2, Vector2};

/// A motion of the track, and a pose on it: tangent `(shift, log scale)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Car {
    pub scale: f64,
    pub shift: f64,
}

/// `(1 - e⁻ˣ) / x`, and its difference from 1 over x.
fn series(x: f64) -> (f64, f64) {
    if x.abs() < 1e-3 {
        let slope = -0.5 + x / 6.0 - x * x / 24.0 + x * x * x / 120.0;
        (1.0 + x * slope, slope)
    } else {
        let value = -(-x).exp_m1() / x;
        (value, (value - 1.0) / x)
    }
}

impl Manifold for Car {
    const NAME: &'static str = "Car";
    const COMPONENTS: &'static [&'static str] = &["shift", "log scale"];
    const MOTION: Option<Motion> = Some(Motion::of_pose::<Self, Self, 2>());
    fn dim(&self) -> usize {
        2
    }
    fn storage_len(&self) -> usize {
        2
    }
    fn store(&self, out: &mut [f64]) {
        out.copy_from_slice(&[self.scale, self.shift]);
    }
    fn load(s: &[f64]) -> Self {
        Self { scale: s[0], shift: s[1] }
    }
    fn retract(&self, d: &[f64]) -> Self {
        self.compose(&Self::exp(&Vector2::from_column_slice(d)))
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        out.copy_from_slice(self.between(other).log().as_slice());
    }
}

impl LieGroup<2> for Car {
    fn identity() -> Self {
        Self { scale: 1.0, shift: 0.0 }
    }
    fn compose(&self, other: &Self) -> Self {
        Self { scale: self.scale * other.scale, shift: self.scale * other.shift + self.shift }
    }
    fn inverse(&self) -> Self {
        Self { scale: 1.0 / self.scale, shift: -self.shift / self.scale }
    }
    fn exp(d: &Vector2<f64>) -> Self {
        Self { scale: d[1].exp(), shift: d[0] * series(-d[1]).0 }
    }
    fn log(&self) -> Vector2<f64> {
        let log = self.scale.ln();
        Vector2::new(self.shift / series(-log).0, log)
    }
    fn adjoint(&self) -> Matrix2<f64> {
        Matrix2::new(self.scale, -self.shift, 0.0, 1.0)
    }
    fn right_jacobian(d: &Vector2<f64>) -> Matrix2<f64> {
        let (value, slope) = series(d[1]);
        Matrix2::new(value, -d[0] * slope, 0.0, 1.0)
    }
    fn right_jacobian_inverse(d: &Vector2<f64>) -> Matrix2<f64> {
        let (value, slope) = series(d[1]);
        Matrix2::new(1.0 / value, d[0] * slope / value, 0.0, 1.0)
    }
}

impl Moves<Car, 2> for Car {
    const ROTATION: usize = 0;
    fn seen_from(&self, frame: &Self) -> Self {
        frame.between(self)
    }
    fn lever(&self, out: &mut [f64]) {
        out.copy_from_slice(self.inverse().adjoint().as_slice());
    }
}

impl Frame<Car, 2> for Car {
    fn frame(&self) -> Self {
        *self
    }
}

/// A mark beside the track. From a car its place is seen scaled, so that the derivative is no rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark(pub f64);

impl Manifold for Mark {
    const NAME: &'static str = "Mark";
    const COMPONENTS: &'static [&'static str] = &["place"];
    const MOTION: Option<Motion> = Some(Motion::of::<Self, Car, 2>());
    fn dim(&self) -> usize {
        1
    }
    fn storage_len(&self) -> usize {
        1
    }
    fn store(&self, out: &mut [f64]) {
        out[0] = self.0;
    }
    fn load(s: &[f64]) -> Self {
        Self(s[0])
    }
    fn retract(&self, d: &[f64]) -> Self {
        Self(self.0 + d[0])
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        out[0] = other.0 - self.0;
    }
}

impl Moves<Car, 2> for Mark {
    const ROTATION: usize = 0;
    fn seen_from(&self, frame: &Car) -> Self {
        Self((self.0 - frame.shift) / frame.scale)
    }
    fn seen_from_derivative(&self, frame: &Car, out: &mut [f64]) {
        out[0] = 1.0 / frame.scale;
    }
    fn lever(&self, out: &mut [f64]) {
        out.copy_from_slice(&[1.0, self.0]);
    }
}
