//! Which cliques an update takes apart or eliminates again: sets that are closed towards the roots.

use crate::tree::{NONE, Tree};

/// What happens to a clique.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mark {
    /// Taken out; its variables are ordered anew.
    Detached,
    /// Eliminated again with new numbers, in place.
    InPlace,
    /// Gets the numbers of an elimination ahead of time.
    Ahead,
}

/// Marks by clique slot. Starting over costs nothing.
#[derive(Debug, Default)]
pub(crate) struct Marks {
    /// Four times the round in which the clique was marked, plus the mark.
    stamp: Vec<u64>,
    /// First frontal, as a position among the frontals, that is touched.
    first: Vec<u32>,
    /// Free for use, while the clique is marked.
    pub(super) place: Vec<u32>,
    round: u64,
    /// Roots among the marked, in the order they were reached.
    pub(super) roots: Vec<u32>,
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
            self.place.resize(tree.slots(), NONE);
        }
    }

    pub(crate) fn get(&self, clique: u32) -> Option<Mark> {
        match self.stamp[clique as usize].checked_sub(4 * self.round) {
            None => None,
            Some(0) => Some(Mark::Detached),
            Some(1) => Some(Mark::InPlace),
            Some(_) => Some(Mark::Ahead),
        }
    }

    fn set(&mut self, clique: u32, mark: Mark) {
        self.stamp[clique as usize] = 4 * self.round + mark as u64;
    }

    /// Marks an unmarked clique as done ahead; `place` is where.
    pub(super) fn set_ahead(&mut self, clique: u32, place: u32) {
        self.set(clique, Mark::Ahead);
        self.place[clique as usize] = place;
    }

    /// Marks the ancestors of a clique as [`touch`](Self::touch) does.
    pub(super) fn touch_above(&mut self, tree: &Tree, clique: u32, mark: Mark) {
        let parent = tree.clique(clique).parent;
        if parent != NONE {
            self.climb(tree, parent, first_of_child(tree, parent, clique), mark);
        }
    }

    /// Position of the first touched frontal of a marked clique.
    pub(super) fn first(&self, clique: u32) -> usize {
        self.first[clique as usize] as usize
    }

    /// Marks the clique of a variable and all of its ancestors. What is marked already keeps its
    /// mark: detach first.
    pub(super) fn touch(&mut self, tree: &Tree, variable: u32, mark: Mark) {
        let clique = tree.clique_of(variable);
        if clique == NONE {
            return;
        }
        self.climb(tree, clique, position_of(tree, clique, variable), mark);
    }

    fn climb(&mut self, tree: &Tree, mut clique: u32, mut position: u32, mark: Mark) {
        loop {
            let slot = clique as usize;
            if self.get(clique).is_some() {
                self.first[slot] = self.first[slot].min(position);
                return;
            }
            self.set(clique, mark);
            self.first[slot] = position;
            self.cost += tree.clique(clique).structure.cost();
            let parent = tree.clique(clique).parent;
            if parent == NONE {
                self.roots.push(clique);
                return;
            }
            // What the clique contributes changes all of its separator.
            position = first_of_child(tree, parent, clique);
            clique = parent;
        }
    }

    /// Marks every clique.
    pub(super) fn touch_all(&mut self, tree: &Tree, mark: Mark) {
        for clique in tree.indices() {
            self.set(clique, mark);
            self.first[clique as usize] = 0;
        }
        self.roots.extend(tree.roots.iter().copied());
    }
}

/// Position of a variable among the frontals of its clique.
fn position_of(tree: &Tree, clique: u32, variable: u32) -> u32 {
    let frontals = &tree.clique(clique).structure.frontals;
    frontals.iter().position(|&v| v == variable).unwrap_or(0) as u32
}

/// Position, among the frontals of a clique, of the first that is in a child's separator.
pub(super) fn first_of_child(tree: &Tree, clique: u32, child: u32) -> u32 {
    let frontals = &tree.clique(clique).structure.frontals;
    if frontals.len() == 1 {
        return 0;
    }
    let separator = &tree.clique(child).structure.separator;
    let own = separator.iter().filter(|&&v| tree.clique_of(v) == clique);
    own.map(|&v| position_of(tree, clique, v)).min().unwrap_or(0)
}
