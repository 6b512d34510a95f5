//! The factor, and the residual that it is made of.

use std::any::Any;
use std::fmt::Debug;

use evergraph_model::{Arguments, Factor, Linearization, Noise, VariableId, VariableType};
use smallvec::SmallVec;

use super::number::{Dual64, Number};
use super::variables::Variables;
use crate::error::FactorError;

/// An error of `ROWS` numbers as a function of some variables; [`AutoDiff`] makes it a factor.
pub trait Residual<const ROWS: usize>: Debug + Send + Sync + 'static {
    /// The types of the variables, a tuple of one to four: `(Pose2, Point2)`, `(Pose3,)`.
    /// A vector of `N` parameters ([`VectorN`](evergraph_model::VectorN)) is
    /// [`Parameters<N>`](super::Parameters).
    type Variables: Variables;

    /// The factor's name in messages.
    const NAME: &'static str;

    /// The error in the units of the measurement, not whitened. In an implementation, name the
    /// types that the variables have here ([`Variable::Lifted`](super::Variable::Lifted)), as in the
    /// [example](crate::autodiff).
    ///
    /// Where the error has no derivative (a root or a distance at zero) the result may be no
    /// number; the solver then names the factor.
    fn evaluate<T: Number>(
        &self,
        variables: <Self::Variables as Variables>::Lifted<T>,
    ) -> [T; ROWS];
}

/// A factor whose Jacobian is found by automatic differentiation: `r = R e(x₁ …)` with the error
/// `e` of a [`Residual`].
#[derive(Clone, Debug)]
pub struct AutoDiff<E, const ROWS: usize> {
    keys: SmallVec<[VariableId; 4]>,
    error: E,
    noise: Noise,
}

impl<E: Residual<ROWS>, const ROWS: usize> AutoDiff<E, ROWS> {
    /// `keys` are those of `error`'s variables, in the order of their types; the noise has `ROWS`
    /// dimensions.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`].
    pub fn new(
        keys: <E::Variables as Variables>::Keys,
        error: E,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        if noise.dim() != ROWS {
            let actual = noise.dim();
            return Err(FactorError::NoiseDimension { factor: E::NAME, expected: ROWS, actual });
        }
        Ok(Self { keys: E::Variables::ids(keys), error, noise })
    }

    /// The count of its variables.
    pub(crate) const VARIABLES: usize = E::Variables::COUNT;

    /// [`new`](Self::new) for variables whose types the graph checks; `None` when they are too many
    /// or too few.
    pub(crate) fn of_ids(
        ids: &[VariableId],
        error: E,
        noise: Noise,
    ) -> Option<Result<Self, FactorError>> {
        (ids.len() == Self::VARIABLES).then(|| {
            if noise.dim() != ROWS {
                let actual = noise.dim();
                return Err(FactorError::NoiseDimension {
                    factor: E::NAME,
                    expected: ROWS,
                    actual,
                });
            }
            Ok(Self { keys: ids.into(), error, noise })
        })
    }

    /// The error at the values; `tangent` gives each variable's tangent by position and component.
    fn evaluate<T: Number>(
        &self,
        at: &Arguments<'_>,
        tangent: impl Fn(usize, usize) -> T,
    ) -> [T; ROWS] {
        self.error.evaluate(E::Variables::lift(at, tangent))
    }

    /// The derivative of the error by one tangent component.
    fn derivative(&self, at: &Arguments<'_>, position: usize, component: usize) -> [f64; ROWS] {
        let seed = |p, c| if (p, c) == (position, component) { 1.0 } else { 0.0 };
        self.evaluate(at, |p, c| Dual64::new(0.0, seed(p, c))).map(|error| error.eps)
    }
}

impl<E, const ROWS: usize> AutoDiff<E, ROWS> {
    /// The error function with its measurement.
    pub fn inner(&self) -> &E {
        &self.error
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<E: Residual<ROWS>, const ROWS: usize> Factor for AutoDiff<E, ROWS> {
    fn name(&self) -> String {
        E::NAME.into()
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        ROWS
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        E::Variables::accepts(position, kind, dim)
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out.copy_from_slice(&self.evaluate(at, |_, _| 0.0));
        self.noise.whiten_columns(out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        for position in 0..self.keys.len() {
            let block = out.block_mut(position);
            for (component, column) in block.chunks_exact_mut(ROWS).enumerate() {
                column.copy_from_slice(&self.derivative(at, position, component));
            }
        }
        out.residual_mut().copy_from_slice(&self.evaluate(at, |_, _| 0.0));
        self.noise.whiten_columns(out.data_mut());
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
