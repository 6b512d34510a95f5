//! The lines of each dialect: tag, fields in order, and what record they make.

use evergraph_model::{Kernel, KernelError};

use crate::coordinates::{Coordinates, Kind};
use crate::measurement::Quantity;
use crate::options::Dialect;
use crate::record::Record;
use crate::weight::EntryOrder;

/// How coordinates are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    Pose2,
    Point2,
    Quaternion,
    Euler,
    Point3,
}

/// What a line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    /// `id coordinates`
    Vertex(Form),
    /// `from to coordinates matrix`
    Edge(Form),
    /// `from to coordinates [matrix]`
    EdgeOptionalMatrix(Form),
    /// `from to parameter coordinates matrix`
    EdgeWithParameter(Form),
    /// `id coordinates`
    Offset(Form),
    /// `id ...`
    Fix,
    /// `ids numbers matrix`, of variables of these kinds
    Measurement(Quantity, &'static [Kind]),
    /// `a b range variance`, of whatever the names say
    NamedRange,
    /// The line says itself how long it is.
    Linear,
    /// `latitude longitude height`
    GeodeticOrigin,
}

/// A line of a dialect.
#[derive(Debug)]
pub(crate) struct Tag {
    pub name: &'static str,
    pub dialect: Dialect,
    pub shape: Shape,
    /// Names of the fields in order. A field in brackets may be left out, which shows in the number
    /// of fields; matrix entries are `I` (information or its square root), `C` (covariance) or `S` (standard
    /// deviations).
    pub layout: &'static str,
}

/// A layout: the fields, then the upper triangle of a matrix.
macro_rules! upper {
    (1, $fields:literal) => {
        concat!($fields, " I")
    };
    (2, $fields:literal) => {
        concat!($fields, " I11 I12 I22")
    };
    (3, $fields:literal) => {
        concat!($fields, " I11 I12 I13 I22 I23 I33")
    };
    (6, $fields:literal) => {
        concat!(
            $fields,
            " I11 I12 I13 I14 I15 I16 I22 I23 I24 I25 I26 I33 I34 I35 I36 I44 I45 I46 I55 I56 I66"
        )
    };
    (covariance 1, $fields:literal) => {
        concat!($fields, " C")
    };
    (covariance 2, $fields:literal) => {
        concat!($fields, " C11 C12 C22")
    };
    (covariance 3, $fields:literal) => {
        concat!($fields, " C11 C12 C13 C22 C23 C33")
    };
    (covariance 6, $fields:literal) => {
        concat!(
            $fields,
            " C11 C12 C13 C14 C15 C16 C22 C23 C24 C25 C26 C33 C34 C35 C36 C44 C45 C46 C55 C56 C66"
        )
    };
}

const fn tag(name: &'static str, dialect: Dialect, shape: Shape, layout: &'static str) -> Tag {
    Tag { name, dialect, shape, layout }
}

const fn factor(
    name: &'static str,
    quantity: Quantity,
    ends: &'static [Kind],
    layout: &'static str,
) -> Tag {
    Tag { name, dialect: Dialect::G2o, shape: Shape::Measurement(quantity, ends), layout }
}

use Dialect::{G2o, Isam, Pyfg, Toro};
use Form::{Euler, Quaternion};
use Kind::{Point2, Point3, Pose2, Pose3};
use Quantity::{
    AntennaPosition, Attitude, Bearing, BearingRange, Between, Depth, DepthDifference, Heading,
    HeadingDifference, Partial, PlanarMotion, Position, Prior, Range, RollPitch,
    TranslationDifference,
};
use Shape::{Edge, EdgeOptionalMatrix, EdgeWithParameter, Measurement, Vertex};

