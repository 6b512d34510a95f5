//! A full graph and a reduced one, factorized for comparison.

use evergraph_model::VariableId;
use evergraph_solver::{Relinearization, Settings};

use crate::factorized::Factorized;
use crate::pairs::Pairs;
use crate::solved::{DivergenceError, Solved};

/// A full graph and a reduced one at the full graph's optimum, both factorized. [`divergence`](Self::divergence) and
/// [`consistency`](Self::consistency) compare them.
#[derive(Debug)]
pub struct Comparison<'a> {
    pub(crate) pairs: Pairs<'a>,
    pub(crate) settings: Settings,
    /// The full graph.
    pub(crate) all: Factorized,
    /// The reduced graph.
    pub(crate) here: Factorized,
}

impl<'a> Comparison<'a> {
    /// `full` and `reduced` are at their optima; `kept` pairs variables of the full graph with those of the reduced graph,
    /// all of which are named. `settings` are for the factorization.
    ///
    /// Costs two sparse factorizations.
    ///
    /// # Errors
    /// [`DivergenceError`].
    pub fn new(
        full: Solved<'a>,
        reduced: Solved<'a>,
        kept: &[(VariableId, VariableId)],
        settings: &Settings,
    ) -> Result<Self, DivergenceError> {
        // Points have to stay at the optimum.
        let settings = settings.with_relinearization(Relinearization::NEVER);
        let pairs = Pairs::new(full, reduced, kept)?;
        let all = Factorized::of(full.graph, full.estimates, |_| true, &settings)
            .map_err(DivergenceError::Full)?;
        let here = Factorized::of(reduced.graph, &pairs.points(), |_| true, &settings)
            .map_err(DivergenceError::Reduced)?;
        Ok(Self { pairs, settings, all, here })
    }
}
