//! One factor evaluated at values of the caller's choice, in a graph or not.

use nalgebra::{DMatrixView, DVectorView};
use smallvec::SmallVec;
use thiserror::Error;

use crate::arguments::{Arguments, Linearization};
use crate::factor::Factor;
use crate::key::VariableId;
use crate::user_code::{self, name_of};
use crate::value::ValueRef;

/// A factor that cannot be evaluated at some values.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// More or fewer values than the factor has variables.
    #[error(
        "factor {name} on {variables:?} was given {actual} values; give one for each of its variables, in their order"
    )]
    Count {
        /// The factor's type.
        name: String,
        /// Its variables.
        variables: Vec<VariableId>,
        /// Number of values.
        actual: usize,
    },
    /// A value of a type or dimension that the factor does not take.
    #[error(
        "factor {name} does not take a {kind} of dimension {dim} as its variable number {position} ({variable})"
    )]
    NotAccepted {
        /// The factor's type.
        name: String,
        /// The variable.
        variable: VariableId,
        /// Its place among the factor's keys, from 0.
        position: usize,
        /// Type of the value.
        kind: &'static str,
        /// Its tangent dimension.
        dim: usize,
    },
    /// A panic in the factor's own code.
    #[error(
        "factor {name} on {variables:?} panicked: {message}; correct its `residual`, `error` or `linearize`"
    )]
    Panicked {
        /// The factor's type.
        name: String,
        /// Its variables.
        variables: Vec<VariableId>,
        /// Message of the panic.
        message: String,
    },
}

/// A factor linearized: whitened residual, Jacobian and its term of the objective.
///
/// Its buffers can be used again for another factor ([`set`](Self::set)).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinearizedFactor {
    residual: SmallVec<[f64; 8]>,
    /// First column of each Jacobian block, then of the residual.
    columns: SmallVec<[u32; 5]>,
    /// `[J₁ … Jₖ | r]`, column-major.
    data: Vec<f64>,
    error: f64,
}

/// Linearizes `factor` at `values`, one for each of its variables in the order of its keys. Neither has to be part of a
/// graph.
///
/// The factor's type, the number of values and their types are checked, and a panic in the factor's code is returned as
/// an error. Numbers are not checked: they may be NaN or infinite.
///
/// # Errors
/// [`EvaluationError`].
pub fn linearize_at(
    factor: &dyn Factor,
    values: &[ValueRef<'_>],
) -> Result<LinearizedFactor, EvaluationError> {
    let mut linearized = LinearizedFactor::default();
    linearized.set(factor, values)?;
    Ok(linearized)
}

impl LinearizedFactor {
    /// [`linearize_at`], in the buffers of this one. After an error its content is unspecified.
    ///
    /// # Errors
    /// [`EvaluationError`].
    pub fn set(
        &mut self,
        factor: &dyn Factor,
        values: &[ValueRef<'_>],
    ) -> Result<(), EvaluationError> {
        check(factor, values)?;
        let rows = factor.residual_dim();
        let mut width = 0;
        self.columns.clear();
        self.columns.push(0);
        for value in values {
            width += value.dim();
            self.columns.push(width as u32);
        }
        self.residual.clear();
        self.residual.resize(rows, 0.0);
        self.data.clear();
        self.data.resize(rows * (width + 1), 0.0);
        let storages: SmallVec<[&[f64]; 4]> = values.iter().map(ValueRef::storage).collect();
        let at = Arguments::new(&storages);
        // The next call overwrites the buffers that a panic leaves half written.
        user_code::call(|| {
            factor.residual(&at, &mut self.residual);
            self.error = factor.error(&self.residual);
            factor.linearize(&at, &mut Linearization::new(rows, &self.columns, &mut self.data));
        })
        .map_err(|message| EvaluationError::Panicked {
            name: name_of(factor),
            variables: factor.keys().to_vec(),
            message,
        })
    }

    /// Rows of the residual.
    pub fn rows(&self) -> usize {
        self.residual.len()
    }

    /// The whitened residual as [`Factor::residual`] wrote it, without the weight of a robust kernel.
    pub fn unweighted_residual(&self) -> &[f64] {
        &self.residual
    }

    /// The factor's term of the objective ([`Factor::error`]).
    pub fn error(&self) -> f64 {
        self.error
    }

    /// The whitened Jacobian of the variable at `position`, scaled by a robust kernel: `rows × dim`.
    ///
    /// # Panics
    /// When the factor has no such variable.
    pub fn jacobian(&self, position: usize) -> DMatrixView<'_, f64> {
        let (from, to) = (self.columns[position] as usize, self.columns[position + 1] as usize);
        let rows = self.rows();
        DMatrixView::from_slice(&self.data[from * rows..to * rows], rows, to - from)
    }

    /// The whitened residual as [`Factor::linearize`] wrote it, scaled by a robust kernel.
    pub fn residual(&self) -> DVectorView<'_, f64> {
        DVectorView::from_slice(&self.data[self.data.len() - self.rows()..], self.rows())
    }

    /// `[J₁ … Jₖ | r]`, column-major with [`rows`](Self::rows) rows.
    pub fn data(&self) -> &[f64] {
        &self.data
    }

    /// [`data`](Self::data), taken out.
    pub fn into_data(self) -> Vec<f64> {
        self.data
    }

    /// First column of each variable's block in [`data`](Self::data), then of the residual.
    pub fn columns(&self) -> &[u32] {
        &self.columns
    }
}