/// All lines that make records. Sources: g2o's `types/slam2d` and `types/slam3d`, TORO's README,
/// iSAM 1.7's `Loader.cpp`, PyFactorGraph; `FACTOR_` and `GEODETIC_ORIGIN` are our own. The first
/// tag of a dialect for a shape is the one that is written.
#[rustfmt::skip]
pub(crate) const TAGS: &[Tag] = &[
    tag("EDGE_SE2", G2o, Edge(Form::Pose2), upper!(3, "from to x y theta")),
    tag("EDGE_SE3:QUAT", G2o, Edge(Quaternion), upper!(6, "from to x y z qx qy qz qw")),
    tag("EDGE_SE2_XY", G2o, Edge(Form::Point2), upper!(2, "pose point x y")),
    tag("EDGE_SE3_TRACKXYZ", G2o, EdgeWithParameter(Form::Point3), upper!(3, "pose point offset x y z")),
    tag("VERTEX_SE2", G2o, Vertex(Form::Pose2), "id x y theta"),
    tag("VERTEX_XY", G2o, Vertex(Form::Point2), "id x y"),
    tag("VERTEX_SE3:QUAT", G2o, Vertex(Quaternion), "id x y z qx qy qz qw"),
    tag("VERTEX_TRACKXYZ", G2o, Vertex(Form::Point3), "id x y z"),
    tag("PARAMS_SE3OFFSET", G2o, Shape::Offset(Quaternion), "id x y z qx qy qz qw"),
    tag("FIX", G2o, Shape::Fix, "id ..."),
    factor("EDGE_PRIOR_SE2", Prior, &[Pose2], upper!(3, "id x y theta")),
    factor("EDGE_SE3_PRIOR", Prior, &[Pose3], upper!(6, "id offset x y z qx qy qz qw")),
    factor("EDGE_PRIOR_XY", Prior, &[Point2], upper!(2, "id x y")),
    factor("EDGE_POINTXYZ_PRIOR", Prior, &[Point3], upper!(3, "id x y z")),
    factor("EDGE_PRIOR_SE2_XY", Position, &[Pose2], upper!(2, "id x y")),
    factor("EDGE_SE3_XYZ_PRIOR", Position, &[Pose3], upper!(3, "id [offset] x y z")),
    // hdl_graph_slam.
    factor("EDGE_SE3_PRIORXYZ", Position, &[Pose3], upper!(3, "id x y z")),
    factor("EDGE_BEARING_SE2_XY", Bearing, &[Pose2, Point2], upper!(1, "pose point bearing")),
    factor("EDGE_POINTXY", Between, &[Point2, Point2], upper!(2, "from to x y")),
    factor("EDGE_POINTXYZ", Between, &[Point3, Point3], upper!(3, "from to x y z")),
    // Our own.
    factor("FACTOR_ANTENNA_SE2", AntennaPosition, &[Pose2], upper!(2, "id x y ax ay")),
    factor("FACTOR_ANTENNA_SE3", AntennaPosition, &[Pose3], upper!(3, "id x y z ax ay az")),
    factor("FACTOR_DEPTH_SE3", Depth, &[Pose3], upper!(1, "id z")),
    factor("FACTOR_HEADING_SE2", Heading, &[Pose2], upper!(1, "id heading")),
    factor("FACTOR_HEADING_SE3", Heading, &[Pose3], upper!(1, "id heading")),
    factor("FACTOR_ROLL_PITCH_SE3", RollPitch, &[Pose3], upper!(2, "id roll pitch")),
    factor("FACTOR_ATTITUDE_SE3", Attitude, &[Pose3], upper!(2, "id gx gy gz mx my mz")),
    factor("FACTOR_PLANE_SE3", PlanarMotion, &[Pose3], upper!(3, "id height")),
    factor("FACTOR_RANGE_SE2", Range, &[Pose2, Pose2], upper!(1, "from to range")),
    factor("FACTOR_RANGE_SE2_XY", Range, &[Pose2, Point2], upper!(1, "pose point range")),
    factor("FACTOR_RANGE_SE3", Range, &[Pose3, Pose3], upper!(1, "from to range")),
    factor("FACTOR_RANGE_SE3_XYZ", Range, &[Pose3, Point3], upper!(1, "pose point range")),
    factor("FACTOR_RANGE_XY", Range, &[Point2, Point2], upper!(1, "from to range")),
    factor("FACTOR_RANGE_XYZ", Range, &[Point3, Point3], upper!(1, "from to range")),
    factor("FACTOR_BEARING_SE2", Bearing, &[Pose2, Pose2], upper!(1, "from to bearing")),
    factor("FACTOR_BEARING_SE3", Bearing, &[Pose3, Pose3], upper!(2, "from to bx by bz")),
    factor("FACTOR_BEARING_SE3_XYZ", Bearing, &[Pose3, Point3], upper!(2, "pose point bx by bz")),
    factor("FACTOR_BEARING_RANGE_SE2", BearingRange, &[Pose2, Pose2], upper!(2, "from to bearing range")),
    factor("FACTOR_BEARING_RANGE_SE2_XY", BearingRange, &[Pose2, Point2], upper!(2, "pose point bearing range")),
    factor("FACTOR_BEARING_RANGE_SE3", BearingRange, &[Pose3, Pose3], upper!(3, "from to bx by bz range")),
    factor("FACTOR_BEARING_RANGE_SE3_XYZ", BearingRange, &[Pose3, Point3], upper!(3, "pose point bx by bz range")),
    factor("FACTOR_DEPTH_DIFFERENCE_SE3", DepthDifference, &[Pose3, Pose3], upper!(1, "from to dz")),
    factor("FACTOR_HEADING_DIFFERENCE_SE3", HeadingDifference, &[Pose3, Pose3], upper!(1, "from to dheading")),
    factor("FACTOR_TRANSLATION_DIFFERENCE_SE2", TranslationDifference, &[Pose2, Pose2], upper!(2, "from to dx dy")),
    factor("FACTOR_TRANSLATION_DIFFERENCE_SE3", TranslationDifference, &[Pose3, Pose3], upper!(3, "from to dx dy dz")),
    factor("FACTOR_PARTIAL_SE2", Partial, &[Pose2, Pose2], "from to k x y theta A.. I.."),
    factor("FACTOR_PARTIAL_SE3", Partial, &[Pose3, Pose3], "from to k x y z qx qy qz qw A.. I.."),
    tag("FACTOR_LINEAR", G2o, Shape::Linear, "shift n (kind id numbers)*n q G.. d.."),
    tag("GEODETIC_ORIGIN", G2o, Shape::GeodeticOrigin, "latitude longitude height"),
    // TORO and HOG-Man.
    tag("EDGE2", Toro, Edge(Form::Pose2), "from to x y theta I11 I12 I22 I33 I13 I23"),
    tag("VERTEX2", Toro, Vertex(Form::Pose2), "id x y theta"),
    tag("EDGE3", Toro, Edge(Euler), upper!(6, "from to x y z roll pitch yaw")),
    tag("VERTEX3", Toro, Vertex(Euler), "id x y z roll pitch yaw"),
    // GTSAM's `load2D`.
    tag("BR", Toro, Measurement(BearingRange, &[Pose2, Point2]), "pose point bearing range S1 S2"),
    // iSAM.
    tag("EDGE2", Isam, Edge(Form::Pose2), upper!(3, "from to x y theta")),
    tag("ODOMETRY", Isam, Edge(Form::Pose2), upper!(3, "from to x y theta")),
    tag("Constraint2", Isam, Edge(Form::Pose2), upper!(3, "from to x y theta")),
    tag("LANDMARK", Isam, Edge(Form::Point2), upper!(2, "pose point x y")),
    tag("EDGE3", Isam, EdgeOptionalMatrix(Euler), upper!(6, "from to x y z roll pitch yaw")),
    tag("POINT3", Isam, EdgeOptionalMatrix(Form::Point3), upper!(3, "pose point x y z")),
    // PyFactorGraph.
    tag("EDGE_SE2", Pyfg, Edge(Form::Pose2), upper!(covariance 3, "time from to x y theta")),
    tag("EDGE_SE3:QUAT", Pyfg, Edge(Quaternion), upper!(covariance 6, "time from to x y z qx qy qz qw")),
    tag("EDGE_SE2_XY", Pyfg, Edge(Form::Point2), upper!(covariance 2, "time pose point x y")),
    tag("EDGE_SE3_XYZ", Pyfg, Edge(Form::Point3), upper!(covariance 3, "time pose point x y z")),
    tag("EDGE_RANGE", Pyfg, Shape::NamedRange, upper!(covariance 1, "time from to range")),
    tag("VERTEX_SE2", Pyfg, Vertex(Form::Pose2), "time name x y theta"),
    tag("VERTEX_XY", Pyfg, Vertex(Form::Point2), "[time] name x y"),
    tag("VERTEX_SE3:QUAT", Pyfg, Vertex(Quaternion), "time name x y z qx qy qz qw"),
    tag("VERTEX_XYZ", Pyfg, Vertex(Form::Point3), "[time] name x y z"),
    tag("VERTEX_SE2:PRIOR", Pyfg, Measurement(Prior, &[Pose2]), upper!(covariance 3, "time name x y theta")),
    tag("VERTEX_SE3:QUAT:PRIOR", Pyfg, Measurement(Prior, &[Pose3]), upper!(covariance 6, "time name x y z qx qy qz qw")),
    tag("VERTEX_XY:PRIOR", Pyfg, Measurement(Prior, &[Point2]), upper!(covariance 2, "time name x y")),
    tag("VERTEX_XYZ:PRIOR", Pyfg, Measurement(Prior, &[Point3]), upper!(covariance 3, "time name x y z")),
];

