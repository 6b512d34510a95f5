//! Relative measurements of part of the state: wheel odometry without heading, a yaw rate, a
//! planar scan match between poses in space.

use std::any::Any;

use evergraph_model::{
    Arguments, Factor, Key, LieGroup, Linearization, Noise, Pose2, Pose3, VariableId, VariableType,
};
use nalgebra::{SMatrix, SVector};
use smallvec::SmallVec;

use crate::error::{FactorError, finite_value};

/// Some components of a relative transform: `r = R S Log(z⁻¹ (xᵢ⁻¹ xⱼ))`.
///
/// `S` picks rows of the tangent, by their index in its order; the noise has as many dimensions.
/// `z = i_from_j` as in [`Between`](crate::Between). All of `z` takes part, since the tangent is
/// taken there: give the components that are not measured their expected values. Jacobians are the
/// picked rows of those of `Between`, whitened.
#[derive(Clone, Debug)]
pub struct PartialBetween<G, const N: usize> {
    keys: [VariableId; 2],
    measurement: G,
    components: SmallVec<[usize; 6]>,
    noise: Noise,
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
        const NAME: &str = "PartialBetween";
        finite_value(NAME, "measurement", &measurement)?;
        let ascending = components.windows(2).all(|pair| pair[0] < pair[1]);
        if components.is_empty() || !ascending || components.iter().any(|&c| c >= N) {
            return Err(FactorError::Selection {
                factor: NAME,
                selection: components.into(),
                dim: N,
            });
        }
        if noise.dim() != components.len() {
            return Err(FactorError::NoiseDimension {
                factor: NAME,
                expected: components.len(),
                actual: noise.dim(),
            });
        }
        Ok(Self { keys: [from.id(), to.id()], measurement, components: components.into(), noise })
    }

    #[inline]
    fn evaluate(&self, at: &Arguments<'_>) -> (G, SVector<f64, N>) {
        let relative = at.get::<G>(0).between(&at.get::<G>(1));
        let error = self.measurement.between(&relative).log();
        (relative, error)
    }

    fn select(&self, full: &SMatrix<f64, N, N>, out: &mut [f64]) {
        let rows = self.components.len();
        for (column, out) in out.chunks_exact_mut(rows).enumerate() {
            for (out, &component) in out.iter_mut().zip(&self.components) {
                *out = full[(component, column)];
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

    /// The measured `from⁻¹ to`, with components that were not measured at their expected values.
    pub fn measurement(&self) -> &G {
        &self.measurement
    }

    /// Indices of the measured tangent components, ascending.
    pub fn components(&self) -> &[usize] {
        &self.components
    }

    /// The noise of the measured components.
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
        self.components.len()
    }

    fn accepts(&self, position: usize, kind: &VariableType, _: usize) -> bool {
        position < 2 && kind.is::<G>()
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let (_, error) = self.evaluate(at);
        out.iter_mut().zip(&self.components).for_each(|(out, &component)| *out = error[component]);
        self.noise.whiten_columns(out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (relative, error) = self.evaluate(at);
        let to = G::right_jacobian_inverse(&error);
        let from = -(to * relative.inverse().adjoint());
        self.select(&from, out.block_mut(0));
        self.select(&to, out.block_mut(1));
        let residual = out.residual_mut().iter_mut().zip(&self.components);
        residual.for_each(|(out, &component)| *out = error[component]);
        self.noise.whiten_columns(out.data_mut());
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
