//! What is known of a variable beforehand.

use std::any::Any;

use evergraph_model::{
    Arguments, Factor, Key, LieGroup, Linearization, Manifold, Noise, Point2, Point3, Pose2, Pose3,
    Rot2, Rot3, VariableId, VariableType, VectorN,
};
use nalgebra::SVector;

use crate::error::{FactorError, finite_value};

/// A manifold whose [`local`](Manifold::local) can be differentiated.
///
/// Implement it to put priors on types of your own.
pub trait LocalJacobian: Manifold {
    /// The derivative of `local(self, x)` by a right perturbation of `x`, at the `x` with
    /// `local(self, x) = tangent`; column-major into `out`, which is zero.
    fn local_jacobian(&self, tangent: &[f64], out: &mut [f64]);
}

macro_rules! local_jacobian_of_group {
    ($($group:ty: $dim:literal),+) => {$(
        impl LocalJacobian for $group {
            #[inline]
            fn local_jacobian(&self, tangent: &[f64], out: &mut [f64]) {
                let tangent = SVector::<f64, $dim>::from_column_slice(tangent);
                out.copy_from_slice(Self::right_jacobian_inverse(&tangent).as_slice());
            }
        }
    )+};
}
local_jacobian_of_group!(Rot2: 1, Rot3: 3, Pose2: 3, Pose3: 6, Point2: 2, Point3: 3);

impl LocalJacobian for VectorN {
    fn local_jacobian(&self, _: &[f64], out: &mut [f64]) {
        let n = self.len();
        (0..n).for_each(|i| out[i * n + i] = 1.0);
    }
}

/// A full prior: `r = R local(z, x)`, for a Lie group `R Log(z⁻¹ x)`.
///
/// `x` is the variable, `z` the prior value; the error is that of `x` seen from `z`, in the tangent
/// order and units of the manifold. Jacobian `R Jr⁻¹(Log(z⁻¹ x))`, for points and vectors `R`.
#[derive(Clone, Debug)]
pub struct Prior<V> {
    keys: [VariableId; 1],
    measurement: V,
    noise: Noise,
}

impl<V: LocalJacobian> Prior<V> {
    /// A prior on `key` at `measurement`; the noise has the dimension of the tangent space.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(key: Key<V>, measurement: V, noise: Noise) -> Result<Self, FactorError> {
        finite_value("Prior", "measurement", &measurement)?;
        if noise.dim() != measurement.dim() {
            return Err(FactorError::NoiseDimension {
                factor: "Prior",
                expected: measurement.dim(),
                actual: noise.dim(),
            });
        }
        Ok(Self { keys: [key.id()], measurement, noise })
    }
}

impl<V> Prior<V> {
    /// The variable.
    pub fn key(&self) -> VariableId {
        self.keys[0]
    }

    /// The prior value `z`.
    pub fn measurement(&self) -> &V {
        &self.measurement
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<V: LocalJacobian> Factor for Prior<V> {
    fn name(&self) -> String {
        format!("Prior<{}>", V::NAME)
    }

    fn keys(&self) -> &[VariableId] {
        &self.keys
    }

    fn residual_dim(&self) -> usize {
        self.noise.dim()
    }

    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        position == 0 && kind.is::<V>() && dim == self.noise.dim()
    }

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        self.measurement.local(&at.get(0), out);
        self.noise.whiten_columns(out);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.measurement.local(&at.get(0), out.residual_mut());
        // The Jacobian and the residual stand side by side in one matrix.
        let n = self.noise.dim();
        let (jacobian, residual) = out.data_mut().split_at_mut(n * n);
        self.measurement.local_jacobian(residual, jacobian);
        self.noise.whiten_columns(out.data_mut());
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
