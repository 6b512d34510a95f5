//! **Evergraph** keeps the best estimate of a growing map current, in milliseconds: an incremental
//! smoothing engine in the style of iSAM, for robots that map for years.
//!
//! This is the crate to depend on. It holds no code of its own: it re-exports the crates of the
//! workspace.
//!
//! | module | holds | feature |
//! |---|---|---|
//! | [`model`] | keys, manifolds, noise, the [`Factor`] trait, the graph and the [`Change`]; units, frames and conventions | |
//! | [`factors`] | priors, odometry, landmarks, GPS, partial states, linear (GLC) factors, and all of them as plain data | |
//! | [`solver`] | the [`Smoother`]: incremental updates, batch optimization, relinearization, covariances | |
//! | [`removal`] | nodes replaced by factors that keep their information, and the price of that | |
//! | [`longterm`] | removals on a live smoother | |
//! | [`initialize`] | start values, placement of landmarks, and the directions that measurements leave free | |
//! | [`nalgebra`] | the linear algebra in public signatures, in the version that they use | |
//! | `formats` | g2o, TORO, iSAM and PyFactorGraph files; TUM and KITTI trajectories | `formats` |
//! | `replay` | files driven through a smoother; audits against the batch optimum | `replay` |
//! | `simulate` | worlds with known truth | `simulate` |
//! | `evaluate` | errors of a map against truth; the loss of a reduced graph | `evaluate` |
//!
//! All features are on by default. A program on a robot can leave them out:
//! `evergraph = { version = "0.1", default-features = false }`. The feature `replay` includes
//! `formats`, and so does `simulate`; `evaluate` includes `replay`.
//!
//! # Embed it
//!
//! ```
//! use evergraph::prelude::*;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut smoother = Smoother::new(Settings::default())?;
//! let noise = Noise::from_sigmas(&[0.05, 0.05, 0.01])?; // x y theta: m, m, rad
//! let step = Pose2::new(1.0, 0.0, std::f64::consts::FRAC_PI_2); // drive 1 m, turn left
//!
//! let mut change = smoother.change();
//! let mut poses = vec![change.add_variable(&Pose2::identity())];
//! change.add_factor(Prior::new(poses[0], Pose2::identity(), noise.clone())?);
//! smoother.apply(change)?;
//!
//! for k in 0..4 {
//!     let mut change = smoother.change();
//!     let guess = smoother.estimate(poses[k])?.compose(&Pose2::new(1.1, 0.0, 1.5)); // biased odometry
//!     poses.push(change.add_variable(&guess));
//!     change.add_factor(BetweenPose2::new(poses[k], poses[k + 1], step, noise.clone())?);
//!     if k == 3 {
//!         // Back at the start: a loop closure.
//!         change.add_factor(BetweenPose2::new(poses[4], poses[0], Pose2::identity(), noise.clone())?);
//!     }
//!     smoother.apply(change)?;
//! }
//! smoother.relinearize_batch()?; // the start values were far off; the policy would come to it later
//! let back = smoother.estimate(poses[4])?;
//! assert!(back.x().abs() < 1e-6 && back.y().abs() < 1e-6);
//! # Ok(())
//! # }
//! ```
//!
//! A change is applied whole or not at all: on `Err`, graph, estimate and factorization are bit
//! for bit what they were. Results are the same bits on any number of threads.
//!
//! # Replay a file
//!
//! With the feature `replay`:
//!
//! ```no_run
//! # #[cfg(feature = "replay")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use evergraph::prelude::*;
//!
//! let document = Document::read("manhattan.g2o", &ReadOptions::default())?;
//! let mut replayer = Replayer::new(&document, &ReplayOptions::default(), Settings::default())?;
//! while let Some(step) = replayer.step()? {
//!     println!("{} {:?}", step.step.pose, step.update);
//! }
//! println!("error {}", replayer.error()?);
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "replay"))]
//! # fn main() {}
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

#[cfg(feature = "evaluate")]
pub use evergraph_evaluate as evaluate;
pub use evergraph_factors as factors;
#[cfg(feature = "formats")]
pub use evergraph_formats as formats;
pub use evergraph_initialize as initialize;
pub use evergraph_longterm as longterm;
pub use evergraph_model as model;
pub use evergraph_removal as removal;
#[cfg(feature = "replay")]
pub use evergraph_replay as replay;
#[cfg(feature = "simulate")]
pub use evergraph_simulate as simulate;
pub use evergraph_solver as solver;
pub use nalgebra;

#[cfg(feature = "evaluate")]
pub use evergraph_evaluate::{Start, conventions};
pub use evergraph_longterm::{Needed, Rules, Thinned, Thinning, ThinningError, ThinningFailure};
pub use evergraph_model::{Change, Factor, Graph, Values};
#[cfg(feature = "replay")]
pub use evergraph_replay::{
    Component, Objective, Overview, Replayed, Replayer, ReplayerError, chordal,
};
pub use evergraph_solver::{
    Phase, Profile, Report, Settings, Smoother, SmootherError, optimize_to_the_end,
};

/// The types that most programs need, in one line: `use evergraph::prelude::*`.
pub mod prelude {
    pub use evergraph_factors::{
        Bearing2, Bearing3, BearingRange2, BearingRange3, BetweenPose2, BetweenPose3, Geodetic,
        GpsPosition2, GpsPosition3, LocalFrame, Prior, Range, RelativePosition2, RelativePosition3,
    };
    #[cfg(feature = "formats")]
    pub use evergraph_formats::{Document, ReadOptions};
    pub use evergraph_longterm::{Rules, Thinning};
    pub use evergraph_model::{
        Change, Factor, FactorId, Graph, Kernel, Key, LieGroup, Manifold, Noise, Point2, Point3,
        Pose2, Pose3, Robust, Rot2, Rot3, Value, Values, VariableId, VectorN,
    };
    pub use evergraph_removal::{Order, Removal};
    #[cfg(feature = "replay")]
    pub use evergraph_replay::{ReplayOptions, Replayed, Replayer};
    pub use evergraph_solver::{
        BatchReport, BatchSettings, Elimination, Method, Relinearization, Report, Settings,
        Smoother, SmootherError, Status,
    };
}

/// Compiles the examples of the README.
#[cfg(all(doctest, feature = "evaluate", feature = "simulate"))]
#[doc = include_str!("../../../README.md")]
struct Readme;
