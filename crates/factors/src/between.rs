//! Relative measurements of the full state: odometry, scan matches, loop closures.

use std::any::Any;

use evergraph_model::{
    Arguments, Factor, Key, LieGroup, Linearization, Noise, Point2, Point3, Pose2, Pose3, Rot2,
    Rot3, VariableId, VariableType,
};
use nalgebra::{SMatrix, SVector};

use crate::error::{FactorError, finite_value, fixed};

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
    noise: Noise,
    sqrt_information: SMatrix<f64, N, N>,
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
        let sqrt_information = fixed("Between", &noise)?;
        Ok(Self { keys: [from.id(), to.id()], measurement, noise, sqrt_information })
    }

    /// The relative transform and the unwhitened residual.
    #[inline]
    fn evaluate(&self, at: &Arguments<'_>) -> (G, SVector<f64, N>) {
        let relative = at.get::<G>(0).between(&at.get::<G>(1));
        let error = self.measurement.between(&relative).log();
        (relative, error)
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
        &self.noise
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
        let (_, error) = self.evaluate(at);
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    #[inline]
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (relative, error) = self.evaluate(at);
        let to = self.sqrt_information * G::right_jacobian_inverse(&error);
        let from = -(to * relative.inverse().adjoint());
        out.set_block(0, &from);
        out.set_block(1, &to);
        out.set_residual(&(self.sqrt_information * error));
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