/// Lines that are recognized, passed over and counted: node identities, unassociated features, laser
/// scans and raw odometry.
pub(crate) const IGNORED: &[&str] =
    &["EQUIV", "DATA_FEATURE_POINTXY", "ROBOTLASER1", "ODOM", "FLASER"];

/// Stands before the line of a factor, with a kernel and its threshold.
pub(crate) const ROBUST: &str = "ROBUST";

/// Kernels by what files call them.
pub(crate) const KERNELS: &[(&str, MakeKernel)] =
    &[("huber", Kernel::huber), ("pseudo_huber", Kernel::pseudo_huber)];

type MakeKernel = fn(f64) -> Result<Kernel, KernelError>;

/// What files call a kernel.
pub(crate) fn kernel_name(kernel: &Kernel) -> &'static str {
    match kernel {
        Kernel::Huber { .. } => "huber",
        Kernel::PseudoHuber { .. } => "pseudo_huber",
    }
}

impl Form {
    /// Whether `at` is written this way.
    pub fn holds(self, at: &Coordinates) -> bool {
        matches!(
            (self, at),
            (Self::Pose2, Coordinates::Pose2(_))
                | (Self::Point2, Coordinates::Point2(_))
                | (Self::Quaternion, Coordinates::Pose3Quaternion(_))
                | (Self::Euler, Coordinates::Pose3Euler(_))
                | (Self::Point3, Coordinates::Point3(_))
        )
    }
}

