//! The motion of variables when a whole clique is moved as one rigid body.

use evergraph_model::{Motion, Value, VariableType, World};
use nalgebra::DMatrix;

/// The world of which the variable is a pose.
pub(crate) fn pose_of(kind: &VariableType) -> Option<World> {
    kind.motion().filter(|motion| motion.is_pose()).map(Motion::world)
}

/// The world whose rigid motions move the variable.
pub(crate) fn world_of(kind: &VariableType) -> Option<World> {
    kind.motion().map(Motion::world)
}

/// The number of entries that hold rotation at the end of a tangent.
pub(crate) fn rotation_part(kind: &VariableType) -> usize {
    kind.motion().map_or(0, Motion::rotation)
}

/// The motion of `value`, in its own tangent, when the pose `root` makes a right perturbation and
/// takes everything along: the matrix A with `dx = A dξ`. `None` for a variable that does not move with the root's
/// world, and for a root whose tangent is not that of its world.
///
/// Of a pose x it is `Ad(x⁻¹ T)` with `T` the root, of a point `C [I  -[c]×]` with `C` the rotation of the root and `c` the
/// point as seen from it. Entries are of the size of the clique, never of the world.
pub(crate) fn carried(root: &Value, value: &Value) -> Option<DMatrix<f64>> {
    let (of_root, motion) = (root.kind().motion()?, value.kind().motion()?);
    if of_root.world() != motion.world() {
        return None;
    }
    let n = of_root.world().dim();
    if root.dim() != n {
        return None;
    }
    let frame = of_root.frame(root.storage())?;
    let mut carried = DMatrix::zeros(value.dim(), n);
    motion.carried(value.storage(), &frame, carried.as_mut_slice());
    if !of_root.is_the_group() {
        // From the frame's right perturbation to the tangent of the root itself.
        let mut by_root = DMatrix::zeros(n, root.dim());
        of_root.frame_derivative(root.storage(), by_root.as_mut_slice());
        carried *= by_root;
    }
    Some(carried)
}
