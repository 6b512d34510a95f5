//! The part of the tree that an update changes.

use evergraph_model::{FactorIndex, Graph, Staged, VariableIndex};

use super::marks::{Mark, Marks, first_of_child};
use crate::index::{CliqueIndex, NodeIndex, PendingIndex};
use crate::ordering::{Groups, Orderer};
use crate::pending::Pending;
use crate::symbolic::Cliques;
use crate::tree::{Form, Structure, Tree};

/// A clique whose first touched frontal is this one or a later one is split there, rather than
/// taken apart whole.
const SHORTEST_PREFIX: usize = 2;

/// A clique that is split: its first `frontals` frontals stay, with their part of R.
#[derive(Clone, Copy, Debug)]
pub(super) struct Split {
    pub(super) clique: CliqueIndex,
    frontals: usize,
    /// First of its children among `split_children`, and how many.
    pub(super) children: (usize, usize),
}

/// Finds out what an update takes apart, and how to put it together again. Its fields are buffers
/// of one plan: every plan starts over.
#[derive(Debug, Default)]
pub(crate) struct Planner {
    pub(super) marks: Marks,
    /// Cliques to take out, children before parents.
    pub(super) detached: Vec<CliqueIndex>,
    pub(super) splits: Vec<Split>,
    /// Children that the first frontals of split cliques keep.
    pub(super) split_children: Vec<CliqueIndex>,
    /// Subtrees that stay, as they are or with new numbers, below what is taken out.
    pub(super) orphans: Vec<CliqueIndex>,
    /// Cliques that get pending numbers.
    pub(super) pending: Vec<(PendingIndex, CliqueIndex)>,
    /// Roots that are eliminated again in place.
    pub(super) roots: Vec<CliqueIndex>,
    /// Variables to eliminate again, in their old order of elimination, new ones at the end.
    pub(super) variables: Vec<VariableIndex>,
    /// Factors to assemble again, and new ones.
    pub(super) factors: Vec<FactorIndex>,

    /// By variable slot: position in `variables`.
    pub(super) local: Vec<u32>,
    pub(super) groups: Groups,
    pub(super) orderer: Orderer,
    pub(super) cliques: Cliques,
    /// By new clique: its first subtree that stays, and the next one by subtree. Subtrees are the
    /// orphans, then the splits.
    pub(super) subtree_of: Vec<u32>,
    pub(super) next_subtree: Vec<u32>,
    /// By new clique: its first child among the new, the next of the same parent, its node.
    pub(super) child_of: Vec<u32>,
    pub(super) next_child: Vec<u32>,
    pub(super) node_of: Vec<NodeIndex>,
    stack: Vec<CliqueIndex>,
    pub(super) cliques_in_place: Vec<CliqueIndex>,
}

impl Planner {
    /// Marks the cliques that a staged change takes apart. `moved` are variables whose linearization
    /// point moves.
    pub(super) fn touch_change(
        &mut self,
        graph: &Graph,
        tree: &Tree,
        staged: &Staged,
        moved: &[VariableIndex],
    ) {
        self.start(tree);
        let dropped = staged.dropped_factors().iter().copied();
        let moved = moved.iter().flat_map(|&v| graph.factors_at(v).iter().copied());
        let reshaped = staged.reshaped().iter().copied();
        for factor in staged.new_factors().chain(dropped).chain(moved).chain(reshaped) {
            self.touch_factor(graph, tree, factor, Mark::Detached);
        }
        for &variable in staged.dropped_variables().iter().chain(staged.fixed()) {
            self.touch_separators(tree, variable);
        }
    }

    /// Marks the cliques that a pending relinearization changes: those with pending numbers, and
    /// others, which are eliminated again in place.
    pub(super) fn touch_pending(&mut self, graph: &Graph, tree: &Tree, pending: &Pending) {
        for (place, clique) in pending.done(tree) {
            if self.marks.get(clique).is_none() {
                self.marks.set_pending(clique, place);
                self.pending.push((place, clique));
            }
        }
        let is_pending = |marks: &Marks, clique| marks.get(clique) == Some(Mark::Pending);
        for &(_, clique) in &self.pending {
            if tree.parent_of(clique).is_none_or(|parent| !is_pending(&self.marks, parent)) {
                self.marks.touch_above(tree, clique, Mark::InPlace);
            }
        }
        for variable in pending.variables(graph) {
            let clique = tree.clique_of(variable).some();
            if clique.is_some_and(|clique| !is_pending(&self.marks, clique)) {
                self.touch_variable(graph, tree, variable);
            }
        }
    }

