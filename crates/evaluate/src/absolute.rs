//! How far poses are from where they were.

use evergraph_model::{LieGroup, Pose3};
use serde::Serialize;

use crate::{EvaluateError, PosePairs, Similarity, Statistics};

/// The error of one pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PoseError {
    /// The pose's id, where it is known.
    pub id: Option<u64>,
    /// Its time, where that is known (s).
    pub time: Option<f64>,
    /// Length of the translation of the error (m).
    pub translation: f64,
    /// Angle of the rotation of the error, in [0, π] (rad).
    pub rotation: f64,
}

/// The absolute trajectory error (ATE; evo's APE) over all poses, `Eₖ = yₖ⁻¹ (S xₖ)`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AbsoluteError {
    /// Of the distances between positions, `‖trans(Eₖ)‖` (m); its `rmse` is what is called *the*
    /// ATE.
    pub translation: Statistics,
    /// Of the angles between orientations (rad).
    pub rotation: Statistics,
    /// Pose by pose.
    pub poses: Vec<PoseError>,
}

impl AbsoluteError {
    /// Measures the estimate, laid over the truth by `similarity` (of [`PosePairs::align`]).
    ///
    /// # Errors
    /// [`EvaluateError::Overflow`].
    pub fn of(pairs: &PosePairs, similarity: &Similarity) -> Result<Self, EvaluateError> {
        let error = |pair: &crate::PosePair| {
            let aligned = similarity.transform_pose(&pair.estimate);
            let (translation, rotation) = size(&pair.truth.between(&aligned));
            PoseError { id: pair.id, time: pair.time, translation, rotation }
        };
        let poses: Vec<PoseError> = pairs.pairs().iter().map(error).collect();
        let [translation, rotation] = summarize(poses.iter().map(|e| (e.translation, e.rotation)))?
            .ok_or(EvaluateError::NoPair { poses: 0, delta: 0 })?;
        Ok(Self { translation, rotation, poses })
    }
}

/// Length of the translation and angle of the rotation.
pub(crate) fn size(error: &Pose3) -> (f64, f64) {
    let length = error.x().hypot(error.y()).hypot(error.z());
    (length, error.rotation().log().norm())
}

/// Of translations and of rotations; `None` when there are none.
pub(crate) fn summarize(
    errors: impl Iterator<Item = (f64, f64)>,
) -> Result<Option<[Statistics; 2]>, EvaluateError> {
    let (translations, rotations): (Vec<f64>, Vec<f64>) = errors.unzip();
    let of_both = Statistics::of(&translations)?.zip(Statistics::of(&rotations)?);
    Ok(of_both.map(|(translation, rotation)| [translation, rotation]))
}
