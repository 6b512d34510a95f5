//! The plan of an update: the cliques that it takes out, and those that take their place. Nothing
//! is altered.

mod cliques;
mod gather;
mod marks;
mod plan;

pub(crate) use gather::Planner;
pub(crate) use marks::Mark;
pub(crate) use plan::{Now, Plan};
