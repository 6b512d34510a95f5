//! Motions with the world against numerical derivatives.

use nalgebra::SVector;

use super::{central, ensure, largest, size, small, subtract};
use crate::manifold::{LieGroup, Manifold, VariableType};
use crate::moves::{Frame, Moves};
use crate::world::World;

/// Step of the numerical derivatives, and the relative deviation from them that counts as truncation and rounding.
const STEP: f64 = 1e-3;
const DERIVATIVE: f64 = 1e-8;

/// Checks the laws of [`Moves`] for `values` and `frames`, which should be of moderate size and of rotations by less than
/// half a turn relative to each other: the action of the group, and the derivatives against central differences.
///
/// # Errors
/// A sentence that names the law, the value and the size of the deviation.
pub fn check_motion<V: Moves<G, N>, G: LieGroup<N>, const N: usize>(
    values: &[V],
    frames: &[G],
) -> Result<(), String> {
    let world = World::of::<G, N>();
    let motion = VariableType::of::<V>().motion();
    ensure(motion.is_some_and(|motion| motion.world() == world), || {
        format!("{}::MOTION does not name the world {}", V::NAME, G::NAME)
    })?;
    for x in values {
        let dim = x.dim();
        ensure(V::ROTATION <= dim, || {
            format!("{} has {} rotations in {dim} dimensions", V::NAME, V::ROTATION)
        })?;
        let scale = 1.0 + size(x);
        let same = local(x, &x.seen_from(&G::identity()));
        small("identity⁻¹ · x = x", x, &same, scale)?;
        let lever = written(dim * N, |out| x.lever(out));
        let moved = |xi: &SVector<f64, N>| x.seen_from(&G::exp(&-*xi));
        derivative("exp(ξ) · x by ξ", x, &lever, scale, |xi| local(x, &moved(xi)))?;
        for frame in frames {
            let scale = scale + size(frame);
            let seen = x.seen_from(frame);
            for other in frames {
                let (once, twice) = (x.seen_from(&frame.compose(other)), seen.seen_from(other));
                small(
                    "(a b)⁻¹ · x = b⁻¹ · (a⁻¹ · x)",
                    x,
                    &local(&once, &twice),
                    scale + size(other),
                )?;
            }
            let by_value = written(dim * dim, |out| x.seen_from_derivative(frame, out));
            by_tangent("frame⁻¹ · x by x", x, &by_value, scale, |y| {
                local(&seen, &y.seen_from(frame))
            })?;
            let carried = written(dim * N, |out| x.carried(frame, out));
            derivative("frame exp(ξ) frame⁻¹ · x by ξ", x, &carried, scale * scale, |xi| {
                let motion = frame.compose(&G::exp(xi)).compose(&frame.inverse());
                local(x, &x.seen_from(&motion.inverse()))
            })?;
        }
    }
    Ok(())
}

/// Checks the laws of [`Frame`] for `poses` and `frames`, and those of [`check_motion`].
///
/// # Errors
/// A sentence that names the law, the pose and the size of the deviation.
pub fn check_pose<V: Frame<G, N>, G: LieGroup<N>, const N: usize>(
    poses: &[V],
    frames: &[G],
) -> Result<(), String> {
    check_motion(poses, frames)?;
    ensure(VariableType::of::<V>().motion().is_some_and(|motion| motion.is_pose()), || {
        format!("{}::MOTION is not made by Motion::of_pose", V::NAME)
    })?;
    for x in poses {
        ensure(x.dim() == N, || {
            format!("{} has {} dimensions and its world has {N}", V::NAME, x.dim())
        })?;
        let own = x.frame();
        let scale = 1.0 + size(x);
        for frame in frames {
            let (expected, found) = (frame.between(&own), x.seen_from(frame).frame());
            let deviation = expected.between(&found).log();
            small("frame(m · x) = m frame(x)", x, deviation.as_slice(), scale + size(frame))?;
        }
        let by_tangent_of_x = written(N * N, |out| x.frame_derivative(out));
        by_tangent("the frame by x", x, &by_tangent_of_x, scale, |y| {
            own.between(&y.frame()).log().as_slice().to_vec()
        })?;
    }
    Ok(())
}

fn local<V: Manifold>(x: &V, y: &V) -> Vec<f64> {
    let mut out = vec![f64::NAN; x.dim()];
    x.local(y, &mut out);
    out
}

/// A matrix as the implementation writes it.
fn written(len: usize, write: impl FnOnce(&mut [f64])) -> Vec<f64> {
    let mut out = vec![0.0; len];
    write(&mut out);
    out
}

