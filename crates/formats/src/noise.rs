//! The noise that the matrix of a line means.

use evergraph_model::Noise;

use crate::check::bad;
use crate::convert;
use crate::document::Document;
use crate::error::FormatError;
use crate::matrix;
use crate::record::Line;
use crate::weight::{Weight, WeightKind};

impl Document {
    /// The noise that the matrix of a factor's line means, in the engine's tangent order and units;
    /// `rows` is the number of rows that the measurement has.
    ///
    /// # Errors
    /// [`FormatError::BadMeasurement`] for a matrix of another size, or one that overflows.
    pub fn noise(&self, line: &Line, weight: &Weight, rows: usize) -> Result<Noise, FormatError> {
        let place = self.place(line.number);
        let mut written = matrix::as_written(weight, rows).ok_or_else(|| {
            bad(&place, "its matrix has not as many entries as the measurement needs")
        })?;
        let kind = if weight.entries.is_empty() { WeightKind::SquareRoot } else { weight.kind };
        let made = match kind {
            WeightKind::SquareRoot => Noise::from_sqrt_information(&written),
            WeightKind::Covariance => Noise::from_covariance(&written),
            WeightKind::Sigmas => Noise::from_sigmas(&weight.entries),
            WeightKind::Information => {
                let has_rotation = line.record.has_rotation_rows();
                if has_rotation && convert::half_angles(self, self.dialect()) {
                    convert::scale_rotation(&mut written, 0.5);
                }
                // What the printed digits can explain was decided, and counted, when the document was
                // made; here no negative eigenvalue is left that they do not.
                Noise::from_information_clipped(&written, f64::INFINITY).map(|(noise, _)| noise)
            }
        };
        made.map_err(|error| bad(&place, error))
    }
}
