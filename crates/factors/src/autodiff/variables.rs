//! Variables of a graph as residuals see them.

use evergraph_model::{
    Arguments, Key, Manifold, Point2, Point3, Pose2, Pose3, Rot2, Rot3, VariableId, VariableType,
    VectorN,
};
use nalgebra::{SVector, Vector2, Vector3};
use smallvec::{SmallVec, smallvec};

use super::geometry::{Rotation2, Rotation3, Transform2, Transform3};
use super::number::Number;

/// A variable that automatic differentiation can move.
///
/// | variable | is seen as |
/// |---|---|
/// | [`Pose2`], [`Pose3`] | [`Transform2`], [`Transform3`] |
/// | [`Rot2`], [`Rot3`] | [`Rotation2`], [`Rotation3`] |
/// | [`Point2`], [`Point3`], [`Parameters`] | nalgebra's vector |
///
/// Implement it for manifolds of your own.
pub trait Variable: 'static {
    /// The type of the variable in the graph.
    type Manifold: Manifold;

    /// The same thing in numbers that carry derivatives.
    type Lifted<T: Number>;

    /// Dimension of the tangent space.
    const DIM: usize;

    /// `retract(x, tangent)`, right to first order in `tangent` and exact where it is zero;
    /// `storage` is what [`Manifold::store`] wrote of `x`, `tangent` has [`DIM`](Self::DIM) entries.
    fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> Self::Lifted<T>;
}

/// A [`VectorN`] of length `N` among the variables of a residual: biases, scales, calibration.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<const N: usize>;

/// Several variables: a tuple of one to four.
pub trait Variables: 'static {
    /// Their keys, in the same order.
    type Keys;

    /// The count of variables.
    const COUNT: usize;

    /// What a residual gets.
    type Lifted<T: Number>;

    /// The keys without their types.
    fn ids(keys: Self::Keys) -> SmallVec<[VariableId; 4]>;

    /// Whether the variable at `position` may be of this manifold and dimension.
    fn accepts(position: usize, kind: &VariableType, dim: usize) -> bool;

    /// The variables moved along `tangent`, which is asked by position and component.
    fn lift<T: Number>(at: &Arguments<'_>, tangent: impl Fn(usize, usize) -> T) -> Self::Lifted<T>;
}

macro_rules! variables {
    ($($position:literal $variable:ident),+) => {
        impl<$($variable: Variable),+> Variables for ($($variable,)+) {
            type Keys = ($(Key<$variable::Manifold>,)+);
            const COUNT: usize = [$($position),+].len();
            type Lifted<T: Number> = ($($variable::Lifted<T>,)+);

            fn ids(keys: Self::Keys) -> SmallVec<[VariableId; 4]> {
                #[allow(non_snake_case, reason = "one name stands for the type and for its key")]
                let ($($variable,)+) = keys;
                smallvec![$($variable.id()),+]
            }

            fn accepts(position: usize, kind: &VariableType, dim: usize) -> bool {
                let fits = [$(kind.is::<$variable::Manifold>() && dim == $variable::DIM),+];
                fits.get(position).copied().unwrap_or(false)
            }

            fn lift<T: Number>(
                at: &Arguments<'_>,
                tangent: impl Fn(usize, usize) -> T,
            ) -> Self::Lifted<T> {
                ($({
                    let tangent: SmallVec<[T; 6]> =
                        (0..$variable::DIM).map(|component| tangent($position, component)).collect();
                    $variable::lift(at.storage($position), &tangent)
                },)+)
            }
        }
    };
}
variables!(0 A);
variables!(0 A, 1 B);
variables!(0 A, 1 B, 2 C);
variables!(0 A, 1 B, 2 C, 3 D);

impl Variable for Rot2 {
    type Manifold = Self;
    type Lifted<T: Number> = Rotation2<T>;
    const DIM: usize = 1;

    fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> Rotation2<T> {
        Rotation2::from(Self::load(storage)).turned(tangent[0])
    }
}

impl Variable for Rot3 {
    type Manifold = Self;
    type Lifted<T: Number> = Rotation3<T>;
    const DIM: usize = 3;

    fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> Rotation3<T> {
        Rotation3::from(Self::load(storage)).turned(&Vector3::from_column_slice(tangent))
    }
}

impl Variable for Pose2 {
    type Manifold = Self;
    type Lifted<T: Number> = Transform2<T>;
    const DIM: usize = 3;

    fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> Transform2<T> {
        let pose = Transform2::from(Self::load(storage));
        let way = Vector2::new(tangent[0], tangent[1]);
        Transform2::new(pose.rotation().turned(tangent[2]), pose.transform_point(&way))
    }
}

impl Variable for Pose3 {
    type Manifold = Self;
    type Lifted<T: Number> = Transform3<T>;
    const DIM: usize = 6;

    fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> Transform3<T> {
        let pose = Transform3::from(Self::load(storage));
        let way = Vector3::from_column_slice(&tangent[..3]);
        let turn = Vector3::from_column_slice(&tangent[3..]);
        Transform3::new(pose.rotation().turned(&turn), pose.transform_point(&way))
    }
}

/// What is stored is a plain vector.
macro_rules! flat {
    ($variable:ty, $manifold:ty, $dim:expr $(, const $n:ident)?) => {
        impl$(<const $n: usize>)? Variable for $variable {
            type Manifold = $manifold;
            type Lifted<T: Number> = SVector<T, { $dim }>;
            const DIM: usize = $dim;

            fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> Self::Lifted<T> {
                SVector::from_fn(|i, _| tangent[i] + storage[i])
            }
        }
    };
}
flat!(Point2, Self, 2);
flat!(Point3, Self, 3);
flat!(Parameters<N>, VectorN, N, const N);
