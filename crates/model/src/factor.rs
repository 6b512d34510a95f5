//! The contract of a measurement.

use std::any::Any;
use std::fmt::Debug;

use crate::arguments::{Arguments, Linearization};
use crate::key::VariableId;
use crate::manifold::VariableType;

/// A term `½ ‖r(x₁ … xₖ)‖²` of the objective, `r` whitened.
///
/// Implement it for measurements of your own, and check the derivative with
/// [`crate::testing::check_jacobian`], one line.
pub trait Factor: Debug + Any + Send + Sync {
    /// The type's name in messages, for example `"Between<Pose2>"`.
    fn name(&self) -> String;

    /// The variables, each once; positions elsewhere refer to this order.
    fn keys(&self) -> &[VariableId];

    /// Rows of the residual.
    fn residual_dim(&self) -> usize;

    /// Whether the variable at `position` may be of this manifold and dimension. Asked once, when
    /// the factor enters a graph; after that [`Arguments`] hold what was accepted.
    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool;

    /// Writes the whitened residual; `out` has [`residual_dim`](Self::residual_dim) entries.
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]);

    /// Writes the whitened Jacobian blocks with respect to right perturbations, and the residual.
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>);

    /// The factor's term of the objective; `residual` is the whitened residual at the same point.
    /// `½ ‖r‖²` unless a robust kernel says otherwise.
    fn error(&self, residual: &[f64]) -> f64 {
        0.5 * residual.iter().map(|r| r * r).sum::<f64>()
    }

    /// For downcasting, so that writers and removal can recognize a factor.
    fn as_any(&self) -> &dyn Any;
}

impl<F: Factor + ?Sized> Factor for std::sync::Arc<F> {
    fn name(&self) -> String {
        (**self).name()
    }
    fn keys(&self) -> &[VariableId] {
        (**self).keys()
    }
    fn residual_dim(&self) -> usize {
        (**self).residual_dim()
    }
    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        (**self).accepts(position, kind, dim)
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        (**self).residual(at, out);
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        (**self).linearize(at, out);
    }
    fn error(&self, residual: &[f64]) -> f64 {
        (**self).error(residual)
    }
    fn as_any(&self) -> &dyn Any {
        (**self).as_any()
    }
}
