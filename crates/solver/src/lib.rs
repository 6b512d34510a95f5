//! The solver: keeps the solution of a growing nonlinear least-squares problem current.
//!
//! At linearization points X, with whitened residuals r and Jacobian J, the step δ that minimizes
//! `‖Jδ + r‖²` solves
//!
//! ```text
//! R δ = −d        RᵀR = JᵀJ,   Rᵀd = Jᵀr
//! ```
//!
//! R, the square-root information matrix, is kept as a tree of cliques (Bayes tree). A change
//! detaches the cliques that it touches and their ancestors, and eliminates their variables in a new
//! order. All subtrees below are kept with their contributions. Batch is the same code on the whole
//! tree.
//!
//! | task | call |
//! |---|---|
//! | apply measurements, removals, fixed variables | [`Smoother::apply`] |
//! | read estimates | [`Smoother::estimate`], [`Smoother::estimates`], [`Smoother::cached_estimates`] |
//! | read covariances | [`Smoother::marginal`], [`Smoother::covariances`] |
//! | optimize to convergence | [`Smoother::optimize`] |
//! | read one factor at the estimate | [`Smoother::residual_of`], [`Smoother::weight_of`], [`Smoother::error_of_factor`] |
//!
//! The solver names no particular factor, file format or removal rule.
//!
//! # Example
//!
//! ```
//! use evergraph_factors::{BetweenPose2, Prior};
//! use evergraph_model::{Noise, Pose2};
//! use evergraph_solver::{Settings, Smoother};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut smoother = Smoother::new(Settings::default())?;
//! let noise = Noise::from_sigmas(&[0.1, 0.1, 0.02])?;
//!
//! let mut change = smoother.change();
//! let a = change.add_variable(&Pose2::new(0.0, 0.0, 0.0));
//! change.add_factor(Prior::new(a, Pose2::new(0.0, 0.0, 0.0), noise.clone())?);
//! let b = change.add_variable(&Pose2::new(0.9, 0.1, 0.0));
//! change.add_factor(BetweenPose2::new(a, b, Pose2::new(1.0, 0.0, 0.0), noise)?);
//! smoother.apply(change)?;
//!
//! assert!((smoother.estimate(b)?.x() - 1.0).abs() < 1e-9);
//! # Ok(())
//! # }
//! ```
//!
//! # References
//!
//! - M. Kaess, A. Ranganathan, F. Dellaert, "iSAM: Incremental smoothing and mapping", T-RO 2008.
//! - M. Kaess et al., "iSAM2: Incremental smoothing and mapping using the Bayes tree", IJRR 2012.
//! - J. Liu, "The multifrontal method for sparse matrix solution", SIAM Review 1992.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod background;
mod batch;
mod belief;
mod covariance;
mod dense;
mod diagnose;
mod eliminate;
mod error;
mod estimate_cache;
mod factor_query;
mod factorization;
mod index;
mod inspect;
mod linearization;
mod mix;
mod optimize;
mod optimum;
mod ordering;
mod pending;
mod planner;
mod pool;
mod profile;
mod quadratic;
mod query;
mod relinearize;
mod report;
mod settings;
mod smoother;
mod solve;
mod symbolic;
#[cfg(test)]
mod tests;
mod tree;

pub use batch::{BatchReport, BatchSettings, Method, Reason, Status};
pub use covariance::Covariances;
pub use error::{FreeVariable, Singular, SmootherError};
pub use estimate_cache::Estimates;
pub use factor_query::FactorLinearization;
pub use inspect::LinearSystem;
pub use optimum::{damped_then_dogleg, optimize_to_the_end};
pub use profile::{Phase, Profile};
pub use report::{FactorizationSize, Report};
pub use settings::{Elimination, Fluid, Relinearization, Settings, SettingsError};
pub use smoother::Smoother;
