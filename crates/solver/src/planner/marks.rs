//! Which cliques an update takes apart or eliminates again: sets that are closed towards the roots.

use evergraph_model::VariableIndex;

use crate::index::{CliqueIndex, NodeIndex, PendingIndex};
use crate::tree::Tree;

/// What happens to a clique.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mark {
    /// Taken out; its variables are ordered anew.
    Detached,
    /// Eliminated again with new numbers, in place.
    InPlace,
    /// Gets the numbers of the pending relinearization.
    Pending,
}

/// Marks by clique slot. Starting over costs nothing.
#[derive(Debug, Default)]
pub(crate) struct Marks {
    /// Four times the round in which the clique was marked, plus the mark.
    stamp: Vec<u64>,
    /// First frontal, as a position among the frontals, that is touched.
    first: Vec<u32>,
    /// The node of a clique that is eliminated in place.
    node: Vec<NodeIndex>,
    /// The place of a clique with pending numbers.
    pending: Vec<PendingIndex>,
    round: u64,
    /// Roots among the marked, in the order they were reached.
    pub(super) roots: Vec<CliqueIndex>,
    /// What it costs to eliminate the marked, in units of about a nanosecond.
    pub(super) cost: f64,
}

impl Marks {
    /// Clears all marks.
    pub(super) fn start(&mut self, tree: &Tree) {
        self.round += 1;
        self.roots.clear();
        self.cost = 0.0;
        if self.stamp.len() < tree.slots() {
            self.stamp.resize(tree.slots(), 0);
            self.first.resize(tree.slots(), 0);
            self.node.resize(tree.slots(), NodeIndex::NONE);
            self.pending.resize(tree.slots(), PendingIndex::NONE);
        }
    }

    pub(crate) fn get(&self, clique: CliqueIndex) -> Option<Mark> {
        match self.stamp[clique.index()].checked_sub(4 * self.round) {
            None => None,
            Some(0) => Some(Mark::Detached),
            Some(1) => Some(Mark::InPlace),
            Some(_) => Some(Mark::Pending),
        }
    }

    fn set(&mut self, clique: CliqueIndex, mark: Mark) {
        self.stamp[clique.index()] = 4 * self.round + mark as u64;
    }

    /// Marks an unmarked clique as one whose new numbers are pending, at `place`.
    pub(super) fn set_pending(&mut self, clique: CliqueIndex, place: PendingIndex) {
        self.set(clique, Mark::Pending);
        self.pending[clique.index()] = place;
    }

    /// The place of a clique with that mark.
    pub(super) fn pending(&self, clique: CliqueIndex) -> PendingIndex {
        self.pending[clique.index()]
    }

    /// Remembers the node of a clique that is eliminated in place.
    pub(super) fn set_node(&mut self, clique: CliqueIndex, node: NodeIndex) {
        self.node[clique.index()] = node;
    }

    /// The node of a clique for which it was [set](Self::set_node).
    pub(super) fn node(&self, clique: CliqueIndex) -> NodeIndex {
        self.node[clique.index()]
    }

    /// Marks the ancestors of a clique as [`touch`](Self::touch) does.
    pub(super) fn touch_above(&mut self, tree: &Tree, clique: CliqueIndex, mark: Mark) {
        if let Some(parent) = tree.parent_of(clique) {
            self.climb(tree, parent, first_of_child(tree, parent, clique), mark);
        }
    }

    /// Position of the first touched frontal of a marked clique.
    pub(super) fn first(&self, clique: CliqueIndex) -> usize {
        self.first[clique.index()] as usize
    }

    /// Marks the clique of a variable and all of its ancestors. What is marked already keeps its
    /// mark: detach first.
    pub(super) fn touch(&mut self, tree: &Tree, variable: VariableIndex, mark: Mark) {
        if let Some(clique) = tree.clique_of(variable).some() {
            self.climb(tree, clique, position_of(tree, clique, variable), mark);
        }
    }

    fn climb(&mut self, tree: &Tree, mut clique: CliqueIndex, mut position: u32, mark: Mark) {
        loop {
            let slot = clique.index();
            if self.get(clique).is_some() {
                self.first[slot] = self.first[slot].min(position);
                return;
            }
            self.set(clique, mark);
            self.first[slot] = position;
            self.cost += tree.clique(clique).structure.cost();
            let Some(parent) = tree.parent_of(clique) else {
                self.roots.push(clique);
                return;
            };
            // What the clique contributes changes all of its separator.
            position = first_of_child(tree, parent, clique);
            clique = parent;
        }
    }

    /// Marks every clique.
    pub(super) fn touch_all(&mut self, tree: &Tree, mark: Mark) {
        for clique in tree.indices() {
            self.set(clique, mark);
            self.first[clique.index()] = 0;
        }
        self.roots.extend(tree.roots.iter().copied());
    }
}

/// Position of a variable among the frontals of its clique.
fn position_of(tree: &Tree, clique: CliqueIndex, variable: VariableIndex) -> u32 {
    let frontals = &tree.clique(clique).structure.frontals;
    frontals.iter().position(|&v| v == variable).unwrap_or(0) as u32
}

/// Position, among the frontals of a clique, of the first that is in a child's separator.
pub(super) fn first_of_child(tree: &Tree, clique: CliqueIndex, child: CliqueIndex) -> u32 {
    let frontals = &tree.clique(clique).structure.frontals;
    if frontals.len() == 1 {
        return 0;
    }
    let separator = &tree.clique(child).structure.separator;
    let own = separator.iter().filter(|&&v| tree.clique_of(v) == clique);
    own.map(|&v| position_of(tree, clique, v)).min().unwrap_or(0)
}
