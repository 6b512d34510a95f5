//! Elimination of a set of cliques, bottom-up: batch and incremental are this code on a larger or
//! smaller part of the tree.
//!
//! A [`Job`] lists the cliques to eliminate in postorder, each with the children that hand it
//! their contributions: other cliques of the job, or kept ones of the tree. Nothing is altered;
//! the results are installed by whoever asked, or dropped if anything fails.

mod assembly;
mod front;
mod parallel;
mod rows;
mod workspace;

use std::collections::BTreeMap;

use evergraph_model::Graph;
use smallvec::SmallVec;
use tracing::debug;

use crate::dense::Instructions;
use crate::linearization::{Blocks, Overlay};
use crate::pool::Pool;
use crate::relinearize::Ahead;
use crate::settings::Elimination;
use crate::tree::{Numeric, Structure, Tree};

pub(crate) use workspace::Workspace;

/// Below this ratio of a pivot to its diagonal entry of JᵀJ, Cholesky has lost too many digits and
/// the subtree is eliminated again by QR from factor rows.
pub(crate) const CHOLESKY_PIVOT: f64 = 1e-9;
/// Below this ratio a pivot of QR is zero: the variable is not determined. The ratio is a square:
/// QR finds R_jj to about 1e-15 of its column's norm, so a free direction shows as 1e-28 or so,
/// while sound ones go down to 2.7e-14 in a public graph (Intel, where one edge weighs 2.7e12).
pub(crate) const QR_PIVOT: f64 = 1e-22;
/// What two pivots of a subtree may lose together: ε/ρ beside ρ for Cholesky, their squares for QR.
pub(crate) const CHOLESKY_PRODUCT: f64 = 1e-14;
pub(crate) const QR_PRODUCT: f64 = 1e-29;

/// Where a contribution comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Child {
    /// A node of the same job.
    Node(u32),
    /// A clique of the tree that is kept.
    Kept(u32),
    /// A clique of the tree that was eliminated ahead of time: its place there.
    Ahead(u32),
}

/// Whose structure a node has.
#[derive(Debug)]
pub(crate) enum NodeStructure {
    /// A new clique.
    New(Structure),
    /// A clique of the tree, to be eliminated again with new numbers.
    Existing(u32),
    /// The first frontals of a clique of the tree whose others are eliminated elsewhere: its part
    /// of R stays, the contribution is made again.
    Prefix {
        /// The clique.
        clique: u32,
        /// Its place among the cliques that are split.
        split: u32,
        structure: Structure,
    },
}

/// A clique to eliminate.
#[derive(Debug)]
pub(crate) struct Node {
    pub(crate) structure: NodeStructure,
    pub(crate) children: SmallVec<[Child; 4]>,
    pub(crate) parent: Option<u32>,
}

/// Cliques to eliminate, in postorder with contiguous subtrees.
#[derive(Debug, Default)]
pub(crate) struct Job {
    pub(crate) nodes: Vec<Node>,
}

/// What elimination reads.
#[derive(Clone, Copy)]
pub(crate) struct System<'a> {
    pub(crate) graph: &'a Graph,
    pub(crate) blocks: &'a Blocks,
    pub(crate) tree: &'a Tree,
    pub(crate) elimination: Elimination,
    pub(crate) instructions: Instructions,
    /// Blocks that stand for those of `blocks`.
    pub(crate) overlay: Option<&'a Overlay>,
    /// What [`Child::Ahead`] refers to.
    pub(crate) ahead: Option<&'a Ahead>,
    /// Added to each scalar's diagonal of the information matrix, by tangent position.
    pub(crate) damping: Option<&'a [f64]>,
}

impl<'a> System<'a> {
    /// The linear system as it is.
    pub(crate) fn new(
        graph: &'a Graph,
        blocks: &'a Blocks,
        tree: &'a Tree,
        elimination: Elimination,
        instructions: Instructions,
    ) -> Self {
        Self {
            graph,
            blocks,
            tree,
            elimination,
            instructions,
            overlay: None,
            ahead: None,
            damping: None,
        }
    }

