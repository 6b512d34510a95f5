//! Measurements beyond poses and points seen from poses, in the numbers of a line.

use evergraph_factors::RootShift;
use evergraph_factors::catalogue::Part;
pub use evergraph_factors::catalogue::Quantity;
use smallvec::SmallVec;

use crate::coordinates::{Coordinates, Kind};
use crate::factor_data::{description, length_in_lines};
use crate::weight::Weight;

/// A measurement of one variable or of two.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The measured quantity.
    pub quantity: Quantity,
    /// Of what: the file's ids, and what kind of variable each names.
    pub ends: SmallVec<[(u64, Kind); 2]>,
    /// The measured numbers, as [`Quantity`] lists them.
    pub numbers: SmallVec<[f64; 4]>,
    /// Its matrix; rows as [`Quantity`] lists them.
    pub weight: Weight,
    /// `EDGE_SE3_PRIOR`, `EDGE_SE3_XYZ_PRIOR`: id of the sensor offset.
    pub parameter: Option<u64>,
}

/// A linear (GLC) factor: `e = G (Local(x', r(x)) - d')`.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearMeasurement {
    /// The variables, with their linearization points.
    pub points: Vec<(u64, Coordinates)>,
    /// The coordinates that it is linear in.
    pub root_shift: RootShift,
    /// Rows of `G`.
    pub rows: usize,
    /// `G`, row by row; the columns follow the variables, each in the order of its tangent.
    pub sqrt_information: Vec<f64>,
    /// `d'`, an entry for each column.
    pub offset: Vec<f64>,
}

impl Measurement {
    /// The types of the variables.
    pub fn kinds(&self) -> SmallVec<[Kind; 2]> {
        self.ends.iter().map(|(_, kind)| *kind).collect()
    }

    /// Rows of the matrix; `None` where ends and numbers are none that the quantity has.
    pub fn rows(&self) -> Option<usize> {
        let kinds = self.kinds();
        let (numbers, rows) = Self::shape(self.quantity, &kinds)?;
        if self.quantity != Quantity::Partial {
            return (self.numbers.len() == numbers).then_some(rows);
        }
        let dim = kinds[0].dim();
        let combinations = self.numbers.len().checked_sub(numbers - dim)?;
        let rows = combinations / dim;
        (combinations == rows * dim && (1..=dim).contains(&rows)).then_some(rows)
    }

    /// The count of numbers that are measured on variables of these kinds, and the rows of the
    /// matrix; `None` where the quantity is not measured on them, or is none of a [`Measurement`].
    /// For [`Quantity::Partial`] the numbers are those of one combination, of one row.
    ///
    /// The numbers are those of [`Quantity`]; a pose is that of a vertex line, by an angle or a
    /// quaternion.
    pub fn shape(quantity: Quantity, kinds: &[Kind]) -> Option<(usize, usize)> {
        if matches!(quantity, Quantity::Relative | Quantity::Linear) {
            return None;
        }
        let of = description(quantity, kinds)?;
        let length = |part: &Part| length_in_lines(*part).or_else(|| Some(kinds.first()?.dim()));
        let numbers = of.parts.iter().map(length).sum::<Option<usize>>()?;
        // A position has the numbers of an antenna without its place on the robot.
        let numbers = if quantity == Quantity::Position { numbers / 2 } else { numbers };
        Some((numbers, of.rows.unwrap_or(1)))
    }
}
