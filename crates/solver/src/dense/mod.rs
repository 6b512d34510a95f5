//! Dense kernels that eliminate the frontal variables of one clique.
//!
//! Small fronts are most of the work in incremental smoothing, and general libraries are built for
//! large matrices: below [`LARGE`] columns our own kernels run (with the instruction set found at
//! run time), above it faer's, always on one thread, because parallelism comes from the tree.

mod cholesky;
mod householder;
mod instructions;
mod large;
mod layout;

pub(crate) use cholesky::{BadPivot, PartialCholesky, PivotBound, SubtractOuter};
pub(crate) use householder::triangularize;
pub(crate) use instructions::Instructions;
pub(crate) use layout::FrontLayout;

/// Fronts with more columns than this go to faer, which blocks for the caches.
const LARGE: usize = 480;

/// Eliminates the frontal columns of a front.
///
/// A pivot that is below `bound` of its diagonal entry of JᵀJ has lost its digits and ends the
/// elimination. Returns the smallest pivot ratio. O(frontal · columns²). `square` is scratch.
#[inline(always)]
pub(crate) fn partial_cholesky<S: pulp::Simd>(
    simd: S,
    front: PartialCholesky<'_>,
    square: &mut Vec<f64>,
) -> Result<f64, BadPivot> {
    use pulp::WithSimd;
    if front.layout.columns() > LARGE && front.layout.frontal() > 32 {
        large::partial_cholesky(front, square)
    } else {
        front.with_simd(simd)
    }
}