    fn touch_variable(&mut self, graph: &Graph, tree: &Tree, variable: VariableIndex) {
        for &factor in graph.factors_at(variable) {
            self.touch_factor(graph, tree, factor, Mark::InPlace);
        }
    }

    /// The cliques that relinearizing `variables` changes, children before parents, and the cost of
    /// eliminating them, in units of about a nanosecond.
    pub(crate) fn changed_by(
        &mut self,
        graph: &Graph,
        tree: &Tree,
        variables: &[VariableIndex],
    ) -> (&[CliqueIndex], f64) {
        self.start(tree);
        for &variable in variables {
            self.touch_variable(graph, tree, variable);
        }
        let mut all = Vec::new();
        for at in 0..self.marks.roots.len() {
            self.collect_in_place(tree, self.marks.roots[at]);
            all.append(&mut self.cliques_in_place);
        }
        self.cliques_in_place = all;
        (&self.cliques_in_place, self.marks.cost)
    }

    /// Gathers the marked part, and what a staged change adds, drops, fixes and frees.
    pub(super) fn gather_change(&mut self, graph: &Graph, tree: &Tree, staged: &Staged) {
        self.gather(graph, tree);
        if !staged.dropped_variables().is_empty() {
            self.variables.retain(|v| staged.dropped_variables().binary_search(v).is_err());
        }
        if !staged.dropped_factors().is_empty() {
            self.factors.retain(|f| staged.dropped_factors().binary_search(f).is_err());
        }
        if !staged.fixed().is_empty() {
            self.variables.retain(|&v| !graph.is_fixed_at(v));
            self.factors.retain(|&f| !graph.unknowns_at(f).is_empty());
        }
        self.variables.extend(staged.new_variables().filter(|&v| !graph.is_fixed_at(v)));
        self.variables.extend_from_slice(staged.freed());
        self.factors.extend(staged.new_factors().filter(|&f| !graph.unknowns_at(f).is_empty()));
        let enters = |f: FactorIndex| had_no_unknowns(graph, tree, f);
        self.factors.extend(staged.reshaped().iter().copied().filter(|&f| enters(f)));
    }

    /// Gathers everything: detached, for a new order of the whole graph, or in place.
    pub(super) fn gather_all(&mut self, graph: &Graph, tree: &Tree, mark: Mark) {
        self.start(tree);
        self.marks.touch_all(tree, mark);
        self.gather(graph, tree);
    }

    /// Gathers everything in a graph, for an empty tree.
    pub(super) fn gather_graph(&mut self, graph: &Graph, tree: &Tree) {
        self.start(tree);
        self.variables.extend(graph.unknown_indices());
        self.factors.extend(graph.factor_indices().filter(|&f| !graph.unknowns_at(f).is_empty()));
    }

    fn start(&mut self, tree: &Tree) {
        self.marks.start(tree);
        self.detached.clear();
        self.splits.clear();
        self.split_children.clear();
        self.orphans.clear();
        self.pending.clear();
        self.roots.clear();
        self.variables.clear();
        self.factors.clear();
    }

    fn touch_factor(&mut self, graph: &Graph, tree: &Tree, factor: FactorIndex, mark: Mark) {
        for &variable in graph.variables_at(factor) {
            self.marks.touch(tree, variable, mark);
        }
    }

    /// Marks the clique of a variable that is dropped or fixed, whole, and all that have it in their
    /// separator: a clique may hold a variable that none of the factors below is on.
    fn touch_separators(&mut self, tree: &Tree, variable: VariableIndex) {
        let Some(own) = tree.clique_of(variable).some() else { return };
        self.marks.touch(tree, tree.clique(own).structure.frontals[0], Mark::Detached);
        self.stack.clear();
        self.stack.push(own);
        while let Some(clique) = self.stack.pop() {
            for &child in &tree.clique(clique).children {
                let structure = &tree.clique(child).structure;
                if structure.separator.contains(&variable) {
                    self.marks.touch(tree, structure.frontals[0], Mark::Detached);
                    self.stack.push(child);
                }
            }
        }
    }

