//! Checks for manifolds and factors of your own, one line each in a test.
//!
//! ```
//! use evergraph_model::testing::{check_lie_group, check_manifold};
//! use evergraph_model::{Pose2, Rot2};
//! use nalgebra::Vector1;
//!
//! let poses = [Pose2::new(1.0, 2.0, 3.0), Pose2::new(-4.0, 0.5, -1.0)];
//! check_manifold(&poses, &[vec![0.1, -0.2, 0.3]]).unwrap();
//! check_lie_group(&[Rot2::from_angle(0.3), Rot2::from_angle(-3.0)], &[Vector1::new(0.1)]).unwrap();
//! ```

mod derivatives;
mod motion;

use nalgebra::{SMatrix, SVector};

pub use derivatives::{
    JacobianCheck, JacobianError, assert_jacobian, check_gradient, check_jacobian,
};
pub use motion::{check_motion, check_pose};

use crate::manifold::{LieGroup, Manifold};

/// Relative deviation from a law that counts as rounding.
const LAW: f64 = 1e-10;

/// Checks the laws of [`Manifold`] at `points` (all of the same dimension) and `tangents`.
///
/// The tangents must be short enough for `local(x, retract(x, d)) = d` to hold: rotations of less
/// than half a turn.
///
/// # Errors
/// A sentence that names the law, the point and by how much it is broken.
pub fn check_manifold<V: Manifold>(points: &[V], tangents: &[Vec<f64>]) -> Result<(), String> {
    let local = |x: &V, y: &V| {
        let mut out = vec![f64::NAN; x.dim()];
        x.local(y, &mut out);
        out
    };
    for x in points {
        let mut storage = vec![f64::NAN; x.storage_len()];
        x.store(&mut storage);
        ensure(V::load(&storage) == *x, || format!("load(store(x)) != x for x = {x:?}"))?;
        ensure(V::COMPONENTS.is_empty() || V::COMPONENTS.len() == x.dim(), || {
            format!(
                "{} names {} components but has dimension {}",
                V::NAME,
                V::COMPONENTS.len(),
                x.dim()
            )
        })?;
        let scale = 1.0 + largest(&storage);
        small("local(x, x) = 0", x, &local(x, x), scale)?;
        small("retract(x, 0) = x", x, &local(x, &x.retract(&vec![0.0; x.dim()])), scale)?;
        for d in tangents {
            let difference = subtract(&local(x, &x.retract(d)), d);
            small("local(x, retract(x, d)) = d", x, &difference, scale + largest(d))?;
        }
        for y in points {
            let reached = x.retract(&local(x, y));
            y.store(&mut storage);
            small(
                "retract(x, local(x, y)) = y",
                x,
                &local(y, &reached),
                scale + largest(&storage),
            )?;
        }
    }
    Ok(())
}

/// Checks the group laws and the derivatives of [`LieGroup`] at `elements` and `tangents`
/// (rotations of less than half a turn by more than 1e-3), and the laws of [`Manifold`].
///
/// # Errors
/// A sentence that names the law, the element and by how much it is broken.
pub fn check_lie_group<G: LieGroup<N>, const N: usize>(
    elements: &[G],
    tangents: &[SVector<f64, N>],
) -> Result<(), String> {
    let plain: Vec<Vec<f64>> = tangents.iter().map(|d| d.as_slice().to_vec()).collect();
    check_manifold(elements, &plain)?;
    let distance = |x: &G, y: &G| x.inverse().compose(y).log();
    let identity = G::identity();
    for a in elements {
        let scale = 1.0 + size(a);
        small("a · a⁻¹ = 1", a, distance(&identity, &a.compose(&a.inverse())).as_slice(), scale)?;
        small("1 · a = a", a, distance(a, &identity.compose(a)).as_slice(), scale)?;
        small("a · 1 = a", a, distance(a, &a.compose(&identity)).as_slice(), scale)?;
        small("exp(log(a)) = a", a, distance(a, &G::exp(&a.log())).as_slice(), scale)?;
        for b in elements {
            let scale = scale + size(b);
            let between = distance(&a.between(b), &a.inverse().compose(b));
            small("between(a, b) = a⁻¹ · b", a, between.as_slice(), scale)?;
            for c in elements {
                let (left, right) = (a.compose(b).compose(c), a.compose(&b.compose(c)));
                small("(a·b)·c = a·(b·c)", a, distance(&left, &right).as_slice(), scale + size(c))?;
            }
        }
        for d in tangents {
            let (left, right) = (a.compose(&G::exp(d)), G::exp(&(a.adjoint() * d)).compose(a));
            small(
                "a · exp(d) = exp(Ad(a) d) · a",
                a,
                distance(&left, &right).as_slice(),
                scale + d.amax(),
            )?;
        }
    }
    for d in tangents {
        let scale = 1.0 + d.amax();
        small("log(exp(d)) = d", &d.as_slice(), (G::exp(d).log() - d).as_slice(), scale)?;
        let (jacobian, inverse) = (G::right_jacobian(d), G::right_jacobian_inverse(d));
        let identity = jacobian * inverse - SMatrix::<f64, N, N>::identity();
        small("Jr(d) Jr(d)⁻¹ = I", &d.as_slice(), identity.as_slice(), scale * scale)?;
        let mut numeric = SMatrix::<f64, N, N>::zeros();
        for i in 0..N {
            let column = central(1e-3, |step| {
                let mut moved = *d;
                moved[i] += step;
                distance(&G::exp(d), &G::exp(&moved)).as_slice().to_vec()
            });
            numeric.column_mut(i).copy_from_slice(&column);
        }
        let difference = (jacobian - numeric).amax();
        ensure(difference <= 1e-9 * scale, || {
            format!(
                "exp(d + e) ≈ exp(d) · exp(Jr(d) e) is broken by {difference:e} at d = {:?}",
                d.as_slice()
            )
        })?;
    }
    Ok(())
}

/// The five-point central difference, exact to the fourth order.
fn central(step: f64, f: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    let (near, far) = ([f(step), f(-step)], [f(2.0 * step), f(-2.0 * step)]);
    (0..near[0].len())
        .map(|i| (8.0 * (near[0][i] - near[1][i]) - (far[0][i] - far[1][i])) / (12.0 * step))
        .collect()
}

fn ensure(holds: bool, message: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(message()) }
}

fn small(
    law: &str,
    at: &impl std::fmt::Debug,
    deviation: &[f64],
    scale: f64,
) -> Result<(), String> {
    let worst = largest(deviation);
    // Not `worst > …`: NaN has to fail.
    ensure(worst <= LAW * scale, || format!("{law} is broken by {worst:e} at {at:?}"))
}

/// The largest magnitude; NaN if there is one.
fn largest(numbers: &[f64]) -> f64 {
    numbers
        .iter()
        .fold(0.0, |m: f64, x| if x.is_nan() || m.is_nan() { f64::NAN } else { m.max(x.abs()) })
}

fn subtract(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn size<V: Manifold>(x: &V) -> f64 {
    let mut storage = vec![0.0; x.storage_len()];
    x.store(&mut storage);
    largest(&storage)
}
