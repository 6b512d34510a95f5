//! The factorization of a graph, and how it is kept current: stage, eliminate, install, undo.
//!
//! Every step takes its inputs as arguments and returns its result. When to take one is decided by
//! [`crate::Smoother`].

mod engine;
mod failure;
mod install;
mod state;
mod undo;
mod update;

pub(crate) use engine::Engine;
pub(crate) use state::Factorization;
pub(crate) use update::{Refusal, Update};