    /// A clique that was eliminated ahead of time: its slot and its new numbers.
    fn ahead(&self, place: u32) -> (u32, &'a Numeric) {
        self.ahead.expect("jobs that take over are given what was done ahead").clique(place)
    }

    /// `[J₁ … Jₖ | r]` of a factor, column-major.
    #[inline]
    pub(crate) fn block(&self, factor: usize) -> &'a [f64] {
        let overlaid = self.overlay.and_then(|overlay| overlay.get(self.blocks, factor));
        overlaid.unwrap_or_else(|| self.blocks.get(factor))
    }

    pub(crate) fn structure(&self, node: &'a Node) -> &'a Structure {
        match &node.structure {
            NodeStructure::New(structure) | NodeStructure::Prefix { structure, .. } => structure,
            NodeStructure::Existing(clique) => &self.tree.clique(*clique).structure,
        }
    }
}

/// The numbers of a job's nodes, and of kept cliques that had to be eliminated again by QR.
#[derive(Debug, Default)]
pub(crate) struct Eliminated {
    pub(crate) nodes: Vec<Option<Numeric>>,
    pub(crate) kept: BTreeMap<u32, Numeric>,
}

impl Eliminated {
    pub(crate) fn smallest_pivot_ratio(&self) -> f64 {
        self.nodes.iter().flatten().map(|n| n.pivot_ratio).fold(f64::INFINITY, f64::min)
    }

    /// Room for a job's results; what is here goes back to the pool.
    fn start(&mut self, job: &Job, pool: &mut Pool) {
        let old =
            self.nodes.drain(..).flatten().chain(std::mem::take(&mut self.kept).into_values());
        old.for_each(|numeric| pool.give(numeric.data));
        self.nodes.resize_with(job.nodes.len(), || None);
    }
}

/// Why an elimination stopped, and at which variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// Its pivot is zero.
    Undetermined { variable: u32 },
    /// Its part of R is not finite.
    Overflow { variable: u32 },
    /// Something below that was eliminated ahead of time, by Cholesky, has to be eliminated by QR.
    Ahead,
}

/// Eliminates all nodes of a job, on several threads where that pays. The arithmetic of a node
/// depends on the node alone, so the bits do not depend on the threads.
pub(crate) fn eliminate(
    system: &System<'_>,
    job: &Job,
    results: &mut Eliminated,
    workspace: &mut Workspace,
    threads: Option<&rayon::ThreadPool>,
) -> Result<(), Failure> {
    results.start(job, &mut workspace.pool);
    // What fails first is only certain in sequence, so a failure is found again below.
    if threads.is_some_and(|pool| parallel::eliminate_subtrees(system, job, pool, results).is_err())
    {
        results.start(job, &mut workspace.pool);
    }
    let Eliminated { nodes, kept } = results;
    Range { system, job, offset: 0, nodes, kept }.eliminate(workspace)
}

/// Eliminates a single clique, by Cholesky without recourse to QR if that is the setting; `None` when
/// that fails.
pub(crate) fn eliminate_one(
    system: &System<'_>,
    structure: &Structure,
    children: &[(&Structure, &Numeric)],
    workspace: &mut Workspace,
) -> Option<Numeric> {
    let numeric = match system.elimination {
        Elimination::Cholesky => front::eliminate(system, structure, children, workspace).ok(),
        Elimination::Qr => rows::eliminate(system, structure, children, workspace).ok(),
    };
    numeric.filter(Numeric::has_finite_rhs)
}

/// A contiguous range of a job's nodes that holds the children of all of its nodes.
struct Range<'a> {
    system: &'a System<'a>,
    job: &'a Job,
    /// The first node.
    offset: usize,
    nodes: &'a mut [Option<Numeric>],
    kept: &'a mut BTreeMap<u32, Numeric>,
}

