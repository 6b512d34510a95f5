//! Whether a line can be what it says, by itself.

use std::collections::HashSet;

use evergraph_factors::RootShift;

use crate::coordinates::{Coordinates, Kind};
use crate::error::{Field, FormatError, Place};
use crate::magnitude::{self, LARGEST};
use crate::matrix::{self, Definiteness};
use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::record::{Line, Record};
use crate::weight::{Weight, WeightKind};

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

/// The length of the quaternion of `x y z qx qy qz qw`, without overflow.
fn quaternion_length(pose: &[f64]) -> f64 {
    pose[3..].iter().fold(0.0, |length: f64, x| length.hypot(*x))
}

/// Checks a line by itself. `texts` gives, when they are needed, so many last fields of the line as
/// printed: the matrix.
pub(crate) fn inspect<'a>(
    line: &Line,
    tag: &'static str,
    place: &Place,
    texts: impl FnOnce(usize) -> Vec<&'a str>,
) -> Result<Finding, FormatError> {
    let mut finding = Finding::default();
    if line.kernel().is_some() && !line.record.is_factor() {
        let problem = format!("a {tag} line is no factor");
        return Err(FormatError::BadKernel { place: place.clone(), problem });
    }
    require_size(line.time().as_slice(), LARGEST, tag, place)?;
    inspect_ends(&line.record.ends(), place)?;
    match &line.record {
        Record::Vertex { at, .. } | Record::SensorOffset { at, .. } => {
            finding.long_quaternion = inspect_coordinates(at, tag, place)?;
        }
        Record::Edge { measurement, weight, .. } => {
            finding.long_quaternion = inspect_coordinates(measurement, tag, place)?;
            let dim = measurement.kind().dim();
            finding.clipped = inspect_weight(weight, dim, tag, place, texts)?;
            inspect_size(measurement.numbers(), weight, dim, tag, place)?;
        }
        Record::Fix { .. } => {}
        Record::Measurement(measurement) => {
            finding = inspect_measurement(measurement, tag, place, texts)?;
        }
        Record::Linear(linear) => finding.long_quaternion = inspect_linear(linear, tag, place)?,
        Record::GeodeticOrigin { latitude, longitude, height } => {
            require_size(&[*latitude, *longitude, *height], LARGEST, tag, place)?;
            if latitude.abs() > 90.0 {
                let (what, demand) = ("latitude", "from -90 to 90 degrees");
                return Err(out_of_range(place, tag, what, *latitude, demand));
            }
        }
    }
    Ok(finding)
}

/// No factor joins a variable to itself. Of a pose and a landmark the ids may be equal: see
/// [`Kinds`](crate::kinds::Kinds).
fn inspect_ends(ends: &[(u64, Kind)], place: &Place) -> Result<(), FormatError> {
    let slots = || ends.iter().map(|(id, kind)| slot(*id, *kind));
    let repeated = match ends {
        [] | [_] => None,
        [a, b] => (slot(a.0, a.1) == slot(b.0, b.1)).then_some(a.0),
        _ => {
            let mut seen = HashSet::new();
            slots().find(|slot| !seen.insert(*slot)).map(|(id, _)| id)
        }
    };
    match repeated {
        Some(id) => Err(FormatError::SelfEdge { place: place.clone(), id }),
        None => Ok(()),
    }
}

fn inspect_measurement<'a>(
    measurement: &Measurement,
    tag: &'static str,
    place: &Place,
    texts: impl FnOnce(usize) -> Vec<&'a str>,
) -> Result<Finding, FormatError> {
    let Measurement { quantity, numbers, weight, parameter, .. } = measurement;
    let Some(rows) = measurement.rows() else {
        let kinds: Vec<_> = measurement.kinds().iter().map(|kind| kind.name()).collect();
        let (what, count) = (quantity.name(), numbers.len());
        let problem =
            format!("{what} of a {} are not given by {count} numbers", kinds.join(", a "));
        return Err(bad(place, problem));
    };
    let of_pose3 = measurement.kinds()[0] == Kind::Pose3;
    let has_offset = of_pose3 && matches!(quantity, Quantity::Prior | Quantity::Position);
    if parameter.is_some() && !has_offset {
        return Err(bad(place, format!("{} know no sensor offset", quantity.name())));
    }
    require_size(numbers, LARGEST, tag, place)?;
    let mut finding = Finding::default();
    match quantity {
        Quantity::Prior | Quantity::Partial if of_pose3 => {
            finding.long_quaternion = inspect_quaternion(&numbers[..7], tag, place)?;
        }
        Quantity::Attitude => {
            inspect_direction(&numbers[..3], "world direction", tag, place)?;
            inspect_direction(&numbers[3..], "measured direction", tag, place)?;
        }
        Quantity::Bearing | Quantity::BearingRange if of_pose3 => {
            inspect_direction(&numbers[..3], "direction", tag, place)?;
        }
        _ => {}
    }
    if let (Quantity::Range | Quantity::BearingRange, Some(&range)) = (quantity, numbers.last())
        && range < 0.0
    {
        return Err(out_of_range(place, tag, "range", range, "0 or more"));
    }
    finding.clipped = inspect_weight(weight, rows, tag, place, texts)?;
    inspect_size(numbers, weight, rows, tag, place)?;
    Ok(finding)
}

