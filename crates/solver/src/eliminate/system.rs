//! What elimination reads.

use evergraph_model::{FactorIndex, Graph};

use super::job::{Node, NodeStructure};
use crate::dense::Instructions;
use crate::index::{CliqueIndex, PendingIndex};
use crate::linearization::{Blocks, Overlay};
use crate::pending::Pending;
use crate::settings::Elimination;
use crate::tree::{Numeric, Structure, Tree};

/// Below this ratio of a pivot to its diagonal entry of JᵀJ, Cholesky has lost too many digits and
/// the subtree is eliminated again by QR from factor rows.
pub(crate) const CHOLESKY_PIVOT: f64 = 1e-9;
/// Below this ratio a pivot of QR is zero: the variable is not determined. The ratio is a square:
/// QR finds R_jj to about 1e-15 of its column's norm, so a free direction shows as 1e-28 or so,
/// while sound ones go down to 2.7e-14 in a public graph (Intel, where one edge weighs 2.7e12).
pub(crate) const QR_PIVOT: f64 = 1e-22;
/// What two pivots of a subtree may lose together by Cholesky: ε/ρ beside ρ.
pub(crate) const CHOLESKY_PRODUCT: f64 = 1e-14;
/// Below this multiple of the error carried in its column, which stands for rounding in units of
/// 1.1e-16, `|R_jj|` of QR is zero.
pub(crate) const QR_ROUNDING: f64 = 1e-14;

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
    /// The relinearization that takes effect: [`Child::Pending`](super::Child::Pending) refers to it.
    pub(crate) pending: Option<&'a Pending>,
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
            pending: None,
            damping: None,
        }
    }

    /// A clique of the pending relinearization: its slot and its new numbers.
    pub(super) fn pending_clique(&self, place: PendingIndex) -> (CliqueIndex, &'a Numeric) {
        self.pending.expect("only jobs that take over a relinearization refer to it").clique(place)
    }

    /// `[J₁ … Jₖ | r]` of a factor, column-major.
    #[inline]
    pub(crate) fn block(&self, factor: FactorIndex) -> &'a [f64] {
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
