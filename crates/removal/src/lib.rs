//! Removing nodes from a factor graph without losing what they know.
//!
//! A robot that goes on for years visits the same places again and again. What grows with time has
//! to be removed, and dropping a pose with its factors loses what they say of *other* poses. This
//! crate plans the removal of nodes between updates, by reading only, and gives back an ordinary
//! [`Change`](evergraph_model::Change) with its price:
//!
//! 1. The **Markov blanket** of the node and the factors `Z_m` on these variables only.
//! 2. The **target information** `Λ_t = R_tᵀR_t`, what `Z_m` says of the blanket with the node
//!    eliminated.
//! 3. The **topology**: one factor on a small blanket, or the **Chow-Liu tree** of most mutual information, of least
//!    divergence or conservative ([`Consistency`]).
//! 4. The **recovery**: each term becomes a **generic linear constraint** in root-shifted
//!    coordinates, or an ordinary factor, placed such that the gradient is kept.
//! 5. The **price**: the Kullback-Leibler divergence of the map after from the map before.
//!
//! Throughout, ξ is a right perturbation and η = -Σ Jᵀ r, both counted from the estimate, in the linear
//! model around linearization points that are near it ([`Options::linear_within`]), else around the
//! estimate. Everything is done on square roots (but for prices, composition and iSAM's variants), so that
//! ranks are told down to 1e-10 of a column's norm and what is relative stays exactly that.
//!
//! # What is promised
//!
//! - A dense factor is exact in that model, information and gradient. A tree has
//!   the exact gradient, and of all trees the least divergence in the regular case.
//! - `null(Λ') = null(Λ_t)`: no direction becomes free, whatever the rest of the graph. Where a tree
//!   cannot do that, the step says what took its place ([`Fallback`]).
//! - A conservative tree has `Λ' ≤ Λ_t` in the Loewner order. The map after any sequence of such removals then knows no
//!   more in any direction than the map that kept everything, at the same linearization points: adding the information of
//!   all other factors and marginalizing both keep that order.
//! - Removal at the optimum moves nothing ([`Offset::KeepGradient`]). But linear factors do not bend:
//!   where residuals bend as much as they tell (ranges to few beacons, false loop closures), an optimum of
//!   the full graph need not be one of the reduced graph when that is optimized again.
//!
//! Not of what is asked to be lost: [`Recovery::Drop`], [`Recovery::Composition`],
//! [`Rank::Absolute`] and robust factors below [`Options::least_weight`].
//!
//! A plan goes stale, rather than wrong, when a variable or factor that it read changes ([`Plan`]).
//!
//! # Fixed variables
//!
//! Fixed variables of a neighborhood are given. They are not marginalized, no new factor is on them, and factors with
//! them hold the blanket in the world. A node that is fixed itself is removed without approximation: its factors stay as
//! factors on their other variables, with its value put in ([`Conditioned`](evergraph_factors::Conditioned)).
//!
//! # Types of your own
//!
//! Variables of any type are removed by generic linear constraints. A type that moves with a world announces it by
//! [`Manifold::MOTION`](evergraph_model::Manifold::MOTION); its relative information then stays exactly relative, and root
//! shifts apply to it.
//!
//! # When not to remove
//!
//! A linear factor is right where it was made. Far from the optimum, before the loop closures around
//! a node are settled, or under a robust factor that may still change its mind, wait.
//!
//! # References
//!
//! - N. Carlevaris-Bianco, R. Eustice, "Long-Term Simultaneous Localization and Mapping with Generic
//!   Linear Constraint Node Removal", IROS 2013 ("the GLC paper").
//! - H. Kretzschmar, C. Stachniss, G. Grisetti, "Efficient Information-Theoretic Graph Pruning for
//!   Graph-Based SLAM with Laser Range Finders", IROS 2011 ("the laser paper").
//! - M. Mazuran, W. Burgard, G. D. Tipaldi, "Nonlinear Factor Recovery for Long-Term SLAM", IJRR
//!   2016.
//! - M. Heath, "Some Extensions of an Algorithm for Sparse Linear Least Squares Problems", SIAM
//!   J. Sci. Stat. Comput. 1982: ranks from QR.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod bounded;
mod condition;
mod conservative;
mod covariance;
mod driver;
mod error;
mod fallback;
mod groups;
mod marginals;
mod member;
mod merge;
mod minimum;
mod motion;
mod neighborhood;
mod options;
mod order;
mod overlay;
mod plan;
mod potential;
mod price;
mod queue;
mod rank_qr;
mod recover;
mod removal;
mod replacement;
mod step;
mod target;
mod topology;
mod whitened;
mod work;

pub use driver::{Remover, remove_in_order};
pub use error::RemovalError;
pub use evergraph_factors::RootShift;
pub use evergraph_model::belief::{BeliefError, Covariance, Estimates, LinearizedEstimate};
pub use fallback::Fallback;
pub use options::{
    Consistency, Guard, MutualInformation, Offset, Options, Rank, Recovery, Topology,
};
pub use order::{Order, shuffled};
pub use overlay::Source;
pub use plan::{Plan, PlannedFactor};
pub use queue::Loss;
pub use removal::Removal;
pub use step::{NewFactor, Step};
pub use whitened::Certificate;