impl<'a> Range<'a> {
    /// Eliminates the nodes that have no numbers yet.
    fn eliminate(&mut self, workspace: &mut Workspace) -> Result<(), Failure> {
        for i in 0..self.nodes.len() {
            if self.nodes[i].is_none() {
                let numeric = self.eliminate_node(self.offset + i, workspace)?;
                // Anything else that is not finite reaches a pivot on the way up.
                let structure = self.structure(Child::Node((self.offset + i) as u32));
                if !numeric.has_finite_rhs() {
                    return Err(Failure::Overflow { variable: structure.frontals[0] });
                }
                self.nodes[i] = Some(numeric);
            }
        }
        Ok(())
    }

    fn eliminate_node(
        &mut self,
        node: usize,
        workspace: &mut Workspace,
    ) -> Result<Numeric, Failure> {
        if self.system.elimination == Elimination::Cholesky {
            let children = self.inputs(Child::Node(node as u32));
            let structure = self.structure(Child::Node(node as u32));
            if let NodeStructure::Prefix { clique, .. } = self.job.nodes[node].structure {
                let whole = &self.system.tree.clique(clique).numeric;
                return Ok(front::prefix(self.system, structure, &children, whole, workspace));
            }
            if let Ok(numeric) = front::eliminate(self.system, structure, &children, workspace) {
                return Ok(numeric);
            }
            debug!(first = structure.frontals[0], "pivot too small for Cholesky, QR from rows");
        }
        self.eliminate_by_rows(node, workspace)
    }

    /// Eliminates a node by QR. Children whose contribution is an information matrix are
    /// eliminated by QR first, from their own factor rows: in their Schur complements the digits
    /// are gone.
    fn eliminate_by_rows(
        &mut self,
        node: usize,
        workspace: &mut Workspace,
    ) -> Result<Numeric, Failure> {
        // What has to be eliminated again, parents before children; done in reverse.
        let mut pending: SmallVec<[Child; 8]> = SmallVec::from_slice(&[Child::Node(node as u32)]);
        let mut next = 0;
        while next < pending.len() {
            let children = self.children(pending[next]).into_iter();
            let children = children.filter(|&child| !self.numeric(child).form.is_root());
            for child in children {
                // What was done ahead was done by Cholesky; it is done again without it.
                if let Child::Ahead(_) = child {
                    return Err(Failure::Ahead);
                }
                pending.push(child);
            }
            next += 1;
        }
        loop {
            let current = pending.pop().expect("the node itself ends the loop");
            let numeric = {
                let children = self.inputs(current);
                rows::eliminate(self.system, self.structure(current), &children, workspace)?
            };
            match current {
                Child::Node(n) if n as usize == node => return Ok(numeric),
                Child::Node(n) => self.nodes[n as usize - self.offset] = Some(numeric),
                Child::Kept(clique) => {
                    self.kept.insert(clique, numeric);
                }
                Child::Ahead(_) => unreachable!("not among the pending"),
            }
        }
    }

    fn children(&self, of: Child) -> SmallVec<[Child; 4]> {
        match of {
            Child::Node(n) => self.job.nodes[n as usize].children.clone(),
            Child::Kept(clique) => {
                self.system.tree.clique(clique).children.iter().map(|&c| Child::Kept(c)).collect()
            }
            Child::Ahead(_) => SmallVec::new(),
        }
    }

    fn structure(&self, of: Child) -> &'a Structure {
        match of {
            Child::Node(n) => self.system.structure(&self.job.nodes[n as usize]),
            Child::Kept(clique) => &self.system.tree.clique(clique).structure,
            Child::Ahead(place) => &self.system.tree.clique(self.system.ahead(place).0).structure,
        }
    }

    fn numeric(&self, of: Child) -> &Numeric {
        match of {
            Child::Node(n) => self.nodes[n as usize - self.offset]
                .as_ref()
                .expect("postorder: children come first"),
            Child::Kept(clique) => {
                self.kept.get(&clique).unwrap_or(&self.system.tree.clique(clique).numeric)
            }
            Child::Ahead(place) => self.system.ahead(place).1,
        }
    }

    /// What the children hand on.
    fn inputs(&self, of: Child) -> SmallVec<[(&'a Structure, &Numeric); 4]> {
        self.children(of)
            .into_iter()
            .map(|child| (self.structure(child), self.numeric(child)))
            .collect()
    }
}
