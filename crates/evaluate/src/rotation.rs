//! The rotation that brings positions closest, and whether it is the only one.
//!
//! It maximizes `Σ ỹₖᵀ R x̃ₖ` over centered positions: in space it is the eigenvector to the largest
//! eigenvalue of Horn's 4x4 matrix, which unlike a singular value decomposition never has to be turned
//! back from a reflection; in the plane an arc tangent. Where several rotations do that equally well,
//! the one that suits the orientations best is taken.

use evergraph_model::Rot3;
use nalgebra::{DMatrix, Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};

/// What positions leave open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Ambiguity {
    /// The rotation and the scale, which is 1 then: on one side all positions are the same, or the two
    /// sides are no more alike than noise (from 12 poses on).
    Still,
    /// The rotation about a line that all positions of one side lie on, up to noise.
    Line,
}

/// Below this share of the largest, two eigenvalues are one: what is left of the noise-free
/// positions on a line after rounding is a hundred times smaller.
const SAME: f64 = 1e-12;
/// A squared correlation below this, over the number of positions, is what noise has with noise: one
/// pair in 70 has more along a line, fewer in space.
const CHANCE: f64 = 6.0;
/// With fewer positions than this, chance explains any correlation and nothing is said of it.
const FEW: usize = 12;

/// The best rotation.
pub(crate) struct Best {
    pub(crate) rotation: Rot3,
    pub(crate) ambiguity: Option<Ambiguity>,
    /// `Σ ỹᵀ R x̃`.
    pub(crate) correlation: f64,
}

/// What is to be laid over what.
pub(crate) struct Shapes<'a> {
    /// Centered positions.
    pub(crate) x: &'a [Vector3<f64>],
    /// Centered positions that they are to come close to.
    pub(crate) y: &'a [Vector3<f64>],
    /// Rotations between orientations.
    pub(crate) turns: &'a [Rot3],
    /// Whether all lie in the plane.
    pub(crate) planar: bool,
    /// Whether all positions of one side are the same.
    pub(crate) still: bool,
}

impl Shapes<'_> {
    /// `None` where numbers overflow.
    pub(crate) fn best(&self) -> Option<Best> {
        let correlation = self.x.iter().zip(self.y).map(|(x, y)| x * y.transpose()).sum();
        let (mut space, largest) =
            if self.planar { in_plane(&correlation) } else { in_space(&correlation)? };
        let mut ambiguity = match (space.len(), self.planar) {
            (1, _) => None,
            (2, false) => Some(Ambiguity::Line),
            _ => Some(Ambiguity::Still),
        };
        if self.still || is_chance(self.x, self.y, largest) {
            ambiguity = Some(Ambiguity::Still);
            let units = Matrix4::identity();
            let free: &[usize] = if self.planar { &[0, 3] } else { &[0, 1, 2, 3] };
            space = free.iter().map(|&k| units.column(k).into_owned()).collect();
        } else if ambiguity.is_none() && !self.planar {
            let rotation = rotation(&space[0])?;
            if let Some(axis) = self.only_axis(&rotation) {
                ambiguity = Some(Ambiguity::Line);
                space.push(about(&axis, &space[0]));
            }
        }
        let rotation = rotation(&self.suiting(&space)?)?;
        Some(Best { rotation, ambiguity, correlation: largest })
    }

    /// The line that the positions lie on, but for noise.
    fn only_axis(&self, rotation: &Rot3) -> Option<Vector3<f64>> {
        let spread: Matrix3<f64> = self.y.iter().map(|y| y * y.transpose()).sum();
        let eigen = spread.symmetric_eigen();
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let off_axis = |point: Vector3<f64>| point - axis * axis.dot(&point);
        let x: Vec<_> = self.x.iter().map(|x| off_axis(rotation.rotate(x))).collect();
        let y: Vec<_> = self.y.iter().map(|y| off_axis(*y)).collect();
        let correlation = x.iter().zip(&y).map(|(x, y)| x.dot(y)).sum();
        is_chance(&x, &y, correlation).then_some(axis)
    }

    /// Of unit quaternions in a space, the one that suits the orientations best; if they do not say
    /// either, the smallest rotation.
    fn suiting(&self, space: &[Vector4<f64>]) -> Option<Vector4<f64>> {
        if let [only] = space {
            return Some(*only);
        }
        let turns: Matrix4<f64> = self
            .turns
            .iter()
            .map(|turn| {
                let [x, y, z, w] = turn.quaternion();
                let turn = Vector4::new(w, x, y, z);
                turn * turn.transpose()
            })
            .sum();
        let of = |i: usize, j: usize| space[i].dot(&(turns * space[j]));
        let matrix = DMatrix::from_fn(space.len(), space.len(), of);
        let eigen = SymmetricEigen::try_new(matrix, f64::EPSILON, MAX_ITERATIONS)?;
        let best = eigen.eigenvalues.imax();
        let second = (0..space.len()).filter(|k| *k != best).map(|k| eigen.eigenvalues[k]);
        if second.fold(0.0, f64::max) < (1.0 - SAME.sqrt()) * eigen.eigenvalues[best] {
            let shares = eigen.eigenvectors.column(best);
            return Some(space.iter().zip(shares.iter()).map(|(v, share)| *share * v).sum());
        }
        let projection: Vector4<f64> = space.iter().map(|v| v[0] * v).sum();
        let half_turns_only = projection.norm() < 1e-8;
        Some(if half_turns_only { space[0] } else { projection })
    }
}

