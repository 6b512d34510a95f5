//! Start values and gauge: the point at which an optimization starts, and the question of what holds a
//! map in the world.
//!
//! Nonlinear least squares finds the optimum next to its start. This crate computes starts from
//! measurements, for graphs in memory; it reads no files and changes no graph.
//!
//! | question | answer |
//! |---|---|
//! | start value of a variable that one measurement gives | [`compose`] |
//! | position of a landmark that only bearings or ranges see, and whether they place it | [`place_landmark`] |
//! | place of a part of a map whose inner shape is known | [`Body::fit`] |
//! | directions of a map that GPS, compass or priors leave free | [`Body::gauge`], [`Gauge`] |
//! | start values of a whole graph of relative measurements | [`chordal`] |
//!
//! # Conventions
//!
//! Those of `evergraph-model`: metres and radians, poses `world_from_body`, tangents with the translation
//! first. A *motion* is a pose `T` that moves the world, `x ↦ T x`; small motions are `(x, y, theta)` or
//! `(x, y, z, rx, ry, rz)` in the world's axes and turn about a named center.
//!
//! # When a map has no gauge
//!
//! Relative measurements determine a map but for a rigid motion. Some measurement of the world has to
//! hold that: a prior, or enough GPS. One position holds two of the three directions of the plane; the
//! heading stays free until the robot has moved, or a compass tells it. [`Gauge::free`] counts the
//! directions that are left, [`Gauge::prior`] makes the prior that holds exactly those.
//!
//! # References
//!
//! - L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM: a survey on
//!   rotation estimation and its use in pose graph optimization", ICRA 2015. The chordal initialization.
//! - D. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963. The small
//!   searches for landmarks and bodies.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod chordal;
mod chordal_linear;
mod compose;
mod gauge;
mod geometry;
mod hint;
mod landmark;
mod minimize;
mod rigid;

pub use chordal::chordal;
pub use compose::compose;
pub use gauge::{Gauge, MotionInformation, hold};
pub use geometry::Geometry;
pub use landmark::{Certainty, Landmark, Sighting, determines_landmark, place_landmark};
pub use rigid::{Body, End};
