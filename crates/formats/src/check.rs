//! Whether records can be what they say: each by itself, then all together.

use std::collections::HashMap;
use std::sync::Arc;

use crate::error::{Field, FormatError, Place};
use crate::matrix::{self, Definiteness};
use crate::record::{Coordinates, Kind, Line, Record, Weight, WeightKind};

/// What was found in a record that can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Finding {
    /// Its matrix is indefinite by what the printed digits rounded away.
    pub clipped: bool,
    /// Its quaternion's length is off by more than [`QUATERNION_TOLERANCE`].
    pub long_quaternion: bool,
}

/// How far a quaternion's length may be from 1 without a warning; files print 6 digits.
pub(crate) const QUATERNION_TOLERANCE: f64 = 1e-3;

/// A quaternion no longer than this names no rotation.
const ZERO_QUATERNION: f64 = 1e-9;

/// The length of a quaternion, without overflow.
pub(crate) fn quaternion_length(pose: &[f64; 7]) -> f64 {
    pose[3..].iter().fold(0.0, |length: f64, x| length.hypot(*x))
}

/// Checks a record by itself. `texts` gives, when it is needed, the matrix entries as printed.
pub(crate) fn inspect<'a>(
    record: &Record,
    tag: &'static str,
    place: &Place,
    texts: impl FnOnce() -> Vec<&'a str>,
) -> Result<Finding, FormatError> {
    let mut finding = Finding::default();
    match record {
        Record::Vertex { at, .. } | Record::SensorOffset { at, .. } => {
            finding.long_quaternion = inspect_coordinates(at, tag, place)?;
        }
        Record::Edge { from, to, measurement, weight, .. } => {
            // Of a pose and a landmark the ids may be equal: see `Kinds`.
            if from == to && measurement.kind().is_pose() {
                return Err(FormatError::SelfEdge { place: place.clone(), id: *from });
            }
            finding.long_quaternion = inspect_coordinates(measurement, tag, place)?;
            finding.clipped = inspect_weight(weight, measurement.kind().dim(), tag, place, texts)?;
        }
        Record::Fix { .. } => {}
        Record::Measurement(_) | Record::Linear(_) | Record::GeodeticOrigin { .. } => {}
    }
    Ok(finding)
}

fn inspect_coordinates(
    at: &Coordinates,
    tag: &'static str,
    place: &Place,
) -> Result<bool, FormatError> {
    require_finite(at.numbers(), tag, place)?;
    let Coordinates::Pose3Quaternion(pose) = at else { return Ok(false) };
    let length = quaternion_length(pose);
    if !(length.is_finite() && length > ZERO_QUATERNION) {
        return Err(FormatError::ZeroQuaternion { place: place.clone(), tag });
    }
    Ok((length - 1.0).abs() > QUATERNION_TOLERANCE)
}

fn inspect_weight<'a>(
    weight: &Weight,
    dim: usize,
    tag: &'static str,
    place: &Place,
    texts: impl FnOnce() -> Vec<&'a str>,
) -> Result<bool, FormatError> {
    require_finite(&weight.entries, tag, place)?;
    let not_positive = |kind, demand, eigenvalue| {
        Err(FormatError::NotPositive { place: place.clone(), tag, kind, demand, eigenvalue })
    };
    if matrix::as_written(weight, dim).is_none() {
        let problem = format!(
            "its matrix has {} entries, which are none of {dim} rows",
            weight.entries.len()
        );
        return Err(FormatError::BadMeasurement { place: place.clone(), problem });
    }
    if weight.entries.is_empty()
        || weight.kind == WeightKind::SquareRoot
        || matrix::is_clearly_definite(weight)
    {
        return Ok(false);
    }
    let half_units = matrix::half_units(&texts());
    match (weight.kind, matrix::definiteness(weight, dim, &half_units)) {
        (_, Definiteness::Positive) => Ok(false),
        (WeightKind::Covariance, Definiteness::Negative(eigenvalue)) => {
            not_positive("covariance", "definite", eigenvalue)
        }
        (WeightKind::Covariance, _) => not_positive("covariance", "definite", 0.0),
        (_, Definiteness::Semi) => Ok(false),
        (_, Definiteness::Rounded) => Ok(true),
        (_, Definiteness::Negative(eigenvalue)) => {
            not_positive("information", "semi-definite", eigenvalue)
        }
    }
}

fn require_finite(numbers: &[f64], tag: &'static str, place: &Place) -> Result<(), FormatError> {
    match numbers.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(at) => Err(FormatError::NotFinite {
            place: place.clone(),
            field: Box::new(Field {
                tag,
                number: at + 1,
                name: "of its coordinates or matrix",
                text: numbers[at].to_string().into(),
            }),
        }),
    }
}

