//! The objective of a map: error and chi2 of its factors.

use evergraph_model::{FactorId, Graph, GraphError};

/// What a map costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Objective {
    /// `½ Σ ‖r‖²` over whitened residuals, after robust kernels `Σ ρ`.
    pub error: f64,
    /// `Σ ‖r‖²`, without kernels.
    pub chi2: f64,
}

impl Objective {
    /// Evaluates the factors that `include` names at `points`, which are laid out as
    /// [`Graph::value_range`] says.
    ///
    /// # Errors
    /// [`GraphError::FactorPanicked`].
    pub fn at(
        graph: &Graph,
        points: &[f64],
        mut include: impl FnMut(FactorId) -> bool,
    ) -> Result<Self, GraphError> {
        let mut sum = Self::default();
        let mut residual = Vec::new();
        for f in graph.factor_indices().filter(|&f| include(graph.factor_id(f))) {
            residual.clear();
            residual.resize(graph.rows_at(f), 0.0);
            graph.residual(f, points, &mut residual)?;
            sum.error += graph.factor_error(f, points)?;
            sum.chi2 += residual.iter().map(|r| r * r).sum::<f64>();
        }
        Ok(sum)
    }
}
