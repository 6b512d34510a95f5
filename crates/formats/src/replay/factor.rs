//! From an observation and its variables to a factor.

use std::sync::Arc;

use evergraph_factors::Linear;
use evergraph_factors::catalogue::CatalogueError;
use evergraph_model::{Factor, Robust, VariableId};

use super::geometry::Handle;
use super::observation::{Constraint, Observation, Observed};
use crate::coordinates::Kind;
use crate::factor_data::{Reading, catalogue, relative_data};

/// The factor, or why there is none.
type Made = Result<Arc<dyn Factor>, String>;

impl Observation {
    /// The factor on variables of its ends, under its kernel.
    pub fn factor(&self, ends: &[Handle]) -> Made {
        let kernel = self.kernel;
        let ids: Vec<(VariableId, Kind)> = ends.iter().map(|end| (end.id(), end.kind())).collect();
        let data = match &self.what {
            Observed::Relative { measurement, sensor, noise } => {
                relative_data(&measurement.value(), sensor.as_ref(), noise, kernel, &ids)
            }
            Observed::Quantity { quantity, numbers, sensor, noise } => {
                let (quantity, sensor) = (*quantity, sensor.as_ref());
                Reading { quantity, numbers, sensor, noise, kernel }.data(&ids)
            }
            Observed::Linear(constraint) => return self.linear(constraint, &ids),
        };
        let data = data.map_err(|error| error.to_string())?;
        catalogue().to_factor(&data).map_err(|error| match error {
            CatalogueError::InvalidFactor { source, .. } => source.to_string(),
            other => other.to_string(),
        })
    }

    fn linear(&self, constraint: &Constraint, ends: &[(VariableId, Kind)]) -> Made {
        let variables: Vec<_> = ends.iter().map(|(id, _)| *id).zip(constraint.points()).collect();
        let (g, offset) = (constraint.sqrt_information.clone(), constraint.offset.clone());
        let linear = Linear::new(&variables, constraint.root_shift, g, offset)
            .map_err(|error| error.to_string())?;
        Ok(match self.kernel {
            Some(kernel) => Arc::new(Robust::new(linear, kernel)),
            None => Arc::new(linear),
        })
    }
}