    /// Collects what is marked. Recursion is on an explicit stack: elimination trees of chains are
    /// deep.
    fn gather(&mut self, graph: &Graph, tree: &Tree) {
        let mut stack = std::mem::take(&mut self.stack);
        stack.clear();
        stack.extend_from_slice(&self.marks.roots);
        while let Some(clique) = stack.pop() {
            if self.marks.get(clique) == Some(Mark::InPlace) {
                self.roots.push(clique);
                continue;
            }
            self.detached.push(clique);
            let split = self.split_at(tree, clique);
            let first = self.split_children.len();
            for &child in &tree.clique(clique).children {
                match self.marks.get(child) {
                    Some(Mark::Detached) => stack.push(child),
                    Some(Mark::InPlace | Mark::Pending) => self.orphans.push(child),
                    None if split > 0 && first_of_child(tree, clique, child) < split as u32 => {
                        self.split_children.push(child);
                    }
                    None => self.orphans.push(child),
                }
            }
            if split > 0 {
                let children = (first, self.split_children.len() - first);
                self.splits.push(Split { clique, frontals: split, children });
            }
        }
        self.stack = stack;
        self.detached.reverse();
        for &clique in &self.detached {
            let split = self.split_at(tree, clique);
            let structure = &tree.clique(clique).structure;
            self.variables.extend_from_slice(&structure.frontals[split..]);
            if split == 0 {
                self.factors.extend_from_slice(&structure.factors);
            } else {
                let first = &structure.frontals[..split];
                let stays = |f: &FactorIndex| !is_on(graph, *f, first);
                self.factors.extend(structure.factors.iter().copied().filter(stays));
            }
        }
    }

    /// The cliques below and at `root` that are eliminated again in place, children before
    /// parents, to `cliques_in_place`.
    pub(super) fn collect_in_place(&mut self, tree: &Tree, root: CliqueIndex) {
        // Depth first, parents before children; then the other way round.
        let Self { marks, stack, cliques_in_place: cliques, .. } = self;
        cliques.clear();
        stack.clear();
        stack.push(root);
        while let Some(clique) = stack.pop() {
            cliques.push(clique);
            let children = tree.clique(clique).children.iter().copied();
            stack.extend(children.filter(|&c| marks.get(c) == Some(Mark::InPlace)));
        }
        cliques.reverse();
    }

    /// How many of the first frontals of a detached clique stay.
    fn split_at(&self, tree: &Tree, clique: CliqueIndex) -> usize {
        let first = self.marks.first(clique);
        let splits =
            first >= SHORTEST_PREFIX && tree.clique(clique).numeric.form == Form::Information;
        if splits { first } else { 0 }
    }
}

impl Split {
    /// The separator of what stays: the other frontals, and the clique's own separator.
    pub(super) fn separator(self, tree: &Tree) -> impl Iterator<Item = VariableIndex> {
        let structure = &tree.clique(self.clique).structure;
        structure.frontals[self.frontals..].iter().chain(&structure.separator).copied()
    }

    /// What stays, with its factors.
    pub(super) fn structure(self, graph: &Graph, tree: &Tree) -> Structure {
        let whole = &tree.clique(self.clique).structure;
        let frontals = &whole.frontals[..self.frontals];
        let mut structure = Structure::new(graph, frontals.into(), self.separator(tree).collect());
        let factors = whole.factors.iter().copied();
        structure.factors.extend(factors.filter(|&f| is_on(graph, f, frontals)));
        structure
    }
}

/// Whether a factor is on any of a few variables.
fn is_on(graph: &Graph, factor: FactorIndex, variables: &[VariableIndex]) -> bool {
    graph.variables_at(factor).iter().any(|v| variables.contains(v))
}

/// Whether a factor whose unknowns changed had none before, and so belonged to no clique: its
/// variables are those of the tree as it was.
fn had_no_unknowns(graph: &Graph, tree: &Tree, factor: FactorIndex) -> bool {
    graph.variables_at(factor).iter().all(|&v| tree.clique_of(v).some().is_none())
}
