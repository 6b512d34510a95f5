//! The plan of an update as a value, and its four kinds.

use evergraph_model::{Graph, Staged, VariableIndex};

use super::gather::Planner;
use super::marks::Mark;
use crate::eliminate::Job;
use crate::index::{CliqueIndex, PendingIndex};
use crate::pending::Pending;
use crate::profile::{Clock, Phase};
use crate::tree::Tree;

/// The cliques that an update takes out, and those that take their place.
#[derive(Debug, Default)]
pub(crate) struct Plan {
    /// Cliques to take out, children before parents.
    pub(crate) detached: Vec<CliqueIndex>,
    /// Those of them whose first frontals stay.
    pub(crate) splits: Vec<CliqueIndex>,
    /// Cliques that get pending numbers, and the places of these.
    pub(crate) pending: Vec<(PendingIndex, CliqueIndex)>,
    /// Cliques to eliminate.
    pub(crate) job: Job,
    /// Number of variables that are ordered anew.
    pub(crate) variables: usize,
    /// Number of subtrees that stay below the detached cliques.
    pub(crate) subtrees_kept: usize,
}

/// What a plan is made for: a factorization whose change is staged.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Now<'a> {
    pub(crate) graph: &'a Graph,
    pub(crate) tree: &'a Tree,
    /// The variable to eliminate last.
    pub(crate) last: Option<VariableIndex>,
}

impl Planner {
    /// The plan of a staged change that moves the linearization points of `moved`, together with a
    /// pending relinearization if there is one. `buffer` is an old plan.
    pub(crate) fn plan_change(
        &mut self,
        now: Now<'_>,
        staged: &Staged,
        moved: &[VariableIndex],
        pending: Option<&Pending>,
        (buffer, clock): (Plan, &mut Clock),
    ) -> Plan {
        self.touch_change(now.graph, now.tree, staged, moved);
        if let Some(pending) = pending {
            self.touch_pending(now.graph, now.tree, pending);
        }
        clock.lap(Phase::Detach);
        self.gather_change(now.graph, now.tree, staged);
        clock.lap(Phase::Gather);
        self.finish(now, buffer, clock)
    }

    /// The plan to eliminate everything: in a new order, or in place.
    pub(crate) fn plan_all(
        &mut self,
        now: Now<'_>,
        mark: Mark,
        (buffer, clock): (Plan, &mut Clock),
    ) -> Plan {
        self.gather_all(now.graph, now.tree, mark);
        self.finish(now, buffer, clock)
    }

    /// The plan to eliminate a whole graph whose tree is empty.
    pub(crate) fn plan_graph(&mut self, now: Now<'_>, (buffer, clock): (Plan, &mut Clock)) -> Plan {
        self.gather_graph(now.graph, now.tree);
        self.finish(now, buffer, clock)
    }

    fn finish(&mut self, now: Now<'_>, mut plan: Plan, clock: &mut Clock) -> Plan {
        plan.job.nodes.clear();
        self.fill(now.graph, now.tree, now.last, &mut plan.job, clock);
        std::mem::swap(&mut plan.detached, &mut self.detached);
        std::mem::swap(&mut plan.pending, &mut self.pending);
        plan.splits.clear();
        plan.splits.extend(self.splits.iter().map(|split| split.clique));
        plan.variables = self.variables.len();
        plan.subtrees_kept = self.orphans.len();
        plan
    }
}
