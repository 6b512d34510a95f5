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
    shape: Shape<N>,
}

/// What there is in a square-root information.
#[derive(Clone, Debug)]
enum Shape<const N: usize> {
    /// A diagonal, as is usual.
    Diagonal(SVector<f64, N>),
    /// Two blocks of three: translation and rotation of a pose in space know nothing of each other.
    Halves,
    Whole,
}

impl<const N: usize> Whitening<N> {
    pub(crate) fn new(factor: &'static str, noise: Noise) -> Result<Self, FactorError> {
        let root = noise.fixed::<N>().ok_or(FactorError::NoiseDimension {
            factor,
            expected: N,
            actual: noise.dim(),
        })?;
        let shape = if SMatrix::from_diagonal(&root.diagonal()) == root {
            Shape::Diagonal(root.diagonal())
        } else if N == 6 && root.rows(0, 3).columns(3, 3).iter().all(|x| *x == 0.0) {
            Shape::Halves
        } else {
            Shape::Whole
        };
        Ok(Self { noise, shape })
    }

    pub(crate) fn noise(&self) -> &Noise {
        &self.noise
    }

    /// [`Noise::whiten_columns`].
    #[inline]
    pub(crate) fn whiten_columns(&self, columns: &mut [f64]) {
        match &self.shape {
            Shape::Diagonal(diagonal) => {
                for column in columns.as_chunks_mut::<N>().0 {
                    for (entry, weight) in column.iter_mut().zip(diagonal.as_slice()) {
                        *entry *= weight;
                    }
                }
            }
            Shape::Halves => whiten_halves(self.noise.sqrt_information().as_slice(), columns),
            Shape::Whole => self.noise.whiten_columns(columns),
        }
    }
}

/// `R e` in the place of each column of six rows, for an `R` of two upper triangular blocks.
fn whiten_halves(root: &[f64], columns: &mut [f64]) {
    let (root, _) = root.as_chunks::<6>();
    for column in columns.as_chunks_mut::<3>().0.chunks_exact_mut(2) {
        for (half, first) in column.iter_mut().zip([0, 3]) {
            let [x, y, z] = *half;
            let r = |row: usize, column: usize| root[first + column][first + row];
            *half =
                [r(0, 0) * x + r(0, 1) * y + r(0, 2) * z, r(1, 1) * y + r(1, 2) * z, r(2, 2) * z];
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Every shape whitens as the noise itself does.
    #[test]
    fn shapes_agree_with_the_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut random = |_, _| rng.random_range(-1.0..1.0);
        let mut columns = DMatrix::from_fn(6, 13, &mut random);
        for shape in 0..3 {
            let root = DMatrix::from_fn(6, 6, &mut random);
            let information = root.transpose() * &root + DMatrix::identity(6, 6);
            let information = information.map_with_location(|i, j, x| match shape {
                0 if i != j => 0.0,
                1 if i / 3 != j / 3 => 0.0,
                _ => x,
            });
            let noise = Noise::from_information(&information).unwrap();
            let mut expected = columns.clone();
            noise.whiten_columns(expected.as_mut_slice());
            let whitening = Whitening::<6>::new("Between", noise).unwrap();
            match (shape, &whitening.shape) {
                (0, Shape::Diagonal(_)) | (1, Shape::Halves) | (2, Shape::Whole) => {}
                (_, other) => panic!("{shape}: {other:?}"),
            }
            whitening.whiten_columns(columns.as_mut_slice());
            assert!((&columns - expected).amax() < 1e-12 * columns.amax().max(1.0), "{shape}");
        }
    }
}
