//! Errors of a map against the truth, the loss of a reduced graph against the full one, and the cost of a
//! file in two conventions.
//!
//! With `xₖ` the estimated and `yₖ` the true poses of the same instants, `S` the motion that lays
//! the estimate over the truth, and `trans`, `rot` the length of the translation and the angle of
//! the rotation of a pose:
//!
//! ```text
//! absolute error (ATE, APE)    Eₖ = yₖ⁻¹ (S xₖ)                        trans(Eₖ), rot(Eₖ)
//! relative error (RPE)         Eₖ = (yₖ⁻¹ yₖ₊Δ)⁻¹ (xₖ⁻¹ xₖ₊Δ)          trans(Eₖ), rot(Eₖ)
//! landmark error               ‖S l̂ - l‖
//! ```
//!
//! The absolute error measures the consistency of the whole map, the relative error its local quality.
//! One wrong turn displaces all later poses, so Kümmerle et al. prefer the relative error.
//!
//! ```
//! use evergraph_evaluate::{AbsoluteError, Alignment, Association, Map, PosePairs};
//! use evergraph_formats::{Document, ReadOptions};
//! # fn main() -> Result<(), evergraph_evaluate::EvaluateError> {
//! let read = |text: &str| Document::parse("map", text.as_bytes(), &ReadOptions::default());
//! let truth = read("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 1 0\n")?;
//! // The same way, started elsewhere and in another direction.
//! let estimate = read("VERTEX_SE2 0 5 5 1.5\nVERTEX_SE2 1 5.070737 5.997495 1.5\nVERTEX_SE2 2 4.143979 7.065727 1.5\n")?;
//!
//! let (estimate, truth) = (Map::of_document(&estimate)?, Map::of_document(&truth)?);
//! let by = Association::of(&estimate.trajectory, &truth.trajectory);
//! let pairs = PosePairs::new(&estimate.trajectory, &truth.trajectory, by)?;
//! let aligned = pairs.align(Alignment::Rigid)?;
//! assert!(AbsoluteError::of(&pairs, &aligned.similarity)?.translation.rmse < 1e-5);
//! # Ok(())
//! # }
//! ```
//!
//! # References
//!
//! - S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns"
//!   (1991). B. K. P. Horn, "Closed-form solution of absolute orientation using unit quaternions"
//!   (1987). The alignment.
//! - J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems" (2012). ATE and RPE.
//! - R. Kümmerle et al., "On measuring the accuracy of SLAM algorithms" (2009). Relative errors.
//! - M. Grupp, evo: Python package for the evaluation of odometry and SLAM (2017). Same pairs, same
//!   numbers.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod absolute;
mod alignment;
mod anchor;
mod association;
mod comparison;
mod consistency;
pub mod conventions;
mod divergence;
mod error;
mod factorized;
mod fit;
mod landmarks;
mod map;
mod nonzeros;
mod pairs;
mod reduced;
mod relative;
mod rotation;
mod size;
mod solved;
mod start;
mod statistics;

pub use absolute::{AbsoluteError, PoseError};
pub use alignment::{Aligned, Alignment, Similarity};
pub use anchor::anchor_alike;
pub use association::{Association, PosePair, PosePairs};
pub use comparison::Comparison;
pub use consistency::{Consistency, WorstMarginal};
pub use divergence::Divergence;
pub use error::EvaluateError;
pub use fit::{FileFactor, Fit, KindFit, Verdict, WorstFactor};
pub use landmarks::LandmarkError;
pub use map::Map;
pub use nonzeros::information_nonzeros;
pub use reduced::{ReducedError, components_gone, shared_values, shared_variables};
pub use relative::{RelativeError, RelativePairs};
pub use rotation::Ambiguity;
pub use size::GraphSize;
pub use solved::{DivergenceError, Solved};
pub use start::Start;
pub use statistics::Statistics;
