//! Measurements of lines as the data of factors.
//!
//! Lines and the catalogue name the same quantities and differ in their numbers: a line gives a
//! pose in the plane by an angle, a pose in space by a quaternion of any length, a direction of any
//! length. The parts of each factor are listed in [`STANDARD`](evergraph_factors::catalogue::STANDARD).

use std::sync::OnceLock;

use evergraph_factors::catalogue::{
    Catalogue, Description, FactorData, Part, Quantity, normalized,
};
use evergraph_model::{
    Kernel, LieGroup, Manifold, Noise, NoiseError, Point3, Pose2, Pose3, Rot3, Value, VariableId,
};
use nalgebra::DMatrix;
use smallvec::SmallVec;
use thiserror::Error;

use crate::coordinates::Kind;

/// The reason for which a measurement makes no factor.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ReadingError {
    /// A quantity that is not measured between such variables.
    #[error("its ends are not of the kinds that it measures")]
    Ends,
    /// Fewer numbers than the quantity has.
    #[error("it lacks numbers")]
    Numbers,
    /// A quaternion without length.
    #[error("its quaternion names no rotation")]
    Rotation,
    /// A noise that cannot be moved from the sensor to the robot.
    #[error(transparent)]
    Noise(#[from] NoiseError),
}

/// A measurement of a line, with the noise and the sensor that the document says.
#[derive(Clone, Copy, Debug)]
pub struct Reading<'a> {
    /// The measured quantity.
    pub quantity: Quantity,
    /// The numbers as in [`Measurement::numbers`](crate::Measurement::numbers).
    pub numbers: &'a [f64],
    /// `robot_from_sensor`, for a measurement that names a sensor offset.
    pub sensor: Option<&'a Pose3>,
    /// The noise, in the units and the order of the engine.
    pub noise: &'a Noise,
    /// The kernel around the factor.
    pub kernel: Option<Kernel>,
}

impl Reading<'_> {
    /// The data of the factor on variables with these ids and kinds.
    ///
    /// # Errors
    /// [`ReadingError`].
    pub fn data(&self, ends: &[(VariableId, Kind)]) -> Result<FactorData, ReadingError> {
        let &Self { quantity, numbers, sensor, noise, kernel } = self;
        let kinds: SmallVec<[Kind; 2]> = ends.iter().map(|(_, kind)| *kind).collect();
        let of = description(quantity, &kinds).ok_or(ReadingError::Ends)?;
        let mut data = empty(of, ends, noise, kernel);
        match (quantity, sensor) {
            (Quantity::Prior, Some(sensor)) if kinds[..] == [Kind::Pose3] => {
                let (prior, noise) = of_robot(pose3(numbers)?, sensor, noise)?;
                push_value(&prior, &mut data.numbers);
                data.noise = Some((&noise).into());
            }
            // A position is that of an antenna in the origin of the robot or of the sensor.
            (Quantity::Position, _) => {
                let size = of.parts.first().and_then(|part| part.count()).unwrap_or(0);
                let arm = sensor.map_or(Point3::identity(), Pose3::translation);
                data.numbers.extend(numbers.get(..size).ok_or(ReadingError::Numbers)?);
                data.numbers.extend(arm.vector().iter().take(size));
            }
            _ => {
                let mut rest = numbers;
                for &part in of.parts {
                    push_part(part, &mut rest, &mut data.numbers)?;
                }
            }
        }
        Ok(data)
    }
}

/// The data of the factor that says that the second variable is seen from the first at `seen`, by a
/// sensor on the robot if it is a landmark in space.
///
/// # Errors
/// [`ReadingError::Ends`].
pub fn relative_data(
    seen: &Value,
    sensor: Option<&Pose3>,
    noise: &Noise,
    kernel: Option<Kernel>,
    ends: &[(VariableId, Kind)],
) -> Result<FactorData, ReadingError> {
    let kinds: SmallVec<[Kind; 2]> = ends.iter().map(|(_, kind)| *kind).collect();
    let is_seen = kinds.get(1).is_some_and(|kind| kind.type_name() == seen.kind().name());
    let of = description(Quantity::Relative, &kinds).filter(|_| is_seen);
    let of = of.ok_or(ReadingError::Ends)?;
    let mut data = empty(of, ends, noise, kernel);
    data.numbers.extend(seen.storage());
    if of.parts == [Part::Point3, Part::Pose3] {
        push_value(sensor.unwrap_or(&Pose3::identity()), &mut data.numbers);
    }
    Ok(data)
}

