//! The size of a graph and of its factorization.

use evergraph_model::FactorId;
use evergraph_solver::Smoother;

use crate::nonzeros::information_nonzeros;

/// The size of a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct GraphSize {
    /// Variables.
    pub variables: usize,
    /// Factors; gauge priors are left out.
    pub factors: usize,
    /// Scalars of the upper triangle of the information matrix, by blocks.
    pub nonzeros: usize,
    /// Scalars of R.
    pub factor_nonzeros: usize,
}

impl GraphSize {
    /// The size of a smoother's graph; `priors` are the gauge priors, of which those that are gone do not
    /// count.
    pub fn of(smoother: &Smoother, priors: &[FactorId]) -> Self {
        let graph = smoother.graph();
        let priors = priors.iter().filter(|id| graph.check_factor(**id).is_ok()).count();
        Self {
            variables: graph.variable_count(),
            factors: graph.factor_count() - priors,
            nonzeros: information_nonzeros(graph),
            factor_nonzeros: smoother.size().nonzeros,
        }
    }
}
