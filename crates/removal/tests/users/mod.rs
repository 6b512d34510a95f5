//! Variable types and factors of a user's own.

mod plane;
mod track;

use std::any::Any;

use evergraph_model::*;
use nalgebra::{DMatrix, Vector2};

pub use plane::{Lamp, Place};
pub use track::{Car, Mark};

/// The derivative of `local(self, x)` by x.
pub trait LocalDerivative: Manifold {
    fn local_derivative(&self, local: &[f64]) -> DMatrix<f64> {
        DMatrix::identity(local.len(), local.len())
    }
}

impl LocalDerivative for Place {}
impl LocalDerivative for Lamp {}
impl LocalDerivative for Mark {}
impl LocalDerivative for Car {
    fn local_derivative(&self, local: &[f64]) -> DMatrix<f64> {
        let inverse = Self::right_jacobian_inverse(&Vector2::from_column_slice(local));
        DMatrix::from_column_slice(2, 2, inverse.as_slice())
    }
}

/// `Local(z, frame⁻¹ · x) / σ`: a variable as seen from a pose.
#[derive(Debug)]
pub struct Sight<R, V, G, const N: usize> {
    keys: [VariableId; 2],
    z: V,
    sigma: f64,
    types: std::marker::PhantomData<fn() -> (R, G)>,
}

impl<R, V: Manifold, G, const N: usize> Sight<R, V, G, N> {
    pub fn new(root: Key<R>, seen: Key<V>, z: V, sigma: f64) -> Self {
        let types = std::marker::PhantomData;
        Self { keys: [root.id(), seen.id()], z, sigma, types }
    }
}

impl<R, V, G, const N: usize> Factor for Sight<R, V, G, N>
where
    R: Frame<G, N>,
    V: Moves<G, N> + LocalDerivative,
    G: LieGroup<N>,
{
    fn name(&self) -> String {
        format!("Sight<{}, {}>", R::NAME, V::NAME)
    }
    fn keys(&self) -> &[VariableId] {
        &self.keys
    }
    fn residual_dim(&self) -> usize {
        self.z.dim()
    }
    fn accepts(&self, position: usize, kind: &VariableType, _: usize) -> bool {
        if position == 0 { kind.is::<R>() } else { kind.is::<V>() }
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let seen = at.get::<V>(1).seen_from(&at.get::<R>(0).frame());
        self.z.local(&seen, out);
        out.iter_mut().for_each(|x| *x /= self.sigma);
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (root, value) = (at.get::<R>(0), at.get::<V>(1));
        let (seen, dim) = (value.seen_from(&root.frame()), value.dim());
        let mut local = vec![0.0; dim];
        self.z.local(&seen, &mut local);
        let outer = self.z.local_derivative(&local) / self.sigma;
        let mut own = DMatrix::zeros(dim, dim);
        value.seen_from_derivative(&root.frame(), own.as_mut_slice());
        let (mut lever, mut frame) = (DMatrix::zeros(dim, N), DMatrix::zeros(N, N));
        seen.lever(lever.as_mut_slice());
        root.frame_derivative(frame.as_mut_slice());
        out.block_mut(0).copy_from_slice((-&outer * lever * frame).as_slice());
        out.block_mut(1).copy_from_slice((outer * own).as_slice());
        self.residual(at, out.residual_mut());
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}
