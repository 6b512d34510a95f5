//! Laying an estimate over the truth.
//!
//! Where a map lies in the world is nothing that relative measurements say, so maps are compared
//! after the motion that suits the estimate best: with `xₖ` estimated and `yₖ` true positions,
//!
//! ```text
//! minimize over R, t (and s)    Σₖ ‖yₖ - (s R xₖ + t)‖²
//! ```
//!
//! (Umeyama 1991, equations 39 to 42). The rotation maximizes `Σ ỹₖᵀ R x̃ₖ` over the centered
//! positions: in space it is the eigenvector to the largest eigenvalue of Horn's 4x4 matrix, which
//! unlike a singular value decomposition never has to be turned back from a reflection; in the plane
//! an arc tangent.

use evergraph_model::{LieGroup, Point3, Pose3, Rot3};
use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};

use crate::{EvaluateError, PosePairs};

/// How an estimate is laid over the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Alignment {
    /// As it is.
    None,
    /// By the rigid motion that brings the positions closest; in the plane z = 0 if all poses lie
    /// there, so that no map is turned over.
    #[default]
    Rigid,
    /// Rigid with a scale, for maps whose scale is free.
    Similarity,
    /// First pose on first pose.
    FirstPose,
}

/// `x -> s R x + t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// `s`, positive.
    pub scale: f64,
    /// `R` and `t`.
    pub motion: Pose3,
}

impl Similarity {
    /// What leaves everything where it is.
    pub fn identity() -> Self {
        Self { scale: 1.0, motion: Pose3::identity() }
    }

    /// Where a point goes.
    pub fn transform_point(&self, point: &Point3) -> Point3 {
        self.motion.transform_point(&(self.scale * Vector3::from(*point)).into())
    }

    /// Where a pose goes; its rotation has no scale.
    pub fn transform_pose(&self, pose: &Pose3) -> Pose3 {
        let rotation = self.motion.rotation().compose(&pose.rotation());
        Pose3::new(rotation, self.transform_point(&pose.translation()))
    }
}

/// An alignment that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Aligned {
    /// `truth_from_estimate`.
    pub similarity: Similarity,
    /// Whether no other rotation lays the positions over one another as well. It is false where the
    /// positions of one side are all on one line in space, or all the same; then this is the
    /// smallest such rotation, and errors of rotation mean little. Always true for
    /// [`Alignment::None`] and [`Alignment::FirstPose`].
    pub unique: bool,
}

/// Below this share of the largest, two eigenvalues are one: what is left of the noise-free
/// positions on a line after rounding is a hundred times smaller.
const SAME: f64 = 1e-12;

/// Below this share of the mean, a spread of positions is rounding.
const ROUNDING: f64 = 1e-13;

impl PosePairs {
    /// The motion that lays the estimate over the truth.
    ///
    /// # Errors
    /// [`EvaluateError::NoScale`] where the scale is asked for and all positions of one side are the
    /// same; [`EvaluateError::Overflow`].
    pub fn align(&self, alignment: Alignment) -> Result<Aligned, EvaluateError> {
        let as_it_is =
            |motion| Ok(Aligned { similarity: Similarity { scale: 1.0, motion }, unique: true });
        match alignment {
            Alignment::None => as_it_is(Pose3::identity()),
            Alignment::FirstPose => {
                let first = &self.pairs()[0];
                as_it_is(first.truth.compose(&first.estimate.inverse()))
            }
            Alignment::Rigid => self.closest(false),
            Alignment::Similarity => self.closest(true),
        }
    }

