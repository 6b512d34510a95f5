//! How full an information matrix is.

use std::collections::BTreeSet;

use evergraph_model::{Graph, VariableIndex};

/// Scalars in the nonzero blocks of the upper triangle of `Λ = JᵀJ`, the diagonal blocks' own upper
/// triangles included: a block for each variable and for each two that share a factor. What the GLC
/// paper draws as sparsity; it counts the graph, where the nonzeros of R count an order of elimination
/// too. Fixed variables are no part of it.
pub fn information_nonzeros(graph: &Graph) -> usize {
    let mut blocks = BTreeSet::new();
    for f in graph.factor_indices() {
        let variables = graph.unknowns_at(f);
        for (at, &a) in variables.iter().enumerate() {
            blocks.extend(variables[at + 1..].iter().map(|&b| (a.min(b), a.max(b))));
        }
    }
    let dim = |v: VariableIndex| graph.dim_at(v);
    let own = |n: usize| n * (n + 1) / 2;
    graph.unknown_indices().map(|v| own(graph.dim_at(v))).sum::<usize>()
        + blocks.into_iter().map(|(a, b)| dim(a) * dim(b)).sum::<usize>()
}
