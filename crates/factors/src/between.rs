//! Relative measurements of the full state: odometry, scan matches, loop closures.

use std::any::Any;

use evergraph_model::{
    Arguments, Factor, Key, LieGroup, Linearization, Noise, Point2, Point3, Pose2, Pose3, Rot2,
    Rot3, VariableId, VariableType,
};

use crate::error::{FactorError, finite_value};
use crate::relative::Relative;
use crate::whitening::Whitening;

/// A measured relative transform: `r = R Log(z⁻¹ (xᵢ⁻¹ xⱼ))`.
///
/// With `xᵢ = world_from_i` and `xⱼ = world_from_j` the measurement is `z = i_from_j`. The error is
/// in the tangent order and units of the group. Jacobians, with `e` the unwhitened residual:
///
/// ```text
/// Jⱼ =  R Jr⁻¹(e)
/// Jᵢ = -R Jr⁻¹(e) Ad((xᵢ⁻¹ xⱼ)⁻¹)
/// ```
#[derive(Clone, Debug)]
pub struct Between<G, const N: usize> {
    keys: [VariableId; 2],
    measurement: G,
    noise: Whitening<N>,
}

/// [`Between`] two poses in the plane; tangent `(x, y, theta)`.
pub type BetweenPose2 = Between<Pose2, 3>;
/// [`Between`] two poses in space; tangent `(x, y, z, rx, ry, rz)`.
pub type BetweenPose3 = Between<Pose3, 6>;
/// [`Between`] two rotations in the plane.
pub type BetweenRot2 = Between<Rot2, 1>;
/// [`Between`] two rotations in space.
pub type BetweenRot3 = Between<Rot3, 3>;
/// [`Between`] two points in the plane: their difference in the frame they are given in.
pub type BetweenPoint2 = Between<Point2, 2>;
/// [`Between`] two points in space: their difference in the frame they are given in.
pub type BetweenPoint3 = Between<Point3, 3>;

impl<G: LieGroup<N>, const N: usize> Between<G, N> {
    /// `measurement` is `to` seen from `from`, that is `from⁻¹ to`.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        from: Key<G>,
        to: Key<G>,
        measurement: G,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        finite_value("Between", "measurement", &measurement)?;
        let noise = Whitening::new("Between", noise)?;
        Ok(Self { keys: [from.id(), to.id()], measurement, noise })
    }
}

impl<G, const N: usize> Between<G, N> {
    /// The variable that the measurement is seen from.
    pub fn from(&self) -> VariableId {
        self.keys[0]
    }

    /// The variable that is seen.
    pub fn to(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured `from⁻¹ to`.
    pub fn measurement(&self) -> &G {
        &self.measurement
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        self.noise.noise()
    }
}

impl<G: LieGroup<N>, const N: usize> Factor for Between<G, N> {
    fn name(&self) -> String {
        format!("Between<{}>", G::NAME)
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        N
    }

    fn accepts(&self, position: usize, kind: &VariableType, _: usize) -> bool {
        position < 2 && kind.is::<G>()
    }

    #[inline]
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let relative = Relative::new(&self.measurement, at);
        out.copy_from_slice(relative.error.as_slice());
        self.noise.whiten_columns(out);
    }

    #[inline]
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let relative = Relative::new(&self.measurement, at);
        // Both blocks and the residual stand side by side in one matrix, whose size the compiler
        // is told here.
        let columns = &mut out.data_mut()[..N * (2 * N + 1)];
        let (blocks, residual) = columns.split_at_mut(2 * N * N);
        let (from, to) = blocks.split_at_mut(N * N);
        relative.jacobians(from, to);
        residual.copy_from_slice(relative.error.as_slice());
        self.noise.whiten_columns(columns);
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
