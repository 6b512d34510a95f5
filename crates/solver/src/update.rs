//! The steps of an update between checking a change and committing it: what to detach, what to
//! gather, and the new cliques. All of it reads only.

use evergraph_model::{Graph, Staged};
use smallvec::SmallVec;

use crate::eliminate::{Child, Job, Node, NodeStructure};
use crate::ordering::{self, Groups};
use crate::symbolic;
use crate::tree::{NONE, Structure, Tree};

/// The part of the tree that an update takes apart.
#[derive(Debug, Default)]
pub(crate) struct Affected {
    /// Cliques to take out, children before parents.
    pub(crate) detached: Vec<u32>,
    /// Kept cliques whose parent is taken out.
    pub(crate) orphans: Vec<u32>,
    /// Variables to eliminate again, in their old order of elimination, new ones at the end.
    pub(crate) variables: Vec<u32>,
    /// Factors to assemble again, and new ones.
    pub(crate) factors: Vec<u32>,
}

/// A set of cliques closed towards the roots.
#[derive(Debug)]
pub(crate) struct Marked {
    /// By clique slot.
    flags: Vec<bool>,
    /// The roots among them, in the order they were reached.
    roots: Vec<u32>,
    pub(crate) count: usize,
}

/// Marks the cliques of `touched` variables and all of their ancestors.
pub(crate) fn mark(tree: &Tree, touched: impl IntoIterator<Item = u32>) -> Marked {
    let mut marked = Marked { flags: vec![false; tree.slots()], roots: Vec::new(), count: 0 };
    for variable in touched {
        let mut clique = tree.clique_of(variable);
        while clique != NONE && !marked.flags[clique as usize] {
            marked.flags[clique as usize] = true;
            marked.count += 1;
            let parent = tree.clique(clique).parent;
            if parent == NONE {
                marked.roots.push(clique);
            }
            clique = parent;
        }
    }
    marked
}

/// Marks every clique.
pub(crate) fn mark_all(tree: &Tree) -> Marked {
    let roots = tree.roots.iter().copied().collect();
    Marked { flags: vec![true; tree.slots()], roots, count: tree.len() }
}

/// The marked cliques (a set closed towards the roots), children before parents, and the kept
/// cliques below them. Recursion is on an explicit stack: elimination trees of chains are deep.
fn marked_postorder(tree: &Tree, marked: &Marked) -> (Vec<u32>, Vec<u32>) {
    let (mut reversed, mut orphans) = (Vec::new(), Vec::new());
    let mut stack = marked.roots.clone();
    while let Some(clique) = stack.pop() {
        reversed.push(clique);
        for &child in &tree.clique(clique).children {
            if marked.flags[child as usize] {
                stack.push(child);
            } else {
                orphans.push(child);
            }
        }
    }
    reversed.reverse();
    (reversed, orphans)
}

impl Affected {
    /// Detach and gather: what a staged change takes apart. `moved` are variables whose
    /// linearization point moves.
    pub(crate) fn by_change(graph: &Graph, tree: &Tree, staged: &Staged, moved: &[u32]) -> Self {
        let of_factors = |factors: &[u32]| -> Vec<u32> {
            factors.iter().flat_map(|&f| graph.variables_at(f as usize).iter().copied()).collect()
        };
        let new_factors: Vec<u32> = staged.new_factors().map(|f| f as u32).collect();
        let moved_factors: Vec<u32> =
            moved.iter().flat_map(|&v| graph.factors_at(v as usize).iter().copied()).collect();
        let touched = of_factors(&new_factors)
            .into_iter()
            .chain(of_factors(staged.dropped_factors()))
            .chain(of_factors(&moved_factors))
            .chain(staged.dropped_variables().iter().copied());
        let mut affected = Self::above(tree, &mark(tree, touched));
        if !staged.dropped_variables().is_empty() {
            affected.variables.retain(|v| staged.dropped_variables().binary_search(v).is_err());
        }
        if !staged.dropped_factors().is_empty() {
            affected.factors.retain(|f| staged.dropped_factors().binary_search(f).is_err());
        }
        affected.variables.extend(staged.new_variables().map(|v| v as u32));
        affected.factors.extend(new_factors);
        affected
    }

    /// Everything: for a new order of the whole graph.
    pub(crate) fn everything(tree: &Tree) -> Self {
        Self::above(tree, &mark_all(tree))
    }

