//! The means of computing factorizations.

use std::sync::Arc;

use evergraph_model::FactorIndex;

use super::undo::Undo;
use crate::dense::Instructions;
use crate::eliminate::{Eliminated, Node, Workspace};
use crate::index::CliqueIndex;
use crate::planner::{Plan, Planner};
use crate::settings::Elimination;
use crate::tree::{Clique, Numeric};

/// How factorizations are computed, with the buffers for it. No part of any state: a clone starts
/// with empty buffers.
#[derive(Debug)]
pub(crate) struct Engine {
    pub(crate) elimination: Elimination,
    pub(crate) instructions: Instructions,
    pub(crate) threads: Option<Arc<rayon::ThreadPool>>,
    /// As [`Settings::largest_clique`](crate::Settings::largest_clique).
    pub(crate) largest_clique: Option<usize>,
    pub(crate) planner: Planner,
    pub(crate) workspace: Workspace,
    pub(super) buffers: Buffers,
}

/// Buffers for nodes are freed when they hold more than this ...
const FEW_NODES: usize = 1024;
/// ... and than this many times the cliques of the tree.
const NODE_SHARE: usize = 4;

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
            largest_clique: None,
            planner: Planner::default(),
            workspace: Workspace::default(),
            buffers: Buffers::default(),
        }
    }

    /// With a bound on the scalars of a clique that an update eliminates.
    pub(crate) fn with_largest_clique(mut self, scalars: Option<usize>) -> Self {
        self.largest_clique = scalars;
        self
    }

    /// Frees buffers that are far larger than a tree of so many cliques and numbers needs.
    pub(crate) fn trim(&mut self, cliques: usize, numbers: usize) {
        let Buffers { plan, eliminated, .. } = &self.buffers;
        let nodes = plan.job.nodes.capacity().max(eliminated.nodes.capacity());
        if nodes > FEW_NODES + NODE_SHARE * cliques {
            self.planner = Planner::default();
            self.buffers = Buffers::default();
        }
        self.workspace.trim(numbers);
    }

    /// Bytes of the buffers whose size follows that of the factorization.
    pub(crate) fn memory_bytes(&self) -> usize {
        let Buffers { plan, eliminated, .. } = &self.buffers;
        let nodes = size_of::<Node>() * plan.job.nodes.capacity()
            + size_of::<Option<Numeric>>() * eliminated.nodes.capacity();
        nodes + self.workspace.memory_bytes()
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
