//! Elimination of a set of cliques, bottom-up: batch and incremental are this code on a larger or
//! smaller part of the tree.
//!
//! A [`Job`] lists the cliques to eliminate in postorder, each with the children that hand it
//! their contributions: other cliques of the job, or kept ones of the tree. Nothing is altered;
//! the results are installed by whoever asked, or dropped if anything fails.

mod front;
mod parallel;
mod rows;

use evergraph_model::Graph;
use smallvec::SmallVec;

use crate::linearization::Blocks;
use crate::settings::Elimination;
use crate::tree::{Numeric, Structure, Tree};

pub(crate) use front::Workspace;

/// Below this ratio of a pivot to its diagonal entry of JᵀJ, Cholesky has lost too many digits and
/// the subtree is eliminated again by QR from factor rows.
pub(crate) const CHOLESKY_PIVOT: f64 = 1e-9;
/// Below this ratio a pivot of QR is zero: the variable is not determined. The ratio is a square:
/// QR finds R_jj to about 1e-15 of its column's norm, so a free direction shows as 1e-28 or so,
/// while sound ones go down to 2.7e-14 in a public graph (Intel, where one edge weighs 2.7e12).
pub(crate) const QR_PIVOT: f64 = 1e-22;

/// Where a contribution comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Child {
    /// A node of the same job.
    Node(usize),
    /// A clique of the tree that is kept.
    Kept(u32),
}

/// Whose structure a node has.
#[derive(Debug)]
pub(crate) enum NodeStructure {
    /// A new clique.
    New(Structure),
    /// A clique of the tree, to be eliminated again with new numbers.
    Existing(u32),
}

/// A clique to eliminate.
#[derive(Debug)]
pub(crate) struct Node {
    pub(crate) structure: NodeStructure,
    pub(crate) children: SmallVec<[Child; 4]>,
    pub(crate) parent: Option<usize>,
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
    pub(crate) arch: pulp::Arch,
    /// Added to each scalar's diagonal of the information matrix, by tangent position.
    pub(crate) damping: Option<&'a [f64]>,
}

impl<'a> System<'a> {
    pub(crate) fn structure(&self, node: &'a Node) -> &'a Structure {
        match &node.structure {
            NodeStructure::New(structure) => structure,
            NodeStructure::Existing(clique) => &self.tree.clique(*clique).structure,
        }
    }
}

/// The numbers of a job's nodes, and of kept cliques that had to be eliminated again by QR.
#[derive(Debug, Default)]
pub(crate) struct Eliminated {
    pub(crate) nodes: Vec<Option<Numeric>>,
    pub(crate) kept: Vec<(u32, Numeric)>,
}

/// A variable that is not determined by what was eliminated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Undetermined {
    /// Slot of the variable whose pivot is zero.
    pub(crate) variable: u32,
}

/// Eliminates all nodes of a job, on several threads where that pays. The arithmetic of a node
/// depends on the node alone, so the bits do not depend on the threads.
pub(crate) fn eliminate(
    system: &System<'_>,
    job: &Job,
    workspace: &mut Workspace,
    threads: Option<&rayon::ThreadPool>,
) -> Result<Eliminated, Undetermined> {
    let mut results = Eliminated { nodes: Vec::with_capacity(job.nodes.len()), kept: Vec::new() };
    results.nodes.resize_with(job.nodes.len(), || None);
    match threads {
        Some(pool) => parallel::run(system, job, workspace, pool, &mut results)?,
        None => run_range(system, job, 0, &mut results.nodes, &mut results.kept, workspace)?,
    }
    Ok(results)
}

/// Eliminates the nodes `offset .. offset + results.len()` that have no result yet; their children
/// lie in the same range.
fn run_range(
    system: &System<'_>,
    job: &Job,
    offset: usize,
    results: &mut [Option<Numeric>],
    kept: &mut Vec<(u32, Numeric)>,
    workspace: &mut Workspace,
) -> Result<(), Undetermined> {
    for i in 0..results.len() {
        if results[i].is_none() {
            results[i] = Some(run_node(system, job, offset, i, results, kept, workspace)?);
        }
    }
    Ok(())
}

fn run_node(
    system: &System<'_>,
    job: &Job,
    offset: usize,
    i: usize,
    results: &mut [Option<Numeric>],
    kept: &mut Vec<(u32, Numeric)>,
    workspace: &mut Workspace,
) -> Result<Numeric, Undetermined> {
    if system.elimination == Elimination::Cholesky {
        let node = &job.nodes[offset + i];
        let inputs = Inputs { system, job, offset, results, kept };
        let children = node.children.iter().map(|&child| inputs.of(child));
        if let Ok(numeric) = front::eliminate(system, system.structure(node), children, workspace) {
            return Ok(numeric);
        }
    }
    eliminate_by_rows(system, job, offset, Child::Node(offset + i), results, kept, workspace)
}

/// Eliminates a node by QR. Children whose contribution is an information matrix are eliminated
/// by QR first, from their own factor rows: in their Schur complements the digits are gone.
fn eliminate_by_rows(
    system: &System<'_>,
    job: &Job,
    offset: usize,
    start: Child,
    results: &mut [Option<Numeric>],
    kept: &mut Vec<(u32, Numeric)>,
    workspace: &mut Workspace,
) -> Result<Numeric, Undetermined> {
    // What has to be eliminated again, children after parents; done in reverse.
    let mut pending = vec![start];
    let mut next = 0;
    while next < pending.len() {
        let inputs = Inputs { system, job, offset, results, kept };
        for child in inputs.children(pending[next]) {
            if !inputs.of(child).1.contribution.is_root() {
                pending.push(child);
            }
        }
        next += 1;
    }
    loop {
        let current = pending.pop().expect("the starting node ends the loop");
        let numeric = {
            let inputs = Inputs { system, job, offset, results, kept };
            let children: SmallVec<[_; 4]> =
                inputs.children(current).into_iter().map(|child| inputs.of(child)).collect();
            rows::eliminate(system, inputs.structure(current), &children, workspace)?
        };
        if pending.is_empty() {
            return Ok(numeric);
        }
        match current {
            Child::Node(n) => results[n - offset] = Some(numeric),
            Child::Kept(clique) => kept.push((clique, numeric)),
        }
    }
}

/// Looks up what children have to hand on.
struct Inputs<'a> {
    system: &'a System<'a>,
    job: &'a Job,
    offset: usize,
    results: &'a [Option<Numeric>],
    kept: &'a [(u32, Numeric)],
}

impl<'a> Inputs<'a> {
    fn structure(&self, of: Child) -> &'a Structure {
        match of {
            Child::Node(n) => self.system.structure(&self.job.nodes[n]),
            Child::Kept(clique) => &self.system.tree.clique(clique).structure,
        }
    }

    fn of(&self, child: Child) -> (&'a Structure, &'a Numeric) {
        let numeric = match child {
            Child::Node(n) => {
                self.results[n - self.offset].as_ref().expect("postorder: children come first")
            }
            Child::Kept(clique) => {
                let again = self.kept.iter().rev().find(|(c, _)| *c == clique);
                again.map_or(&self.system.tree.clique(clique).numeric, |(_, numeric)| numeric)
            }
        };
        (self.structure(child), numeric)
    }

    fn children(&self, of: Child) -> SmallVec<[Child; 4]> {
        match of {
            Child::Node(n) => self.job.nodes[n].children.clone(),
            Child::Kept(clique) => {
                self.system.tree.clique(clique).children.iter().map(|&c| Child::Kept(c)).collect()
            }
        }
    }
}
