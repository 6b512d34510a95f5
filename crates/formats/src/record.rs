//! What a line of a graph file says, in the file's own numbers.

use evergraph_model::Kernel;
use smallvec::SmallVec;

use crate::coordinates::{Coordinates, Kind};
use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::weight::Weight;

/// A line of a graph file: what it says, and what the file says about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// The line, from 1; 0 for a record that was added later.
    pub number: usize,
    /// What it says.
    pub record: Record,
    /// Few lines have any, and a file has millions of lines.
    notes: Option<Box<Notes>>,
}

/// What is said about a line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Notes {
    time: Option<f64>,
    kernel: Option<Kernel>,
}

impl From<Record> for Line {
    /// A record of no file, without time and kernel.
    fn from(record: Record) -> Self {
        Self::new(0, record)
    }
}

impl Line {
    /// What line `number` says.
    pub fn new(number: usize, record: Record) -> Self {
        Self { number, record, notes: None }
    }

    /// When, in seconds, where the file says so (PyFactorGraph).
    pub fn time(&self) -> Option<f64> {
        self.notes.as_ref()?.time
    }

    /// The robust kernel that the factor stands under; `None` for anything but a factor.
    pub fn kernel(&self) -> Option<Kernel> {
        self.notes.as_ref()?.kernel
    }

    /// Gives it a time, or none.
    pub fn set_time(&mut self, time: Option<f64>) {
        self.set_notes(Notes { time, kernel: self.kernel() });
    }

    /// Puts it under a kernel, or none.
    pub fn set_kernel(&mut self, kernel: Option<Kernel>) {
        self.set_notes(Notes { time: self.time(), kernel });
    }

    fn set_notes(&mut self, notes: Notes) {
        self.notes = (notes != Notes::default()).then(|| Box::new(notes));
    }
}

/// What a line says.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A variable with the value that the file gives for it.
    Vertex {
        /// The file's id.
        id: u64,
        /// Value.
        at: Coordinates,
    },
    /// A measurement of `to` in the frame of `from`.
    Edge {
        /// The pose that is the frame of reference.
        from: u64,
        /// The pose or point that is seen.
        to: u64,
        /// `from_from_to`: a pose makes it a between factor, a point a landmark observation.
        measurement: Coordinates,
        /// How much the measurement is worth.
        weight: Weight,
        /// `EDGE_SE3_TRACKXYZ`: id of the sensor offset.
        parameter: Option<u64>,
    },
    /// `FIX`: a vertex that stays where it is. It names the pose where a landmark has the same id.
    Fix {
        /// The file's id.
        id: u64,
    },
    /// `PARAMS_SE3OFFSET`: where a sensor sits on the robot, `robot_from_sensor`.
    SensorOffset {
        /// The file's id.
        id: u64,
        /// `robot_from_sensor`.
        at: Coordinates,
    },
    /// Any other measurement of one variable or of two.
    Measurement(Box<Measurement>),
    /// A linear (GLC) factor on any number of variables.
    Linear(Box<LinearMeasurement>),
    /// `GEODETIC_ORIGIN`: where on the earth the origin of the world is, its axes pointing east,
    /// north and up (WGS 84).
    GeodeticOrigin {
        /// Geodetic latitude, degrees north.
        latitude: f64,
        /// Longitude, degrees east.
        longitude: f64,
        /// Height above the ellipsoid, metres.
        height: f64,
    },
}

impl Record {
    /// Whether it is a factor: an edge, any other measurement, or a linear factor.
    pub fn is_factor(&self) -> bool {
        matches!(self, Self::Edge { .. } | Self::Measurement(_) | Self::Linear(_))
    }

    /// The variables of a factor, in its order; empty for any other record.
    pub fn ends(&self) -> SmallVec<[(u64, Kind); 2]> {
        match self {
            Self::Edge { from, to, measurement, .. } => {
                let kind = measurement.kind();
                SmallVec::from_slice(&[(*from, kind.observer()), (*to, kind)])
            }
            Self::Measurement(measurement) => measurement.ends.clone(),
            Self::Linear(linear) => linear.points.iter().map(|(id, at)| (*id, at.kind())).collect(),
            _ => SmallVec::new(),
        }
    }

    /// The sensor offset that a measurement names.
    pub(crate) fn parameter(&self) -> Option<u64> {
        match self {
            Self::Edge { parameter, .. } => *parameter,
            Self::Measurement(measurement) => measurement.parameter,
            _ => None,
        }
    }

    /// Whether its matrix has rows for the rotation of a 3D pose that g2o weights in its own units.
    pub(crate) fn has_rotation_rows(&self) -> bool {
        match self {
            Self::Edge { measurement, .. } => measurement.kind() == Kind::Pose3,
            Self::Measurement(m) => m.quantity == Quantity::Prior && m.ends[0].1 == Kind::Pose3,
            _ => false,
        }
    }
}
