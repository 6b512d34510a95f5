//! Elimination of the cliques of a pending relinearization, a slice at a time.

use smallvec::SmallVec;

use super::range::eliminate_one;
use super::system::System;
use super::workspace::Workspace;
use crate::pending::Pending;
use crate::tree::{Numeric, Structure};

/// Eliminates cliques with the pending Jacobians until `budget`, in units of about a nanosecond, is
/// spent or none are left.
pub(crate) fn eliminate_pending(
    system: &System<'_>,
    pending: &mut Pending,
    mut budget: f64,
    workspace: &mut Workspace,
) {
    while budget > 0.0 && !pending.is_ready() {
        budget -= eliminate_next(system, pending, workspace);
    }
}

/// Eliminates the next clique. Returns the cost.
fn eliminate_next(system: &System<'_>, pending: &mut Pending, workspace: &mut Workspace) -> f64 {
    let tree = system.tree;
    let (place, clique) = pending.next_clique(tree);
    // Roots are hardly ever the same when the relinearization takes effect.
    let Some(clique) = clique.map(|index| tree.clique(index)).filter(|c| c.parent.some().is_some())
    else {
        return 0.0;
    };
    let children: SmallVec<[(&Structure, &Numeric); 4]> = clique
        .children
        .iter()
        .map(|&child| {
            let live = tree.clique(child);
            (&live.structure, pending.numeric_of(tree, child).unwrap_or(&live.numeric))
        })
        .collect();
    let system = System { overlay: Some(pending.overlay()), ..*system };
    let numeric = eliminate_one(&system, &clique.structure, &children, workspace);
    drop(children);
    pending.set_numeric(place, numeric);
    clique.structure.cost()
}
