//! Distances.

use std::marker::PhantomData;

use evergraph_model::{Arguments, Factor, Key, Linearization, Noise, VariableId};
use nalgebra::{Matrix1, SVector};

use crate::error::{FactorError, distance, fixed, fixed_shape};
use crate::positioned::{Positioned, polar};

/// A measured distance between two things in a world of `D` dimensions: `r = R (|p_b - p_a| - z)`.
///
/// `p_a` and `p_b` are positions in the world, `z` the measured distance, metres. Poses and points
/// in any combination: a radio beacon on a robot, sonar between two robots. With `u` the unit
/// vector from `p_a` to `p_b` the Jacobians are `-R uᵀ ∂p_a/∂ξ` and `R uᵀ ∂p_b/∂ξ`. At distance
/// zero there is no direction; the Jacobian jumps there and is taken as zero.
///
/// Two things seen by range only stay free to move about each other: an estimate needs a start
/// value on the right side.
#[derive(Clone, Debug)]
pub struct Range<A, B, const D: usize> {
    keys: [VariableId; 2],
    measurement: f64,
    noise: Noise,
    sqrt_information: f64,
    kinds: PhantomData<fn() -> (A, B)>,
}

impl<A: Positioned<D>, B: Positioned<D>, const D: usize> Range<A, B, D> {
    /// `range` is the distance of `a` and `b` in metres, zero or more; the noise has one dimension.
    ///
    /// # Errors
    /// [`FactorError::NegativeRange`], [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(a: Key<A>, b: Key<B>, range: f64, noise: Noise) -> Result<Self, FactorError> {
        let measurement = distance("Range", range)?;
        let sqrt_information: Matrix1<f64> = fixed("Range", &noise)?;
        Ok(Self {
            keys: [a.id(), b.id()],
            measurement,
            noise,
            sqrt_information: sqrt_information.x,
            kinds: PhantomData,
        })
    }

    /// Length and direction of the way from `a` to `b`.
    #[inline]
    fn way(a: &A, b: &B) -> (f64, Option<SVector<f64, D>>) {
        polar(&(b.position() - a.position()))
    }
}

impl<A, B, const D: usize> Range<A, B, D> {
    /// The one end.
    pub fn a(&self) -> VariableId {
        self.keys[0]
    }

    /// The other end.
    pub fn b(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured distance, in metres.
    pub fn measurement(&self) -> f64 {
        self.measurement
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<A: Positioned<D>, B: Positioned<D>, const D: usize> Factor for Range<A, B, D> {
    fixed_shape!(format!("Range<{}, {}>", A::NAME, B::NAME), 1, [A, B]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let (range, _) = Self::way(&at.get(0), &at.get(1));
        out[0] = self.sqrt_information * (range - self.measurement);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (a, b): (A, B) = (at.get(0), at.get(1));
        let (range, direction) = Self::way(&a, &b);
        if let Some(direction) = direction {
            let by_b = self.sqrt_information * direction.transpose();
            a.chain(&-by_b, out.block_mut(0));
            b.chain(&by_b, out.block_mut(1));
        }
        out.residual_mut()[0] = self.sqrt_information * (range - self.measurement);
    }
}
