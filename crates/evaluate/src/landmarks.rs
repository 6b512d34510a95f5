//! How far landmarks are from where they were.

use std::collections::BTreeMap;

use evergraph_model::Point3;
use nalgebra::Vector3;
use serde::Serialize;

use crate::{EvaluateError, Similarity, Statistics};

/// Distances between estimated and true landmarks of the same ids.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LandmarkError {
    /// Of the distances (m).
    pub distance: Statistics,
    /// Estimated landmarks that the truth does not know.
    pub unknown: usize,
    /// True landmarks that the estimate does not have.
    pub missing: usize,
}

impl LandmarkError {
    /// Measures landmarks by id, the estimate laid over the truth by `similarity`, which is that of
    /// the poses. `None` when no landmark has a partner.
    ///
    /// # Errors
    /// [`EvaluateError::Overflow`].
    pub fn of(
        estimate: &BTreeMap<u64, Point3>,
        truth: &BTreeMap<u64, Point3>,
        similarity: &Similarity,
    ) -> Result<Option<Self>, EvaluateError> {
        let distance = |(id, point): (&u64, &Point3)| {
            let aligned: Vector3<f64> = similarity.transform_point(point).into();
            let apart = aligned - Vector3::from(*truth.get(id)?);
            Some(apart.x.hypot(apart.y).hypot(apart.z))
        };
        let distances: Vec<f64> = estimate.iter().filter_map(distance).collect();
        let matched = distances.len();
        let (unknown, missing) = (estimate.len() - matched, truth.len() - matched);
        let statistics = Statistics::of(&distances)?;
        Ok(statistics.map(|distance| Self { distance, unknown, missing }))
    }
}