/// Compares a matrix with the derivative of `f` by a motion ξ.
fn derivative<const N: usize>(
    law: &str,
    at: &impl std::fmt::Debug,
    matrix: &[f64],
    scale: f64,
    f: impl Fn(&SVector<f64, N>) -> Vec<f64>,
) -> Result<(), String> {
    let numeric = (0..N).flat_map(|i| {
        central(STEP, |step| f(&SVector::from_fn(|k, _| if k == i { step } else { 0.0 })))
    });
    compare(law, at, matrix, &numeric.collect::<Vec<_>>(), scale)
}

/// Compares a matrix with the derivative of `f` by the tangent at `x`.
fn by_tangent<V: Manifold>(
    law: &str,
    x: &V,
    matrix: &[f64],
    scale: f64,
    f: impl Fn(&V) -> Vec<f64>,
) -> Result<(), String> {
    let numeric = (0..x.dim()).flat_map(|i| {
        central(STEP, |step| {
            let mut delta = vec![0.0; x.dim()];
            delta[i] = step;
            f(&x.retract(&delta))
        })
    });
    compare(law, x, matrix, &numeric.collect::<Vec<_>>(), scale)
}

fn compare(
    law: &str,
    at: &impl std::fmt::Debug,
    matrix: &[f64],
    numeric: &[f64],
    scale: f64,
) -> Result<(), String> {
    let worst = largest(&subtract(matrix, numeric));
    // Not `worst > …`: NaN has to fail.
    ensure(worst <= DERIVATIVE * scale, || {
        format!("the derivative of {law} deviates by {worst:e} from central differences at {at:?}")
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector1, Vector3, Vector6};

    use super::*;
    use crate::{Motion, Point2, Point3, Pose2, Pose3, Rot2, Rot3, VectorN};

    #[test]
    fn the_library_s_types_move_as_they_say() {
        let frames = [Pose2::new(3.0, -2.0, 0.8), Pose2::new(-1.0, 0.5, -0.4), Pose2::identity()];
        check_pose(&[Pose2::new(-1.0, 4.0, 1.5), Pose2::new(2.0, 0.0, -0.2)], &frames).unwrap();
        check_motion(&[Point2::new(-1.0, 4.0), Point2::new(0.0, 0.0)], &frames).unwrap();
        check_motion(&[Rot2::exp(&Vector1::new(0.3))], &frames).unwrap();
        let frames = [
            Pose3::exp(&Vector6::new(3.0, -2.0, 1.0, 0.4, -0.3, 0.9)),
            Pose3::exp(&Vector6::new(-1.0, 0.0, 0.2, -0.1, 0.6, 0.0)),
        ];
        let poses = [Pose3::exp(&Vector6::new(-1.0, 5.0, 0.5, -0.6, 0.1, 0.2))];
        check_pose(&poses, &frames).unwrap();
        check_motion(&[Point3::new(-1.0, 4.0, 2.0)], &frames).unwrap();
        check_motion(&[Rot3::exp(&Vector3::new(0.3, 0.2, -1.0))], &frames).unwrap();
        assert!(VariableType::of::<VectorN>().motion().is_none());
    }

    /// A point that forgets to turn with its world, and one that says nothing of it.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Wrong<const SAYS: bool>(Point2);

    impl<const SAYS: bool> Manifold for Wrong<SAYS> {
        const NAME: &'static str = "Wrong";
        const COMPONENTS: &'static [&'static str] = &["x", "y"];
        const MOTION: Option<Motion> =
            if SAYS { Some(Motion::of::<Self, Pose2, 3>()) } else { None };
        fn dim(&self) -> usize {
            2
        }
        fn storage_len(&self) -> usize {
            2
        }
        fn store(&self, out: &mut [f64]) {
            self.0.store(out);
        }
        fn load(storage: &[f64]) -> Self {
            Self(Point2::load(storage))
        }
        fn retract(&self, delta: &[f64]) -> Self {
            Self(self.0.retract(delta))
        }
        fn local(&self, other: &Self, out: &mut [f64]) {
            self.0.local(&other.0, out);
        }
    }

    impl<const SAYS: bool> Moves<Pose2, 3> for Wrong<SAYS> {
        const ROTATION: usize = 0;
        fn seen_from(&self, frame: &Pose2) -> Self {
            Self(self.0.seen_from(frame))
        }
        fn lever(&self, out: &mut [f64]) {
            self.0.lever(out);
        }
    }

    #[test]
    fn wrong_derivatives_are_named() {
        let frames = [Pose2::new(3.0, -2.0, 0.8)];
        let error = check_motion(&[Wrong::<true>(Point2::new(1.0, 2.0))], &frames).unwrap_err();
        assert!(error.contains("frame⁻¹ · x by x"), "{error}");
        let error = check_motion(&[Wrong::<false>(Point2::new(1.0, 2.0))], &frames).unwrap_err();
        assert!(error.contains("MOTION does not name the world Pose2"), "{error}");
    }
}
