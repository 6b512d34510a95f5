//! Measurements of your own without a derivative by hand.
//!
//! Write the error once, for any [`Number`] `T`, in terms of [`Transform2`], [`Transform3`],
//! [`Rotation2`], [`Rotation3`] and nalgebra's vectors; [`AutoDiff`] makes a
//! [`Factor`](evergraph_model::Factor) of it. Its Jacobian is exact: the error is evaluated on dual numbers `a + b ε` with
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

mod factor;
mod geometry;
mod number;
mod variables;

pub use nalgebra::{SVector, Vector2, Vector3};

pub use factor::{AutoDiff, Residual};
pub use geometry::{Rotation2, Rotation3, Transform2, Transform3, norm, wrap_angle};
pub use number::{Dual64, DualNum, Number};
pub use variables::{Parameters, Variable, Variables};