/// Whether noise would correlate as much.
fn is_chance(x: &[Vector3<f64>], y: &[Vector3<f64>], correlation: f64) -> bool {
    let spread = |points: &[Vector3<f64>]| points.iter().map(Vector3::norm_squared).sum::<f64>();
    let share = CHANCE / x.len() as f64;
    x.len() >= FEW && correlation * correlation <= share * spread(x) * spread(y)
}

const MAX_ITERATIONS: usize = 1000;

/// About the z axis, for `correlation = Σ x̃ ỹᵀ`: the quaternions and the largest correlation.
fn in_plane(correlation: &Matrix3<f64>) -> (Vec<Vector4<f64>>, f64) {
    let sin = correlation[(0, 1)] - correlation[(1, 0)];
    let cos = correlation[(0, 0)] + correlation[(1, 1)];
    let size = sin.hypot(cos);
    if size > SAME * correlation.norm() {
        let (sin, cos) = (0.5 * sin.atan2(cos)).sin_cos();
        return (vec![Vector4::new(cos, 0.0, 0.0, sin)], size);
    }
    (vec![Vector4::x(), Vector4::w()], size)
}

/// For `correlation = Σ x̃ ỹᵀ`: Horn (1987), section 4.
fn in_space(correlation: &Matrix3<f64>) -> Option<(Vec<Vector4<f64>>, f64)> {
    let s = |i, j| correlation[(i, j)];
    #[rustfmt::skip]
    let horn = Matrix4::new(
        s(0, 0) + s(1, 1) + s(2, 2), s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0),
        s(1, 2) - s(2, 1), s(0, 0) - s(1, 1) - s(2, 2), s(0, 1) + s(1, 0), s(2, 0) + s(0, 2),
        s(2, 0) - s(0, 2), s(0, 1) + s(1, 0), s(1, 1) - s(0, 0) - s(2, 2), s(1, 2) + s(2, 1),
        s(0, 1) - s(1, 0), s(2, 0) + s(0, 2), s(1, 2) + s(2, 1), s(2, 2) - s(0, 0) - s(1, 1),
    );
    let eigen = SymmetricEigen::try_new(horn, f64::EPSILON, MAX_ITERATIONS)?;
    let largest = eigen.eigenvalues.max();
    let same = SAME * eigen.eigenvalues.amax();
    let space = (0..4)
        .filter(|&k| eigen.eigenvalues[k] >= largest - same)
        .map(|k| eigen.eigenvectors.column(k).into_owned())
        .collect();
    Some((space, largest))
}

/// The rotation of a quaternion `w x y z`.
fn rotation(q: &Vector4<f64>) -> Option<Rot3> {
    Rot3::from_quaternion(q[1], q[2], q[3], q[0]).ok()
}

/// A half turn about an axis after the rotation of a quaternion `w x y z`.
fn about(axis: &Vector3<f64>, q: &Vector4<f64>) -> Vector4<f64> {
    let vector = Vector3::new(q[1], q[2], q[3]);
    let turned = axis * q[0] + axis.cross(&vector);
    Vector4::new(-axis.dot(&vector), turned.x, turned.y, turned.z)
}
