//! From an observation and its variables to a factor.

use std::sync::Arc;

use evergraph_factors::{
    Attitude, Bearing2, Bearing3, BearingRange2, BearingRange3, BetweenPoint2, BetweenPoint3,
    BetweenPose2, BetweenPose3, Depth, DepthDifference, FactorError, GpsPosition2, GpsPosition3,
    Heading2, Heading3, HeadingDifference, Linear, PartialBetween, PlanarMotion, Prior, Range,
    RelativePosition2, RelativePosition3, RollPitch, TranslationDifference2,
    TranslationDifference3,
};
use evergraph_formats::Quantity;
use evergraph_model::{
    Factor, Kernel, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Robust, Rot3,
};
use nalgebra::{DMatrix, Vector3};

use crate::geometry::{Geometry, Handle};
use crate::observation::{Observation, Observed};

/// The factor, or why there is none.
type Made = Result<Arc<dyn Factor>, String>;

impl Observation {
    /// The factor on variables of its ends, under its kernel.
    pub fn factor(&self, ends: &[Handle]) -> Made {
        let kernel = self.kernel;
        match &self.what {
            Observed::Relative { measurement, sensor, noise } => {
                relative(ends, measurement, sensor.as_ref(), noise.clone(), kernel)
            }
            Observed::Quantity { quantity, numbers, sensor, noise } => {
                let numbers = Numbers { numbers, sensor: sensor.as_ref() };
                factor_of(*quantity, ends, &numbers, noise.clone(), kernel)
            }
            Observed::Linear(linear) => {
                let variables: Vec<_> =
                    ends.iter().map(|end| end.id()).zip(linear.points()).collect();
                let (g, offset) = (linear.sqrt_information.clone(), linear.offset.clone());
                wrap(Linear::new(&variables, linear.root_shift, g, offset), kernel)
            }
        }
    }
}

fn relative(
    ends: &[Handle],
    measurement: &Geometry,
    sensor: Option<&Pose3>,
    noise: Noise,
    kernel: Option<Kernel>,
) -> Made {
    use Handle as H;
    match (*measurement, ends) {
        (Geometry::Pose2(z), [H::Pose2(from), H::Pose2(to)]) => {
            wrap(BetweenPose2::new(*from, *to, z, noise), kernel)
        }
        (Geometry::Pose3(z), [H::Pose3(from), H::Pose3(to)]) => {
            wrap(BetweenPose3::new(*from, *to, z, noise), kernel)
        }
        (Geometry::Point2(z), [H::Pose2(from), H::Point2(to)]) => {
            wrap(RelativePosition2::new(*from, *to, z, noise), kernel)
        }
        (Geometry::Point3(z), [H::Pose3(from), H::Point3(to)]) => match sensor {
            Some(at) => wrap(RelativePosition3::with_sensor(*from, *to, z, *at, noise), kernel),
            None => wrap(RelativePosition3::new(*from, *to, z, noise), kernel),
        },
        _ => Err("its ends are not of the kinds that it measures".into()),
    }
}

