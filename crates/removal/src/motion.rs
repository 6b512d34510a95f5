//! How things move when the whole clique is moved as one rigid body.

use evergraph_model::{LieGroup, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VariableType};
use nalgebra::{DMatrix, Matrix2, SMatrix};

/// Which poses move a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum World {
    Plane,
    Space,
}

pub(crate) const WORLDS: [World; 2] = [World::Plane, World::Space];

/// Whether the variable is a pose, and in which world.
pub(crate) fn pose_of(kind: &VariableType) -> Option<World> {
    if kind.is::<Pose2>() {
        Some(World::Plane)
    } else if kind.is::<Pose3>() {
        Some(World::Space)
    } else {
        None
    }
}

/// The world whose rigid motions move the variable to any other of its values.
pub(crate) fn world_of(kind: &VariableType) -> Option<World> {
    if kind.is::<Pose2>() || kind.is::<Point2>() || kind.is::<Rot2>() {
        Some(World::Plane)
    } else if kind.is::<Pose3>() || kind.is::<Point3>() || kind.is::<Rot3>() {
        Some(World::Space)
    } else {
        None
    }
}

/// The motion of `value`, in its own tangent, when the pose `root` makes a right perturbation and
/// takes everything along: the matrix A with `dx = A dξ`. `None` for what does not move.
///
/// With `T` the root, `C` its rotation and `c = T⁻¹ p`, from `T exp(ξ) T⁻¹` applied to
///
/// ```text
/// a pose x        Ad(x⁻¹ T)
/// a point p       C [I  -[c]×]     (in the plane C [I  J c])
/// a rotation R    [0  Rᵀ C]        (in the plane [0  1])
/// ```
///
/// Entries are of the size of the clique, never of the world.
pub(crate) fn carried(root: &Value, value: &Value) -> Option<DMatrix<f64>> {
    if let Some(root) = root.get::<Pose2>() {
        if let Some(pose) = value.get::<Pose2>() {
            return Some(dynamic(&pose.between(&root).adjoint()));
        } else if let Some(point) = value.get::<Point2>() {
            let c = root.inverse_transform_point(&point);
            let (cos, sin) = (root.rotation().cos(), root.rotation().sin());
            let rotation = Matrix2::new(cos, -sin, sin, cos);
            let lever = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -c.y(), 0.0, 1.0, c.x());
            return Some(dynamic(&(rotation * lever)));
        }
        return value.get::<Rot2>().map(|_| DMatrix::from_row_slice(1, 3, &[0.0, 0.0, 1.0]));
    }
    let root = root.get::<Pose3>()?;
    let rotation = root.rotation().matrix();
    if let Some(pose) = value.get::<Pose3>() {
        return Some(dynamic(&pose.between(&root).adjoint()));
    } else if let Some(point) = value.get::<Point3>() {
        let c = root.inverse_transform_point(&point).vector();
        let mut lever = SMatrix::<f64, 3, 6>::identity();
        lever.fixed_view_mut::<3, 3>(0, 3).copy_from(&-c.cross_matrix());
        return Some(dynamic(&(rotation * lever)));
    }
    value.get::<Rot3>().map(|own| {
        let mut turn = SMatrix::<f64, 3, 6>::zeros();
        turn.fixed_view_mut::<3, 3>(0, 3).copy_from(&(own.matrix().transpose() * rotation));
        dynamic(&turn)
    })
}

fn dynamic<const R: usize, const C: usize>(m: &SMatrix<f64, R, C>) -> DMatrix<f64> {
    DMatrix::from_column_slice(R, C, m.as_slice())
}

/// The number of entries that hold rotation at the end of a pose's tangent.
pub(crate) fn rotation_part(kind: &VariableType) -> usize {
    if kind.is::<Pose2>() || kind.is::<Rot2>() {
        1
    } else if kind.is::<Pose3>() || kind.is::<Rot3>() {
        3
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evergraph_model::Manifold;
    use nalgebra::{SVector, Vector3, Vector6};

    /// `A dξ` against the difference of the moved value.
    fn check<const N: usize, G, V>(root: G, value: V, act: impl Fn(G, &V) -> V)
    where
        G: LieGroup<N>,
        V: Manifold,
    {
        let motion = carried(&Value::new(&root), &Value::new(&value)).unwrap();
        for i in 0..N {
            let step = 1e-6 * SVector::<f64, N>::from_fn(|k, _| f64::from(u8::from(i == k)));
            let world = root.compose(&G::exp(&step)).compose(&root.inverse());
            let mut moved = vec![0.0; value.dim()];
            value.local(&act(world, &value), &mut moved);
            for (k, moved) in moved.iter().enumerate() {
                assert!((1e6 * moved - motion[(k, i)]).abs() < 1e-4, "{k} {i}");
            }
        }
    }

    #[test]
    fn everything_moves_with_the_root() {
        let root = Pose2::new(3.0, -2.0, 0.8);
        check(root, Pose2::new(-1.0, 4.0, 2.5), |m, x| m * *x);
        check(root, Point2::new(-1.0, 4.0), |m, p| m.transform_point(p));
        check(root, Rot2::exp(&nalgebra::Vector1::new(0.3)), |m, r| m.rotation() * *r);
        let root = Pose3::exp(&Vector6::new(3.0, -2.0, 1.0, 0.4, -0.3, 0.9));
        let other = Pose3::exp(&Vector6::new(-1.0, 5.0, 0.5, -1.6, 0.1, 0.2));
        check(root, other, |m, x| m * *x);
        check(root, Point3::new(-1.0, 4.0, 2.0), |m, p| m.transform_point(p));
        check(root, Rot3::exp(&Vector3::new(0.3, 0.2, -1.0)), |m, r| m.rotation() * *r);
    }
}
