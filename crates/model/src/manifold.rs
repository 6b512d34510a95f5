//! What a variable must be able to do, typed ([`Manifold`]) and erased ([`VariableType`]).

use std::any::TypeId;
use std::fmt;

use nalgebra::{SMatrix, SVector};

use crate::world::Motion;

/// A smooth manifold that a variable may live on.
///
/// Implement it for types of your own and check the laws with
/// [`crate::testing::check_manifold`]:
///
/// ```text
/// retract(x, 0) = x       retract(x, local(x, y)) = y       local(x, retract(x, d)) = d (small d)
/// ```
///
/// A value is kept by the engine as [`storage_len`](Self::storage_len) plain numbers, so that
/// states can be copied, hashed and saved without knowing the type.
pub trait Manifold: Clone + fmt::Debug + PartialEq + Send + Sync + 'static {
    /// The type's name in messages and files, for example `"Pose2"`.
    const NAME: &'static str;

    /// Names of the tangent components, in order; empty when the dimension is known only at run
    /// time.
    const COMPONENTS: &'static [&'static str];

    /// The motion of the type with its world, `Motion::of` or `Motion::of_pose` of a type that implements
    /// [`Moves`](crate::Moves). The default, `None`, is a variable that does not move with the world, such as a vector of
    /// biases.
    const MOTION: Option<Motion> = None;

    /// Dimension of the tangent space.
    fn dim(&self) -> usize;

    /// How many `f64` hold the value.
    fn storage_len(&self) -> usize;

    /// Writes the value; `out` has [`storage_len`](Self::storage_len) entries.
    fn store(&self, out: &mut [f64]);

    /// Reads what [`store`](Self::store) wrote.
    fn load(storage: &[f64]) -> Self;

    /// Moves along `delta`, a tangent vector at `self` of [`dim`](Self::dim) entries.
    #[must_use]
    fn retract(&self, delta: &[f64]) -> Self;

    /// The tangent vector at `self` that leads to `other`, the inverse of
    /// [`retract`](Self::retract); `out` has [`dim`](Self::dim) entries.
    fn local(&self, other: &Self, out: &mut [f64]);
}

/// A Lie group of dimension `N` with right perturbation, `retract(x, d) = x * exp(d)`.
///
/// Jacobians follow Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in
/// robotics" (2018).
pub trait LieGroup<const N: usize>: Manifold + Copy {
    /// The neutral element.
    fn identity() -> Self;
    /// `self * other`.
    #[must_use]
    fn compose(&self, other: &Self) -> Self;
    /// `self⁻¹`.
    #[must_use]
    fn inverse(&self) -> Self;
    /// The exponential at the identity.
    fn exp(tangent: &SVector<f64, N>) -> Self;
    /// The logarithm, the inverse of [`exp`](Self::exp) with angles in (-π, π].
    fn log(&self) -> SVector<f64, N>;
    /// `Ad(x)`, with `x * exp(d) = exp(Ad(x) d) * x`.
    fn adjoint(&self) -> SMatrix<f64, N, N>;
    /// `Jr(d)`, with `exp(d + e) ≈ exp(d) * exp(Jr(d) e)`.
    fn right_jacobian(tangent: &SVector<f64, N>) -> SMatrix<f64, N, N>;
    /// `Jr(d)⁻¹`, with `log(exp(d) * exp(e)) ≈ d + Jr(d)⁻¹ e`.
    fn right_jacobian_inverse(tangent: &SVector<f64, N>) -> SMatrix<f64, N, N>;
    /// `self⁻¹ * other`.
    #[must_use]
    fn between(&self, other: &Self) -> Self {
        self.inverse().compose(other)
    }
}

/// A [`Manifold`] as the engine sees it: functions on stored numbers.
#[derive(Clone, Copy)]
pub struct VariableType {
    name: &'static str,
    components: &'static [&'static str],
    type_id: TypeId,
    motion: Option<Motion>,
    retract: fn(&[f64], &[f64], &mut [f64]),
    local: fn(&[f64], &[f64], &mut [f64]),
    reload: fn(&[f64]) -> (usize, usize),
}

impl VariableType {
    /// The erased form of `V`; one static per type.
    pub fn of<V: Manifold>() -> &'static Self {
        struct Erased<V>(std::marker::PhantomData<V>);
        impl<V: Manifold> Erased<V> {
            const TYPE: VariableType = VariableType {
                name: V::NAME,
                components: V::COMPONENTS,
                type_id: TypeId::of::<V>(),
                motion: V::MOTION,
                retract: |x, delta, out| V::load(x).retract(delta).store(out),
                local: |x, y, out| V::load(x).local(&V::load(y), out),
                reload: |x| {
                    let value = V::load(x);
                    (value.dim(), value.storage_len())
                },
            };
        }
        &Erased::<V>::TYPE
    }

    /// [`Manifold::NAME`].
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The name of tangent component `i`: [`Manifold::COMPONENTS`], or the index itself.
    pub fn component(&self, i: usize) -> String {
        self.components.get(i).map_or_else(|| i.to_string(), |name| (*name).to_string())
    }

    /// [`Manifold::MOTION`].
    pub fn motion(&self) -> Option<&Motion> {
        self.motion.as_ref()
    }

    /// Whether this is the erased form of `V`.
    pub fn is<V: Manifold>(&self) -> bool {
        self.type_id == TypeId::of::<V>()
    }

    /// [`Manifold::retract`] on stored values.
    pub fn retract(&self, x: &[f64], delta: &[f64], out: &mut [f64]) {
        (self.retract)(x, delta, out);
    }

    /// Dimension and number of stored numbers of the value that these numbers load as.
    ///
    /// # Panics
    /// When the type cannot read them.
    pub(crate) fn reload(&self, x: &[f64]) -> (usize, usize) {
        (self.reload)(x)
    }

    /// [`Manifold::local`] on stored values.
    pub fn local(&self, x: &[f64], y: &[f64], out: &mut [f64]) {
        (self.local)(x, y, out);
    }
}

impl PartialEq for VariableType {
    fn eq(&self, other: &Self) -> bool {
        self.type_id == other.type_id
    }
}

impl Eq for VariableType {}

impl fmt::Debug for VariableType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}
