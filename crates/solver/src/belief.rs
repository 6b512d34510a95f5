//! A smoother as a source of estimates and covariances.

use evergraph_model::belief::{self, BeliefError, Covariance, LinearizedEstimate};
use evergraph_model::{GraphError, Value, VariableId};
use nalgebra::DMatrix;

use crate::covariance::Covariances;
use crate::error::SmootherError;
use crate::estimate_cache::Estimates;
use crate::smoother::Smoother;

/// Back-substitutes only what is asked for, which suits a few nodes of a large map. For many nodes
/// [`Smoother::estimates`] or [`Smoother::cached_estimates`] cost less, but have no linearization points.
impl belief::Estimates for Smoother {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self.estimate_value(variable).map_err(|error| of_graph(error, &[variable]))
    }

    fn estimates_of(&self, variables: &[VariableId]) -> Result<Vec<Value>, GraphError> {
        self.estimate_values(variables).map_err(|error| of_graph(error, variables))
    }

    fn linearized(
        &self,
        variables: &[VariableId],
    ) -> Result<Option<Vec<LinearizedEstimate>>, GraphError> {
        let deltas = self.deltas(variables).map_err(|error| of_graph(error, variables))?;
        let found = variables.iter().zip(deltas).map(|(&variable, delta)| {
            let point = self.linearization_point(variable);
            let point = point.map_err(|error| of_graph(error, &[variable]))?;
            Ok(LinearizedEstimate { point, delta })
        });
        found.collect::<Result<_, _>>().map(Some)
    }
}

/// Estimates fail by ids and by users' code only, which are both errors of the graph. For any other error the first
/// variable counts as without an estimate.
fn of_graph(error: SmootherError, variables: &[VariableId]) -> GraphError {
    match (error, variables.first()) {
        (SmootherError::Graph(error), _) => error,
        (_, Some(&variable)) => GraphError::UnknownVariable { variable },
        (error, None) => GraphError::Foreign { what: error.to_string() },
    }
}

impl belief::Estimates for Estimates<'_> {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        let value = self.value(variable).map_err(|error| of_graph(error, &[variable]))?;
        Ok(value.to_value())
    }
}

impl Covariance for Covariances<'_> {
    fn joint(&mut self, variables: &[VariableId]) -> Result<DMatrix<f64>, BeliefError> {
        Covariances::joint(self, variables).map_err(|error| match error {
            SmootherError::Graph(error) => error.into(),
            error => BeliefError::Source(Box::new(error)),
        })
    }
}
