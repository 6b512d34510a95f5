//! A variable of a neighborhood.

use evergraph_model::{Value, VariableId};
use nalgebra::DVector;

/// A variable, and the point at which a removal linearizes its factors.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    pub(crate) id: VariableId,
    /// The linearization point of the removal.
    pub(crate) value: Value,
    /// The step from there to the estimate.
    pub(crate) delta: DVector<f64>,
}

impl Member {
    /// Linearized at its estimate.
    pub(crate) fn at(id: VariableId, value: Value) -> Self {
        let delta = DVector::zeros(value.dim());
        Self { id, value, delta }
    }

    /// The estimate's stored numbers.
    pub(crate) fn estimate(&self) -> Vec<f64> {
        let mut estimate = self.value.storage().to_vec();
        if self.is_off() {
            self.value.kind().retract(self.value.storage(), self.delta.as_slice(), &mut estimate);
        }
        estimate
    }

    /// Whether the linearization point is not the estimate.
    pub(crate) fn is_off(&self) -> bool {
        self.delta.iter().any(|&x| x != 0.0)
    }
}
