//! Relative measurements of part of the state: wheel odometry without heading, a yaw rate, a
//! planar scan match between poses in space, a speed along a slanted beam.

use std::any::Any;

use evergraph_model::{
    Arguments, Factor, Key, LieGroup, Linearization, Noise, Pose2, Pose3, VariableId, VariableType,
};
use nalgebra::{DMatrix, SMatrix};

use crate::error::{FactorError, finite, finite_value};
use crate::relative::Relative;

const NAME: &str = "PartialBetween";

/// A part of a relative transform: `r = R A Log(z⁻¹ (xᵢ⁻¹ xⱼ))`.
///
/// `A` (k × `N`) combines components of the tangent, in its order; the simplest picks some of them.
/// The noise has k dimensions. `z = i_from_j` as in [`Between`](crate::Between). All of `z` takes
/// part, since the tangent is taken there: give what is not measured its expected value. Jacobians
/// are `A` times those of `Between`, whitened.
#[derive(Clone, Debug)]
pub struct PartialBetween<G, const N: usize> {
    keys: [VariableId; 2],
    measurement: G,
    combinations: DMatrix<f64>,
    noise: Noise,
    /// The rows of `R A`.
    whitened: Vec<[f64; N]>,
}

/// [`PartialBetween`] poses in the plane; components 0 x, 1 y, 2 theta.
pub type PartialBetweenPose2 = PartialBetween<Pose2, 3>;
/// [`PartialBetween`] poses in space; components 0 x, 1 y, 2 z, 3 rx, 4 ry, 5 rz.
pub type PartialBetweenPose3 = PartialBetween<Pose3, 6>;

impl<G: LieGroup<N>, const N: usize> PartialBetween<G, N> {
    /// `measurement` is `to` seen from `from`, of which `components` (ascending) are known.
    ///
    /// # Errors
    /// [`FactorError::Selection`], [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        from: Key<G>,
        to: Key<G>,
        measurement: G,
        components: &[usize],
        noise: Noise,
    ) -> Result<Self, FactorError> {
        let ascending = components.windows(2).all(|pair| pair[0] < pair[1]);
        if components.is_empty() || !ascending || components.iter().any(|&c| c >= N) {
            return Err(FactorError::Selection {
                factor: NAME,
                selection: components.into(),
                dim: N,
            });
        }
        let combinations = DMatrix::from_fn(components.len(), N, |row, column| {
            if components[row] == column { 1.0 } else { 0.0 }
        });
        Self::with_combinations(from, to, measurement, combinations, noise)
    }

    /// `measurement` is `to` seen from `from`, of which the `combinations` (k × `N`, k ≥ 1) of the
    /// tangent are known; the noise has k dimensions.
    ///
    /// # Errors
    /// [`FactorError::Combinations`], [`FactorError::EmptyCombination`],
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn with_combinations(
        from: Key<G>,
        to: Key<G>,
        measurement: G,
        combinations: DMatrix<f64>,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        finite_value(NAME, "measurement", &measurement)?;
        let (rows, columns) = combinations.shape();
        if rows == 0 || columns != N {
            return Err(FactorError::Combinations { factor: NAME, rows, columns, dim: N });
        }
        finite(NAME, "combinations", combinations.as_slice())?;
        if let Some(row) = (0..rows).find(|&row| combinations.row(row).amax() == 0.0) {
            return Err(FactorError::EmptyCombination { factor: NAME, row });
        }
        if noise.dim() != rows {
            let actual = noise.dim();
            return Err(FactorError::NoiseDimension { factor: NAME, expected: rows, actual });
        }
        let whitened = (noise.sqrt_information() * &combinations)
            .row_iter()
            .map(|row| std::array::from_fn(|column| row[column]))
            .collect();
        Ok(Self { keys: [from.id(), to.id()], measurement, combinations, noise, whitened })
    }

    /// Writes `R A` times `full`, column by column.
    fn combine(&self, full: &[f64], out: &mut [f64]) {
        let (columns, _) = full.as_chunks::<N>();
        for (column, out) in columns.iter().zip(out.chunks_exact_mut(self.whitened.len())) {
            for (row, out) in self.whitened.iter().zip(out) {
                *out = row.iter().zip(column).map(|(weight, entry)| weight * entry).sum();
            }
        }
    }
}

impl<G, const N: usize> PartialBetween<G, N> {
    /// The variable that the measurement is seen from.
    pub fn from(&self) -> VariableId {
        self.keys[0]
    }

    /// The variable that is seen.
    pub fn to(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured `from⁻¹ to`, with what was not measured at its expected value.
    pub fn measurement(&self) -> &G {
        &self.measurement
    }

    /// `A`, which combines the tangent: a row per measured number, a column per component.
    pub fn combinations(&self) -> &DMatrix<f64> {
        &self.combinations
    }

    /// The noise of the measured combinations.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<G: LieGroup<N>, const N: usize> Factor for PartialBetween<G, N> {
    fn name(&self) -> String {
        format!("PartialBetween<{}>", G::NAME)
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        self.combinations.nrows()
    }

    fn accepts(&self, position: usize, kind: &VariableType, _: usize) -> bool {
        position < 2 && kind.is::<G>()
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let relative = Relative::new(&self.measurement, at);
        self.combine(relative.error.as_slice(), out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let relative = Relative::new(&self.measurement, at);
        let (mut from, mut to) = (SMatrix::<f64, N, N>::zeros(), SMatrix::<f64, N, N>::zeros());
        relative.jacobians(from.as_mut_slice(), to.as_mut_slice());
        self.combine(from.as_slice(), out.block_mut(0));
        self.combine(to.as_slice(), out.block_mut(1));
        self.combine(relative.error.as_slice(), out.residual_mut());
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
