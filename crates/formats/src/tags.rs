//! The lines of each dialect: tag, fields in order, and what record they make.

use smallvec::SmallVec;

use crate::error::{Field, FormatError, Place, excerpt};
use crate::options::Dialect;
use crate::record::{Coordinates, EntryOrder, Record, Weight, WeightKind};

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
}

/// A line of a dialect.
#[derive(Debug)]
pub(crate) struct Tag {
    pub name: &'static str,
    pub dialect: Dialect,
    pub shape: Shape,
    /// Names of the fields in order.
    pub layout: &'static str,
}

macro_rules! upper6 {
    ($coordinates:literal) => {
        concat!(
            $coordinates,
            " I11 I12 I13 I14 I15 I16 I22 I23 I24 I25 I26 I33 I34 I35 I36 I44 I45 I46 I55 I56 I66"
        )
    };
}

const fn tag(name: &'static str, dialect: Dialect, shape: Shape, layout: &'static str) -> Tag {
    Tag { name, dialect, shape, layout }
}

/// All lines that make records. Sources: g2o's `types/slam2d` and `types/slam3d`, TORO's README,
/// iSAM 1.7's `Loader.cpp`. The first tag of a dialect for a shape is the one that is written.
pub(crate) const TAGS: &[Tag] = &[
    tag(
        "EDGE_SE2",
        Dialect::G2o,
        Shape::Edge(Form::Pose2),
        "from to x y theta I11 I12 I13 I22 I23 I33",
    ),
    tag(
        "EDGE_SE3:QUAT",
        Dialect::G2o,
        Shape::Edge(Form::Quaternion),
        upper6!("from to x y z qx qy qz qw"),
    ),
    tag("EDGE_SE2_XY", Dialect::G2o, Shape::Edge(Form::Point2), "pose point x y I11 I12 I22"),
    tag(
        "EDGE_SE3_TRACKXYZ",
        Dialect::G2o,
        Shape::EdgeWithParameter(Form::Point3),
        "pose point offset x y z I11 I12 I13 I22 I23 I33",
    ),
    tag("VERTEX_SE2", Dialect::G2o, Shape::Vertex(Form::Pose2), "id x y theta"),
    tag("VERTEX_XY", Dialect::G2o, Shape::Vertex(Form::Point2), "id x y"),
    tag("VERTEX_SE3:QUAT", Dialect::G2o, Shape::Vertex(Form::Quaternion), "id x y z qx qy qz qw"),
    tag("VERTEX_TRACKXYZ", Dialect::G2o, Shape::Vertex(Form::Point3), "id x y z"),
    tag("PARAMS_SE3OFFSET", Dialect::G2o, Shape::Offset(Form::Quaternion), "id x y z qx qy qz qw"),
    tag("FIX", Dialect::G2o, Shape::Fix, "id ..."),
    tag(
        "EDGE2",
        Dialect::Toro,
        Shape::Edge(Form::Pose2),
        "from to x y theta I11 I12 I22 I33 I13 I23",
    ),
    tag("VERTEX2", Dialect::Toro, Shape::Vertex(Form::Pose2), "id x y theta"),
    tag("EDGE3", Dialect::Toro, Shape::Edge(Form::Euler), upper6!("from to x y z roll pitch yaw")),
    tag("VERTEX3", Dialect::Toro, Shape::Vertex(Form::Euler), "id x y z roll pitch yaw"),
    tag(
        "EDGE2",
        Dialect::Isam,
        Shape::Edge(Form::Pose2),
        "from to x y theta I11 I12 I13 I22 I23 I33",
    ),
    tag(
        "ODOMETRY",
        Dialect::Isam,
        Shape::Edge(Form::Pose2),
        "from to x y theta I11 I12 I13 I22 I23 I33",
    ),
    tag(
        "Constraint2",
        Dialect::Isam,
        Shape::Edge(Form::Pose2),
        "from to x y theta I11 I12 I13 I22 I23 I33",
    ),
    tag("LANDMARK", Dialect::Isam, Shape::Edge(Form::Point2), "pose point x y I11 I12 I22"),
    tag(
        "EDGE3",
        Dialect::Isam,
        Shape::EdgeOptionalMatrix(Form::Euler),
        upper6!("from to x y z roll pitch yaw"),
    ),
    tag(
        "POINT3",
        Dialect::Isam,
        Shape::EdgeOptionalMatrix(Form::Point3),
        "pose point x y z I11 I12 I13 I22 I23 I33",
    ),
];

/// Lines that are recognized, passed over and counted: node identities, bearing-range and
/// unassociated features, laser scans and raw odometry.
pub(crate) const IGNORED: &[&str] =
    &["EQUIV", "BR", "DATA_FEATURE_POINTXY", "ROBOTLASER1", "ODOM", "FLASER"];