    fn above(tree: &Tree, marked: &Marked) -> Self {
        let (detached, orphans) = marked_postorder(tree, marked);
        let (mut variables, mut factors) = (Vec::new(), Vec::new());
        for &clique in &detached {
            let structure = &tree.clique(clique).structure;
            variables.extend_from_slice(&structure.frontals);
            factors.extend_from_slice(&structure.factors);
        }
        Self { detached, orphans, variables, factors }
    }

    /// Order and symbolic structure: the new cliques, ready to be eliminated. `last` is eliminated
    /// last if it is affected. `local` is scratch by variable slot.
    pub(crate) fn plan(&self, graph: &Graph, tree: &Tree, last: u32, local: &mut Vec<u32>) -> Job {
        local.resize(graph.variable_slots(), NONE);
        for (i, &v) in self.variables.iter().enumerate() {
            local[v as usize] = i as u32;
        }
        let mut groups = Groups::default();
        for &f in &self.factors {
            groups.push(graph.variables_at(f as usize).iter().map(|&v| local[v as usize]));
        }
        for &orphan in &self.orphans {
            groups.push(tree.clique(orphan).structure.separator.iter().map(|&v| local[v as usize]));
        }
        // The newest variable has the highest local number unless it is an old one.
        let last = self.variables.iter().rposition(|&v| v == last).map(|i| i as u32);
        let elimination = ordering::order(self.variables.len(), &groups, last);
        let cliques = symbolic::cliques(&elimination);

        let mut clique_of = vec![0_u32; self.variables.len()];
        for (c, clique) in cliques.iter().enumerate() {
            for &v in &clique.frontals {
                clique_of[v as usize] = c as u32;
            }
        }
        let first_clique = |variables: &[u32]| {
            let first = variables
                .iter()
                .map(|&v| local[v as usize])
                .min_by_key(|&l| elimination.position[l as usize]);
            clique_of[first.expect("factors and orphans have variables") as usize] as usize
        };
        let slot = |l: &u32| self.variables[*l as usize];
        let dim = |variables: &[u32]| variables.iter().map(|&v| graph.dim_at(v as usize)).sum();
        let mut job = Job { nodes: Vec::with_capacity(cliques.len()) };
        let mut children: Vec<SmallVec<[Child; 4]>> = vec![SmallVec::new(); cliques.len()];
        for (c, clique) in cliques.iter().enumerate() {
            if let Some(parent) = clique.parent {
                children[parent].push(Child::Node(c));
            }
        }
        for &orphan in &self.orphans {
            children[first_clique(&tree.clique(orphan).structure.separator)]
                .push(Child::Kept(orphan));
        }
        for (clique, children) in cliques.iter().zip(children) {
            let frontals: SmallVec<[u32; 4]> = clique.frontals.iter().map(slot).collect();
            let separator: SmallVec<[u32; 8]> = clique.separator.iter().map(slot).collect();
            let (frontal_dim, separator_dim) = (dim(&frontals), dim(&separator));
            let structure = Structure {
                frontals,
                separator,
                factors: SmallVec::new(),
                frontal_dim,
                separator_dim,
            };
            job.nodes.push(Node {
                structure: NodeStructure::New(structure),
                children,
                parent: clique.parent,
            });
        }
        for &f in &self.factors {
            let node = &mut job.nodes[first_clique(graph.variables_at(f as usize))];
            if let NodeStructure::New(structure) = &mut node.structure {
                structure.factors.push(f);
            }
        }
        job
    }
}

/// A job that eliminates existing cliques (a set closed towards the roots) again, in place.
pub(crate) fn in_place(tree: &Tree, marked: &Marked) -> Job {
    let (cliques, _) = marked_postorder(tree, marked);
    let mut node_of = vec![usize::MAX; tree.slots()];
    for (i, &clique) in cliques.iter().enumerate() {
        node_of[clique as usize] = i;
    }
    let nodes = cliques
        .iter()
        .map(|&index| {
            let clique = tree.clique(index);
            Node {
                structure: NodeStructure::Existing(index),
                children: clique
                    .children
                    .iter()
                    .map(|&c| {
                        if marked.flags[c as usize] {
                            Child::Node(node_of[c as usize])
                        } else {
                            Child::Kept(c)
                        }
                    })
                    .collect(),
                parent: (clique.parent != NONE).then(|| node_of[clique.parent as usize]),
            }
        })
        .collect();
    Job { nodes }
}