    fn closest(&self, with_scale: bool) -> Result<Aligned, EvaluateError> {
        let positions = |of: fn(&crate::PosePair) -> Pose3| -> Vec<Vector3<f64>> {
            self.pairs().iter().map(|pair| of(pair).translation().into()).collect()
        };
        let (mut x, mut y) = (positions(|pair| pair.estimate), positions(|pair| pair.truth));
        let (mean_x, mean_y) = (center(&mut x)?, center(&mut y)?);
        // In units of the largest coordinate, so that no product overflows or vanishes.
        let (unit_x, unit_y) = (normalize(&mut x), normalize(&mut y));
        let correlation: Matrix3<f64> = x.iter().zip(&y).map(|(x, y)| x * y.transpose()).sum();
        let best = if self.is_planar() {
            in_plane(&correlation)
        } else {
            in_space(&correlation).ok_or(EvaluateError::Overflow)?
        };
        let spread: f64 = x.iter().map(Vector3::norm_squared).sum();
        let scale = match with_scale {
            false => 1.0,
            true if best.correlation > 0.0 => (best.correlation / spread) * (unit_y / unit_x),
            true => return Err(EvaluateError::NoScale),
        };
        let translation = mean_y - scale * best.rotation.rotate(&mean_x);
        if !(scale.is_finite() && translation.iter().all(|x| x.is_finite())) {
            return Err(EvaluateError::Overflow);
        }
        let motion = Pose3::new(best.rotation, translation);
        Ok(Aligned { similarity: Similarity { scale, motion }, unique: best.unique })
    }
}

/// Takes the mean off.
fn center(points: &mut [Vector3<f64>]) -> Result<Vector3<f64>, EvaluateError> {
    let count = points.len() as f64;
    let mean: Vector3<f64> = points.iter().map(|point| point / count).sum();
    points.iter_mut().for_each(|point| *point -= mean);
    // Of equal positions, rounding of the mean leaves a spread that is none.
    let spread = points.iter().map(|point| point.amax()).fold(0.0, f64::max);
    if spread <= ROUNDING * mean.amax() {
        points.iter_mut().for_each(|point| *point = Vector3::zeros());
    }
    let finite = points.iter().flatten().all(|x| x.is_finite());
    if finite { Ok(mean) } else { Err(EvaluateError::Overflow) }
}

/// Divides by the largest coordinate, if any is not zero, and returns what it divided by.
fn normalize(points: &mut [Vector3<f64>]) -> f64 {
    let largest = points.iter().map(|point| point.amax()).fold(0.0, f64::max);
    let unit = if largest > 0.0 { largest } else { 1.0 };
    points.iter_mut().for_each(|point| *point /= unit);
    unit
}

/// The best rotation.
struct Best {
    rotation: Rot3,
    unique: bool,
    /// `Σ ỹᵀ R x̃`.
    correlation: f64,
}

/// About the z axis, for `correlation = Σ x̃ ỹᵀ`.
fn in_plane(correlation: &Matrix3<f64>) -> Best {
    let sin = correlation[(0, 1)] - correlation[(1, 0)];
    let cos = correlation[(0, 0)] + correlation[(1, 1)];
    let size = sin.hypot(cos);
    let unique = size > SAME * correlation.norm();
    let yaw = if unique { sin.atan2(cos) } else { 0.0 };
    Best { rotation: Rot3::from_roll_pitch_yaw(0.0, 0.0, yaw), unique, correlation: size }
}

/// For `correlation = Σ x̃ ỹᵀ`: Horn (1987), section 4.
fn in_space(correlation: &Matrix3<f64>) -> Option<Best> {
    const MAX_ITERATIONS: usize = 1000;
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
    let space: Vec<Vector4<f64>> = (0..4)
        .filter(|&k| eigen.eigenvalues[k] >= largest - same)
        .map(|k| eigen.eigenvectors.column(k).into_owned())
        .collect();
    let unique = space.len() == 1;
    // Of unit quaternions in a subspace, the one of the smallest angle is the identity's projection.
    let projection: Vector4<f64> = space.iter().map(|v| v[0] * v).sum();
    let half_turns_only = projection.norm() < 1e-8;
    let q = if unique || half_turns_only { space[0] } else { projection };
    let rotation = Rot3::from_quaternion(q[1], q[2], q[3], q[0]).ok()?;
    Some(Best { rotation, unique, correlation: largest })
}
