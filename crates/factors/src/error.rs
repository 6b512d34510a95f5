//! What can be wrong with a measurement before it meets a graph.

use evergraph_model::{Manifold, Noise};
use nalgebra::SMatrix;
use smallvec::SmallVec;
use thiserror::Error;

/// Why numbers do not make a factor.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FactorError {
    /// The noise has another dimension than the residual.
    #[error("the residual of {factor} has dimension {expected}, but its noise has {actual}")]
    NoiseDimension {
        /// The factor's name.
        factor: &'static str,
        /// Rows of the residual.
        expected: usize,
        /// Dimension of the noise given.
        actual: usize,
    },
    /// A NaN or an infinity.
    #[error("the {what} of {factor} must be finite, got {numbers:?}")]
    NotFinite {
        /// The factor's name.
        factor: &'static str,
        /// Which of its numbers.
        what: &'static str,
        /// The numbers given.
        numbers: Vec<f64>,
    },
    /// A direction without length.
    #[error("the {what} of {factor} is {numbers:?}, which has no length and so points nowhere")]
    NoDirection {
        /// The factor's name.
        factor: &'static str,
        /// Which direction.
        what: &'static str,
        /// The numbers given.
        numbers: Vec<f64>,
    },
    /// A distance below zero.
    #[error("the range of {factor} is {range}; a distance cannot be negative")]
    NegativeRange {
        /// The factor's name.
        factor: &'static str,
        /// The range given.
        range: f64,
    },
    /// Selected components that are not a subset of the tangent's.
    #[error(
        "{factor} cannot measure components {selection:?}: name at least one, ascending, each below {dim}"
    )]
    Selection {
        /// The factor's name.
        factor: &'static str,
        /// The components given.
        selection: Vec<usize>,
        /// Dimension of the tangent space.
        dim: usize,
    },
    /// A matrix of combinations that does not fit the tangent.
    #[error(
        "the combinations of {factor} are {rows} by {columns}; they need at least one row, and {dim} columns"
    )]
    Combinations {
        /// The factor's name.
        factor: &'static str,
        /// Rows of the matrix.
        rows: usize,
        /// Columns of the matrix.
        columns: usize,
        /// Dimension of the tangent space.
        dim: usize,
    },
    /// A combination of nothing.
    #[error(
        "row {row} of the combinations of {factor} is zero and so measures nothing; leave it out"
    )]
    EmptyCombination {
        /// The factor's name.
        factor: &'static str,
        /// From 0.
        row: usize,
    },
    /// Parts of a linear factor that do not fit each other.
    #[error("the {what} of Linear has {actual} {unit}, {expected} are needed")]
    Shape {
        /// Which part.
        what: &'static str,
        /// What is counted.
        unit: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        actual: usize,
    },
    /// A root shift whose root is not a pose.
    #[error("a root shift needs a Pose2 or a Pose3 as the first variable, not a {actual}")]
    RootIsNoPose {
        /// Type of the first variable.
        actual: &'static str,
    },
}

/// The square-root information as a matrix of `N` rows.
pub(crate) fn fixed<const N: usize>(
    factor: &'static str,
    noise: &Noise,
) -> Result<SMatrix<f64, N, N>, FactorError> {
    noise.fixed().ok_or(FactorError::NoiseDimension { factor, expected: N, actual: noise.dim() })
}

pub(crate) fn finite(
    factor: &'static str,
    what: &'static str,
    numbers: &[f64],
) -> Result<(), FactorError> {
    if numbers.iter().all(|x| x.is_finite()) {
        Ok(())
    } else {
        Err(FactorError::NotFinite { factor, what, numbers: numbers.into() })
    }
}

/// A measured distance.
pub(crate) fn distance(factor: &'static str, range: f64) -> Result<f64, FactorError> {
    finite(factor, "range", &[range])?;
    if range < 0.0 { Err(FactorError::NegativeRange { factor, range }) } else { Ok(range) }
}

pub(crate) fn finite_value<V: Manifold>(
    factor: &'static str,
    what: &'static str,
    value: &V,
) -> Result<(), FactorError> {
    let mut numbers: SmallVec<[f64; 7]> = SmallVec::from_elem(0.0, value.storage_len());
    value.store(&mut numbers);
    finite(factor, what, &numbers)
}

/// The parts of `impl Factor` that are the same for every factor of fixed shape: `$rows` residual
/// rows, fields `keys` with one entry per type in the list.
macro_rules! fixed_shape {
    ($name:expr, $rows:expr, [$($kind:ty),+]) => {
        fn name(&self) -> String {
            $name.into()
        }

        fn keys(&self) -> &[evergraph_model::VariableId] {
            &self.keys
        }

        fn residual_dim(&self) -> usize {
            $rows
        }

        fn accepts(&self, position: usize, kind: &evergraph_model::VariableType, _dim: usize) -> bool {
            let fits = [$(kind.is::<$kind>()),+];
            fits.get(position).copied().unwrap_or(false)
        }

        fn as_any(&self) -> &dyn std::any::Any {
            self
        }
    };
}
pub(crate) use fixed_shape;
