//! Variables that move with their world.

use std::any::TypeId;

use nalgebra::DMatrix;
use smallvec::SmallVec;

use crate::manifold::{LieGroup, Manifold};
use crate::world::{Motion, PoseMotion, World};

/// A variable that moves with the rigid motions `G` of its world.
///
/// The motions act from the left: `m · x` is the variable after the world has been moved by `m`. Removal and root shifts
/// read this. A type announces it by [`Manifold::MOTION`], and [`check_motion`](crate::testing::check_motion) compares
/// it with numerical derivatives.
///
/// `dim` is the tangent dimension of the variable; matrices are column-major and zero when they are given.
///
/// # Examples
/// A place in the plane that has a weight of its own:
///
/// ```
/// use evergraph_model::testing::check_motion;
/// use evergraph_model::{Manifold, Motion, Moves, Point2, Pose2};
///
/// #[derive(Clone, Debug, PartialEq)]
/// struct Tree {
///     place: Point2,
///     age: f64,
/// }
///
/// impl Manifold for Tree {
///     const NAME: &'static str = "Tree";
///     const COMPONENTS: &'static [&'static str] = &["x", "y", "age"];
///     const MOTION: Option<Motion> = Some(Motion::of::<Self, Pose2, 3>());
///     fn dim(&self) -> usize {
///         3
///     }
///     fn storage_len(&self) -> usize {
///         3
///     }
///     fn store(&self, out: &mut [f64]) {
///         out.copy_from_slice(&[self.place.x(), self.place.y(), self.age]);
///     }
///     fn load(s: &[f64]) -> Self {
///         Self { place: Point2::new(s[0], s[1]), age: s[2] }
///     }
///     fn retract(&self, d: &[f64]) -> Self {
///         Self { place: self.place.retract(&d[..2]), age: self.age + d[2] }
///     }
///     fn local(&self, other: &Self, out: &mut [f64]) {
///         self.place.local(&other.place, &mut out[..2]);
///         out[2] = other.age - self.age;
///     }
/// }
///
/// impl Moves<Pose2, 3> for Tree {
///     const ROTATION: usize = 0;
///     fn seen_from(&self, frame: &Pose2) -> Self {
///         Self { place: frame.inverse_transform_point(&self.place), ..self.clone() }
///     }
///     fn seen_from_derivative(&self, frame: &Pose2, out: &mut [f64]) {
///         let (cos, sin) = (frame.rotation().cos(), frame.rotation().sin());
///         out.copy_from_slice(&[cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0]);
///     }
///     fn lever(&self, out: &mut [f64]) {
///         let (x, y) = (self.place.x(), self.place.y());
///         out.copy_from_slice(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -y, x, 0.0]);
///     }
/// }
///
/// let tree = Tree { place: Point2::new(3.0, -1.0), age: 80.0 };
/// check_motion(&[tree], &[Pose2::new(1.0, 2.0, 0.5), Pose2::new(-4.0, 0.0, 2.0)]).unwrap();
/// ```
pub trait Moves<G: LieGroup<N>, const N: usize>: Manifold {
    /// The number of entries at the end of the tangent that are rotations, in radians.
    const ROTATION: usize;

    /// Whether a root shift replaces the variable by its coordinates relative to the root. `false` keeps it as it is.
    const IS_SEEN: bool = true;

    /// The coordinates relative to `frame`: `frame⁻¹ · self`.
    #[must_use]
    fn seen_from(&self, frame: &G) -> Self;

    /// The derivative of [`seen_from`](Self::seen_from) by `self`, tangents on both sides: `dim × dim`. The identity by
    /// default, which is right for right perturbations of group elements.
    fn seen_from_derivative(&self, frame: &G, out: &mut [f64]) {
        let _ = frame;
        let dim = self.dim();
        (0..dim).for_each(|i| out[i * (dim + 1)] = 1.0);
    }

