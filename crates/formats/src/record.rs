//! What a line of a graph file says, in the file's own numbers.

use evergraph_model::Kernel;
use smallvec::SmallVec;

use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::options::Dialect;
use crate::tags::Tag;
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
    /// `FIX`: the variable that holds the gauge.
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

/// A pose or a point in the numbers that the file used: an unwrapped angle, a quaternion of any
/// length, Euler angles. Kept so that writing the same format gives the same bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coordinates {
    /// `x y theta` (m, rad).
    Pose2([f64; 3]),
    /// `x y` (m).
    Point2([f64; 2]),
    /// `x y z qx qy qz qw` (m).
    Pose3Quaternion([f64; 7]),
    /// `x y z roll pitch yaw` (m, rad), `R = Rz(yaw) Ry(pitch) Rx(roll)`.
    Pose3Euler([f64; 6]),
    /// `x y z` (m).
    Point3([f64; 3]),
}

/// What a variable is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A pose in the plane.
    Pose2,
    /// A pose in space.
    Pose3,
    /// A landmark in the plane.
    Point2,
    /// A landmark in space.
    Point3,
}

impl Kind {
    /// Whether it is a pose; else it is a landmark.
    pub fn is_pose(self) -> bool {
        matches!(self, Self::Pose2 | Self::Pose3)
    }

    /// Whether it is in space; else it is in the plane.
    pub fn is_in_space(self) -> bool {
        matches!(self, Self::Pose3 | Self::Point3)
    }

    /// The kind of pose that measures it.
    pub fn observer(self) -> Self {
        match self {
            Self::Pose2 | Self::Point2 => Self::Pose2,
            Self::Pose3 | Self::Point3 => Self::Pose3,
        }
    }

    /// Dimension of its tangent space, which is that of a measurement of it.
    pub fn dim(self) -> usize {
        match self {
            Self::Pose2 | Self::Point3 => 3,
            Self::Pose3 => 6,
            Self::Point2 => 2,
        }
    }

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pose2 => "2D pose",
            Self::Pose3 => "3D pose",
            Self::Point2 => "2D landmark",
            Self::Point3 => "3D landmark",
        }
    }
}

impl Coordinates {
    /// What they are the coordinates of.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Pose2(_) => Kind::Pose2,
            Self::Point2(_) => Kind::Point2,
            Self::Pose3Quaternion(_) | Self::Pose3Euler(_) => Kind::Pose3,
            Self::Point3(_) => Kind::Point3,
        }
    }

    /// The numbers, in the order of the line.
    pub fn numbers(&self) -> &[f64] {
        match self {
            Self::Pose2(x) | Self::Point3(x) => x,
            Self::Point2(x) => x,
            Self::Pose3Quaternion(x) => x,
            Self::Pose3Euler(x) => x,
        }
    }
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

    /// The tag that messages use, g2o's.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Vertex { at, .. } => match at.kind() {
                Kind::Pose2 => "VERTEX_SE2",
                Kind::Pose3 => "VERTEX_SE3:QUAT",
                Kind::Point2 => "VERTEX_XY",
                Kind::Point3 => "VERTEX_TRACKXYZ",
            },
            Self::Edge { measurement, .. } => match measurement.kind() {
                Kind::Pose2 => "EDGE_SE2",
                Kind::Pose3 => "EDGE_SE3:QUAT",
                Kind::Point2 => "EDGE_SE2_XY",
                Kind::Point3 => "EDGE_SE3_TRACKXYZ",
            },
            Self::SensorOffset { .. } => "PARAMS_SE3OFFSET",
            other => Tag::of(other, Dialect::G2o).map_or("FACTOR", |tag| tag.name),
        }
    }
}