/// The catalogue of the library, which makes the factors of lines and the lines of factors.
pub fn catalogue() -> &'static Catalogue {
    static STANDARD: OnceLock<Catalogue> = OnceLock::new();
    STANDARD.get_or_init(Catalogue::standard)
}

/// The factor type that a quantity on variables of these kinds makes.
pub(crate) fn description(quantity: Quantity, kinds: &[Kind]) -> Option<&'static Description> {
    let quantity = match quantity {
        Quantity::Position => Quantity::AntennaPosition,
        other => other,
    };
    let names: SmallVec<[&str; 2]> = kinds.iter().map(|kind| kind.type_name()).collect();
    Description::of(quantity, &names)
}

fn empty(
    of: &Description,
    ends: &[(VariableId, Kind)],
    noise: &Noise,
    kernel: Option<Kernel>,
) -> FactorData {
    FactorData {
        name: of.name.into(),
        ends: ends.iter().map(|(id, _)| *id).collect(),
        numbers: Vec::new(),
        values: Vec::new(),
        noise: Some(noise.into()),
        kernel,
        given: Vec::new(),
    }
}

/// Moves one part from the numbers of a line to those of data.
fn push_part(part: Part, line: &mut &[f64], data: &mut Vec<f64>) -> Result<(), ReadingError> {
    let count = length_in_lines(part).unwrap_or(line.len());
    let (numbers, rest) = line.split_at_checked(count).ok_or(ReadingError::Numbers)?;
    *line = rest;
    match (part, numbers) {
        (Part::Pose2, &[x, y, theta]) => push_value(&Pose2::new(x, y, theta), data),
        (Part::Pose3, _) => push_value(&pose3(numbers)?, data),
        // The factor refuses a direction without length.
        (Part::Direction, &[x, y, z]) => data.extend(normalized([x, y, z]).unwrap_or([x, y, z])),
        _ => data.extend(numbers),
    }
    Ok(())
}

/// The count of numbers of a line that a part is; `None` for all that are left.
pub(crate) fn length_in_lines(part: Part) -> Option<usize> {
    if part == Part::Pose2 { Some(3) } else { part.count() }
}

fn push_value(value: &impl Manifold, numbers: &mut Vec<f64>) {
    let start = numbers.len();
    numbers.resize(start + value.storage_len(), 0.0);
    value.store(&mut numbers[start..]);
}

fn pose3(numbers: &[f64]) -> Result<Pose3, ReadingError> {
    let &[x, y, z, qx, qy, qz, qw] = numbers else { return Err(ReadingError::Numbers) };
    let rotation = Rot3::from_quaternion(qx, qy, qz, qw).map_err(|_| ReadingError::Rotation)?;
    Ok(Pose3::new(rotation, Point3::new(x, y, z)))
}

/// The prior on the robot that a prior `z` on a sensor is, `S` being the place of the sensor:
/// `Log(z⁻¹ X S) = Ad(S⁻¹) Log((z S⁻¹)⁻¹ X)`.
fn of_robot(z: Pose3, sensor: &Pose3, noise: &Noise) -> Result<(Pose3, Noise), NoiseError> {
    let sensor_from_robot = sensor.inverse();
    let adjoint = sensor_from_robot.adjoint();
    let adjoint = DMatrix::from_column_slice(6, 6, adjoint.as_slice());
    let noise = Noise::from_sqrt_information(&(noise.sqrt_information() * adjoint))?;
    Ok((z.compose(&sensor_from_robot), noise))
}