impl Tag {
    /// How many entries the matrix has.
    pub fn entries(&self) -> usize {
        let is_entry = |name: &&str| {
            name.strip_prefix(['I', 'C', 'S'])
                .is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit()))
        };
        self.layout.split(' ').filter(is_entry).count()
    }

    /// The order of the matrix entries.
    pub fn order(&self) -> EntryOrder {
        match (self.dialect, self.shape) {
            (Dialect::Toro, Shape::Edge(Form::Pose2)) => EntryOrder::Toro,
            _ => EntryOrder::UpperTriangle,
        }
    }

    /// True if its matrix is diagonal and written as standard deviations.
    pub fn has_sigmas(&self) -> bool {
        self.dialect == Toro && matches!(self.shape, Measurement(..))
    }

    /// Whether only Evergraph knows the line.
    pub fn is_our_own(&self) -> bool {
        self.name.starts_with("FACTOR_") || self.shape == Shape::GeodeticOrigin
    }

    /// The line of a dialect that holds a record, which is in the dialect's form.
    pub fn of(record: &Record, dialect: Dialect) -> Option<&'static Self> {
        TAGS.iter().filter(|tag| tag.dialect == dialect).find(|tag| match (record, tag.shape) {
            (Record::Fix { .. }, Shape::Fix)
            | (Record::Linear(_), Shape::Linear)
            | (Record::GeodeticOrigin { .. }, Shape::GeodeticOrigin) => true,
            (Record::Vertex { at, .. }, Shape::Vertex(form))
            | (Record::SensorOffset { at, .. }, Shape::Offset(form)) => form.holds(at),
            (
                Record::Edge { measurement, .. },
                Shape::Edge(form)
                | Shape::EdgeOptionalMatrix(form)
                | Shape::EdgeWithParameter(form),
            ) => form.holds(measurement),
            (Record::Measurement(m), Shape::Measurement(quantity, ends)) => {
                m.quantity == quantity && m.ends.iter().map(|(_, kind)| kind).eq(ends)
            }
            (Record::Measurement(m), Shape::NamedRange) => m.quantity == Quantity::Range,
            _ => false,
        })
    }
}

impl Record {
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
