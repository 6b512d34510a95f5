//! Connected groups among the nodes to remove.

use std::collections::BTreeSet;

use evergraph_model::VariableId;

use crate::overlay::Overlay;

/// Nodes that share factors with each other: the connected components among `nodes`, in the order in which the first
/// node of each was given.
pub(crate) fn groups(overlay: &Overlay<'_>, nodes: &[VariableId]) -> Vec<Vec<VariableId>> {
    let all: BTreeSet<VariableId> = nodes.iter().copied().collect();
    let mut seen = BTreeSet::new();
    let mut groups = Vec::new();
    for &start in nodes {
        if !seen.insert(start) {
            continue;
        }
        let mut group = vec![start];
        let mut next = 0;
        while let Some(&node) = group.get(next) {
            next += 1;
            for (_, factor) in overlay.factors_of(node) {
                for &key in factor.keys() {
                    if all.contains(&key) && seen.insert(key) {
                        group.push(key);
                    }
                }
            }
        }
        groups.push(group);
    }
    groups
}
