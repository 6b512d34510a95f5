//! Measurements of your own without a derivative by hand.
//!
//! Write the error once, for any [`Number`] `T`, in terms of [`Transform2`], [`Transform3`],
//! [`Rotation2`], [`Rotation3`] and nalgebra's vectors; [`AutoDiff`] makes a
//! [`Factor`] of it. Its Jacobian is exact: the error is evaluated on dual numbers `a + b ε` with
//! `ε² = 0` (forward-mode automatic differentiation), once per tangent component of the variables.
//! A variable `x` enters as `x Exp(d)` to first order in `d`, which is all that a derivative at
//! `d = 0` sees.
//!
//! ```
//! use evergraph_factors::autodiff::{AutoDiff, Number, Residual, Transform2, Vector2, norm};
//! use evergraph_model::testing::check_jacobian;
//! use evergraph_model::{Graph, Noise, Point2, Pose2, Value};
//!
//! /// The distance from an antenna on the robot to a beacon.
//! #[derive(Debug)]
//! struct AntennaRange {
//!     antenna_in_robot: Point2,
//!     range: f64,
//! }
//!
//! impl Residual<1> for AntennaRange {
//!     type Variables = (Pose2, Point2);
//!     const NAME: &'static str = "AntennaRange";
//!
//!     fn evaluate<T: Number>(&self, (pose, beacon): (Transform2<T>, Vector2<T>)) -> [T; 1] {
//!         let antenna = pose.transform_point(&self.antenna_in_robot.vector().map(T::from));
//!         [norm(&(beacon - antenna)) - self.range]
//!     }
//! }
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let (robot, place) = (Pose2::new(1.0, 2.0, 0.5), Point2::new(4.0, 6.0));
//! let graph = Graph::new();
//! let mut change = graph.change();
//! let keys = (change.add_variable(&robot), change.add_variable(&place));
//! let measured = AntennaRange { antenna_in_robot: Point2::new(0.3, 0.0), range: 4.8 };
//! let factor = AutoDiff::new(keys, measured, Noise::isotropic(1, 0.1)?)?;
//! check_jacobian(&factor, &[Value::new(&robot), Value::new(&place)])?;
//! change.add_factor(factor);
//! # Ok(())
//! # }
//! ```
//!
//! A factor written by hand is faster: one pass instead of one per tangent component.

mod geometry;
mod variables;

use std::any::Any;
use std::fmt::Debug;

use evergraph_model::{Arguments, Factor, Linearization, Noise, VariableId, VariableType};
pub use nalgebra::{SVector, Vector2, Vector3};
pub use num_dual::{Dual64, DualNum};
use smallvec::SmallVec;

pub use geometry::{Rotation2, Rotation3, Transform2, Transform3, norm, wrap_angle};
pub use variables::{Parameters, Variable, Variables};

use crate::error::FactorError;

/// What a residual computes with: an `f64`, or one that carries a derivative.
///
/// Has the operators, with `f64` on the right too, and the functions of [`DualNum`] (`sqrt`, `sin`,
/// `atan2`, …); `T::from(2.0)` is a constant, `x.re()` the plain value, to branch on.
pub trait Number: DualNum<Primitive = f64> + Copy {}
impl<T: DualNum<Primitive = f64> + Copy> Number for T {}

/// An error of `ROWS` numbers as a function of some variables; [`AutoDiff`] makes it a factor.
pub trait Residual<const ROWS: usize>: Debug + Send + Sync + 'static {
    /// The types of the variables, a tuple of one to four: `(Pose2, Point2)`, `(Pose3,)`.
    /// A vector of `N` parameters ([`VectorN`](evergraph_model::VectorN)) is
    /// [`Parameters<N>`](Parameters).
    type Variables: Variables;

    /// The factor's name in messages.
    const NAME: &'static str;

    /// The error in the units of the measurement, not whitened. In an implementation, name the
    /// types that the variables have here ([`Variable::Lifted`]), as in the
    /// [example](crate::autodiff).
    ///
    /// Where the error has no derivative (a root or a distance at zero) the result may be no
    /// number; the solver then names the factor.
    fn evaluate<T: Number>(
        &self,
        variables: <Self::Variables as Variables>::Lifted<T>,
    ) -> [T; ROWS];
}

/// A factor whose Jacobian is found by automatic differentiation: `r = R e(x₁ …)` with the error
/// `e` of a [`Residual`].
#[derive(Clone, Debug)]
pub struct AutoDiff<E, const ROWS: usize> {
    keys: SmallVec<[VariableId; 4]>,
    error: E,
    noise: Noise,
}

impl<E: Residual<ROWS>, const ROWS: usize> AutoDiff<E, ROWS> {
    /// `keys` are those of `error`'s variables, in the order of their types; the noise has `ROWS`
    /// dimensions.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`].
    pub fn new(
        keys: <E::Variables as Variables>::Keys,
        error: E,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        if noise.dim() != ROWS {
            let actual = noise.dim();
            return Err(FactorError::NoiseDimension { factor: E::NAME, expected: ROWS, actual });
        }
        Ok(Self { keys: E::Variables::ids(keys), error, noise })
    }

    /// The error at the values; `tangent` gives each variable's tangent by position and component.
    fn evaluate<T: Number>(
        &self,
        at: &Arguments<'_>,
        tangent: impl Fn(usize, usize) -> T,
    ) -> [T; ROWS] {
        self.error.evaluate(E::Variables::lift(at, tangent))
    }

    /// The derivative of the error by one tangent component.
    fn derivative(&self, at: &Arguments<'_>, position: usize, component: usize) -> [f64; ROWS] {
        let seed = |p, c| if (p, c) == (position, component) { 1.0 } else { 0.0 };
        self.evaluate(at, |p, c| Dual64::new(0.0, seed(p, c))).map(|error| error.eps)
    }
}

impl<E, const ROWS: usize> AutoDiff<E, ROWS> {
    /// The error function with its measurement.
    pub fn inner(&self) -> &E {
        &self.error
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<E: Residual<ROWS>, const ROWS: usize> Factor for AutoDiff<E, ROWS> {
    fn name(&self) -> String {
        E::NAME.into()
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        ROWS
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        E::Variables::accepts(position, kind, dim)
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out.copy_from_slice(&self.evaluate(at, |_, _| 0.0));
        self.noise.whiten_columns(out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        for position in 0..self.keys.len() {
            let block = out.block_mut(position);
            for (component, column) in block.chunks_exact_mut(ROWS).enumerate() {
                column.copy_from_slice(&self.derivative(at, position, component));
            }
        }
        out.residual_mut().copy_from_slice(&self.evaluate(at, |_, _| 0.0));
        self.noise.whiten_columns(out.data_mut());
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
