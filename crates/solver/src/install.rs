//! Putting what was eliminated into the tree.

use crate::eliminate::{Child, NodeStructure};
use crate::smoother::{Scratch, Smoother};
use crate::tree::{Clique, NONE};

impl Smoother {
    /// Replaces the detached cliques by those of the job that was eliminated, and gives existing
    /// ones their new numbers.
    pub(crate) fn install(&mut self) {
        let Scratch { planner, job, eliminated, workspace, installed, shortened, .. } =
            &mut self.scratch;
        let tree = &mut self.tree;
        let mut split: Vec<Option<Clique>> = std::mem::take(shortened);
        split.extend(planner.splits().map(|clique| tree.remove(clique)));
        for &index in &planner.detached {
            if let Some(clique) = tree.remove(index) {
                workspace.pool.give(clique.numeric.data);
            }
        }
        installed.clear();
        for (node, numeric) in job.nodes.drain(..).zip(eliminated.nodes.drain(..)) {
            let numeric = numeric.expect("a finished elimination has numbers for every node");
            let (structure, numeric, solved) = match node.structure {
                NodeStructure::Existing(index) => {
                    tree.replace_numeric(index, numeric, &mut workspace.pool);
                    installed.push(index);
                    continue;
                }
                NodeStructure::New(structure) => (structure, numeric, 0),
                NodeStructure::Prefix { split: at, structure, .. } => {
                    let whole = split[at as usize].take().expect("each split has one node");
                    if numeric.is_without_panel() {
                        let mut shorter = whole.numeric;
                        shorter.shorten(&numeric);
                        workspace.pool.give(numeric.data);
                        (structure, shorter, whole.solved)
                    } else {
                        workspace.pool.give(whole.numeric.data);
                        (structure, numeric, 0)
                    }
                }
            };
            let children = node
                .children
                .iter()
                .map(|child| match child {
                    Child::Node(node) => installed[*node as usize],
                    Child::Kept(clique) => *clique,
                    Child::Ahead(place) => self.ahead.clique(*place).0,
                })
                .collect();
            let clique = Clique {
                structure,
                numeric,
                parent: NONE,
                children,
                solved,
                kept: 0,
                unfinished: solved > 0,
                birth: 0,
            };
            let index = tree.insert(clique);
            tree.adopt(index);
            if node.parent.is_none() {
                tree.roots.insert(index);
            }
            installed.push(index);
        }
        split.clear();
        *shortened = split;
        for &(place, clique) in planner.ahead() {
            if let Some(numeric) = self.ahead.take(place) {
                tree.replace_numeric(clique, numeric, &mut workspace.pool);
            }
        }
        for (clique, numeric) in std::mem::take(&mut eliminated.kept) {
            tree.replace_numeric(clique, numeric, &mut workspace.pool);
        }
    }
}
