//! The steps of an update between checking a change and committing it: what to detach, what to
//! gather, and the new cliques. All of it reads only.

mod marks;
mod plan;

use evergraph_model::{Graph, Staged};

use crate::ordering::{Groups, Orderer};
use crate::relinearize::Ahead;
use crate::symbolic::Cliques;
use crate::tree::{Form, NONE, Structure, Tree};
pub(crate) use marks::Mark;
use marks::{Marks, first_of_child};

/// A clique whose first touched frontal is this one or a later one is split there, rather than
/// taken apart whole.
const SHORTEST_PREFIX: usize = 2;

/// A clique that is split: its first `frontals` frontals stay, with their part of R.
#[derive(Clone, Copy, Debug)]
struct Split {
    clique: u32,
    frontals: usize,
    /// First of its children among `split_children`, and how many.
    children: (usize, usize),
}

/// Finds out what an update takes apart, and how to put it together again.
#[derive(Debug, Default)]
pub(crate) struct Planner {
    marks: Marks,
    /// Cliques to take out, children before parents.
    pub(crate) detached: Vec<u32>,
    splits: Vec<Split>,
    /// Children that the first frontals of split cliques keep.
    split_children: Vec<u32>,
    /// Subtrees that stay, as they are or with new numbers, below what is taken out.
    pub(crate) orphans: Vec<u32>,
    /// Cliques done ahead of time.
    ahead: Vec<(u32, u32)>,
    /// Roots that are eliminated again in place.
    roots: Vec<u32>,
    /// Variables to eliminate again, in their old order of elimination, new ones at the end.
    pub(crate) variables: Vec<u32>,
    /// Factors to assemble again, and new ones.
    factors: Vec<u32>,

    /// By variable slot: position in `variables`.
    local: Vec<u32>,
    groups: Groups,
    orderer: Orderer,
    cliques: Cliques,
    /// By new clique: its first subtree that stays, and the next one by subtree. Subtrees are the
    /// orphans, then the splits.
    subtree_of: Vec<u32>,
    next_subtree: Vec<u32>,
    /// By new clique: its first child among the new, the next of the same parent, its node.
    child_of: Vec<u32>,
    next_child: Vec<u32>,
    node_of: Vec<u32>,
    stack: Vec<u32>,
    cliques_in_place: Vec<u32>,
}

impl Planner {
    /// Marks what a staged change takes apart. `moved` are variables whose linearization point it
    /// moves.
    pub(crate) fn touch_change(
        &mut self,
        graph: &Graph,
        tree: &Tree,
        staged: &Staged,
        moved: impl Iterator<Item = u32>,
    ) {
        self.start(tree);
        let new = staged.new_factors().map(|f| f as u32);
        let dropped = staged.dropped_factors().iter().copied();
        let moved = moved.flat_map(|v| graph.factors_at(v as usize).iter().copied());
        for factor in new.chain(dropped).chain(moved) {
            self.touch_factor(graph, tree, factor, Mark::Detached);
        }
        for &variable in staged.dropped_variables() {
            self.touch_separators(tree, variable);
        }
    }

    /// Marks what taking over relinearized variables changes: cliques that were done ahead get
    /// their numbers, the others are eliminated again in place.
    pub(crate) fn touch_ahead(&mut self, graph: &Graph, tree: &Tree, ahead: &Ahead) {
        for (place, clique) in ahead.done(tree) {
            if self.marks.get(clique).is_none() {
                self.marks.set_ahead(clique, place);
                self.ahead.push((place, clique));
            }
        }
        let is_ahead = |marks: &Marks, clique| marks.get(clique) == Some(Mark::Ahead);
        for &(_, clique) in &self.ahead {
            let parent = tree.clique(clique).parent;
            if parent == NONE || !is_ahead(&self.marks, parent) {
                self.marks.touch_above(tree, clique, Mark::InPlace);
            }
        }
        for variable in ahead.variables(graph) {
            let clique = tree.clique_of(variable);
            if clique != NONE && !is_ahead(&self.marks, clique) {
                self.touch_variable(graph, tree, variable);
            }
        }
    }

    fn touch_variable(&mut self, graph: &Graph, tree: &Tree, variable: u32) {
        for &factor in graph.factors_at(variable as usize) {
            self.touch_factor(graph, tree, factor, Mark::InPlace);
        }
    }

