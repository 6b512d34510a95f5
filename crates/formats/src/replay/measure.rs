//! Edges with numbers: measurement, noise, the factor they make, the start values they give.

use evergraph_factors::{
    BetweenPose2, BetweenPose3, FactorError, Prior, RelativePosition2, RelativePosition3,
};
use evergraph_model::{
    Change, Factor, FactorId, Kernel, Key, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Robust,
    Value, VariableId,
};

use crate::check::bad;
use crate::convert;
use crate::document::Document;
use crate::error::{FormatError, Place};
use crate::matrix;
use crate::record::{Coordinates, Kind};
use crate::weight::{Weight, WeightKind};

/// A typed key of any of the file's kinds.
#[derive(Clone, Copy, Debug)]
pub(super) enum Handle {
    Pose2(Key<Pose2>),
    Pose3(Key<Pose3>),
    Point2(Key<Point2>),
    Point3(Key<Point3>),
}

impl Handle {
    pub fn id(self) -> VariableId {
        match self {
            Self::Pose2(key) => key.id(),
            Self::Pose3(key) => key.id(),
            Self::Point2(key) => key.id(),
            Self::Point3(key) => key.id(),
        }
    }
}

/// A pose or a point as the engine has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Geometry {
    Pose2(Pose2),
    Pose3(Pose3),
    Point2(Point2),
    Point3(Point3),
}

impl Geometry {
    /// What coordinates name; `None` for a quaternion of length zero, which no document holds.
    pub fn of(at: &Coordinates) -> Option<Self> {
        Some(match *at {
            Coordinates::Pose2([x, y, theta]) => Self::Pose2(Pose2::new(x, y, theta)),
            Coordinates::Point2([x, y]) => Self::Point2(Point2::new(x, y)),
            Coordinates::Point3([x, y, z]) => Self::Point3(Point3::new(x, y, z)),
            Coordinates::Pose3Quaternion(_) | Coordinates::Pose3Euler(_) => {
                Self::Pose3(convert::pose3(at)?)
            }
        })
    }

    pub fn from_value(value: &Value, kind: Kind) -> Option<Self> {
        Some(match kind {
            Kind::Pose2 => Self::Pose2(value.get()?),
            Kind::Pose3 => Self::Pose3(value.get()?),
            Kind::Point2 => Self::Point2(value.get()?),
            Kind::Point3 => Self::Point3(value.get()?),
        })
    }

    /// Where a part begins that nothing says the place of.
    pub fn origin(kind: Kind) -> Self {
        match kind {
            Kind::Pose2 => Self::Pose2(Pose2::identity()),
            Kind::Pose3 => Self::Pose3(Pose3::identity()),
            Kind::Point2 => Self::Point2(Point2::new(0.0, 0.0)),
            Kind::Point3 => Self::Point3(Point3::new(0.0, 0.0, 0.0)),
        }
    }

    pub fn is_finite(&self) -> bool {
        let value = match self {
            Self::Pose2(v) => Value::new(v),
            Self::Pose3(v) => Value::new(v),
            Self::Point2(v) => Value::new(v),
            Self::Point3(v) => Value::new(v),
        };
        value.storage().iter().all(|x| x.is_finite())
    }

    pub fn add_to(&self, change: &mut Change) -> Handle {
        match self {
            Self::Pose2(v) => Handle::Pose2(change.add_variable(v)),
            Self::Pose3(v) => Handle::Pose3(change.add_variable(v)),
            Self::Point2(v) => Handle::Point2(change.add_variable(v)),
            Self::Point3(v) => Handle::Point3(change.add_variable(v)),
        }
    }
}

/// An edge, ready to become a factor.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    pub line: usize,
    /// `from_from_to`.
    pub measurement: Geometry,
    /// `robot_from_sensor` of a landmark in space.
    pub sensor: Option<Pose3>,
    pub noise: Noise,
}

