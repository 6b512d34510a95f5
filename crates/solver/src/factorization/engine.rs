//! The means of computing factorizations.

use std::sync::Arc;

use evergraph_model::FactorIndex;

use super::undo::Undo;
use crate::dense::Instructions;
use crate::eliminate::{Eliminated, Workspace};
use crate::index::CliqueIndex;
use crate::planner::{Plan, Planner};
use crate::settings::Elimination;
use crate::tree::Clique;

/// How factorizations are computed, with the buffers for it. No part of any state: a clone starts
/// with empty buffers.
#[derive(Debug)]
pub(crate) struct Engine {
    pub(crate) elimination: Elimination,
    pub(crate) instructions: Instructions,
    pub(crate) threads: Option<Arc<rayon::ThreadPool>>,
    pub(crate) planner: Planner,
    pub(crate) workspace: Workspace,
    pub(super) buffers: Buffers,
}

/// Results of earlier updates, whose memory the next ones use again.
#[derive(Debug, Default)]
pub(super) struct Buffers {
    pub(super) plan: Plan,
    pub(super) eliminated: Eliminated,
    pub(super) undo: Undo,
    /// Factors to linearize again.
    pub(super) factors: Vec<FactorIndex>,
    /// The clique of each node of a job that is installed.
    pub(super) installed: Vec<CliqueIndex>,
    /// Cliques taken out of the tree whose first frontals stay.
    pub(super) shortened: Vec<Option<Clique>>,
}

impl Engine {
    pub(crate) fn new(
        elimination: Elimination,
        instructions: Instructions,
        threads: Option<Arc<rayon::ThreadPool>>,
    ) -> Self {
        Self {
            elimination,
            instructions,
            threads,
            planner: Planner::default(),
            workspace: Workspace::default(),
            buffers: Buffers::default(),
        }
    }

    /// An old plan, for the next one to fill.
    pub(crate) fn take_plan(&mut self) -> Plan {
        std::mem::take(&mut self.buffers.plan)
    }
}

impl Clone for Engine {
    fn clone(&self) -> Self {
        Self::new(self.elimination, self.instructions, self.threads.clone())
    }
}
