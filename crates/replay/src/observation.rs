//! The factors of a file with their numbers, before there are variables for them.

use evergraph_factors::RootShift;
use evergraph_formats::{
    Coordinates, Document, Kind, Line, LinearMeasurement, Measurement, Quantity, Weight,
};
use evergraph_model::{Kernel, LieGroup, Noise, Pose3, Value};
use nalgebra::{DMatrix, DVector};
use smallvec::SmallVec;

use crate::error::ReplayerError;
use crate::geometry::{Geometry, bad, named_by};
use crate::order::Ties;

/// A line that is a factor.
#[derive(Clone, Debug)]
pub(crate) struct Observation {
    pub line: usize,
    /// What the factor stands under.
    pub kernel: Option<Kernel>,
    pub what: Observed,
}

/// What was measured.
#[derive(Clone, Debug)]
pub(crate) enum Observed {
    /// A pose or a point seen from a pose.
    Relative {
        /// `from_from_to`.
        measurement: Geometry,
        /// `robot_from_sensor` of a landmark in space.
        sensor: Option<Pose3>,
        noise: Noise,
    },
    /// Any other measurement of one variable or two.
    Quantity {
        quantity: Quantity,
        numbers: SmallVec<[f64; 4]>,
        /// `robot_from_sensor` of a prior on a sensor.
        sensor: Option<Pose3>,
        noise: Noise,
    },
    /// A generic linear constraint.
    Linear(Box<Constraint>),
}

/// The parts of a [`Linear`](evergraph_factors::Linear) factor.
#[derive(Clone, Debug)]
pub(crate) struct Constraint {
    pub points: Vec<Geometry>,
    pub root_shift: RootShift,
    pub sqrt_information: DMatrix<f64>,
    pub offset: DVector<f64>,
}

impl Observed {
    pub fn edge(
        document: &Document,
        line: &Line,
        (measurement, weight): (&Coordinates, &Weight),
        sensor: Option<Pose3>,
    ) -> Result<Self, ReplayerError> {
        let place = document.place(line.number);
        Ok(Self::Relative {
            measurement: named_by(measurement)
                .ok_or_else(|| bad(&place, "its quaternion names no rotation"))?,
            sensor,
            noise: document.noise(line, weight, measurement.kind().dim())?,
        })
    }

    pub fn measurement(
        document: &Document,
        line: &Line,
        measurement: &Measurement,
        sensor: Option<Pose3>,
    ) -> Result<Self, ReplayerError> {
        let place = document.place(line.number);
        let Measurement { quantity, ends, numbers, weight, .. } = measurement;
        let kinds: SmallVec<[Kind; 2]> = ends.iter().map(|(_, kind)| *kind).collect();
        let (mut count, mut rows) = Measurement::shape(*quantity, &kinds)
            .ok_or_else(|| bad(&place, format!("no {quantity:?} is measured on its variables")))?;
        if *quantity == Quantity::Partial {
            let dim = kinds[0].dim();
            rows = numbers.len().saturating_sub(count - dim) / dim;
            count += dim * rows.saturating_sub(1);
        }
        if numbers.len() != count {
            let problem = format!("it has {} numbers instead of {count}", numbers.len());
            return Err(bad(&place, problem));
        }
        let noise = document.noise(line, weight, rows)?;
        Ok(Self::Quantity { quantity: *quantity, numbers: numbers.clone(), sensor, noise })
    }

    pub fn linear(
        document: &Document,
        line: &Line,
        linear: &LinearMeasurement,
    ) -> Result<Self, ReplayerError> {
        let place = document.place(line.number);
        let LinearMeasurement { points, root_shift, rows, sqrt_information, offset } = linear;
        let points: Option<Vec<Geometry>> = points.iter().map(|(_, at)| named_by(at)).collect();
        let points = points.ok_or_else(|| bad(&place, "a quaternion names no rotation"))?;
        let columns: usize = points.iter().map(|point| point.value().dim()).sum();
        if rows.checked_mul(columns) != Some(sqrt_information.len()) || offset.len() != columns {
            return Err(bad(&place, "its matrix or its offset does not fit its variables"));
        }
        Ok(Self::Linear(Box::new(Constraint {
            points,
            root_shift: *root_shift,
            sqrt_information: DMatrix::from_row_slice(*rows, columns, sqrt_information),
            offset: DVector::from_column_slice(offset),
        })))
    }

