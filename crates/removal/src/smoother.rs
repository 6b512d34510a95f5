//! Estimates and covariances straight from a smoother.

use evergraph_model::{GraphError, Value, VariableId};
use evergraph_solver::{Covariances, Smoother};
use nalgebra::DMatrix;

use crate::overlay::{Estimates, Linearized};
use crate::price::Covariance;

/// Back-substituted for what is asked only: right for a few nodes of a large map. For many nodes
/// [`Smoother::estimates`] or [`Smoother::kept_estimates`] cost less, but know no linearization points:
/// right after [`Smoother::optimize`] these are the estimates, at other times a plan from such a source is off
/// by what bends between the two.
impl Estimates for Smoother {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self.graph().check_variable(variable)?;
        self.estimate_value(variable).map_err(|_| GraphError::UnknownVariable { variable })
    }

    fn estimates_of(&self, variables: &[VariableId]) -> Result<Vec<Value>, GraphError> {
        self.estimate_values(variables)
    }

    fn linearized(&self, variables: &[VariableId]) -> Result<Option<Vec<Linearized>>, GraphError> {
        let deltas = self.deltas(variables)?;
        let found = variables.iter().zip(deltas).map(|(&variable, delta)| {
            let point = self.linearization_point(variable);
            let point = point.map_err(|_| GraphError::UnknownVariable { variable })?;
            Ok(Linearized { point, delta })
        });
        found.collect::<Result<_, _>>().map(Some)
    }
}

impl Estimates for evergraph_solver::Estimates<'_> {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self.value(variable).map(|value| value.to_value())
    }
}

impl Covariance for Covariances<'_> {
    fn joint(&mut self, variables: &[VariableId]) -> Result<DMatrix<f64>, String> {
        Covariances::joint(self, variables).map_err(|error| error.to_string())
    }
}
