//! From one dialect's numbers to another's.

mod matrices;

use std::collections::HashMap;

use evergraph_model::{Point2, Point3, Pose2, Pose3, Rot3, Value};
use nalgebra::DMatrix;

use crate::check;
use crate::coordinates::{Coordinates, Kind};
use crate::document::Document;
use crate::error::{FormatError, Place};
use crate::measurement::{Measurement, Quantity};
use crate::names;
use crate::options::{Dialect, G2oRotation};
use crate::record::{Line, Record};

impl Coordinates {
    /// The pose or point that the coordinates name; `None` for a quaternion of length zero, which no
    /// document holds.
    pub fn value(&self) -> Option<Value> {
        Some(match *self {
            Self::Pose2([x, y, theta]) => Value::new(&Pose2::new(x, y, theta)),
            Self::Point2([x, y]) => Value::new(&Point2::new(x, y)),
            Self::Point3([x, y, z]) => Value::new(&Point3::new(x, y, z)),
            Self::Pose3Quaternion(_) | Self::Pose3Euler(_) => Value::new(&pose3(self)?),
        })
    }
}

/// The pose that 3D coordinates name; `None` for other coordinates.
pub(crate) fn pose3(at: &Coordinates) -> Option<Pose3> {
    let (rotation, [x, y, z]) = match *at {
        Coordinates::Pose3Quaternion([x, y, z, qx, qy, qz, qw]) => {
            (Rot3::from_quaternion(qx, qy, qz, qw).ok()?, [x, y, z])
        }
        Coordinates::Pose3Euler([x, y, z, roll, pitch, yaw]) => {
            (Rot3::from_roll_pitch_yaw(roll, pitch, yaw), [x, y, z])
        }
        _ => return None,
    };
    Some(Pose3::new(rotation, Point3::new(x, y, z)))
}

/// `x y z qx qy qz qw` of a pose.
pub(crate) fn quaternion(pose: &Pose3) -> Coordinates {
    let [qx, qy, qz, qw] = pose.rotation().quaternion();
    Coordinates::Pose3Quaternion([pose.x(), pose.y(), pose.z(), qx, qy, qz, qw])
}

/// `x y z roll pitch yaw` of a pose.
pub(crate) fn euler(pose: &Pose3) -> Coordinates {
    let [roll, pitch, yaw] = pose.rotation().roll_pitch_yaw();
    Coordinates::Pose3Euler([pose.x(), pose.y(), pose.z(), roll, pitch, yaw])
}

/// Rotation rows and columns of a 3D information matrix, each times `factor`.
pub(crate) fn scale_rotation(information: &mut DMatrix<f64>, factor: f64) {
    if information.nrows() == 6 {
        information.rows_mut(3, 3).scale_mut(factor);
        information.columns_mut(3, 3).scale_mut(factor);
    }
}

/// Whether a document's 3D information is in g2o's own half-angle units.
pub(crate) fn half_angles(document: &Document, dialect: Dialect) -> bool {
    dialect == Dialect::G2o && document.g2o_rotation == G2oRotation::Quaternion
}

/// That every variable of a document has a name of its own.
fn check_names(document: &Document) -> Result<(), FormatError> {
    let mut owners: HashMap<String, u64> = HashMap::new();
    for (id, kind) in document.ids() {
        let file = || document.name().into();
        let Some(name) = names::of(id, kind) else {
            return Err(FormatError::NoName { file: file(), id });
        };
        if let Some(other) = owners.insert(name.clone(), id) {
            return Err(FormatError::NameTaken { file: file(), id, name, other });
        }
    }
    Ok(())
}

/// A document's records in the form that a dialect writes.
pub(crate) struct Converter<'a> {
    document: &'a Document,
    target: Dialect,
    /// `robot_from_sensor` by id.
    offsets: HashMap<u64, Pose3>,
    /// New ids of landmarks whose ids are poses', too: g2o has one range for both.
    renumbered: HashMap<u64, u64>,
    /// Id of a sensor offset at the robot's own place, for g2o's lines that name one.
    default_offset: u64,
    /// Whether a record needs it.
    needs_offset: bool,
    /// For PyFactorGraph, poses in the order of ids: the time of lines that have none.
    ranks: HashMap<u64, u32>,
}

impl<'a> Converter<'a> {
    /// # Errors
    /// [`FormatError::NoName`], [`FormatError::NameTaken`].
    pub fn new(document: &'a Document, target: Dialect) -> Result<Self, FormatError> {
        let mut offsets = HashMap::new();
        for record in document.records() {
            if let Record::SensorOffset { id, at } = record {
                offsets.extend(pose3(at).map(|pose| (*id, pose)));
            }
        }
        let renumbered = match (document.dialect, target) {
            (Dialect::Isam, Dialect::G2o) => renumber(document),
            _ => HashMap::new(),
        };
        let mut ranks = HashMap::new();
        if target == Dialect::Pyfg {
            check_names(document)?;
            let poses = document.ids().into_iter().filter(|(_, kind)| kind.is_pose());
            ranks.extend(poses.map(|(id, _)| id).zip(0..));
        }
        let default_offset = (0..).find(|id| !offsets.contains_key(id)).unwrap_or(0);
        let mut converter = Self {
            document,
            target,
            offsets,
            renumbered,
            default_offset,
            needs_offset: false,
            ranks,
        };
        converter.needs_offset = document
            .records()
            .any(|record| record.parameter().is_none() && converter.offset_for(record).is_some());
        Ok(converter)
    }