fn factor_of(
    quantity: Quantity,
    ends: &[Handle],
    at: &Numbers<'_>,
    noise: Noise,
    kernel: Option<Kernel>,
) -> Made {
    use Handle as H;
    use Quantity as Q;
    match (quantity, ends) {
        (Q::Prior, [H::Pose2(x)]) => wrap(Prior::new(*x, at.pose2()?, noise), kernel),
        (Q::Prior, [H::Pose3(x)]) => {
            let (z, noise) = of_robot(at.pose3()?, at.sensor, noise)?;
            wrap(Prior::new(*x, z, noise), kernel)
        }
        (Q::Prior, [H::Point2(p)]) => wrap(Prior::new(*p, at.point2(0)?, noise), kernel),
        (Q::Prior, [H::Point3(p)]) => wrap(Prior::new(*p, at.point3(0)?, noise), kernel),
        (Q::Position, [H::Pose2(x)]) => wrap(GpsPosition2::new(*x, at.point2(0)?, noise), kernel),
        (Q::Position, [H::Pose3(x)]) => {
            let arm = at.sensor.map_or(Point3::identity(), Pose3::translation);
            wrap(GpsPosition3::with_lever_arm(*x, at.point3(0)?, arm, noise), kernel)
        }
        (Q::AntennaPosition, [H::Pose2(x)]) => {
            wrap(GpsPosition2::with_lever_arm(*x, at.point2(0)?, at.point2(2)?, noise), kernel)
        }
        (Q::AntennaPosition, [H::Pose3(x)]) => {
            wrap(GpsPosition3::with_lever_arm(*x, at.point3(0)?, at.point3(3)?, noise), kernel)
        }
        (Q::Depth, [H::Pose3(x)]) => wrap(Depth::new(*x, at.number(0)?, noise), kernel),
        (Q::Heading, [H::Pose2(x)]) => wrap(Heading2::new(*x, at.number(0)?, noise), kernel),
        (Q::Heading, [H::Pose3(x)]) => wrap(Heading3::new(*x, at.number(0)?, noise), kernel),
        (Q::RollPitch, [H::Pose3(x)]) => {
            wrap(RollPitch::new(*x, at.number(0)?, at.number(1)?, noise), kernel)
        }
        (Q::Attitude, [H::Pose3(x)]) => {
            wrap(Attitude::new(*x, at.vector3(0)?, at.vector3(3)?, noise), kernel)
        }
        (Q::PlanarMotion, [H::Pose3(x)]) => {
            wrap(PlanarMotion::new(*x, at.number(0)?, noise), kernel)
        }
        (Q::Between, [H::Point2(a), H::Point2(b)]) => {
            wrap(BetweenPoint2::new(*a, *b, at.point2(0)?, noise), kernel)
        }
        (Q::Between, [H::Point3(a), H::Point3(b)]) => {
            wrap(BetweenPoint3::new(*a, *b, at.point3(0)?, noise), kernel)
        }
        (Q::Range, ends) => range(ends, at.number(0)?, noise, kernel),
        (Q::Bearing | Q::BearingRange, ends) => bearing(quantity, ends, at, noise, kernel),
        (Q::DepthDifference, [H::Pose3(a), H::Pose3(b)]) => {
            wrap(DepthDifference::new(*a, *b, at.number(0)?, noise), kernel)
        }
        (Q::HeadingDifference, [H::Pose3(a), H::Pose3(b)]) => {
            wrap(HeadingDifference::new(*a, *b, at.number(0)?, noise), kernel)
        }
        (Q::TranslationDifference, [H::Pose2(a), H::Pose2(b)]) => {
            wrap(TranslationDifference2::new(*a, *b, at.point2(0)?, noise), kernel)
        }
        (Q::TranslationDifference, [H::Pose3(a), H::Pose3(b)]) => {
            wrap(TranslationDifference3::new(*a, *b, at.point3(0)?, noise), kernel)
        }
        (Q::Partial, [H::Pose2(a), H::Pose2(b)]) => {
            let combinations = at.combinations(3, 3)?;
            wrap(
                PartialBetween::with_combinations(*a, *b, at.pose2()?, combinations, noise),
                kernel,
            )
        }
        (Q::Partial, [H::Pose3(a), H::Pose3(b)]) => {
            let combinations = at.combinations(7, 6)?;
            wrap(
                PartialBetween::with_combinations(*a, *b, at.pose3()?, combinations, noise),
                kernel,
            )
        }
        _ => Err("its ends are not of the kinds that it measures".into()),
    }
}

