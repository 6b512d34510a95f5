//! Simulated worlds with known truth.
//!
//! The true poses are known, the noise follows the stated information matrices exactly, and the size
//! is free: ten poses for a unit test, a million for a scaling curve. A world has a
//! [`World::document`], the recording of a robot, and a [`World::truth`], its true poses.
//!
//! | world | like | shape |
//! |---|---|---|
//! | [`Grid::manhattan`] | M3500 | 2D, random walk on a grid of short blocks |
//! | [`Grid::city`] | city10000 | 2D, long streets, visited many times |
//! | either with [`Grid::landmarks`] | | 2D, points seen within a range |
//! | [`Surface::sphere`] | sphere2500 | 3D, a spiral over a sphere, closed to the ring below |
//! | [`Surface::torus`] | torus | 3D, a spiral around a torus, closed to the ring before |
//!
//! # Measurements
//!
//! With true poses `Xᵢ`, `Xⱼ` and standard deviations `σ` in tangent order,
//!
//! ```text
//! z = Xᵢ⁻¹ Xⱼ Exp(n),   nₖ ~ N(0, σₖ²),   Ω = diag(1/σₖ²)        poses
//! z = Xᵢ⁻¹ l + n                                                  landmarks
//! ```
//!
//! At the truth the whitened between residual `Log(z⁻¹ Xᵢ⁻¹ Xⱼ)` is standard normal, and
//! the expected chi2 is the number of measured components. Ids are 0, 1, ... in time order; landmarks
//! follow the poses in the order of their first sightings. The document holds all vertices
//! first (the initial guess: odometry composed from the true first pose), then the edges: for each
//! pose its odometry, its closures with earlier poses, its landmarks.
//!
//! # The same bits everywhere
//!
//! A world depends on its parameters only. The random stream is ChaCha8, and all numbers come from
//! IEEE arithmetic, square roots and the portable functions of `libm`; sines of the platform may differ
//! in the last bit. The walk, the odometry noise, the closures and the landmarks have streams of their
//! own: worlds with different closures share walk and odometry.
//!
//! Time and memory are linear in the number of poses, whatever the density: neighbours come from a
//! grid of cells, of each of which a bounded number of poses is looked at.
//!
//! # Example
//!
//! ```
//! use evergraph_simulate::Grid;
//!
//! let mut city = Grid::city(500, 7);
//! city.odometry = [0.05, 0.01, 0.005]; // forward is worse than sideways
//! city.closures.probability = 0.3;
//! let world = city.generate()?;
//! assert_eq!(world.truth.summary().poses, 500);
//! # Ok::<(), evergraph_simulate::WorldError>(())
//! ```
//!
//! # References
//!
//! - Olson, Leonard, Teller: Fast iterative alignment of pose graphs with poor initial estimates
//!   (2006). The Manhattan world.
//! - Kaess, Ranganathan, Dellaert: iSAM: Incremental smoothing and mapping (2008). City10000 and
//!   sphere2500.
//! - Solà, Deray, Atchuthan: A micro Lie theory for state estimation in robotics (2018). `Exp`.
//! - Leva: A fast normal random number generator (1992).
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod builder;
mod cells;
mod error;
mod grid;
mod landmarks;
mod noise;
mod pose;
mod surface;

use evergraph_formats::Document;

pub use builder::Closures;
pub use error::WorldError;
pub use grid::Grid;
pub use landmarks::Landmarks;
pub use surface::{Shape, Surface};

/// What a robot recorded, and where it was.
#[derive(Debug)]
#[non_exhaustive]
pub struct World {
    /// Initial guess of every vertex, then the measurements in time order.
    pub document: Document,
    /// The true value of every vertex, in the order of [`document`](Self::document)'s vertices.
    pub truth: Document,
}
