//! How well motions are known.

use std::num::NonZeroUsize;

use evergraph_model::LieGroup;
use serde::Serialize;

use crate::absolute::{size, summarize};
use crate::{EvaluateError, PosePairs, Statistics};

/// Between which poses motions are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct RelativePairs {
    /// How many poses apart, counted among the poses that a truth is known for. Default: 1.
    pub delta: NonZeroUsize,
    /// All pairs `(k, k + Δ)`, so that motions overlap; else `(0, Δ), (Δ, 2Δ), …`, each starting
    /// where the one before ends. Default: not all, as evo's.
    pub all: bool,
}

impl Default for RelativePairs {
    fn default() -> Self {
        Self { delta: NonZeroUsize::MIN, all: false }
    }
}

impl RelativePairs {
    /// Sets [`delta`](Self::delta).
    #[must_use]
    pub const fn with_delta(mut self, delta: NonZeroUsize) -> Self {
        self.delta = delta;
        self
    }

    /// Sets [`all`](Self::all).
    #[must_use]
    pub const fn with_all(mut self, all: bool) -> Self {
        self.all = all;
        self
    }
}

/// The relative pose error (RPE), `Eₖ = (yₖ⁻¹ yₖ₊Δ)⁻¹ (xₖ⁻¹ xₖ₊Δ)`: the same wherever in the world
/// the estimate lies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RelativeError {
    /// Of the lengths of the translations (m).
    pub translation: Statistics,
    /// Of the angles of the rotations (rad).
    pub rotation: Statistics,
}

impl RelativeError {
    /// Compares motions.
    ///
    /// # Errors
    /// [`EvaluateError::NoPair`] when there are too few poses, [`EvaluateError::Overflow`].
    pub fn of(pairs: &PosePairs, between: RelativePairs) -> Result<Self, EvaluateError> {
        let (poses, delta) = (pairs.pairs(), between.delta.get());
        let step = if between.all { 1 } else { delta };
        let ends = poses.iter().zip(poses.iter().skip(delta)).step_by(step);
        let errors = ends.map(|(from, to)| {
            let truth = from.truth.between(&to.truth);
            size(&truth.between(&from.estimate.between(&to.estimate)))
        });
        let [translation, rotation] =
            summarize(errors)?.ok_or(EvaluateError::NoPair { poses: poses.len(), delta })?;
        Ok(Self { translation, rotation })
    }
}
