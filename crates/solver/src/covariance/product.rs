//! The covariance times a vector.

use super::Covariances;
use crate::factorization::Factorization;

impl Covariances<'_> {
    /// `Σ b`, the covariance of all variables times a vector: the solution of `JᵀJ x = b`. Both vectors hold the tangents
    /// of all variables, at [`Graph::tangent_range`](evergraph_model::Graph::tangent_range) of each; entries of fixed
    /// variables are ignored, and zero in the result. O(nonzeros of R).
    ///
    /// `None` when `b` is not as long as [`Graph::tangent_len`](evergraph_model::Graph::tangent_len).
    #[must_use]
    pub fn times(&self, b: &[f64]) -> Option<Vec<f64>> {
        let factorization = &self.smoother.factorization;
        let Factorization { graph, tree, .. } = factorization;
        if b.len() != graph.tangent_len() {
            return None;
        }
        let mut x = b.to_vec();
        for index in graph.variable_indices().filter(|&index| graph.is_fixed_at(index)) {
            x[graph.tangent_range(index)].fill(0.0);
        }
        let top_down = tree.top_down();
        let mut scalars = Vec::new();
        // R^T y = b from the leaves to the roots, then R x = y back.
        for &clique in top_down.iter().rev() {
            let clique = tree.clique(clique);
            scalars.clear();
            scalars.extend(clique.structure.variables().flat_map(|v| graph.tangent_range(v)));
            for j in 0..clique.numeric.layout.frontal() {
                let row = clique.numeric.row(j);
                let y = x[scalars[j]] / row[0];
                x[scalars[j]] = y;
                scalars[j + 1..].iter().zip(&row[1..]).for_each(|(&k, r)| x[k] -= r * y);
            }
        }
        for &clique in &top_down {
            let clique = tree.clique(clique);
            scalars.clear();
            scalars.extend(clique.structure.variables().flat_map(|v| graph.tangent_range(v)));
            for j in (0..clique.numeric.layout.frontal()).rev() {
                let row = clique.numeric.row(j);
                let known: f64 =
                    scalars[j + 1..].iter().zip(&row[1..]).map(|(&k, r)| r * x[k]).sum();
                x[scalars[j]] = (x[scalars[j]] - known) / row[0];
            }
        }
        Some(x)
    }
}
