//! How a smoothing problem is described: variables on manifolds, factors between them, and the
//! [`Change`] that is the only way to alter a graph.
//!
//! The problem is nonlinear least squares on a product of manifolds,
//!
//! ```text
//! minimize over X    ½ Σₖ ‖rₖ(X)‖²        rₖ: whitened residual of factor k
//! ```
//!
//! Nothing here knows how the problem is solved, read from a file, or reduced.
//!
//! # Conventions
//!
//! These hold in every crate of the workspace; other pages link here.
//!
//! - **Units**: SI and radians, `f64` throughout. Frames are right-handed. Angles that leave the
//!   library lie in (-π, π].
//! - **Transforms**: `a_from_b` maps coordinates of frame b into frame a, so that composing reads
//!   `a_from_c = a_from_b * b_from_c`. A pose of a robot is `world_from_robot`.
//! - **Tangent order**: translation first, `(x, y, theta)` in 2D and `(x, y, z, rx, ry, rz)` in 3D.
//! - **Perturbation**: on the right, `retract(X, d) = X * Exp(d)`, `local(X, Y) = Log(X⁻¹ * Y)`,
//!   with the full exponential and logarithm of SE(2) and SE(3), for retraction and residuals alike.
//! - **Whitening**: information `Ω = RᵀR` with `R` upper triangular; a whitened residual is `R e`.
//!   [`Noise`] constructors say in their names what the numbers are.
//! - **error** is `½ Σ ‖r‖²` (with robust kernels `Σ ρ`), **chi2** is `Σ ‖r‖²`.
//! - **Two states of every variable**: the *linearization point*, where its Jacobians were taken,
//!   and the *estimate*, `retract(linearization point, delta)`. Neither is called just "value".
//!
//! # Matrices in memory
//!
//! All flat matrices are column-major, as nalgebra's.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod arguments;
pub mod belief;
mod change;
mod error;
mod evaluate;
mod factor;
pub mod geometry;
mod graph;
mod ids;
mod kernel;
mod key;
mod manifold;
mod moves;
mod noise;
mod slots;
pub mod testing;
pub mod user_code;
mod value;
mod values;
mod world;

pub use arguments::{Arguments, Linearization};
pub use change::Change;
pub use error::GraphError;
pub use evaluate::{EvaluationError, LinearizedFactor, linearize_at};
pub use factor::Factor;
pub use geometry::{Point2, Point3, Pose2, Pose3, Rot2, Rot3, VectorN};
pub use graph::{Graph, SavedFactor, SavedGraph, SavedVariable, Staged};
pub use ids::Ids;
pub use kernel::{Kernel, KernelError, Robust};
pub use key::{FactorId, FactorIndex, Key, VariableId, VariableIndex, Version};
pub use manifold::{LieGroup, Manifold, VariableType};
pub use moves::{Frame, Moves};
pub use noise::{Noise, NoiseError};
pub use value::{Value, ValueRef};
pub use values::Values;
pub use world::{Motion, World};
