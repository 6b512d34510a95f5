//! Two variables compared with a measured transform between them.

use std::any::Any;

use evergraph_model::{Arguments, LieGroup, Pose2, Pose3};
use nalgebra::{Matrix3, SVector};

use crate::cross::times_skew;

/// `xᵢ⁻¹ xⱼ` and its difference `e = Log(z⁻¹ (xᵢ⁻¹ xⱼ))` from the measurement `z`.
pub(crate) struct Relative<G, const N: usize> {
    transform: G,
    pub(crate) error: SVector<f64, N>,
}

impl<G: LieGroup<N>, const N: usize> Relative<G, N> {
    /// Of the first two arguments.
    // Inlined even where it has two callers: what it returns would go through memory.
    #[inline(always)]
    pub(crate) fn new(measurement: &G, at: &Arguments<'_>) -> Self {
        let transform = at.get::<G>(0).between(&at.get::<G>(1));
        Self { transform, error: measurement.between(&transform).log() }
    }

    /// Writes the derivatives of `e`, column-major,
    ///
    /// ```text
    /// Jⱼ = Jr⁻¹(e)       Jᵢ = -Jr⁻¹(e) Ad((xᵢ⁻¹ xⱼ)⁻¹)
    /// ```
    ///
    /// Factors of poses spend most of their time here, and nearly half of the entries of these
    /// matrices are known: poses have versions of their own. Which one it is, is decided when this
    /// is compiled.
    #[inline(always)]
    pub(crate) fn jacobians(&self, from: &mut [f64], to: &mut [f64]) {
        let any: &dyn Any = self;
        if let Some(in_plane) = any.downcast_ref::<Relative<Pose2, 3>>() {
            in_plane.jacobians_in_plane(from, to);
        } else if let Some(in_space) = any.downcast_ref::<Relative<Pose3, 6>>() {
            in_space.jacobians_in_space(from, to);
        } else {
            self.jacobians_of_any_group(from, to);
        }
    }

    #[inline(always)]
    fn jacobians_of_any_group(&self, from: &mut [f64], to: &mut [f64]) {
        let by_to = G::right_jacobian_inverse(&self.error);
        let by_from = -(by_to * self.transform.inverse().adjoint());
        from.copy_from_slice(by_from.as_slice());
        to.copy_from_slice(by_to.as_slice());
    }
}

impl Relative<Pose2, 3> {
    /// With `Jⱼ = [A b; 0 1]` and the rotation `C` and translation `t` of `xᵢ⁻¹ xⱼ`
    ///
    /// ```text
    /// Jᵢ = [-P  P (t_y, -t_x)ᵀ - b; 0  -1],   P = A Cᵀ
    /// ```
    ///
    /// where `A`, `C` and `P` are multiples of rotations.
    #[inline(always)]
    fn jacobians_in_plane(&self, from: &mut [f64], to: &mut [f64]) {
        let j = Pose2::right_jacobian_inverse(&self.error);
        let (x, y) = (self.transform.x(), self.transform.y());
        let (cos, sin) = (self.transform.rotation().cos(), self.transform.rotation().sin());
        // The first columns of A and P.
        let (a, c) = (j[(0, 0)], j[(1, 0)]);
        let (p, q) = (a * cos + c * sin, c * cos - a * sin);
        let b = [p * y + q * x - j[(0, 2)], q * y - p * x - j[(1, 2)]];
        from.copy_from_slice(&[-p, -q, 0.0, q, -p, 0.0, b[0], b[1], -1.0]);
        to.copy_from_slice(j.as_slice());
    }
}

impl Relative<Pose3, 6> {
    /// With `Jⱼ = [A B; 0 A]` and the rotation `C` and translation `t` of `xᵢ⁻¹ xⱼ`
    ///
    /// ```text
    /// Jᵢ = [-P  P [t]× - B Cᵀ; 0  -P],   P = A Cᵀ
    /// ```
    #[inline(always)]
    fn jacobians_in_space(&self, from: &mut [f64], to: &mut [f64]) {
        let j = Pose3::right_jacobian_inverse(&self.error);
        let a = Matrix3::from_fn(|i, k| j[(i, k)]);
        let b = Matrix3::from_fn(|i, k| j[(i, k + 3)]);
        let inverse = self.transform.rotation().matrix().transpose();
        let t = self.transform.translation().vector();
        let p = a * inverse;
        write_block_triangular(&-p, &(times_skew(&p, &t) - b * inverse), from);
        write_block_triangular(&a, &b, to);
    }
}

/// `[A B; 0 A]`, column-major.
#[inline(always)]
fn write_block_triangular(a: &Matrix3<f64>, b: &Matrix3<f64>, out: &mut [f64]) {
    let (columns, _) = out.as_chunks_mut::<6>();
    let (left, right) = columns.split_at_mut(3);
    for j in 0..3 {
        left[j] = [a[(0, j)], a[(1, j)], a[(2, j)], 0.0, 0.0, 0.0];
        right[j] = [b[(0, j)], b[(1, j)], b[(2, j)], a[(0, j)], a[(1, j)], a[(2, j)]];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DVector, Vector3, Vector6};

    fn check<G: LieGroup<N>, const N: usize>(measurement: &SVector<f64, N>, i: G, j: G) {
        let (mut x, mut y) = (vec![0.0; i.storage_len()], vec![0.0; j.storage_len()]);
        i.store(&mut x);
        j.store(&mut y);
        let relative = Relative::new(&G::exp(measurement), &Arguments::new(&[&x, &y]));
        let blocks = || (DVector::from_element(N * N, f64::NAN), DVector::zeros(N * N));
        let (mut special, mut any) = (blocks(), blocks());
        relative.jacobians(special.0.as_mut_slice(), special.1.as_mut_slice());
        relative.jacobians_of_any_group(any.0.as_mut_slice(), any.1.as_mut_slice());
        assert!((special.0 - any.0).amax() < 1e-13);
        assert!((special.1 - any.1).amax() < 1e-13);
    }

    #[test]
    fn poses_have_the_derivatives_of_any_group() {
        let plane = [Vector3::new(3.0, -2.0, 0.4), Vector3::new(-1.0, 5.0, 2.9)];
        let space = [
            Vector6::new(3.0, -2.0, 1.0, 0.4, -0.3, 0.9),
            Vector6::new(-1.0, 5.0, 0.5, -1.6, 2.1, 0.2),
        ];
        for scale in [1.0, 0.1, 1e-5, 0.0] {
            let [i, j] = plane.map(|d| Pose2::exp(&d));
            check(&(scale * plane[0]), i, j);
            check(&plane[1], i, i * Pose2::exp(&plane[1]) * Pose2::exp(&(scale * plane[0])));
            let [i, j] = space.map(|d| Pose3::exp(&d));
            check(&(scale * space[0]), i, j);
            check(&space[1], i, i * Pose3::exp(&space[1]) * Pose3::exp(&(scale * space[0])));
        }
    }
}
