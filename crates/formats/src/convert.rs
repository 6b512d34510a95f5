//! From one dialect's numbers to another's.

use std::collections::HashMap;

use evergraph_model::{LieGroup, Noise, Point3, Pose3, Rot3};
use nalgebra::{DMatrix, Matrix3};

use crate::check;
use crate::document::Document;
use crate::error::{FormatError, Place};
use crate::matrix;
use crate::options::{Dialect, G2oRotation};
use crate::record::{Coordinates, EntryOrder, Kind, Record, Weight, WeightKind};

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

/// A document's records in the form that a dialect writes.
pub(crate) struct Converter<'a> {
    document: &'a Document,
    target: Dialect,
    /// `robot_from_sensor` by id.
    offsets: HashMap<u64, Pose3>,
    /// New ids of landmarks whose ids are poses', too: g2o has one range for both.
    renumbered: HashMap<u64, u64>,
    /// The sensor offset for 3D landmarks that have none of their own: an id, and whether the
    /// target needs a line for it.
    pub default_offset: (u64, bool),
}

impl<'a> Converter<'a> {
    pub fn new(document: &'a Document, target: Dialect) -> Self {
        let mut offsets = HashMap::new();
        let mut needed = false;
        for record in document.records() {
            match record {
                Record::SensorOffset { id, at } => {
                    offsets.extend(pose3(at).map(|pose| (*id, pose)));
                }
                Record::Edge { measurement: Coordinates::Point3(_), parameter: None, .. } => {
                    needed = true
                }
                _ => {}
            }
        }
        let free = (0..).find(|id| !offsets.contains_key(id)).unwrap_or(0);
        let default_offset = (free, needed && target == Dialect::G2o);
        let renumbered = match (document.dialect, target) {
            (Dialect::Isam, Dialect::G2o) => renumber(document),
            _ => HashMap::new(),
        };
        Self { document, target, offsets, renumbered, default_offset }
    }

    /// How many landmarks get another id.
    pub fn renumbered(&self) -> usize {
        self.renumbered.len()
    }

    fn id(&self, id: u64, kind: Kind) -> u64 {
        if kind.is_pose() { id } else { self.renumbered.get(&id).copied().unwrap_or(id) }
    }

    /// The record as the target writes it; `None` where the target has no line for it and nothing
    /// of the measurements is lost: vertices in iSAM, sensor offsets outside g2o (measurements are
    /// taken into the robot's frame).
    pub fn record(&self, line: usize, record: &Record) -> Result<Option<Record>, FormatError> {
        let place = self.document.place(line);
        let unsupported = |what| {
            Err(FormatError::Unsupported { place: place.clone(), dialect: self.target, what })
        };
        match record {
            Record::Vertex { .. } if self.target == Dialect::Isam => Ok(None),
            Record::SensorOffset { .. } if self.target != Dialect::G2o => Ok(None),
            Record::Fix { .. } if self.target != Dialect::G2o => unsupported("a fixed vertex"),
            Record::Vertex { at: Coordinates::Point2(_) | Coordinates::Point3(_), .. }
            | Record::Edge {
                measurement: Coordinates::Point2(_) | Coordinates::Point3(_), ..
            } if self.target == Dialect::Toro => unsupported("landmarks"),
            Record::Measurement(_) | Record::Linear(_) | Record::GeodeticOrigin { .. } => {
                unsupported("this measurement")
            }
            Record::Fix { id } => Ok(Some(Record::Fix { id: *id })),
            Record::Vertex { id, at } => {
                let id = self.id(*id, at.kind());
                Ok(Some(Record::Vertex { id, at: self.coordinates(at, &place)? }))
            }
            Record::SensorOffset { id, at } => {
                Ok(Some(Record::SensorOffset { id: *id, at: self.coordinates(at, &place)? }))
            }
            Record::Edge { from, to, measurement, weight, parameter } => {
                let (measurement, weight) =
                    self.in_robot_frame(measurement, weight, *parameter, &place)?;
                let weight = self.weight(&weight, measurement.kind().dim(), &place)?;
                let parameter = match (self.target, &measurement) {
                    (Dialect::G2o, Coordinates::Point3(_)) => {
                        parameter.or(Some(self.default_offset.0))
                    }
                    _ => None,
                };
                let measurement = self.coordinates(&measurement, &place)?;
                let to = self.id(*to, measurement.kind());
                Ok(Some(Record::Edge { from: *from, to, measurement, weight, parameter }))
            }
        }
    }