impl Form {
    fn read(self, fields: &mut Fields<'_>) -> Result<Coordinates, FormatError> {
        Ok(match self {
            Self::Pose2 => Coordinates::Pose2(fields.numbers()?),
            Self::Point2 => Coordinates::Point2(fields.numbers()?),
            Self::Quaternion => Coordinates::Pose3Quaternion(fields.numbers()?),
            Self::Euler => Coordinates::Pose3Euler(fields.numbers()?),
            Self::Point3 => Coordinates::Point3(fields.numbers()?),
        })
    }

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
        self.layout.split(' ').filter(|name| name.starts_with('I')).count()
    }

    /// The order of the matrix entries.
    pub fn order(&self) -> EntryOrder {
        match (self.dialect, self.shape) {
            (Dialect::Toro, Shape::Edge(Form::Pose2)) => EntryOrder::Toro,
            _ => EntryOrder::UpperTriangle,
        }
    }

    /// Reads the fields after the tag.
    pub fn read(
        &'static self,
        rest: &str,
        place: &Place,
        matrix: WeightKind,
        mut out: impl FnMut(Record),
    ) -> Result<(), FormatError> {
        let mut fields =
            Fields { tag: self, rest, words: rest.split_ascii_whitespace(), taken: 0, place };
        let record = match self.shape {
            Shape::Vertex(form) => Record::Vertex { id: fields.id()?, at: form.read(&mut fields)? },
            Shape::Offset(form) => {
                Record::SensorOffset { id: fields.id()?, at: form.read(&mut fields)? }
            }
            Shape::Edge(form)
            | Shape::EdgeOptionalMatrix(form)
            | Shape::EdgeWithParameter(form) => {
                let (from, to) = (fields.id()?, fields.id()?);
                let parameter = match self.shape {
                    Shape::EdgeWithParameter(_) => Some(fields.id()?),
                    _ => None,
                };
                let measurement = form.read(&mut fields)?;
                let optional = matches!(self.shape, Shape::EdgeOptionalMatrix(_));
                let weight = fields.weight(matrix, optional)?;
                Record::Edge { from, to, measurement, weight, parameter }
            }
            Shape::Fix => {
                let mut ids: SmallVec<[u64; 4]> = SmallVec::new();
                ids.push(fields.id()?);
                while fields.words.clone().next().is_some() {
                    ids.push(fields.id()?);
                }
                ids.into_iter().for_each(|id| out(Record::Fix { id }));
                return Ok(());
            }
        };
        if fields.words.next().is_some() {
            return Err(fields.count_error());
        }
        out(record);
        Ok(())
    }
}

/// The fields of one line.
struct Fields<'a> {
    tag: &'static Tag,
    rest: &'a str,
    words: std::str::SplitAsciiWhitespace<'a>,
    taken: usize,
    place: &'a Place,
}

impl<'a> Fields<'a> {
    fn next(&mut self) -> Result<&'a str, FormatError> {
        self.taken += 1;
        self.words.next().ok_or_else(|| self.count_error())
    }

    fn id(&mut self) -> Result<u64, FormatError> {
        let word = self.next()?;
        word.parse().map_err(|_| FormatError::NotAnId {
            place: self.place.clone(),
            field: self.field(word),
        })
    }

    fn number(&mut self) -> Result<f64, FormatError> {
        let word = self.next()?;
        match word.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            Ok(_) => {
                Err(FormatError::NotFinite { place: self.place.clone(), field: self.field(word) })
            }
            Err(_) => {
                Err(FormatError::NotANumber { place: self.place.clone(), field: self.field(word) })
            }
        }
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], FormatError> {
        let mut numbers = [0.0; N];
        for x in &mut numbers {
            *x = self.number()?;
        }
        Ok(numbers)
    }

    fn weight(&mut self, kind: WeightKind, optional: bool) -> Result<Weight, FormatError> {
        let mut entries = SmallVec::new();
        if !optional || self.words.clone().next().is_some() {
            let count = self.tag.entries();
            entries.reserve_exact(count);
            for _ in 0..count {
                entries.push(self.number()?);
            }
        }
        Ok(Weight { kind, order: self.tag.order(), entries })
    }

    fn field(&self, word: &str) -> Box<Field> {
        let name = match self.tag.shape {
            Shape::Fix => "id",
            _ => self.tag.layout.split(' ').nth(self.taken - 1).unwrap_or("field"),
        };
        Box::new(Field { tag: self.tag.name, number: self.taken, name, text: excerpt(word) })
    }

    fn count_error(&self) -> FormatError {
        let all = self.tag.layout.split(' ').count();
        let expected = match self.tag.shape {
            Shape::Fix => "1 or more".to_string(),
            Shape::EdgeOptionalMatrix(_) => format!("{} or {all}", all - self.tag.entries()),
            _ => all.to_string(),
        };
        FormatError::FieldCount {
            place: self.place.clone(),
            tag: self.tag.name,
            expected,
            found: self.rest.split_ascii_whitespace().count(),
            layout: self.tag.layout,
        }
    }
}
