//! Vectors whose length is known at run time.

use std::fmt;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::manifold::Manifold;

/// A plain vector of any length: biases, calibration parameters, anything without curvature.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "Vec<f64>", into = "Vec<f64>")]
pub struct VectorN(DVector<f64>);

impl VectorN {
    /// The vector with these entries.
    pub fn new(entries: impl Into<Vec<f64>>) -> Self {
        Self(DVector::from_vec(entries.into()))
    }

    /// The vector of `len` zeros.
    pub fn zeros(len: usize) -> Self {
        Self(DVector::zeros(len))
    }

    /// How many entries it has.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The entries.
    pub fn as_slice(&self) -> &[f64] {
        self.0.as_slice()
    }

    /// The entries as nalgebra's vector.
    pub fn vector(&self) -> &DVector<f64> {
        &self.0
    }
}

impl Manifold for VectorN {
    const NAME: &'static str = "VectorN";
    const COMPONENTS: &'static [&'static str] = &[];

    fn dim(&self) -> usize {
        self.len()
    }

    fn storage_len(&self) -> usize {
        self.len()
    }

    fn store(&self, out: &mut [f64]) {
        out.copy_from_slice(self.as_slice());
    }

    fn load(storage: &[f64]) -> Self {
        Self(DVector::from_column_slice(storage))
    }

    fn retract(&self, delta: &[f64]) -> Self {
        Self(DVector::from_iterator(self.len(), self.0.iter().zip(delta).map(|(x, d)| x + d)))
    }

    fn local(&self, other: &Self, out: &mut [f64]) {
        for ((out, x), y) in out.iter_mut().zip(&self.0).zip(&other.0) {
            *out = y - x;
        }
    }
}

impl From<Vec<f64>> for VectorN {
    fn from(entries: Vec<f64>) -> Self {
        Self::new(entries)
    }
}

impl From<DVector<f64>> for VectorN {
    fn from(vector: DVector<f64>) -> Self {
        Self(vector)
    }
}

impl From<VectorN> for Vec<f64> {
    fn from(vector: VectorN) -> Self {
        vector.0.data.into()
    }
}

impl fmt::Debug for VectorN {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("VectorN").field(&self.as_slice()).finish()
    }
}
