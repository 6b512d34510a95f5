//! Laying an estimate over the truth.
//!
//! Where a map lies in the world is nothing that relative measurements say, so maps are compared
//! after the motion that suits the estimate best: with `xₖ` estimated and `yₖ` true positions,
//!
//! ```text
//! minimize over R, t (and s)    Σₖ ‖yₖ - (s R xₖ + t)‖²
//! ```
//!
//! (Umeyama 1991, equations 39 to 42; the rotation as in `rotation.rs`).

use evergraph_model::{LieGroup, Point3, Pose3, Rot3};
use nalgebra::Vector3;

use crate::rotation::{Ambiguity, Shapes};
use crate::{EvaluateError, PosePair, PosePairs};

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
    /// Why other motions lay the positions over one another as well; none where this is the only one,
    /// and for [`Alignment::None`] and [`Alignment::FirstPose`]. Of such rotations, this is the one that
    /// suits the orientations best.
    pub ambiguity: Option<Ambiguity>,
}

/// Below this share of the coordinates, differences of positions are rounding.
const ROUNDING: f64 = 1e-12;

impl PosePairs {
    /// The motion that lays the estimate over the truth.
    ///
    /// # Errors
    /// [`EvaluateError::Overflow`].
    pub fn align(&self, alignment: Alignment) -> Result<Aligned, EvaluateError> {
        let as_it_is =
            |motion| Ok(Aligned { similarity: Similarity { scale: 1.0, motion }, ambiguity: None });
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
        let positions = |of: fn(&PosePair) -> Pose3| -> Vec<Vector3<f64>> {
            self.pairs().iter().map(|pair| of(pair).translation().into()).collect()
        };
        let (mut x, mut y) = (positions(|pair| pair.estimate), positions(|pair| pair.truth));
        let (mean_x, mean_y) = (center(&mut x)?, center(&mut y)?);
        // In units of the largest coordinate, so that no product overflows or vanishes.
        let (unit_x, unit_y) = (normalize(&mut x), normalize(&mut y));
        let still = unit_x <= ROUNDING * mean_x.amax() || unit_y <= ROUNDING * mean_y.amax();
        let turns: Vec<Rot3> = self.pairs().iter().map(turn).collect();
        let shapes = Shapes { x: &x, y: &y, turns: &turns, planar: self.is_planar(), still };
        let best = shapes.best().ok_or(EvaluateError::Overflow)?;
        let spread: f64 = x.iter().map(Vector3::norm_squared).sum();
        let has_scale = with_scale && best.ambiguity != Some(Ambiguity::Still);
        let scale = if has_scale { (best.correlation / spread) * (unit_y / unit_x) } else { 1.0 };
        let translation = mean_y - scale * best.rotation.rotate(&mean_x);
        if !(scale.is_finite() && translation.iter().all(|x| x.is_finite())) {
            return Err(EvaluateError::Overflow);
        }
        let motion = Pose3::new(best.rotation, translation);
        Ok(Aligned { similarity: Similarity { scale, motion }, ambiguity: best.ambiguity })
    }
}

/// The rotation that brings one orientation onto the other.
fn turn(pair: &PosePair) -> Rot3 {
    pair.truth.rotation().compose(&pair.estimate.rotation().inverse())
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

/// Divides by the largest coordinate, if any is not zero, and returns it.
fn normalize(points: &mut [Vector3<f64>]) -> f64 {
    let largest = points.iter().map(|point| point.amax()).fold(0.0, f64::max);
    if largest > 0.0 {
        points.iter_mut().for_each(|point| *point /= largest);
    }
    largest
}