/// All variables of a file, by id and whether they are poses. iSAM numbers poses and landmarks
/// apart, and so does a file that gives VERTEX lines for a pose and a landmark of the same id.
pub(crate) type Kinds = HashMap<(u64, bool), Kind>;

/// Where a record's variable stands among the [`Kinds`].
pub(crate) fn slot(id: u64, kind: Kind) -> (u64, bool) {
    (id, kind.is_pose())
}

/// Checks the records of a file together. Calls `reject` for each that does not fit and removes it;
/// `reject` may stop everything by returning the error.
pub(crate) fn reconcile(
    file: &Arc<str>,
    lines: &mut Vec<Line>,
    numbered_apart: bool,
    mut reject: impl FnMut(FormatError) -> Result<(), FormatError>,
) -> Result<Kinds, FormatError> {
    let mut kinds = Kinds::new();
    let mut vertex_lines: HashMap<(u64, bool), usize> = HashMap::new();
    let mut offset_lines: HashMap<u64, usize> = HashMap::new();
    let mut failure = None;
    let mut keep = |result: Result<(), FormatError>| match result {
        Ok(()) => true,
        Err(error) => {
            if failure.is_none() {
                failure = reject(error).err();
            }
            false
        }
    };
    let place = |line| Place { file: Arc::clone(file), line };

    // 1. Vertices and sensor offsets, each once.
    lines.retain(|Line { number: line, record, .. }| {
        let (what, id, first) = match record {
            Record::Vertex { id, at } => {
                kinds.entry(slot(*id, at.kind())).or_insert(at.kind());
                ("vertex", *id, *vertex_lines.entry(slot(*id, at.kind())).or_insert(*line))
            }
            Record::SensorOffset { id, .. } => {
                ("sensor offset", *id, *offset_lines.entry(*id).or_insert(*line))
            }
            _ => return true,
        };
        match first {
            first if first == *line => true,
            first => keep(Err(FormatError::Duplicate { place: place(*line), what, id, first })),
        }
    });

    // 2. Edges: to what is there, and from a pose to what it can see.
    let has_vertices = !kinds.is_empty();
    lines.retain(|Line { number: line, record, .. }| {
        let Record::Edge { from, to, measurement, parameter, .. } = record else { return true };
        let seen = measurement.kind();
        keep((|| {
            if let Some(parameter) = parameter
                && !offset_lines.contains_key(parameter)
            {
                return Err(FormatError::MissingOffset { place: place(*line), id: *parameter });
            }
            let ends = [(*from, seen.observer()), (*to, seen)];
            for (id, used) in ends {
                let other = || kinds.get(&(id, !used.is_pose())).filter(|_| !numbered_apart);
                match kinds.get(&slot(id, used)).or_else(other) {
                    Some(&actual) if actual == used => {}
                    Some(&actual) => {
                        let (used, actual) = (used.name(), actual.name());
                        return Err(FormatError::WrongKind {
                            place: place(*line),
                            id,
                            used,
                            actual,
                        });
                    }
                    None if has_vertices => {
                        return Err(FormatError::MissingVertex { place: place(*line), id });
                    }
                    None => {}
                }
            }
            if from == to && !numbered_apart && !kinds.contains_key(&(*to, false)) {
                return Err(FormatError::SelfEdge { place: place(*line), id: *from });
            }
            if !has_vertices {
                kinds.extend(ends.map(|(id, kind)| (slot(id, kind), kind)));
            }
            Ok(())
        })())
    });

    // 3. What is fixed: poses that are there.
    lines.retain(|Line { number: line, record, .. }| {
        let Record::Fix { id } = record else { return true };
        keep(match kinds.get(&(*id, true)).or(kinds.get(&(*id, false))) {
            Some(kind) if kind.is_pose() => Ok(()),
            Some(kind) => Err(FormatError::WrongKind {
                place: place(*line),
                id: *id,
                used: "pose that holds the gauge",
                actual: kind.name(),
            }),
            None => Err(FormatError::MissingVertex { place: place(*line), id: *id }),
        })
    });
    match failure {
        Some(error) => Err(error),
        None => Ok(kinds),
    }
}

/// A measurement that cannot be used, for a reason in words.
pub(crate) fn bad(place: &Place, problem: impl ToString) -> FormatError {
    FormatError::BadMeasurement { place: place.clone(), problem: problem.to_string() }
}
