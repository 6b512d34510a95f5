//! The record of each factor.

use evergraph_factors::Linear;
use evergraph_factors::catalogue::{Description, FactorData, Part};
use evergraph_model::{Factor, LieGroup, Manifold, Noise, Pose2, Pose3, Value};
use nalgebra::{DMatrix, Vector3};
use smallvec::SmallVec;

use super::exporter::{Exporter, settled};
use super::settle;
use crate::coordinates::{Coordinates, Kind};
use crate::factor_data::catalogue;
use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::record::{Line, Record};

impl Exporter {
    /// The line of a factor; `None` for factors of others.
    pub fn line(&mut self, factor: &dyn Factor) -> Option<Line> {
        if let Some((linear, kernel)) = factor.downcast::<Linear>() {
            let mut line = Line::from(self.linear(linear)?);
            line.set_kernel(kernel);
            return Some(line);
        }
        let data = catalogue().to_data(factor).ok()?;
        // No line has given values.
        if !data.given.is_empty() {
            return None;
        }
        let of = Description::named(&data.name)?;
        let noise = data.noise.as_ref()?.to_noise().ok()?;
        let record = match of.quantity {
            Quantity::Relative => self.edge(&data, of.parts, &noise)?,
            quantity => self.measurement(quantity, &data, of.parts, noise)?,
        };
        let mut line = Line::from(record);
        line.set_kernel(data.kernel);
        Some(line)
    }

    /// A factor between a pose and what it sees.
    fn edge(&mut self, data: &FactorData, parts: &[Part], noise: &Noise) -> Option<Record> {
        let &[from, to] = &data.ends[..] else { return None };
        let mut rest = &data.numbers[..];
        let measurement = next_coordinates(*parts.first()?, &mut rest)?;
        // A landmark in space is seen by a sensor.
        let parameter =
            (parts.get(1) == Some(&Part::Pose3)).then(|| self.sensor(&Pose3::load(rest)));
        let (from, to) = (self.id(from)?, self.id(to)?);
        Some(Record::Edge { from, to, measurement, weight: settle::weight(noise), parameter })
    }

    /// Any other measurement.
    fn measurement(
        &mut self,
        quantity: Quantity,
        data: &FactorData,
        parts: &[Part],
        noise: Noise,
    ) -> Option<Record> {
        let mut ends: SmallVec<[(u64, Kind); 2]> = SmallVec::new();
        for end in &data.ends {
            ends.push(self.end(*end)?);
        }
        let (mut quantity, mut noise) = (quantity, noise);
        let mut numbers = data.numbers.clone();
        if let [pose, Part::Combinations3 | Part::Combinations6] = parts {
            noise = few_combinations(&mut numbers, pose.count()?, ends[0].1.dim(), noise)?;
        }
        let mut numbers = in_lines(parts, &numbers)?;
        // A position is that of an antenna in the origin of the robot.
        let (position, arm) = numbers.split_at(numbers.len() / 2);
        if quantity == Quantity::AntennaPosition && arm.iter().all(|x| *x == 0.0) {
            quantity = Quantity::Position;
            numbers.truncate(position.len());
        }
        // Files name the pose first.
        if quantity == Quantity::Range && ends[1].1.is_pose() && !ends[0].1.is_pose() {
            ends.reverse();
        }
        let weight = settle::weight(&noise);
        let needs_sensor = ends[..].iter().map(|(_, kind)| *kind).eq([Kind::Pose3])
            && matches!(quantity, Quantity::Prior | Quantity::Position);
        let parameter = needs_sensor.then(|| self.sensor(&Pose3::identity()));
        Some(Record::Measurement(Box::new(Measurement {
            quantity,
            ends,
            numbers,
            weight,
            parameter,
        })))
    }

    fn linear(&self, linear: &Linear) -> Option<Record> {
        let mut points = Vec::new();
        for (variable, point) in linear.keys().iter().zip(linear.linearization_points()) {
            points.push((self.id(*variable)?, settled(point)?));
        }
        let g = linear.sqrt_information();
        Some(Record::Linear(Box::new(LinearMeasurement {
            points,
            root_shift: linear.root_shift(),
            rows: g.nrows(),
            sqrt_information: g.transpose().as_slice().to_vec(),
            offset: linear.offset().as_slice().to_vec(),
        })))
    }
}

/// The numbers of a line for those of data.
fn in_lines(parts: &[Part], numbers: &[f64]) -> Option<SmallVec<[f64; 4]>> {
    let mut line = SmallVec::new();
    let mut rest = numbers;
    for &part in parts {
        match part {
            Part::Pose2 | Part::Pose3 => {
                line.extend_from_slice(next_coordinates(part, &mut rest)?.numbers());
            }
            Part::Direction => {
                let direction = Vector3::from_column_slice(next(part, &mut rest)?);
                line.extend(settle::direction(&direction));
            }
            _ => line.extend_from_slice(next(part, &mut rest)?),
        }
    }
    Some(line)
}

/// The coordinates that a pose or a point among the numbers of data has in files.
fn next_coordinates(part: Part, rest: &mut &[f64]) -> Option<Coordinates> {
    let numbers = next(part, rest)?;
    match part {
        Part::Pose2 => settled(&Value::new(&Pose2::load(numbers))),
        Part::Pose3 => settled(&Value::new(&Pose3::load(numbers))),
        Part::Point2 => Some(Coordinates::Point2(numbers.try_into().ok()?)),
        Part::Point3 => Some(Coordinates::Point3(numbers.try_into().ok()?)),
        _ => None,
    }
}

/// The numbers of the next part.
fn next<'a>(part: Part, rest: &mut &'a [f64]) -> Option<&'a [f64]> {
    let (numbers, behind) = rest.split_at_checked(part.count().unwrap_or(rest.len()))?;
    *rest = behind;
    Some(numbers)
}

/// Replaces more combinations than the tangent has components by as many as it has, with the same
/// error at every point, and returns their noise.
fn few_combinations(
    numbers: &mut Vec<f64>,
    pose: usize,
    dim: usize,
    noise: Noise,
) -> Option<Noise> {
    if noise.dim() <= dim {
        return Some(noise);
    }
    let combinations = DMatrix::from_row_slice(noise.dim(), dim, numbers.get(pose..)?);
    // ‖R A e‖ = ‖U e‖ with R A = Q U.
    let upper = (noise.sqrt_information() * combinations).qr().r();
    let rows: Vec<_> = upper.row_iter().filter(|row| row.amax() > 0.0).collect();
    numbers.truncate(pose);
    rows.iter().for_each(|row| numbers.extend(row.iter().copied()));
    Noise::isotropic(rows.len(), 1.0).ok()
}
