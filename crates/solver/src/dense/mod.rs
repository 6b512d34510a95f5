//! Dense kernels that eliminate the frontal variables of one clique.
//!
//! Small fronts are most of the work in incremental smoothing, and general libraries are built for
//! large matrices: below [`LARGE`] columns our own kernels run (with the instruction set found at
//! run time), above it faer's, always on one thread, because parallelism comes from the tree.

mod cholesky;
mod householder;

pub(crate) use cholesky::{BadPivot, PivotBound, partial_cholesky, select_arch};
pub(crate) use householder::triangularize;

/// Fronts with more columns than this go to faer, which blocks for the caches.
const LARGE: usize = 320;
