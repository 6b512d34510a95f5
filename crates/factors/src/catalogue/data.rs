//! Factors and values as plain data.

use evergraph_model::{Kernel, Noise, NoiseError, VariableId};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::error::DataError;

/// A factor as plain data: the form of files, snapshots and bindings.
///
/// Conversion in either direction keeps every bit. Nothing here is checked;
/// [`Catalogue::to_factor`](super::Catalogue::to_factor) checks all of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FactorData {
    /// The stable name of the factor's type, for example `"Between<Pose2>"`.
    pub name: String,
    /// The variables, in the order of the factor.
    pub ends: Vec<VariableId>,
    /// The measured numbers, in the order in which the type stores them; see
    /// [`Description::parts`](super::Description::parts). SI units and radians.
    pub numbers: Vec<f64>,
    /// Values of types that the name does not say: the linearization points of a
    /// [`Linear`](crate::Linear) factor.
    pub values: Vec<ValueData>,
    /// The noise; `None` for types without one.
    pub noise: Option<NoiseData>,
    /// The robust kernel around the factor.
    pub kernel: Option<Kernel>,
    /// The given values of a [`Conditioned`](crate::Conditioned) factor, by ascending position. All else is then of the
    /// whole factor, but for `ends`, which are the variables that are left.
    #[serde(default)]
    pub given: Vec<GivenData>,
}

/// A value in the place of a variable of a factor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GivenData {
    /// The place of the variable among those of the whole factor, from 0.
    pub position: u32,
    /// The variable of the whole factor; it may be part of no graph any more.
    pub variable: VariableId,
    /// The value.
    pub value: ValueData,
}

/// A value of a variable as plain data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ValueData {
    /// The stable name of its type: [`Manifold::NAME`](evergraph_model::Manifold::NAME).
    pub kind: String,
    /// The stored numbers: [`Manifold::store`](evergraph_model::Manifold::store). A pose in the
    /// plane is `x y cos sin`, one in space `x y z qx qy qz qw`.
    pub numbers: Vec<f64>,
}

/// The square-root information `R` of a [`Noise`] as plain data: upper triangular, with a diagonal
/// that is not negative.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseData {
    /// The diagonal; all other entries are zero. At most [`NoiseData::LARGEST_DIAGONAL`] entries.
    Diagonal(Vec<f64>),
    /// The rows from the diagonal on, n (n + 1) / 2 entries.
    Upper(Vec<f64>),
}

impl NoiseData {
    /// The dimension up to which a diagonal is stored as such. A few bytes of data cannot ask for
    /// a large matrix this way.
    pub const LARGEST_DIAGONAL: usize = 64;

    /// Rows of the matrix; `None` for a number of entries that no triangle has, and for a diagonal
    /// that is too long.
    pub fn dim(&self) -> Option<usize> {
        match self {
            Self::Diagonal(entries) => {
                (entries.len() <= Self::LARGEST_DIAGONAL).then_some(entries.len())
            }
            Self::Upper(entries) => {
                // The root is exact far beyond any length that fits into memory.
                let n = (((8.0 * entries.len() as f64 + 1.0).sqrt() - 1.0) / 2.0).round() as usize;
                (n * (n + 1) / 2 == entries.len()).then_some(n)
            }
        }
    }

    /// The noise.
    ///
    /// # Errors
    /// [`DataError::NoiseEntries`] for a wrong number of entries, [`DataError::Noise`] for no
    /// entries, entries that are not finite, and a negative diagonal, which could not come back
    /// with the same bits.
    pub fn to_noise(&self) -> Result<Noise, DataError> {
        let (Self::Diagonal(entries) | Self::Upper(entries)) = self;
        let n = self.dim().ok_or(DataError::NoiseEntries { actual: entries.len() })?;
        let mut root = DMatrix::zeros(n, n);
        match self {
            Self::Diagonal(entries) => (0..n).for_each(|i| root[(i, i)] = entries[i]),
            Self::Upper(entries) => {
                for (&entry, (i, j)) in entries.iter().zip(upper_triangle(n)) {
                    root[(i, j)] = entry;
                }
            }
        }
        if let Some(index) = (0..n).find(|&i| root[(i, i)] < 0.0) {
            let sigma = 1.0 / root[(index, index)];
            return Err(NoiseError::BadSigma { index, sigma }.into());
        }
        Ok(Noise::from_sqrt_information(&root)?)
    }
}

impl From<&Noise> for NoiseData {
    fn from(noise: &Noise) -> Self {
        let (n, root) = (noise.dim(), noise.sqrt_information());
        let is_plain_zero = |(i, j)| i == j || root[(i, j)].to_bits() == 0.0_f64.to_bits();
        if n <= Self::LARGEST_DIAGONAL && upper_triangle(n).all(is_plain_zero) {
            return Self::Diagonal(root.diagonal().iter().copied().collect());
        }
        Self::Upper(upper_triangle(n).map(|place| root[place]).collect())
    }
}

/// Row and column of the entries from the diagonal on, row by row.
fn upper_triangle(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |i| (i..n).map(move |j| (i, j)))
}