    fn coordinates(&self, at: &Coordinates, place: &Place) -> Result<Coordinates, FormatError> {
        let wants_quaternion = self.target == Dialect::G2o;
        let convert = match at {
            Coordinates::Pose3Quaternion(_) if !wants_quaternion => euler,
            Coordinates::Pose3Euler(_) if wants_quaternion => quaternion,
            _ => return Ok(*at),
        };
        let pose = pose3(at).map(|pose| convert(&pose));
        pose.ok_or_else(|| check::bad(place, "its quaternion names no rotation"))
    }

    /// A landmark that a sensor sees, seen from the robot, where the target has no sensor offsets.
    fn in_robot_frame(
        &self,
        measurement: &Coordinates,
        weight: &Weight,
        parameter: Option<u64>,
        place: &Place,
    ) -> Result<(Coordinates, Weight), FormatError> {
        let unchanged = (*measurement, weight.clone());
        let (Coordinates::Point3(point), Some(parameter)) = (measurement, parameter) else {
            return Ok(unchanged);
        };
        if self.target == Dialect::G2o {
            return Ok(unchanged);
        }
        let Some(robot_from_sensor) = self.offsets.get(&parameter) else {
            return Err(FormatError::MissingOffset { place: place.clone(), id: parameter });
        };
        if *robot_from_sensor == Pose3::identity() {
            return Ok(unchanged);
        }
        let seen = robot_from_sensor.transform_point(&Point3::from(*point));
        let information = self.information(weight, 3, place)?;
        let r: Matrix3<f64> = robot_from_sensor.rotation().matrix();
        let inner: Matrix3<f64> = information.fixed_view::<3, 3>(0, 0).into_owned();
        let rotated = r * inner * r.transpose();
        let rotated = DMatrix::from_fn(3, 3, |i, j| 0.5 * (rotated[(i, j)] + rotated[(j, i)]));
        let weight = Weight {
            kind: WeightKind::Information,
            order: EntryOrder::UpperTriangle,
            entries: matrix::entries(&rotated, EntryOrder::UpperTriangle),
        };
        Ok((Coordinates::Point3([seen.x(), seen.y(), seen.z()]), weight))
    }

    fn information(
        &self,
        weight: &Weight,
        dim: usize,
        place: &Place,
    ) -> Result<DMatrix<f64>, FormatError> {
        matrix::information(weight, dim).filter(|m| m.iter().all(|x| x.is_finite())).ok_or_else(
            || check::bad(place, "its matrix cannot be converted to information, or overflows"),
        )
    }

    fn weight(&self, weight: &Weight, dim: usize, place: &Place) -> Result<Weight, FormatError> {
        let kind = match (self.target, self.document.dialect) {
            (Dialect::G2o | Dialect::Toro, _) => WeightKind::Information,
            (Dialect::Isam, Dialect::Isam) => self.document.isam_matrix,
            (Dialect::Isam, _) => WeightKind::SquareRoot,
        };
        let order = match self.target {
            Dialect::Toro if dim == 3 => EntryOrder::Toro,
            _ => EntryOrder::UpperTriangle,
        };
        let source = half_angles(self.document, self.document.dialect);
        let target = half_angles(self.document, self.target);
        let rescale = dim == 6 && source != target;
        if weight.entries.is_empty() && self.target == Dialect::Isam && dim != 2 && !rescale {
            return Ok(Weight { kind, order, entries: weight.entries.clone() });
        }
        if weight.kind == kind && !rescale && !weight.entries.is_empty() {
            if weight.order == order {
                return Ok(weight.clone());
            }
            // Only the places of the entries change; a 2D pose is the one with two orders.
            if let Some(matrix) = matrix::as_written(weight, dim) {
                return Ok(Weight { kind, order, entries: matrix::entries(&matrix, order) });
            }
        }
        let mut information = self.information(weight, dim, place)?;
        if rescale {
            scale_rotation(&mut information, if source { 0.5 } else { 2.0 });
        }
        let matrix = match kind {
            WeightKind::Information => information,
            // What is clipped is clipped as the engine does, or the optimum would move.
            WeightKind::SquareRoot => Noise::from_information_clipped(&information, f64::INFINITY)
                .map_err(|error| check::bad(place, error.to_string()))?
                .0
                .sqrt_information()
                .clone(),
            WeightKind::Covariance => {
                let inverse = nalgebra::Cholesky::new(information).map(|c| c.inverse());
                inverse.ok_or_else(|| {
                    check::bad(place, "its information is singular and has no covariance")
                })?
            }
        };
        Ok(Weight { kind, order, entries: matrix::entries(&matrix, order) })
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
