//! Removals on a live smoother: the policy of a map that lives for years.
//!
//! A robot that maps for years cannot keep every pose. `evergraph-removal` plans what takes the place of
//! a node; this crate drives such plans on a smoother that goes on working. [`Thinning::run`] removes
//! nodes one by one in any order, and [`Rules`] hold the order, the limit and the form of the new
//! factors.
//!
//! Each removal is one change, applied whole or not at all. The smoother is not copied and no batch step
//! is forced: a removal costs its plan and an ordinary incremental update. Nodes without which a
//! direction of the map would be free stay; [`Thinning::kept`] lists them with the reason.
//!
//! ```
//! use evergraph_factors::{BetweenPose2, Prior};
//! use evergraph_longterm::{Rules, Thinning};
//! use evergraph_model::{LieGroup, Noise, Pose2};
//! use evergraph_solver::{Settings, Smoother};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut smoother = Smoother::new(Settings::default())?;
//! let mut change = smoother.change();
//! let noise = Noise::from_sigmas(&[0.1, 0.1, 0.02])?;
//! let poses: Vec<_> =
//!     (0..10).map(|k| change.add_variable(&Pose2::new(f64::from(k), 0.0, 0.0))).collect();
//! change.add_factor(Prior::new(poses[0], Pose2::identity(), noise.clone())?);
//! for pair in poses.windows(2) {
//!     let step = Pose2::new(1.0, 0.0, 0.0);
//!     change.add_factor(BetweenPose2::new(pair[0], pair[1], step, noise.clone())?);
//! }
//! smoother.apply(change)?;
//!
//! let every_second: Vec<_> = poses.iter().skip(1).step_by(2).map(|pose| pose.id()).collect();
//! let thinning = Thinning::run(&mut smoother, &every_second, &Rules::default(), || ())?;
//! assert_eq!((thinning.removed.len(), smoother.graph().variable_count()), (5, 5));
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod error;
mod live;
mod needed;
mod rules;
mod thinning;

pub use error::{ThinningError, ThinningFailure};
pub use evergraph_removal::RemovalError;
pub use needed::Needed;
pub use rules::Rules;
pub use thinning::{Thinned, Thinning};