    /// How many landmarks get another id.
    pub fn renumbered(&self) -> usize {
        self.renumbered.len()
    }

    /// How many variables get a name instead of a number.
    pub fn named(&self) -> usize {
        if self.target != Dialect::Pyfg {
            return 0;
        }
        self.document.ids().into_iter().filter(|(id, _)| names::is_new(*id)).count()
    }

    /// The sensor offset at the robot's own place, if the target needs one more.
    pub fn default_offset(&self) -> Option<Record> {
        let at = Coordinates::Pose3Quaternion([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        self.needs_offset.then_some(Record::SensorOffset { id: self.default_offset, at })
    }

    /// The sensor offset that the target's line for this record names.
    fn offset_for(&self, record: &Record) -> Option<u64> {
        if self.target != Dialect::G2o {
            return None;
        }
        let needs = match record {
            Record::Edge { measurement, .. } => measurement.kind() == Kind::Point3,
            Record::Measurement(m) if m.kinds()[..] == [Kind::Pose3] => match m.quantity {
                Quantity::Prior => true,
                // g2o's own line has an offset, others leave it out; what was read stays.
                Quantity::Position => self.document.dialect != Dialect::G2o,
                _ => false,
            },
            _ => false,
        };
        record.parameter().or(needs.then_some(self.default_offset))
    }

    fn id(&self, id: u64, kind: Kind) -> u64 {
        if kind.is_pose() { id } else { self.renumbered.get(&id).copied().unwrap_or(id) }
    }

    /// The line as the target writes it; `None` where the target has no line for it and nothing
    /// of the measurements is lost: vertices in iSAM, sensor offsets outside g2o (measurements are
    /// taken into the robot's frame).
    pub fn line(&self, line: &Line) -> Result<Option<Line>, FormatError> {
        let place = self.document.place(line.number);
        if line.kernel().is_some() && self.target != Dialect::G2o {
            return Err(self.unsupported("robust kernels", &place));
        }
        let Some(record) = self.record(&line.record, &place)? else { return Ok(None) };
        let time = if self.target == Dialect::Pyfg { self.time(line) } else { None };
        let mut converted = Line::new(line.number, record);
        converted.set_time(time);
        converted.set_kernel(line.kernel());
        Ok(Some(converted))
    }

    /// The line's time; where it has none and needs one, the rank of its last pose.
    fn time(&self, line: &Line) -> Option<f64> {
        let rank = |id| self.ranks.get(&id).copied().unwrap_or(0);
        let last = match &line.record {
            Record::Vertex { at, .. } if !at.kind().is_pose() => return line.time(),
            Record::Vertex { id, .. } => rank(*id),
            // A landmark may have the id of a pose.
            factor => {
                let ends = factor.ends();
                let poses = ends.iter().filter(|(_, kind)| kind.is_pose());
                poses.map(|(id, _)| rank(*id)).max().unwrap_or(0)
            }
        };
        line.time().or(Some(f64::from(last)))
    }

    fn unsupported(&self, what: &'static str, place: &Place) -> FormatError {
        FormatError::Unsupported { place: place.clone(), dialect: self.target, what }
    }

    fn record(&self, record: &Record, place: &Place) -> Result<Option<Record>, FormatError> {
        let is_g2o = self.target == Dialect::G2o;
        let converted = match record {
            Record::Vertex { .. } if self.target == Dialect::Isam => return Ok(None),
            Record::SensorOffset { .. } if !is_g2o => return Ok(None),
            Record::Fix { .. } if !is_g2o => return Err(self.unsupported("fixed vertices", place)),
            Record::Linear(_) if !is_g2o => return Err(self.unsupported("linear factors", place)),
            Record::GeodeticOrigin { .. } if !is_g2o => {
                return Err(self.unsupported("a geodetic origin", place));
            }
            Record::Vertex { at: Coordinates::Point2(_), .. } if self.target == Dialect::Toro => {
                return Ok(None);
            }
            Record::Vertex { at: Coordinates::Point3(_), .. }
            | Record::Edge {
                measurement: Coordinates::Point2(_) | Coordinates::Point3(_), ..
            } if self.target == Dialect::Toro => {
                return Err(self.unsupported("landmarks that are seen by position", place));
            }
            Record::Fix { .. } | Record::GeodeticOrigin { .. } => record.clone(),
            Record::Vertex { id, at } => {
                Record::Vertex { id: self.id(*id, at.kind()), at: self.coordinates(at, place)? }
            }
            Record::SensorOffset { id, at } => {
                Record::SensorOffset { id: *id, at: self.coordinates(at, place)? }
            }
            Record::Edge { from, to, measurement, weight, parameter } => {
                let (seen, weight) = self.in_robot_frame(measurement, weight, *parameter, place)?;
                let dim = measurement.kind().dim();
                let weight = self.weight(&weight, dim, self.rescale(record), place)?;
                let measurement = self.coordinates(&seen, place)?;
                let parameter = self.offset_for(record);
                let to = self.id(*to, measurement.kind());
                Record::Edge { from: *from, to, measurement, weight, parameter }
            }
            Record::Measurement(measurement) => {
                Record::Measurement(Box::new(self.measurement(measurement, record, place)?))
            }
            Record::Linear(linear) => {
                let mut linear = linear.clone();
                for (id, at) in &mut linear.points {
                    *id = self.id(*id, at.kind());
                    *at = self.coordinates(at, place)?;
                }
                Record::Linear(linear)
            }
        };
        Ok(Some(converted))
    }

    fn measurement(
        &self,
        measurement: &Measurement,
        record: &Record,
        place: &Place,
    ) -> Result<Measurement, FormatError> {
        let holds = match self.target {
            Dialect::G2o => true,
            Dialect::Pyfg => matches!(measurement.quantity, Quantity::Prior | Quantity::Range),
            Dialect::Toro => {
                measurement.quantity == Quantity::BearingRange
                    && measurement.kinds()[..] == [Kind::Pose2, Kind::Point2]
            }
            Dialect::Isam => false,
        };
        if !holds {
            return Err(self.unsupported(measurement.quantity.name(), place));
        }
        let mut converted = self.prior_of_robot(measurement, place)?;
        let rescale = self.rescale(record).filter(|_| converted.weight == measurement.weight);
        let rows = measurement.rows().unwrap_or(0);
        converted.weight = if self.target == Dialect::Toro {
            self.sigmas(&converted.weight, rows, place)?
        } else {
            self.weight(&converted.weight, rows, rescale, place)?
        };
        converted.parameter = self.offset_for(record);
        for (id, kind) in &mut converted.ends {
            *id = self.id(*id, *kind);
        }
        let landmark_first = |ends: &[(u64, Kind)]| !ends[0].1.is_pose() && ends[1].1.is_pose();
        if converted.quantity == Quantity::Range
            && self.target == Dialect::G2o
            && landmark_first(&converted.ends)
        {
            converted.ends.reverse();
        }
        self.require_readable_kinds(&converted, place)?;
        Ok(converted)
    }

    /// In a PyFactorGraph file without vertices, names say between what a range is.
    fn require_readable_kinds(
        &self,
        measurement: &Measurement,
        place: &Place,
    ) -> Result<(), FormatError> {
        let named = self.target == Dialect::Pyfg && self.document.summary().vertices == 0;
        let misleads = |(id, kind): &&(u64, Kind)| {
            !names::is_new(*id) && names::kind(*id, kind.is_in_space()) != *kind
        };
        match measurement.ends.iter().find(misleads) {
            Some((id, kind)) if named => Err(check::bad(
                place,
                format!(
                    "without a VERTEX line nothing would say that {} is a {}",
                    names::spell_id(*id),
                    kind.name()
                ),
            )),
            _ => Ok(()),
        }
    }

    fn coordinates(&self, at: &Coordinates, place: &Place) -> Result<Coordinates, FormatError> {
        let wants_quaternion = matches!(self.target, Dialect::G2o | Dialect::Pyfg);
        let convert = match at {
            Coordinates::Pose3Quaternion(_) if !wants_quaternion => euler,
            Coordinates::Pose3Euler(_) if wants_quaternion => quaternion,
            _ => return Ok(*at),
        };
        let pose = pose3(at).map(|pose| convert(&pose));
        pose.ok_or_else(|| check::bad(place, "its quaternion names no rotation"))
    }
}

/// New ids, above all others (from the lowest free one when there is no room), for landmarks whose
/// ids are poses', too.
fn renumber(document: &Document) -> HashMap<u64, u64> {
    let used: Vec<(u64, Kind)> = document.ids();
    let taken = |id: u64| used.binary_search_by_key(&id, |(id, _)| *id).is_ok();
    let clashing: Vec<u64> = used.windows(2).filter(|w| w[0].0 == w[1].0).map(|w| w[1].0).collect();
    let start = used.last().map_or(0, |(id, _)| id.saturating_add(1));
    let room = u64::MAX - start > clashing.len() as u64;
    let free = (if room { start } else { 0 }..).filter(|id| !taken(*id));
    clashing.into_iter().zip(free).collect()
}
