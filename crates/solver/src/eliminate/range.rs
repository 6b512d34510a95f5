//! Elimination of nodes one after the other, by Cholesky where possible.

use std::collections::BTreeMap;

use smallvec::SmallVec;
use tracing::debug;

use super::job::{Child, Failure, Job, NodeStructure};
use super::system::System;
use super::workspace::Workspace;
use super::{front, rows};
use crate::index::{CliqueIndex, NodeIndex};
use crate::settings::Elimination;
use crate::tree::{Numeric, Structure};

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
pub(super) struct Range<'a> {
    pub(super) system: &'a System<'a>,
    pub(super) job: &'a Job,
    /// The first node.
    pub(super) offset: usize,
    pub(super) nodes: &'a mut [Option<Numeric>],
    pub(super) kept: &'a mut BTreeMap<CliqueIndex, Numeric>,
}

impl<'a> Range<'a> {
    /// Eliminates the nodes that have no numbers yet.
    pub(super) fn eliminate(mut self, workspace: &mut Workspace) -> Result<(), Failure> {
        for i in 0..self.nodes.len() {
            if self.nodes[i].is_none() {
                let numeric = self.eliminate_node(NodeIndex::new(self.offset + i), workspace)?;
                // Anything else that is not finite reaches a pivot on the way up.
                let structure = self.structure(Child::Node(NodeIndex::new(self.offset + i)));
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
        node: NodeIndex,
        workspace: &mut Workspace,
    ) -> Result<Numeric, Failure> {
        if self.system.elimination == Elimination::Cholesky {
            let children = self.inputs(Child::Node(node));
            let structure = self.structure(Child::Node(node));
            if let NodeStructure::Prefix { clique, .. } = self.job.nodes[node.index()].structure {
                let whole = &self.system.tree.clique(clique).numeric;
                return Ok(front::prefix(self.system, structure, &children, whole, workspace));
            }
            if let Ok(numeric) = front::eliminate(self.system, structure, &children, workspace) {
                return Ok(numeric);
            }
            debug!(
                first = structure.frontals[0].index(),
                "pivot too small for Cholesky, QR from rows"
            );
        }
        self.eliminate_by_rows(node, workspace)
    }

    /// Eliminates a node by QR. Children whose contribution is an information matrix are
    /// eliminated by QR first, from their own factor rows: in their Schur complements the digits
    /// are gone.
    fn eliminate_by_rows(
        &mut self,
        node: NodeIndex,
        workspace: &mut Workspace,
    ) -> Result<Numeric, Failure> {
        // What has to be eliminated again, parents before children; done in reverse.
        let mut pending: SmallVec<[Child; 8]> = SmallVec::from_slice(&[Child::Node(node)]);
        let mut next = 0;
        while next < pending.len() {
            let children = self.children(pending[next]).into_iter();
            let children = children.filter(|&child| !self.numeric(child).form.is_root());
            for child in children {
                // Pending results are those of Cholesky: the update is done again without them.
                if let Child::Pending(_) = child {
                    return Err(Failure::Pending);
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
                Child::Node(n) if n == node => return Ok(numeric),
                Child::Node(n) => self.nodes[n.index() - self.offset] = Some(numeric),
                Child::Kept(clique) => {
                    self.kept.insert(clique, numeric);
                }
                Child::Pending(_) => unreachable!("not among the pending"),
            }
        }
    }

    fn children(&self, of: Child) -> SmallVec<[Child; 4]> {
        match of {
            Child::Node(n) => self.job.nodes[n.index()].children.clone(),
            Child::Kept(clique) => {
                self.system.tree.clique(clique).children.iter().map(|&c| Child::Kept(c)).collect()
            }
            Child::Pending(_) => SmallVec::new(),
        }
    }

    fn structure(&self, of: Child) -> &'a Structure {
        match of {
            Child::Node(n) => self.system.structure(&self.job.nodes[n.index()]),
            Child::Kept(clique) => &self.system.tree.clique(clique).structure,
            Child::Pending(place) => {
                &self.system.tree.clique(self.system.pending_clique(place).0).structure
            }
        }
    }

    fn numeric(&self, of: Child) -> &Numeric {
        match of {
            Child::Node(n) => self.nodes[n.index() - self.offset]
                .as_ref()
                .expect("postorder: children come first"),
            Child::Kept(clique) => {
                self.kept.get(&clique).unwrap_or(&self.system.tree.clique(clique).numeric)
            }
            Child::Pending(place) => self.system.pending_clique(place).1,
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
