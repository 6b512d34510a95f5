//! New cliques take the place of the detached ones.

use super::engine::{Buffers, Engine};
use super::state::Factorization;
use crate::eliminate::{Child, Eliminated, NodeStructure};
use crate::index::CliqueIndex;
use crate::pending::Pending;
use crate::planner::Plan;
use crate::tree::{Clique, Numeric, Structure, Tree};

impl Factorization {
    /// Replaces the detached cliques of a plan by those that were eliminated, and gives existing
    /// ones their new numbers, those of `pending` included.
    pub(super) fn install(
        &mut self,
        mut plan: Plan,
        mut eliminated: Eliminated,
        mut pending: Option<&mut Pending>,
        engine: &mut Engine,
    ) {
        let tree = &mut self.tree;
        let pool = &mut engine.workspace.pool;
        let Buffers { installed, shortened, .. } = &mut engine.buffers;
        shortened.extend(plan.splits.iter().map(|&clique| tree.remove(clique)));
        for &index in &plan.detached {
            if let Some(clique) = tree.remove(index) {
                pool.give(clique.numeric.data);
            }
        }
        installed.clear();
        for (node, numeric) in plan.job.nodes.drain(..).zip(eliminated.nodes.drain(..)) {
            let numeric = numeric.expect("a finished elimination has numbers for every node");
            let (structure, numeric, solved) = match node.structure {
                NodeStructure::Existing(index) => {
                    tree.replace_numeric(index, numeric, pool);
                    installed.push(index);
                    continue;
                }
                NodeStructure::New(structure) => (structure, numeric, 0),
                NodeStructure::Prefix { split: at, structure, .. } => {
                    let whole = shortened[at].take().expect("each split has one node");
                    if numeric.is_without_panel() {
                        // Out of the tree: its numbers are no longer counted there.
                        let mut shorter = whole.numeric;
                        shorter.shorten(&numeric);
                        pool.give(numeric.data);
                        (structure, shorter, whole.solved)
                    } else {
                        pool.give(whole.numeric.data);
                        (structure, numeric, 0)
                    }
                }
            };
            let clique_of = |child: &Child| match (child, pending.as_deref()) {
                (Child::Node(node), _) => installed[node.index()],
                (Child::Kept(clique), _) => *clique,
                (Child::Pending(place), Some(pending)) => pending.clique(*place).0,
                (Child::Pending(_), None) => {
                    unreachable!("only jobs that take over a relinearization refer to it")
                }
            };
            let children = node.children.iter().map(clique_of).collect();
            let index = insert(tree, structure, numeric, children, solved);
            if node.parent.is_none() {
                tree.roots.insert(index);
            }
            installed.push(index);
        }
        shortened.clear();
        for &(place, clique) in &plan.pending {
            if let Some(numeric) = pending.as_deref_mut().and_then(|pending| pending.take(place)) {
                tree.replace_numeric(clique, numeric, pool);
            }
        }
        for (clique, numeric) in std::mem::take(&mut eliminated.kept) {
            tree.replace_numeric(clique, numeric, pool);
        }
        pool.set_in_use(tree.numbers());
        engine.buffers.plan = plan;
        engine.buffers.eliminated = eliminated;
    }
}

/// Adds a new clique to the tree, above its children.
fn insert(
    tree: &mut Tree,
    structure: Structure,
    numeric: Numeric,
    children: smallvec::SmallVec<[CliqueIndex; 4]>,
    solved: u64,
) -> CliqueIndex {
    let index = tree.insert(Clique {
        structure,
        numeric,
        parent: CliqueIndex::NONE,
        children,
        solved,
        cached: 0,
        unfinished: solved > 0,
        birth: 0,
    });
    tree.adopt(index);
    index
}
