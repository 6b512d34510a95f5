//! Matrices, and what is measured by a sensor, in the units and frames of another dialect.

use evergraph_model::{LieGroup, Noise, Point3, Pose3};
use nalgebra::{DMatrix, Matrix3};

use super::{Converter, half_angles, pose3, quaternion, scale_rotation};
use crate::check;
use crate::coordinates::Coordinates;
use crate::error::{FormatError, Place};
use crate::matrix;
use crate::measurement::{Measurement, Quantity};
use crate::options::Dialect;
use crate::record::Record;
use crate::weight::{EntryOrder, Weight, WeightKind};

impl Converter<'_> {
    /// A prior on a sensor's pose as one on the robot's, where the target has no sensor offsets.
    pub(super) fn prior_of_robot(
        &self,
        measurement: &Measurement,
        place: &Place,
    ) -> Result<Measurement, FormatError> {
        let unchanged = || Ok(measurement.clone());
        let (Quantity::Prior, Some(parameter)) = (measurement.quantity, measurement.parameter)
        else {
            return unchanged();
        };
        if self.target == Dialect::G2o {
            return unchanged();
        }
        let robot_from_sensor = self.offset(parameter, place)?;
        if *robot_from_sensor == Pose3::identity() {
            return unchanged();
        }
        let numbers = <[f64; 7]>::try_from(&measurement.numbers[..])
            .map_err(|_| check::bad(place, "it is no pose"))?;
        let world_from_sensor = pose3(&Coordinates::Pose3Quaternion(numbers))
            .ok_or_else(|| check::bad(place, "its quaternion names no rotation"))?;
        let sensor_from_robot = robot_from_sensor.inverse();
        let world_from_robot = world_from_sensor.compose(&sensor_from_robot);
        let mut information = self.information(&measurement.weight, 6, place)?;
        if half_angles(self.document, self.document.dialect) {
            scale_rotation(&mut information, 0.5);
        }
        // The error in the sensor's frame is the adjoint of the robot's.
        let adjoint = sensor_from_robot.adjoint();
        let adjoint = DMatrix::from_fn(6, 6, |i, j| adjoint[(i, j)]);
        let moved = symmetric(&(adjoint.tr_mul(&information) * &adjoint));
        Ok(Measurement {
            numbers: quaternion(&world_from_robot).numbers().into(),
            weight: information_weight(&moved),
            ..measurement.clone()
        })
    }

    fn offset(&self, id: u64, place: &Place) -> Result<&Pose3, FormatError> {
        let missing = || FormatError::MissingOffset { place: place.clone(), id };
        self.offsets.get(&id).ok_or_else(missing)
    }

    /// A landmark that a sensor sees, seen from the robot, where the target has no sensor offsets.
    pub(super) fn in_robot_frame(
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
        let robot_from_sensor = self.offset(parameter, place)?;
        if *robot_from_sensor == Pose3::identity() {
            return Ok(unchanged);
        }
        let seen = robot_from_sensor.transform_point(&Point3::from(*point));
        let information = self.information(weight, 3, place)?;
        let r: Matrix3<f64> = robot_from_sensor.rotation().matrix();
        let inner: Matrix3<f64> = information.fixed_view::<3, 3>(0, 0).into_owned();
        let rotated = r * inner * r.transpose();
        let rotated = symmetric(&DMatrix::from_fn(3, 3, |i, j| rotated[(i, j)]));
        Ok((Coordinates::Point3([seen.x(), seen.y(), seen.z()]), information_weight(&rotated)))
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

    /// By what rotation rows and columns are multiplied, where the units of 3D rotations change.
    pub(super) fn rescale(&self, record: &Record) -> Option<f64> {
        let source = half_angles(self.document, self.document.dialect);
        let target = half_angles(self.document, self.target);
        let changes = record.has_rotation_rows() && source != target;
        changes.then_some(if source { 0.5 } else { 2.0 })
    }

    /// A diagonal matrix as standard deviations.
    pub(super) fn sigmas(
        &self,
        weight: &Weight,
        dim: usize,
        place: &Place,
    ) -> Result<Weight, FormatError> {
        if weight.kind == WeightKind::Sigmas {
            return Ok(weight.clone());
        }
        let information = self.information(weight, dim, place)?;
        let is_diagonal = information == DMatrix::from_diagonal(&information.diagonal());
        if !is_diagonal || information.diagonal().iter().any(|x| *x <= 0.0) {
            return Err(self.unsupported("bearings and ranges that are correlated", place));
        }
        let entries = information.diagonal().map(|x| 1.0 / x.sqrt());
        Ok(Weight {
            kind: WeightKind::Sigmas,
            order: EntryOrder::UpperTriangle,
            entries: entries.iter().copied().collect(),
        })
    }

    pub(super) fn weight(
        &self,
        weight: &Weight,
        dim: usize,
        rescale: Option<f64>,
        place: &Place,
    ) -> Result<Weight, FormatError> {
        let kind = match (self.target, self.document.dialect) {
            (Dialect::G2o | Dialect::Toro, _) => WeightKind::Information,
            (Dialect::Isam, Dialect::Isam) => self.document.isam_matrix,
            (Dialect::Isam, _) => WeightKind::SquareRoot,
            (Dialect::Pyfg, _) => WeightKind::Covariance,
        };
        let order = match self.target {
            Dialect::Toro if dim == 3 => EntryOrder::Toro,
            _ => EntryOrder::UpperTriangle,
        };
        if weight.entries.is_empty()
            && self.target == Dialect::Isam
            && dim != 2
            && rescale.is_none()
        {
            return Ok(Weight { kind, order, entries: weight.entries.clone() });
        }
        if weight.kind == kind && rescale.is_none() && !weight.entries.is_empty() {
            if weight.order == order {
                return Ok(weight.clone());
            }
            // Only the places of the entries change; a 2D pose is the one with two orders.
            if let Some(matrix) = matrix::as_written(weight, dim) {
                return Ok(Weight { kind, order, entries: matrix::entries(&matrix, order) });
            }
        }
        let mut information = self.information(weight, dim, place)?;
        if let Some(factor) = rescale {
            scale_rotation(&mut information, factor);
        }
        let matrix = match kind {
            // No dialect has all of its matrices as standard deviations.
            WeightKind::Information | WeightKind::Sigmas => information,
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

fn symmetric(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    (matrix + matrix.transpose()) * 0.5
}

fn information_weight(information: &DMatrix<f64>) -> Weight {
    Weight {
        kind: WeightKind::Information,
        order: EntryOrder::UpperTriangle,
        entries: matrix::entries(information, EntryOrder::UpperTriangle),
    }
}
