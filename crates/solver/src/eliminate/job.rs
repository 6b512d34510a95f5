//! What is to be eliminated, and what comes of it.

use std::collections::BTreeMap;

use evergraph_model::VariableIndex;
use smallvec::SmallVec;

use crate::index::{CliqueIndex, NodeIndex, PendingIndex};
use crate::pool::Pool;
use crate::tree::{Numeric, Structure};

/// Where a contribution comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Child {
    /// A node of the same job.
    Node(NodeIndex),
    /// A clique of the tree that is kept.
    Kept(CliqueIndex),
    /// A clique of the tree whose new numbers are those of the pending relinearization.
    Pending(PendingIndex),
}

/// Whose structure a node has.
#[derive(Debug)]
pub(crate) enum NodeStructure {
    /// A new clique.
    New(Structure),
    /// A clique of the tree, to be eliminated again with new numbers.
    Existing(CliqueIndex),
    /// The first frontals of a clique of the tree whose others are eliminated elsewhere: its part
    /// of R stays, the contribution is made again.
    Prefix {
        /// The clique.
        clique: CliqueIndex,
        /// Its place among the cliques that are split.
        split: usize,
        structure: Structure,
    },
}

/// A clique to eliminate.
#[derive(Debug)]
pub(crate) struct Node {
    pub(crate) structure: NodeStructure,
    pub(crate) children: SmallVec<[Child; 4]>,
    pub(crate) parent: Option<NodeIndex>,
}

/// Cliques to eliminate, in postorder with contiguous subtrees.
#[derive(Debug, Default)]
pub(crate) struct Job {
    pub(crate) nodes: Vec<Node>,
}

impl Job {
    /// Adds a node, and links its children to it.
    pub(crate) fn push(
        &mut self,
        structure: NodeStructure,
        children: SmallVec<[Child; 4]>,
    ) -> NodeIndex {
        let node = NodeIndex::new(self.nodes.len());
        for child in &children {
            if let Child::Node(child) = child {
                self.nodes[child.index()].parent = Some(node);
            }
        }
        self.nodes.push(Node { structure, children, parent: None });
        node
    }
}

/// The numbers of a job's nodes, and of kept cliques that had to be eliminated again by QR.
#[derive(Debug, Default)]
pub(crate) struct Eliminated {
    pub(crate) nodes: Vec<Option<Numeric>>,
    pub(crate) kept: BTreeMap<CliqueIndex, Numeric>,
}

impl Eliminated {
    pub(crate) fn smallest_pivot_ratio(&self) -> f64 {
        self.nodes.iter().flatten().map(|n| n.pivot_ratio).fold(f64::INFINITY, f64::min)
    }

    /// Room for a job's results.
    pub(super) fn start(&mut self, job: &Job, pool: &mut Pool) {
        self.recycle(pool);
        self.nodes.resize_with(job.nodes.len(), || None);
    }

    /// Returns the numbers to the pool.
    pub(super) fn recycle(&mut self, pool: &mut Pool) {
        let old =
            self.nodes.drain(..).flatten().chain(std::mem::take(&mut self.kept).into_values());
        old.for_each(|numeric| pool.give(numeric.data));
    }
}

/// Why an elimination stopped, and at which variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// Its pivot is zero.
    Undetermined { variable: VariableIndex },
    /// Its part of R is not finite.
    Overflow { variable: VariableIndex },
    /// Something below, which the pending relinearization eliminated by Cholesky, has to be
    /// eliminated by QR.
    Pending,
}
