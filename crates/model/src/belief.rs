//! Estimates and covariances, as read by those who do not solve.
//!
//! A solver implements [`Estimates`] and [`Covariance`]; removal and other readers take them as trait objects. Closures
//! and [`Values`] implement them too.

use nalgebra::DMatrix;
use thiserror::Error;

use crate::error::GraphError;
use crate::key::VariableId;
use crate::value::Value;
use crate::values::Values;

/// A source of estimates.
///
/// Implemented by solvers, by [`Values`], and by closures `Fn(VariableId) -> Result<Value, GraphError>`.
pub trait Estimates {
    /// The estimate of a variable.
    ///
    /// # Errors
    /// [`GraphError`] when the variable has no estimate here.
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError>;

    /// The estimates of some variables, in the order given. Sources that can share work between variables override it.
    ///
    /// # Errors
    /// [`GraphError`] when one of the variables has no estimate here.
    fn estimates_of(&self, variables: &[VariableId]) -> Result<Vec<Value>, GraphError> {
        variables.iter().map(|&variable| self.estimate(variable)).collect()
    }

    /// The estimates of some variables, in the order given, as steps from their linearization points. `None`, the
    /// default, for a source without linearization points.
    ///
    /// # Errors
    /// [`GraphError`] when one of the variables has no estimate here.
    fn linearized(
        &self,
        variables: &[VariableId],
    ) -> Result<Option<Vec<LinearizedEstimate>>, GraphError> {
        let _ = variables;
        Ok(None)
    }
}

/// An estimate `retract(point, delta)`, as a step from the linearization point of its variable.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearizedEstimate {
    /// The linearization point: the value at which the variable's factors are linearized.
    pub point: Value,
    /// The step δ, one entry per tangent component at the point, in metres, radians or units of the type's own.
    pub delta: Vec<f64>,
}

impl Estimates for Values {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self.value(variable).map(|value| value.to_value())
    }
}

impl<F: Fn(VariableId) -> Result<Value, GraphError>> Estimates for F {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self(variable)
    }
}

/// A source of joint covariances of the whole graph at its linearization point.
///
/// Implemented by solvers, and by closures `FnMut(&[VariableId]) -> Result<DMatrix<f64>, E>` whose error is an
/// [`Error`](std::error::Error), a `String` or a `&str`.
pub trait Covariance {
    /// The joint marginal covariance of `variables`: a symmetric positive definite matrix of as many rows and columns as
    /// the variables have tangent dimensions together. Blocks are in the order given, each in the order of its tangent.
    ///
    /// # Errors
    /// [`BeliefError`] when it cannot be had.
    fn joint(&mut self, variables: &[VariableId]) -> Result<DMatrix<f64>, BeliefError>;
}

impl<F, E> Covariance for F
where
    F: FnMut(&[VariableId]) -> Result<DMatrix<f64>, E>,
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    fn joint(&mut self, variables: &[VariableId]) -> Result<DMatrix<f64>, BeliefError> {
        self(variables).map_err(|error| BeliefError::Source(error.into()))
    }
}

/// A covariance that cannot be had, or that is none.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BeliefError {
    /// An id that is stale or foreign.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// A matrix of the wrong shape.
    #[error("it is {rows} by {columns} where {expected} by {expected} is needed")]
    Shape {
        /// Rows of the matrix.
        rows: usize,
        /// Columns of the matrix.
        columns: usize,
        /// Tangent dimensions of the variables together.
        expected: usize,
    },
    /// A matrix with a NaN or an infinity.
    #[error("it has entries that are not finite")]
    NotFinite,
    /// A matrix that is not positive definite, or too large for the numbers that are derived from it.
    #[error("it is not positive definite, or too large")]
    NotPositiveDefinite,
    /// An error of the source itself.
    #[error(transparent)]
    Source(Box<dyn std::error::Error + Send + Sync>),
}

/// The joint covariance of `variables` from `source`, with its shape and numbers checked; `dim` is the sum of their
/// tangent dimensions.
///
/// # Errors
/// [`BeliefError`]: that of the source, [`BeliefError::Shape`] or [`BeliefError::NotFinite`].
pub fn checked_joint(
    source: &mut dyn Covariance,
    variables: &[VariableId],
    dim: usize,
) -> Result<DMatrix<f64>, BeliefError> {
    let sigma = source.joint(variables)?;
    if sigma.shape() != (dim, dim) {
        let (rows, columns) = sigma.shape();
        return Err(BeliefError::Shape { rows, columns, expected: dim });
    }
    if sigma.iter().any(|x| !x.is_finite()) {
        return Err(BeliefError::NotFinite);
    }
    Ok(sigma)
}