    /// Whether it says nothing of where the world is.
    pub fn is_relative(&self) -> bool {
        match self {
            Self::Relative { .. } => true,
            Self::Quantity { quantity, .. } => matches!(
                quantity,
                Quantity::Between
                    | Quantity::Range
                    | Quantity::Bearing
                    | Quantity::BearingRange
                    | Quantity::Partial
            ),
            Self::Linear(_) => false,
        }
    }

    /// The kernel that the options put around it: see
    /// [`ReplayOptions::kernel`](super::ReplayOptions::kernel).
    pub fn kernel(&self, ends: usize, kernel: Option<Kernel>) -> Option<Kernel> {
        kernel.filter(|_| ends > 1 && !matches!(self, Self::Linear(_)))
    }

    /// What it ties its variables to each other with.
    pub fn ties(&self, kinds: &[Kind]) -> Ties {
        let one_kind = kinds.iter().all(|kind| kind.is_pose() && *kind == kinds[0]);
        match self {
            Self::Relative { .. } if one_kind => Ties::Poses,
            Self::Relative { noise, .. } if has_full_rank(noise) => Ties::Sighting,
            Self::Linear(constraint) if one_kind && kinds.len() > 1 && constraint.is_rigid() => {
                Ties::Poses
            }
            _ => Ties::Weak,
        }
    }

    /// True for a linear factor that holds all of its variables in place relative to its first, a pose.
    pub fn is_rigid(&self) -> bool {
        matches!(self, Self::Linear(constraint) if constraint.is_rigid())
    }

    /// The value of the variable at `target` of its ends, given that of the one at `known`.
    pub fn compose(&self, known: usize, value: &Geometry, target: usize) -> Option<Geometry> {
        let Self::Relative { measurement, sensor, .. } = self else {
            let Self::Linear(constraint) = self else { return None };
            let (known, target) = (constraint.points.get(known)?, constraint.points.get(target)?);
            let origin = match known {
                Geometry::Pose2(_) => Geometry::Pose2(LieGroup::identity()),
                Geometry::Pose3(_) => Geometry::Pose3(LieGroup::identity()),
                Geometry::Point2(_) | Geometry::Point3(_) => return None,
            };
            // The motion of the world that brings the known variable to its value.
            let motion = known.between(&origin)?.moved(value)?;
            return target.moved(&motion);
        };
        let backwards = target == 0;
        match (measurement, value) {
            (Geometry::Pose2(z), Geometry::Pose2(_)) if backwards => {
                Geometry::Pose2(LieGroup::inverse(z)).moved(value)
            }
            (Geometry::Pose3(z), Geometry::Pose3(_)) if backwards => {
                Geometry::Pose3(LieGroup::inverse(z)).moved(value)
            }
            (Geometry::Point3(z), Geometry::Pose3(_)) => {
                let in_robot = sensor.map_or(*z, |robot_from_sensor| robot_from_sensor * *z);
                Geometry::Point3(in_robot).moved(value)
            }
            _ => measurement.moved(value),
        }
    }
}

/// True if a measurement informs all of its directions. A sighting that does not leaves its landmark
/// undetermined, as a bearing does.
pub(crate) fn has_full_rank(noise: &Noise) -> bool {
    let eigenvalues = noise.information().symmetric_eigenvalues();
    eigenvalues.min() > 1e-12 * eigenvalues.max()
}

impl Constraint {
    /// True if all variables are held in place relative to the first, a pose, as far as the rank tells.
    fn is_rigid(&self) -> bool {
        let singular = self.sqrt_information.singular_values();
        let rank = singular.iter().filter(|&&s| s > 1e-9 * singular.max()).count();
        let dims = self.points.iter().map(|point| point.value().dim());
        rank + self.points[0].value().dim() >= dims.sum()
    }

    pub fn points(&self) -> Vec<Value> {
        self.points.iter().map(Geometry::value).collect()
    }
}
