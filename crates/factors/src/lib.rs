//! Measurements: each a residual and its Jacobian.
//!
//! A factor is a term `½ ‖r(x)‖²` of the objective with a whitened residual `r = R e(x)`, where `e`
//! is the error in the units of the measurement and `R` the square root of its information
//! ([`Noise`](evergraph_model::Noise)). Every factor here gives analytic Jacobians with respect to
//! right perturbations, in the [conventions](evergraph_model#conventions) of the model, and keeps
//! its measurement and noise readable. The [`catalogue`] converts every factor into plain data with
//! a stable name, and back, bit for bit.
//!
//! | factor | variables | error `e` | rows |
//! |---|---|---|---|
//! | [`Prior`] | any | `Local(z, x)` | dimension |
//! | [`Between`] | two of a group | `Log(z⁻¹ xᵢ⁻¹ xⱼ)` | dimension |
//! | [`PartialBetween`] | two poses | `A Log(z⁻¹ xᵢ⁻¹ xⱼ)`: picked or combined components | any |
//! | [`DepthDifference`], [`HeadingDifference`] | two poses in space | difference in the world less `d` | 1 |
//! | [`TranslationDifference2`], [`TranslationDifference3`] | two poses | `tⱼ - tᵢ - d` | 2, 3 |
//! | [`RelativePosition2`], [`RelativePosition3`] | pose, point | `T⁻¹ p - z` | 2, 3 |
//! | [`Range`] | two [`Positioned`] | `\|p_b - p_a\| - z` | 1 |
//! | [`Bearing2`], [`Bearing3`] | pose, [`Positioned`] | angle; logarithm on the sphere | 1, 2 |
//! | [`BearingRange2`], [`BearingRange3`] | pose, [`Positioned`] | both | 2, 3 |
//! | [`GpsPosition2`], [`GpsPosition3`] | pose | `t + C a - z` | 2, 3 |
//! | [`Depth`] | pose in space | `t_z - z` | 1 |
//! | [`PlanarMotion`] | pose in space | `t_z - h` and tilt | 3 |
//! | [`Attitude`] | pose in space | logarithm on the sphere of `Cᵀ g` at `m` | 2 |
//! | [`RollPitch`] | pose in space | ZYX roll and pitch | 2 |
//! | [`Heading2`], [`Heading3`] | pose | `wrap(heading - psi)` | 1 |
//! | [`AutoDiff`] | one to four | your own, with an exact Jacobian; see [`autodiff`] | any |
//! | [`Linear`] | any, any number | `G (Local(x̂', r(x)) - d')` | any |
//!
//! Constructors refuse what cannot be measured (numbers that are not finite, a noise of another
//! dimension); the graph refuses variables that a factor does not take. Any factor can stand under
//! a robust kernel, [`Robust`](evergraph_model::Robust), or have some of its variables given,
//! [`Conditioned`].
//!
//! # Example
//!
//! ```
//! use evergraph_factors::{BetweenPose2, Prior};
//! use evergraph_model::{Graph, Noise, Pose2};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let graph = Graph::new();
//! let mut change = graph.change();
//! let start = change.add_variable(&Pose2::new(0.0, 0.0, 0.0));
//! let next = change.add_variable(&Pose2::new(1.1, 0.0, 0.0));
//!
//! let known = Noise::from_sigmas(&[0.01, 0.01, 0.01])?;
//! change.add_factor(Prior::new(start, Pose2::new(0.0, 0.0, 0.0), known)?);
//!
//! // One metre ahead, to 5 cm and one degree.
//! let odometry = Noise::from_sigmas(&[0.05, 0.05, 1_f64.to_radians()])?;
//! change.add_factor(BetweenPose2::new(start, next, Pose2::new(1.0, 0.0, 0.0), odometry)?);
//! assert_eq!(change.new_factors().len(), 2);
//! # Ok(())
//! # }
//! ```
//!
//! # References
//!
//! - Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics" (2018):
//!   Jacobians on groups.
//! - Dellaert and Kaess, "Factor Graphs for Robot Perception" (2017): factors and whitening.
//! - Carlevaris-Bianco and Eustice, "Long-Term Simultaneous Localization and Mapping with Generic
//!   Linear Constraint Node Removal" (2013): [`Linear`].
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod attitude;
pub mod autodiff;
mod bearing2;
mod bearing3;
mod between;
pub mod catalogue;
mod conditioned;
mod cross;
mod differences;
mod error;
mod geodetic;
mod gps;
mod landmark;
mod linear;
mod partial_between;
mod partial_prior;
mod planar_motion;
mod positioned;
mod prior;
mod range;
mod relative;
mod root_shift;
mod sphere;
mod whitening;

pub use attitude::{Attitude, RollPitch};
pub use autodiff::AutoDiff;
pub use bearing2::{Bearing2, BearingRange2};
pub use bearing3::{Bearing3, BearingRange3};
pub use between::{
    Between, BetweenPoint2, BetweenPoint3, BetweenPose2, BetweenPose3, BetweenRot2, BetweenRot3,
};
pub use conditioned::{Conditioned, Input};
pub use differences::{
    DepthDifference, HeadingDifference, TranslationDifference2, TranslationDifference3,
};
pub use error::FactorError;
pub use geodetic::{Geodetic, GeodeticError, LocalFrame};
pub use gps::{GpsPosition2, GpsPosition3};
pub use landmark::{RelativePosition2, RelativePosition3};
pub use linear::Linear;
pub use partial_between::{PartialBetween, PartialBetweenPose2, PartialBetweenPose3};
pub use partial_prior::{Depth, Heading2, Heading3};
pub use planar_motion::PlanarMotion;
pub use positioned::Positioned;
pub use prior::{LocalJacobian, Prior};
pub use range::Range;
pub use root_shift::RootShift;
