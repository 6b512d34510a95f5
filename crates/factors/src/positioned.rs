//! Things with a place in the world, so that ranges and bearings are written once.

use evergraph_model::{Manifold, Point2, Point3, Pose2, Pose3};
use nalgebra::{SMatrix, SVector};

/// A variable with a position in a world of `D` dimensions.
///
/// Implement it for types of your own to measure ranges and bearings to them.
pub trait Positioned<const D: usize>: Manifold {
    /// The position in the world, metres.
    fn position(&self) -> SVector<f64, D>;

    /// Writes `by_position ∂p/∂ξ`, the derivative by a right perturbation `ξ` of `self` of
    /// something whose derivative by the position `p` is `by_position`. Column-major into `out`,
    /// which has `R` rows, a column per tangent component, and is zero.
    fn chain<const R: usize>(&self, by_position: &SMatrix<f64, R, D>, out: &mut [f64]);
}

// The position of a pose moves along its own axes and is first in the tangent.
macro_rules! positioned {
    ($pose:ty, $point:ty, $dim:literal) => {
        impl Positioned<$dim> for $pose {
            #[inline]
            fn position(&self) -> SVector<f64, $dim> {
                self.translation().vector()
            }

            #[inline]
            fn chain<const R: usize>(&self, by_position: &SMatrix<f64, R, $dim>, out: &mut [f64]) {
                let block = by_position * self.rotation().matrix();
                out[..R * $dim].copy_from_slice(block.as_slice());
            }
        }

        impl Positioned<$dim> for $point {
            #[inline]
            fn position(&self) -> SVector<f64, $dim> {
                self.vector()
            }

            #[inline]
            fn chain<const R: usize>(&self, by_position: &SMatrix<f64, R, $dim>, out: &mut [f64]) {
                out.copy_from_slice(by_position.as_slice());
            }
        }
    };
}
positioned!(Pose2, Point2, 2);
positioned!(Pose3, Point3, 3);

/// Two points that are no further apart than this (m, in each coordinate) are in the same place: the
/// direction from one to the other would be that of rounding.
const COINCIDENT: f64 = 1e-12;

/// Length and direction of `v`; no direction where it has no length.
///
/// Scaled by the largest component first where a square would leave the range of `f64`.
#[inline]
pub(crate) fn polar<const D: usize>(v: &SVector<f64, D>) -> (f64, Option<SVector<f64, D>>) {
    // Not by the largest, which leaves out NaN.
    if v.iter().all(|x| x.abs() < COINCIDENT) {
        return (0.0, None);
    }
    let squared = v.norm_squared();
    if squared.is_normal() {
        let norm = squared.sqrt();
        return (norm, Some(v / norm));
    }
    let largest = v.amax();
    let scaled = v / largest;
    let norm = scaled.norm();
    (largest * norm, Some(scaled / norm))
}