    /// The cliques that relinearizing `variables` changes, children before parents, and what it
    /// costs to eliminate them, in units of about a nanosecond.
    pub(crate) fn changed_by(
        &mut self,
        graph: &Graph,
        tree: &Tree,
        variables: &[u32],
    ) -> (&[u32], f64) {
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

    /// Cliques that get the numbers of an elimination ahead of time: places there, and slots.
    pub(crate) fn ahead(&self) -> &[(u32, u32)] {
        &self.ahead
    }

    /// Gathers what is marked, and what a staged change adds and drops.
    pub(crate) fn gather_change(&mut self, graph: &Graph, tree: &Tree, staged: &Staged) {
        self.gather(graph, tree);
        if !staged.dropped_variables().is_empty() {
            self.variables.retain(|v| staged.dropped_variables().binary_search(v).is_err());
        }
        if !staged.dropped_factors().is_empty() {
            self.factors.retain(|f| staged.dropped_factors().binary_search(f).is_err());
        }
        self.variables.extend(staged.new_variables().map(|v| v as u32));
        self.factors.extend(staged.new_factors().map(|f| f as u32));
    }

    /// Everything: detached, for a new order of the whole graph, or in place.
    pub(crate) fn gather_all(&mut self, graph: &Graph, tree: &Tree, mark: Mark) {
        self.start(tree);
        self.marks.touch_all(tree, mark);
        self.gather(graph, tree);
    }

    /// Everything in a graph, for an empty tree.
    pub(crate) fn gather_graph(&mut self, graph: &Graph, tree: &Tree) {
        self.start(tree);
        self.variables.extend(graph.variable_indices().map(|v| v as u32));
        self.factors.extend(graph.factor_indices().map(|f| f as u32));
    }

    fn start(&mut self, tree: &Tree) {
        self.marks.start(tree);
        self.detached.clear();
        self.splits.clear();
        self.split_children.clear();
        self.orphans.clear();
        self.ahead.clear();
        self.roots.clear();
        self.variables.clear();
        self.factors.clear();
    }

    fn touch_factor(&mut self, graph: &Graph, tree: &Tree, factor: u32, mark: Mark) {
        for &variable in graph.variables_at(factor as usize) {
            self.marks.touch(tree, variable, mark);
        }
    }

    /// Marks the clique of a variable that is dropped, whole, and all that have it in their
    /// separator: a clique may hold a variable that none of the factors below is on.
    fn touch_separators(&mut self, tree: &Tree, variable: u32) {
        let own = tree.clique_of(variable);
        if own == NONE {
            return;
        }
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
                    Some(Mark::InPlace | Mark::Ahead) => self.orphans.push(child),
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
                let stays = |f: &u32| !is_on(graph, *f, first);
                self.factors.extend(structure.factors.iter().copied().filter(stays));
            }
        }
    }

    /// Detached cliques whose first frontals stay.
    pub(crate) fn splits(&self) -> impl Iterator<Item = u32> {
        self.splits.iter().map(|split| split.clique)
    }

    /// The cliques below and at `root` that are eliminated again in place, children before
    /// parents, to `cliques_in_place`.
    fn collect_in_place(&mut self, tree: &Tree, root: u32) {
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
    fn split_at(&self, tree: &Tree, clique: u32) -> usize {
        let first = self.marks.first(clique);
        let splits =
            first >= SHORTEST_PREFIX && tree.clique(clique).numeric.form == Form::Information;
        if splits { first } else { 0 }
    }
}

impl Split {
    /// The separator of what stays: the other frontals, and the clique's own separator.
    fn separator(self, tree: &Tree) -> impl Iterator<Item = u32> {
        let structure = &tree.clique(self.clique).structure;
        structure.frontals[self.frontals..].iter().chain(&structure.separator).copied()
    }

    /// What stays, with its factors.
    fn structure(self, graph: &Graph, tree: &Tree) -> Structure {
        let whole = &tree.clique(self.clique).structure;
        let frontals = &whole.frontals[..self.frontals];
        let mut structure = Structure::new(graph, frontals.into(), self.separator(tree).collect());
        let factors = whole.factors.iter().copied();
        structure.factors.extend(factors.filter(|&f| is_on(graph, f, frontals)));
        structure
    }
}

/// Whether a factor is on any of a few variables.
fn is_on(graph: &Graph, factor: u32, variables: &[u32]) -> bool {
    graph.variables_at(factor as usize).iter().any(|v| variables.contains(v))
}
