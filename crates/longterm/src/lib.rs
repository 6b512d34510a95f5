//! Removals on a live smoother: which nodes go, in which order, and what it costs.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod thinning;

pub use thinning::{Needed, Rules, Thinned, Thinning, ThinningError};
