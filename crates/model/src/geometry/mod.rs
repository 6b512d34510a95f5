//! The manifolds that come with the library: rotations, poses, points and plain vectors.
//!
//! Rotations and poses are Lie groups with right perturbation and the tangent order of the
//! [crate page](crate#conventions): translation first, angles in radians. Derivatives follow
//! Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), and for
//! SE(3) Barfoot, "State Estimation for Robotics" (2017), section 7.1.5. All of them hold their
//! accuracy near a rotation of zero and near half a turn.
//!
//! Rotations are stored so that composing and acting on points needs no trigonometry, and are
//! brought back to unit length after each composition.
//!
//! ```
//! use evergraph_model::{LieGroup, Point2, Pose2};
//!
//! let world_from_robot = Pose2::new(1.0, 2.0, std::f64::consts::FRAC_PI_2);
//! let point_in_robot = Point2::new(3.0, 0.0);
//! let point_in_world = world_from_robot * point_in_robot;
//! assert!((point_in_world.x() - 1.0).abs() < 1e-12);
//! assert!((point_in_world.y() - 5.0).abs() < 1e-12);
//! let back = world_from_robot.inverse() * point_in_world;
//! assert!((back.x() - 3.0).abs() < 1e-12);
//! ```

mod coefficients;
mod manifolds;
mod point;
mod pose2;
mod pose3;
mod rot2;
mod rot3;
#[cfg(test)]
mod tests;
mod vector;

use thiserror::Error;

pub use point::{Point2, Point3};
pub use pose2::Pose2;
pub use pose3::Pose3;
pub use rot2::{Rot2, wrap_angle};
pub use rot3::{Rot3, skew};
pub use vector::VectorN;

/// Why numbers do not make a rotation.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GeometryError {
    /// A NaN or an infinity.
    #[error("a rotation needs finite numbers, got {numbers:?}")]
    NotFinite {
        /// The numbers given.
        numbers: Vec<f64>,
    },
    /// A direction or quaternion of (nearly) zero length.
    #[error("{numbers:?} has no length, so it names no rotation; the identity is (0, 0, 0, 1)")]
    ZeroNorm {
        /// The numbers given.
        numbers: Vec<f64>,
    },
    /// A matrix that is not orthogonal with determinant one.
    #[error(
        "the matrix is not a rotation (largest entry of |MᵀM - I| is {deviation:.3e}, determinant {determinant:.6}); \
         orthonormalize it first, and check for a reflection"
    )]
    NotARotation {
        /// Largest entry of `|MᵀM - I|`.
        deviation: f64,
        /// Determinant.
        determinant: f64,
    },
}

/// `Mul` of a transform and something it acts on.
macro_rules! acts_on {
    ($transform:ty, $object:ty, $method:ident) => {
        impl std::ops::Mul<$object> for $transform {
            type Output = $object;

            #[inline]
            fn mul(self, object: $object) -> $object {
                self.$method(&object)
            }
        }
    };
}
use acts_on;