fn inspect_linear(
    linear: &LinearMeasurement,
    tag: &'static str,
    place: &Place,
) -> Result<bool, FormatError> {
    let mut is_long = false;
    for (_, at) in &linear.points {
        is_long |= inspect_coordinates(at, tag, place)?;
    }
    let width: usize = linear.points.iter().map(|(_, at)| at.kind().dim()).sum();
    let entries = linear.rows.checked_mul(width);
    let has_shape = entries == Some(linear.sqrt_information.len()) && linear.offset.len() == width;
    if width == 0 || linear.rows == 0 || !has_shape {
        let problem = format!(
            "G has {} entries and d' {}, of {} rows and {width} columns",
            linear.sqrt_information.len(),
            linear.offset.len(),
            linear.rows
        );
        return Err(bad(place, problem));
    }
    if linear.root_shift != RootShift::None && !linear.points[0].1.kind().is_pose() {
        return Err(bad(place, "its first variable, the root of the shift, is no pose"));
    }
    require_size(&linear.sqrt_information, LARGEST, tag, place)?;
    require_size(&linear.offset, LARGEST, tag, place)?;
    Ok(is_long)
}

/// A direction has to have a length, and one that can be divided by.
fn inspect_direction(
    direction: &[f64],
    what: &'static str,
    tag: &'static str,
    place: &Place,
) -> Result<(), FormatError> {
    let length = direction.iter().fold(0.0, |length: f64, x| length.hypot(*x));
    if length.is_normal() {
        return Ok(());
    }
    Err(out_of_range(place, tag, what, length, "of a length that is not zero, and finite"))
}

fn out_of_range(
    place: &Place,
    tag: &'static str,
    what: &'static str,
    value: f64,
    demand: &'static str,
) -> FormatError {
    FormatError::OutOfRange { place: place.clone(), tag, what, value, demand }
}

fn inspect_coordinates(
    at: &Coordinates,
    tag: &'static str,
    place: &Place,
) -> Result<bool, FormatError> {
    require_size(at.numbers(), LARGEST, tag, place)?;
    match at {
        Coordinates::Pose3Quaternion(pose) => inspect_quaternion(pose, tag, place),
        _ => Ok(false),
    }
}

/// Whether the length of the quaternion of `x y z qx qy qz qw` is off.
fn inspect_quaternion(pose: &[f64], tag: &'static str, place: &Place) -> Result<bool, FormatError> {
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
    texts: impl FnOnce(usize) -> Vec<&'a str>,
) -> Result<bool, FormatError> {
    require_size(&weight.entries, magnitude::largest_entry(weight.kind), tag, place)?;
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
    if weight.kind == WeightKind::Sigmas {
        return match weight.entries.iter().find(|sigma| **sigma <= 0.0) {
            None => Ok(false),
            Some(&sigma) => Err(out_of_range(place, tag, "standard deviation", sigma, "above 0")),
        };
    }
    if weight.entries.is_empty()
        || weight.kind == WeightKind::SquareRoot
        || matrix::is_clearly_definite(weight)
    {
        return Ok(false);
    }
    let half_units = matrix::half_units(&texts(weight.entries.len()));
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

/// No number may be infinite, or so large that squares overflow.
fn require_size(
    numbers: &[f64],
    limit: f64,
    tag: &'static str,
    place: &Place,
) -> Result<(), FormatError> {
    let Some(at) = numbers.iter().position(|x| x.is_nan() || x.abs() > limit) else {
        return Ok(());
    };
    let (place, x) = (place.clone(), numbers[at]);
    let name = "of its coordinates or matrix";
    let text = format!("{x:?}").into();
    let field = Box::new(Field { tag, number: at + 1, name, text });
    Err(match x.is_finite() {
        true => FormatError::TooLarge { place, field, limit },
        false => FormatError::NotFinite { place, field },
    })
}

/// Nor may what is measured be, once it is multiplied by the root of its information.
fn inspect_size(
    numbers: &[f64],
    weight: &Weight,
    dim: usize,
    tag: &'static str,
    place: &Place,
) -> Result<(), FormatError> {
    let root = magnitude::root_information(weight, dim);
    if root > LARGEST {
        let (what, demand) = ("information", "at most 1e150");
        return Err(out_of_range(place, tag, what, root * root, demand));
    }
    require_size(numbers, if root > 1.0 { LARGEST / root } else { LARGEST }, tag, place)
}

/// A variable's id and whether it is a pose: iSAM numbers poses and landmarks apart.
pub(crate) fn slot(id: u64, kind: Kind) -> (u64, bool) {
    (id, kind.is_pose())
}

/// A measurement that cannot be used, for a reason in words.
pub(crate) fn bad(place: &Place, problem: impl ToString) -> FormatError {
    FormatError::BadMeasurement { place: place.clone(), problem: problem.to_string() }
}
