//! The objective of a map: error and chi2 of its factors.

use evergraph_model::{Arguments, FactorId, Graph};

/// What a map costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Objective {
    /// `½ Σ ‖r‖²` over whitened residuals, after robust kernels `Σ ρ`.
    pub error: f64,
    /// `Σ ‖r‖²`, without kernels.
    pub chi2: f64,
}

impl Objective {
    /// Evaluates the factors that `include` names at `points`, which are laid out as
    /// [`Graph::value_range`] says.
    pub fn at(graph: &Graph, points: &[f64], mut include: impl FnMut(FactorId) -> bool) -> Self {
        let mut sum = Self::default();
        let mut residual = Vec::new();
        for f in graph.factor_indices().filter(|&f| include(graph.factor_id(f))) {
            let factor = graph.factor_at(f);
            residual.clear();
            residual.resize(graph.rows_at(f), 0.0);
            with_arguments(graph, f, points, |at| factor.residual(at, &mut residual));
            sum.error += factor.error(&residual);
            sum.chi2 += squared_norm(&residual);
        }
        sum
    }
}

fn squared_norm(residual: &[f64]) -> f64 {
    residual.iter().map(|r| r * r).sum()
}

fn with_arguments(
    graph: &Graph,
    factor: usize,
    points: &[f64],
    evaluate: impl FnOnce(&Arguments<'_>),
) {
    let storages: Vec<&[f64]> = graph
        .variables_at(factor)
        .iter()
        .map(|&v| &points[graph.value_range(v as usize)])
        .collect();
    evaluate(&Arguments::new(&storages));
}