    /// The motion of `self`, in its tangent, when the world is moved by `exp(ξ)`: the derivative of `exp(ξ) · self` by ξ
    /// at zero, `dim × N`.
    fn lever(&self, out: &mut [f64]);

    /// The motion of `self`, in its tangent, when `frame` makes a right perturbation ξ and takes the world along:
    /// `dim × N`. Entries are of the size of the distance to the frame, not to the origin.
    ///
    /// By default computed from the other functions: [`lever`](Self::lever) at `frame⁻¹ · self`, brought back by the inverse
    /// of [`seen_from_derivative`](Self::seen_from_derivative). NaN where that has none.
    fn carried(&self, frame: &G, out: &mut [f64]) {
        let dim = self.dim();
        self.seen_from(frame).lever(out);
        let mut derivative = DMatrix::zeros(dim, dim);
        self.seen_from_derivative(frame, derivative.as_mut_slice());
        let carried = derivative.lu().solve(&DMatrix::from_column_slice(dim, N, out));
        match carried {
            Some(carried) => out.copy_from_slice(carried.as_slice()),
            None => out.fill(f64::NAN),
        }
    }
}

/// A pose: a variable that is a frame of its world, from which other variables can be seen. Its tangent has as many
/// dimensions as the world, `N`.
///
/// [`check_pose`](crate::testing::check_pose) compares an implementation with numerical derivatives.
pub trait Frame<G: LieGroup<N>, const N: usize>: Moves<G, N> {
    /// The frame, with `m · self` having the frame `m * frame`.
    fn frame(&self) -> G;

    /// The right perturbation ξ of the frame, `frame * exp(ξ)`, by a tangent vector of `self`: `N × N`. The identity by
    /// default, which is right for a pose that is the group itself.
    fn frame_derivative(&self, out: &mut [f64]) {
        (0..N).for_each(|i| out[i * (N + 1)] = 1.0);
    }
}

impl World {
    /// The world whose motions are the elements of `G`.
    pub const fn of<G: LieGroup<N>, const N: usize>() -> Self {
        Self { group: TypeId::of::<G>(), name: G::NAME, dim: N }
    }
}

impl Motion {
    /// The motion of a variable that is no pose, for [`Manifold::MOTION`].
    pub const fn of<V: Moves<G, N>, G: LieGroup<N>, const N: usize>() -> Self {
        Self {
            world: World::of::<G, N>(),
            rotation: V::ROTATION,
            is_seen: V::IS_SEEN,
            seen_from: |x, frame, out| V::load(x).seen_from(&G::load(frame)).store(out),
            seen_from_derivative: |x, frame, out| {
                out.fill(0.0);
                V::load(x).seen_from_derivative(&G::load(frame), out);
            },
            lever: |x, out| {
                out.fill(0.0);
                V::load(x).lever(out);
            },
            carried: |x, frame, out| {
                out.fill(0.0);
                V::load(x).carried(&G::load(frame), out);
            },
            pose: None,
        }
    }

    /// The motion of a pose, for [`Manifold::MOTION`].
    pub const fn of_pose<V: Frame<G, N>, G: LieGroup<N>, const N: usize>() -> Self {
        let pose = PoseMotion {
            kind: TypeId::of::<V>(),
            frame: |x| {
                let frame = V::load(x).frame();
                let mut stored = SmallVec::from_elem(0.0, frame.storage_len());
                frame.store(&mut stored);
                stored
            },
            frame_derivative: |x, out| {
                out.fill(0.0);
                V::load(x).frame_derivative(out);
            },
            inverted: |x, out| {
                // `frame⁻¹ · (frame⁻¹ · x)` has the frame `frame⁻¹`.
                let pose = V::load(x);
                let frame = pose.frame();
                pose.seen_from(&frame).seen_from(&frame).store(out);
            },
        };
        Self { pose: Some(pose), ..Self::of::<V, G, N>() }
    }
}
