//! Documents with measurements of any kind, replayed: what comes in when, what holds the map, and
//! that it ends at the truth.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod gauge;
mod landmarks;
mod order;
mod world;
