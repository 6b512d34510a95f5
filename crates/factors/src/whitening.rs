//! The square-root information of factors whose dimension is known at compile time.

use evergraph_model::Noise;
use nalgebra::{SMatrix, SVector};

use crate::error::FactorError;

/// A noise of `N` dimensions.
///
/// Keeps the diagonal close by and leaves a whole square root where the noise has it: a factor of
/// poses in space is three cache lines shorter than with a copy.
#[derive(Clone, Debug)]
pub(crate) struct Whitening<const N: usize> {
    noise: Noise,
    /// The diagonal of its square-root information if nothing stands beside it, as is usual.
    diagonal: Option<SVector<f64, N>>,
}

impl<const N: usize> Whitening<N> {
    pub(crate) fn new(factor: &'static str, noise: Noise) -> Result<Self, FactorError> {
        let root = noise.fixed::<N>().ok_or(FactorError::NoiseDimension {
            factor,
            expected: N,
            actual: noise.dim(),
        })?;
        let diagonal = root.diagonal();
        let diagonal = (SMatrix::from_diagonal(&diagonal) == root).then_some(diagonal);
        Ok(Self { noise, diagonal })
    }

    pub(crate) fn noise(&self) -> &Noise {
        &self.noise
    }

    /// [`Noise::whiten_columns`].
    #[inline]
    pub(crate) fn whiten_columns(&self, columns: &mut [f64]) {
        match &self.diagonal {
            Some(diagonal) => {
                for column in columns.as_chunks_mut::<N>().0 {
                    for (entry, weight) in column.iter_mut().zip(diagonal.as_slice()) {
                        *entry *= weight;
                    }
                }
            }
            None => self.noise.whiten_columns(columns),
        }
    }
}