fn check(factor: &dyn Factor, values: &[ValueRef<'_>]) -> Result<(), EvaluationError> {
    let keys = factor.keys();
    if keys.len() != values.len() {
        return Err(EvaluationError::Count {
            name: factor.name(),
            variables: keys.to_vec(),
            actual: values.len(),
        });
    }
    for (position, (value, &variable)) in values.iter().zip(keys).enumerate() {
        if !factor.accepts(position, value.kind(), value.dim()) {
            return Err(EvaluationError::NotAccepted {
                name: factor.name(),
                variable,
                position,
                kind: value.kind().name(),
                dim: value.dim(),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::any::Any;

    use super::*;
    use crate::{Graph, Point2, Rot2, Value, VariableType};

    /// `(x, y) · w` of a point, and what its code does wrong.
    #[derive(Debug)]
    struct Weighted {
        keys: [VariableId; 1],
        rows: usize,
        panics: bool,
    }

    impl Factor for Weighted {
        fn name(&self) -> String {
            "Weighted".into()
        }
        fn keys(&self) -> &[VariableId] {
            &self.keys
        }
        fn residual_dim(&self) -> usize {
            self.rows
        }
        fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
            kind.is::<Point2>()
        }
        fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
            assert!(!self.panics, "no weight for {}", self.keys[0]);
            out.copy_from_slice(&[2.0 * at.storage(0)[0], 2.0 * at.storage(0)[1]]);
        }
        fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
            out.block_mut(0).copy_from_slice(&[2.0, 0.0, 0.0, 2.0]);
            self.residual(at, out.residual_mut());
        }
        fn as_any(&self) -> &dyn Any {
            self
        }
    }

    fn weighted(rows: usize, panics: bool) -> Weighted {
        let key = Graph::new().change().add_value(Value::new(&Point2::new(0.0, 0.0)));
        Weighted { keys: [key], rows, panics }
    }

    #[test]
    fn a_factor_off_the_graph_is_linearized() {
        let point = Value::new(&Point2::new(1.0, -3.0));
        let found = linearize_at(&weighted(2, false), &[point.as_ref()]).unwrap();
        assert_eq!(found.rows(), 2);
        assert_eq!(found.unweighted_residual(), [2.0, -6.0]);
        assert_eq!(found.residual().as_slice(), [2.0, -6.0]);
        assert_eq!(found.jacobian(0), nalgebra::DMatrix::from_diagonal_element(2, 2, 2.0));
        assert_eq!(found.error(), 20.0);
        assert_eq!((found.columns(), found.data().len()), (&[0, 2][..], 6));
    }

    /// And the buffers are good for the next one.
    #[test]
    fn errors_name_the_factor() {
        let (point, turn) =
            (Value::new(&Point2::new(1.0, 2.0)), Value::new(&Rot2::from_angle(0.1)));
        let mut found = LinearizedFactor::default();
        let error = found.set(&weighted(2, true), &[point.as_ref()]).unwrap_err();
        let EvaluationError::Panicked { name, message, .. } = &error else { panic!("{error}") };
        assert_eq!((&**name, &**message), ("Weighted", "no weight for x0"));
        // Three rows where its code writes two.
        let error = found.set(&weighted(3, false), &[point.as_ref()]).unwrap_err();
        assert!(matches!(error, EvaluationError::Panicked { .. }), "{error}");
        let error = found.set(&weighted(2, false), &[turn.as_ref()]).unwrap_err();
        assert!(matches!(error, EvaluationError::NotAccepted { kind: "Rot2", .. }), "{error}");
        let error = found.set(&weighted(2, false), &[]).unwrap_err();
        assert!(matches!(error, EvaluationError::Count { actual: 0, .. }), "{error}");
        found.set(&weighted(2, false), &[point.as_ref()]).unwrap();
        assert_eq!(found.error(), 10.0);
    }
}
