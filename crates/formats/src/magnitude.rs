//! Numbers that are too large to be computed with.
//!
//! Steps of a solver take products of two squares: `‖Jᵀr‖²` has the fourth power of a whitened
//! measurement in it. Beyond 1e75 that is near the end of 64-bit numbers, which is 1.8e308.

use crate::matrix;
use crate::weight::{Weight, WeightKind};

/// The largest coordinate, measured number, entry of a square root, or standard deviation.
pub(crate) const LARGEST: f64 = 1e75;
/// The largest entry of an information or covariance matrix.
const LARGEST_SQUARE: f64 = 1e150;

/// The largest entry of a matrix of this kind.
pub(crate) fn largest_entry(kind: WeightKind) -> f64 {
    match kind {
        WeightKind::Information | WeightKind::Covariance => LARGEST_SQUARE,
        WeightKind::SquareRoot | WeightKind::Sigmas => LARGEST,
    }
}

/// The square root of the largest information, roughly; 0 for a matrix that is not given.
pub(crate) fn root_information(weight: &Weight, dim: usize) -> f64 {
    let sizes = || weight.entries.iter().map(|x| x.abs());
    let largest = || sizes().fold(0.0, f64::max);
    let smallest = |sizes: &mut dyn Iterator<Item = f64>| {
        sizes.filter(|x| *x > 0.0).fold(f64::INFINITY, f64::min)
    };
    match weight.kind {
        WeightKind::Information => largest().sqrt(),
        WeightKind::SquareRoot => largest(),
        WeightKind::Sigmas => 1.0 / smallest(&mut sizes()),
        // Entries off the diagonal may be small; they are seldom looked at.
        WeightKind::Covariance if smallest(&mut sizes()) > 1.0 / LARGEST => {
            1.0 / smallest(&mut sizes()).sqrt()
        }
        WeightKind::Covariance => matrix::as_written(weight, dim)
            .map_or(0.0, |matrix| 1.0 / smallest(&mut matrix.diagonal().iter().copied()).sqrt()),
    }
}
