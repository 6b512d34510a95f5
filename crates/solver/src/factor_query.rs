//! Single factors at the estimate.

use evergraph_model::{FactorId, FactorIndex};
use nalgebra::{DMatrix, DVector};

use crate::error::SmootherError;
use crate::smoother::Smoother;

/// A factor linearized at the estimate, whitened, with the weight of its robust kernel applied.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FactorLinearization {
    /// A block for each variable of the factor that is not fixed, in the order of its keys: `rows ×
    /// dim`, with respect to right perturbations, each in the order of its tangent (translation
    /// first, m and rad).
    pub jacobians: Vec<DMatrix<f64>>,
    /// The residual, scaled by the square root of the [weight](Smoother::weight_of).
    pub residual: DVector<f64>,
}

/// Questions about one factor cost the cliques between its variables and their root.
impl Smoother {
    /// The whitened residual of a factor at the estimate, without the weight of a robust kernel.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign, and when the code of the
    /// factor or a variable's type fails.
    pub fn residual_of(&self, factor: FactorId) -> Result<DVector<f64>, SmootherError> {
        let index = self.graph().factor_index(factor)?;
        self.residual_at(index, &self.values_of(index)?)
    }

    /// A factor's term of the objective at the estimate: `½ ‖r‖²`, or `ρ` under a robust kernel.
    ///
    /// # Errors
    /// As [`residual_of`](Self::residual_of).
    pub fn error_of_factor(&self, factor: FactorId) -> Result<f64, SmootherError> {
        let index = self.graph().factor_index(factor)?;
        Ok(self.graph().factor_error(index, &self.values_of(index)?)?)
    }

    /// The linearization of a factor at the estimate: anew, not the one at the linearization points
    /// that the factorization uses.
    ///
    /// # Errors
    /// As [`residual_of`](Self::residual_of).
    pub fn linearization_of(&self, factor: FactorId) -> Result<FactorLinearization, SmootherError> {
        let index = self.graph().factor_index(factor)?;
        self.linearization_at(index, &self.values_of(index)?)
    }

    /// The factor on the information of a measurement in iteratively reweighted least squares,
    /// `2 ρ'(‖r‖²)` at the estimate: between 0 and 1 under a robust kernel, 1 without.
    ///
    /// # Errors
    /// As [`residual_of`](Self::residual_of).
    pub fn weight_of(&self, factor: FactorId) -> Result<f64, SmootherError> {
        let index = self.graph().factor_index(factor)?;
        let values = self.values_of(index)?;
        let plain = self.residual_at(index, &values)?.norm_squared();
        let weighted = self.linearization_at(index, &values)?.residual.norm_squared();
        // Every kernel trusts small residuals.
        let is_tiny = plain < f64::MIN_POSITIVE;
        let is_rounding = (weighted - plain).abs() <= 8.0 * f64::EPSILON * plain;
        Ok(if is_tiny || is_rounding { 1.0 } else { weighted / plain })
    }

    fn residual_at(
        &self,
        factor: FactorIndex,
        values: &[f64],
    ) -> Result<DVector<f64>, SmootherError> {
        let mut residual = DVector::zeros(self.graph().rows_at(factor));
        self.graph().residual(factor, values, residual.as_mut_slice())?;
        Ok(residual)
    }

    fn linearization_at(
        &self,
        factor: FactorIndex,
        values: &[f64],
    ) -> Result<FactorLinearization, SmootherError> {
        let graph = self.graph();
        let rows = graph.rows_at(factor);
        let mut block = vec![0.0; graph.linearization_len(factor)];
        graph.linearize(factor, values, &mut block)?;
        let mut rest = block.as_slice();
        let mut jacobians = Vec::new();
        for &v in graph.unknowns_at(factor) {
            let (own, others) = rest.split_at(rows * graph.dim_at(v));
            jacobians.push(DMatrix::from_column_slice(rows, graph.dim_at(v), own));
            rest = others;
        }
        Ok(FactorLinearization { jacobians, residual: DVector::from_column_slice(rest) })
    }

    /// An array laid out as the linearization points, with the estimates of the factor's variables.
    fn values_of(&self, factor: FactorIndex) -> Result<Vec<f64>, SmootherError> {
        let graph = self.graph();
        let variables = graph.variables_at(factor);
        let deltas = self.factorization.deltas(self.engine.instructions, variables);
        // Zeroed memory comes from the system untouched: this does not cost what the map holds.
        let mut values = vec![0.0; graph.value_len()];
        for (&v, delta) in variables.iter().zip(&deltas) {
            self.factorization.moved(v, delta, &mut values[graph.value_range(v)])?;
        }
        Ok(values)
    }
}