fn range(ends: &[Handle], range: f64, noise: Noise, kernel: Option<Kernel>) -> Made {
    use Handle as H;
    match ends {
        [H::Pose2(a), H::Pose2(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Pose2(a), H::Point2(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Point2(a), H::Pose2(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Point2(a), H::Point2(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Pose3(a), H::Pose3(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Pose3(a), H::Point3(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Point3(a), H::Pose3(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        [H::Point3(a), H::Point3(b)] => wrap(Range::new(*a, *b, range, noise), kernel),
        _ => Err("its ends are not of the kinds that it measures".into()),
    }
}

/// A bearing, with the range where that is measured, too.
fn bearing(
    quantity: Quantity,
    ends: &[Handle],
    at: &Numbers<'_>,
    noise: Noise,
    kernel: Option<Kernel>,
) -> Made {
    use Handle as H;
    let with_range = quantity == Quantity::BearingRange;
    match ends {
        [H::Pose2(x), H::Pose2(y)] if with_range => {
            wrap(BearingRange2::new(*x, *y, at.number(0)?, at.number(1)?, noise), kernel)
        }
        [H::Pose2(x), H::Point2(p)] if with_range => {
            wrap(BearingRange2::new(*x, *p, at.number(0)?, at.number(1)?, noise), kernel)
        }
        [H::Pose3(x), H::Pose3(y)] if with_range => {
            wrap(BearingRange3::new(*x, *y, at.vector3(0)?, at.number(3)?, noise), kernel)
        }
        [H::Pose3(x), H::Point3(p)] if with_range => {
            wrap(BearingRange3::new(*x, *p, at.vector3(0)?, at.number(3)?, noise), kernel)
        }
        [H::Pose2(x), H::Pose2(y)] => wrap(Bearing2::new(*x, *y, at.number(0)?, noise), kernel),
        [H::Pose2(x), H::Point2(p)] => wrap(Bearing2::new(*x, *p, at.number(0)?, noise), kernel),
        [H::Pose3(x), H::Pose3(y)] => wrap(Bearing3::new(*x, *y, at.vector3(0)?, noise), kernel),
        [H::Pose3(x), H::Point3(p)] => wrap(Bearing3::new(*x, *p, at.vector3(0)?, noise), kernel),
        _ => Err("its ends are not of the kinds that it measures".into()),
    }
}

/// The prior on the robot that a prior `z` on a sensor is, `S` being where that sits:
/// `Log(z⁻¹ X S) = Ad(S⁻¹) Log((z S⁻¹)⁻¹ X)`.
fn of_robot(z: Pose3, sensor: Option<&Pose3>, noise: Noise) -> Result<(Pose3, Noise), String> {
    let Some(sensor) = sensor else { return Ok((z, noise)) };
    let sensor_from_robot = sensor.inverse();
    let adjoint = sensor_from_robot.adjoint();
    let adjoint = DMatrix::from_column_slice(6, 6, adjoint.as_slice());
    let noise = Noise::from_sqrt_information(&(noise.sqrt_information() * adjoint))
        .map_err(|error| error.to_string())?;
    Ok((z.compose(&sensor_from_robot), noise))
}

fn wrap<F: Factor>(factor: Result<F, FactorError>, kernel: Option<Kernel>) -> Made {
    let factor = factor.map_err(|error| error.to_string())?;
    Ok(match kernel {
        Some(kernel) => Arc::new(Robust::new(factor, kernel)),
        None => Arc::new(factor),
    })
}

/// The measured numbers, and where the sensor sits.
pub(crate) struct Numbers<'a> {
    pub numbers: &'a [f64],
    pub sensor: Option<&'a Pose3>,
}

impl Numbers<'_> {
    fn array<const N: usize>(&self, from: usize) -> Result<[f64; N], String> {
        let numbers = self.numbers.get(from..from + N);
        numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| "it lacks numbers".into())
    }

    pub fn number(&self, at: usize) -> Result<f64, String> {
        self.array(at).map(|[x]| x)
    }

    pub fn vector3(&self, from: usize) -> Result<Vector3<f64>, String> {
        self.array::<3>(from).map(Vector3::from)
    }

    pub fn point2(&self, from: usize) -> Result<Point2, String> {
        self.array(from).map(|[x, y]| Point2::new(x, y))
    }

    pub fn point3(&self, from: usize) -> Result<Point3, String> {
        self.array(from).map(|[x, y, z]| Point3::new(x, y, z))
    }

    fn pose2(&self) -> Result<Pose2, String> {
        self.array(0).map(|[x, y, theta]| Pose2::new(x, y, theta))
    }

    fn pose3(&self) -> Result<Pose3, String> {
        let [x, y, z, qx, qy, qz, qw] = self.array(0)?;
        let rotation = Rot3::from_quaternion(qx, qy, qz, qw)
            .map_err(|_| "its quaternion names no rotation".to_string())?;
        Ok(Pose3::new(rotation, Point3::new(x, y, z)))
    }

    /// Combinations of `columns` tangent components, after a pose of `from` numbers.
    fn combinations(&self, from: usize, columns: usize) -> Result<DMatrix<f64>, String> {
        let rows = self.numbers.get(from..).ok_or("it lacks numbers")?;
        Ok(DMatrix::from_row_slice(rows.len() / columns, columns, rows))
    }
}