impl Measured {
    /// The value of `to` given `from`'s, or, `backwards`, of `from` given `to`'s.
    pub fn compose(&self, known: &Geometry, backwards: bool) -> Option<Geometry> {
        Some(match (known, &self.measurement) {
            (Geometry::Pose2(x), Geometry::Pose2(z)) if backwards => {
                Geometry::Pose2(x.compose(&z.inverse()))
            }
            (Geometry::Pose3(x), Geometry::Pose3(z)) if backwards => {
                Geometry::Pose3(x.compose(&z.inverse()))
            }
            (Geometry::Pose2(x), Geometry::Pose2(z)) => Geometry::Pose2(x.compose(z)),
            (Geometry::Pose3(x), Geometry::Pose3(z)) => Geometry::Pose3(x.compose(z)),
            (Geometry::Pose2(x), Geometry::Point2(z)) => Geometry::Point2(x.transform_point(z)),
            (Geometry::Pose3(x), Geometry::Point3(z)) => {
                let in_robot = self
                    .sensor
                    .map_or(*z, |robot_from_sensor| robot_from_sensor.transform_point(z));
                Geometry::Point3(x.transform_point(&in_robot))
            }
            _ => return None,
        })
    }

    /// Adds the factor, under the kernel if there is one.
    pub fn add_to(
        &self,
        change: &mut Change,
        ends: (Handle, Handle),
        kernel: Option<Kernel>,
        place: impl Fn() -> Place,
    ) -> Result<FactorId, FormatError> {
        let noise = self.noise.clone();
        let failed = |error: FactorError| bad(&place(), error);
        match (self.measurement, ends) {
            (Geometry::Pose2(z), (Handle::Pose2(from), Handle::Pose2(to))) => {
                Ok(add(change, BetweenPose2::new(from, to, z, noise).map_err(failed)?, kernel))
            }
            (Geometry::Pose3(z), (Handle::Pose3(from), Handle::Pose3(to))) => {
                Ok(add(change, BetweenPose3::new(from, to, z, noise).map_err(failed)?, kernel))
            }
            (Geometry::Point2(z), (Handle::Pose2(from), Handle::Point2(to))) => {
                Ok(add(change, RelativePosition2::new(from, to, z, noise).map_err(failed)?, kernel))
            }
            (Geometry::Point3(z), (Handle::Pose3(from), Handle::Point3(to))) => {
                let factor = match self.sensor {
                    Some(sensor) => RelativePosition3::with_sensor(from, to, z, sensor, noise),
                    None => RelativePosition3::new(from, to, z, noise),
                };
                Ok(add(change, factor.map_err(failed)?, kernel))
            }
            _ => Err(bad(&place(), "its ends are not of the kinds that it measures")),
        }
    }
}

fn add<F: Factor>(change: &mut Change, factor: F, kernel: Option<Kernel>) -> FactorId {
    match kernel {
        Some(kernel) => change.add_factor(Robust::new(factor, kernel)),
        None => change.add_factor(factor),
    }
}

/// Adds a prior of one sigma for positions and angles.
pub(super) fn add_prior(
    change: &mut Change,
    pose: Handle,
    at: Geometry,
    sigma: f64,
    place: &Place,
) -> Result<FactorId, FormatError> {
    let noise = |dim| Noise::isotropic(dim, sigma).map_err(|error| bad(place, error));
    let failed = |error: FactorError| bad(place, error);
    match (pose, at) {
        (Handle::Pose2(key), Geometry::Pose2(at)) => {
            Ok(change.add_factor(Prior::new(key, at, noise(3)?).map_err(failed)?))
        }
        (Handle::Pose3(key), Geometry::Pose3(at)) => {
            Ok(change.add_factor(Prior::new(key, at, noise(6)?).map_err(failed)?))
        }
        _ => Err(bad(place, "a gauge prior is for poses")),
    }
}

/// The noise that a matrix of a document means, in the engine's tangent order and units.
pub(super) fn noise(
    document: &Document,
    weight: &Weight,
    dim: usize,
    place: &Place,
) -> Result<Noise, FormatError> {
    let mut written = matrix::as_written(weight, dim)
        .ok_or_else(|| bad(place, "its matrix has not as many entries as the measurement needs"))?;
    let kind = if weight.entries.is_empty() { WeightKind::SquareRoot } else { weight.kind };
    let made = match kind {
        WeightKind::SquareRoot => Noise::from_sqrt_information(&written),
        WeightKind::Covariance => Noise::from_covariance(&written),
        WeightKind::Information => {
            if convert::half_angles(document, document.dialect()) {
                convert::scale_rotation(&mut written, 0.5);
            }
            // What the printed digits can explain was decided, and counted, when the document was
            // made; here no negative eigenvalue is left that they do not.
            Noise::from_information_clipped(&written, f64::INFINITY).map(|(noise, _)| noise)
        }
    };
    made.map_err(|error| bad(place, error))
}
