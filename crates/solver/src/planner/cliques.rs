//! Order and symbolic structure: from what was gathered to the cliques to eliminate.

use evergraph_model::{Graph, VariableIndex};
use smallvec::SmallVec;

use super::gather::Planner;
use super::marks::Mark;
use crate::eliminate::{Child, Job, NodeStructure};
use crate::index::{CliqueIndex, NodeIndex};
use crate::profile::{Clock, Phase};
use crate::tree::{Structure, Tree};

/// The end of a list that is linked through an array.
const END: u32 = u32::MAX;

impl Planner {
    /// Fills an empty job with the cliques to eliminate. `last` is eliminated last if it is
    /// affected.
    pub(super) fn fill(
        &mut self,
        graph: &Graph,
        tree: &Tree,
        last: Option<VariableIndex>,
        job: &mut Job,
        clock: &mut Clock,
    ) {
        for at in 0..self.roots.len() {
            self.push_in_place(tree, self.roots[at], job);
        }
        if self.variables.is_empty() {
            return;
        }
        self.order(graph, tree, last);
        clock.lap(Phase::Order);
        self.cliques.build(&self.orderer.elimination);
        self.hang(tree);
        let count = self.cliques.cliques.len();
        self.node_of.clear();
        self.node_of.resize(count, NodeIndex::NONE);
        self.child_of.clear();
        self.child_of.resize(count, END);
        self.next_child.resize(count, END);
        for at in 0..count {
            self.push_new(graph, tree, self.cliques.postorder[at] as usize, job);
        }
        for at in 0..self.factors.len() {
            let factor = self.factors[at];
            let first = self.first_clique(graph.unknowns_at(factor).iter().copied());
            let node = &mut job.nodes[self.node_of[first].index()];
            if let NodeStructure::New(structure) = &mut node.structure {
                structure.factors.push(factor);
            }
        }
        clock.lap(Phase::Symbolic);
    }

    /// Orders the affected variables.
    fn order(&mut self, graph: &Graph, tree: &Tree, last: Option<VariableIndex>) {
        let Self { local, groups, .. } = self;
        if local.len() < graph.variable_slots() {
            local.resize(graph.variable_slots(), END);
        }
        for (i, &v) in self.variables.iter().enumerate() {
            local[v.index()] = i as u32;
        }
        let number = |v: VariableIndex| local[v.index()];
        groups.clear();
        for &factor in &self.factors {
            groups.push(graph.unknowns_at(factor).iter().map(|&v| number(v)));
        }
        for &orphan in &self.orphans {
            groups.push(tree.clique(orphan).structure.separator.iter().map(|&v| number(v)));
        }
        for split in &self.splits {
            groups.push(split.separator(tree).map(number));
        }
        // The newest variable has the highest local number unless it is an old one.
        let last = self.variables.iter().rposition(|&v| Some(v) == last).map(|i| i as u32);
        self.orderer.order(self.variables.len(), groups, last);
    }

    /// Hangs each subtree that stays at the new clique of its separator's first variable.
    fn hang(&mut self, tree: &Tree) {
        self.subtree_of.clear();
        self.subtree_of.resize(self.cliques.cliques.len(), END);
        self.next_subtree.resize(self.orphans.len() + self.splits.len(), END);
        for subtree in (0..self.next_subtree.len()).rev() {
            let clique = match subtree.checked_sub(self.orphans.len()) {
                None => {
                    let separator = &tree.clique(self.orphans[subtree]).structure.separator;
                    self.first_clique(separator.iter().copied())
                }
                Some(split) => self.first_clique(self.splits[split].separator(tree)),
            };
            let next = std::mem::replace(&mut self.subtree_of[clique], subtree as u32);
            self.next_subtree[subtree] = next;
        }
    }

    /// The new clique that eliminates the first of `variables`.
    fn first_clique(&self, variables: impl Iterator<Item = VariableIndex>) -> usize {
        let position = &self.orderer.elimination.position;
        let locals = variables.map(|v| self.local[v.index()]);
        let first = locals.min_by_key(|&l| position[l as usize]);
        let first = first.expect("factors and subtrees that hang have variables");
        self.cliques.clique_of[first as usize] as usize
    }

    /// Adds a new clique, after the subtrees that stay below it.
    fn push_new(&mut self, graph: &Graph, tree: &Tree, c: usize, job: &mut Job) {
        let mut children: SmallVec<[Child; 4]> = SmallVec::new();
        let mut child = self.child_of[c];
        while child != END {
            children.push(Child::Node(self.node_of[child as usize]));
            child = self.next_child[child as usize];
        }
        let mut subtree = self.subtree_of[c];
        while subtree != END {
            children.push(self.push_subtree(graph, tree, subtree as usize, job));
            subtree = self.next_subtree[subtree as usize];
        }
        let elimination = &self.orderer.elimination;
        let clique = &self.cliques.cliques[c];
        let slot = |l: u32| self.variables[l as usize];
        let last = elimination.position[clique.last as usize] as usize;
        let mut separator: SmallVec<[u32; 8]> = elimination.separator(last).into();
        separator.sort_unstable_by_key(|&l| elimination.position[l as usize]);
        let separator = separator.iter().map(|&l| slot(l)).collect();
        let frontals = clique.frontals.iter().rev().map(|&l| slot(l)).collect();
        let structure = Structure::new(graph, frontals, separator);
        if let Some(parent) = clique.parent {
            self.next_child[c] = std::mem::replace(&mut self.child_of[parent as usize], c as u32);
        }
        self.node_of[c] = job.push(NodeStructure::New(structure), children);
    }

    /// Adds the nodes of a subtree that stays; what its parent calls it.
    fn push_subtree(&mut self, graph: &Graph, tree: &Tree, subtree: usize, job: &mut Job) -> Child {
        let Some(at) = subtree.checked_sub(self.orphans.len()) else {
            let orphan = self.orphans[subtree];
            return match self.marks.get(orphan) {
                Some(Mark::Pending) => Child::Pending(self.marks.pending(orphan)),
                Some(_) => Child::Node(self.push_in_place(tree, orphan, job)),
                None => Child::Kept(orphan),
            };
        };
        let split = self.splits[at];
        let (first, count) = split.children;
        let children = self.split_children[first..first + count].iter();
        let children = children.map(|&child| Child::Kept(child)).collect();
        let structure = split.structure(graph, tree);
        let structure = NodeStructure::Prefix { clique: split.clique, split: at, structure };
        Child::Node(job.push(structure, children))
    }

    /// Adds the marked cliques of a subtree, to be eliminated again in place; the node of its root.
    fn push_in_place(&mut self, tree: &Tree, root: CliqueIndex, job: &mut Job) -> NodeIndex {
        self.collect_in_place(tree, root);
        let cliques = std::mem::take(&mut self.cliques_in_place);
        let mut node = NodeIndex::NONE;
        for &clique in &cliques {
            let children = tree.clique(clique).children.iter();
            let children = children
                .map(|&child| match self.marks.get(child) {
                    Some(Mark::Pending) => Child::Pending(self.marks.pending(child)),
                    Some(_) => Child::Node(self.marks.node(child)),
                    None => Child::Kept(child),
                })
                .collect();
            node = job.push(NodeStructure::Existing(clique), children);
            self.marks.set_node(clique, node);
        }
        self.cliques_in_place = cliques;
        node
    }
}
