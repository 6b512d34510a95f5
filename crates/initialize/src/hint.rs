//! The position of a landmark as far as one measurement gives it.

use evergraph_factors::{
    Bearing2, Bearing3, BearingRange2, BearingRange3, BetweenPoint2, BetweenPoint3, Linear, Prior,
    Range, RelativePosition2, RelativePosition3,
};
use evergraph_model::{Factor, Point2, Point3, Pose2, Pose3};
use nalgebra::Vector3;

use crate::geometry::Geometry;

/// A start for the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Hint {
    At(Vector3<f64>),
    /// Somewhere along a unit vector.
    Along(Vector3<f64>, Vector3<f64>),
    /// At a distance.
    Around(Vector3<f64>, f64),
    Nowhere,
}

impl Hint {
    /// The hint of a factor with its variable at position `landmark` unknown, the others at `ends`.
    pub fn of(factor: &dyn Factor, ends: &[Option<Geometry>], landmark: usize) -> Self {
        Self::find(factor, ends, landmark).unwrap_or(Self::Nowhere)
    }

    fn find(factor: &dyn Factor, ends: &[Option<Geometry>], landmark: usize) -> Option<Self> {
        if let Some((linear, _)) = factor.downcast::<Linear>() {
            let point = linear.linearization_points().get(landmark)?;
            return Some(Self::At(Geometry::of(point)?.position()));
        }
        if let Some((prior, _)) = factor.downcast::<Prior<Point2>>() {
            return Some(Self::At(flat(prior.measurement())));
        }
        if let Some((prior, _)) = factor.downcast::<Prior<Point3>>() {
            return Some(Self::At(prior.measurement().vector()));
        }
        let other = ends.iter().enumerate().find(|(at, _)| *at != landmark)?.1.as_ref()?;
        let from = other.position();
        let apart = |z: Vector3<f64>| Self::At(if landmark == 1 { from + z } else { from - z });
        if let Some((between, _)) = factor.downcast::<BetweenPoint2>() {
            return Some(apart(flat(between.measurement())));
        }
        if let Some((between, _)) = factor.downcast::<BetweenPoint3>() {
            return Some(apart(between.measurement().vector()));
        }
        if let Some(range) = range(factor) {
            return Some(Self::Around(from, range));
        }
        match other {
            Geometry::Pose2(pose) => Self::from_pose2(factor, pose, from),
            Geometry::Pose3(pose) => Self::from_pose3(factor, pose, from),
            Geometry::Point2(_) | Geometry::Point3(_) => None,
        }
    }

    fn from_pose2(factor: &dyn Factor, pose: &Pose2, from: Vector3<f64>) -> Option<Self> {
        let ahead = |bearing: f64| {
            let rotation = Pose2::new(0.0, 0.0, pose.theta() + bearing).rotation();
            Vector3::new(rotation.cos(), rotation.sin(), 0.0)
        };
        if let Some((seen, _)) = factor.downcast::<Bearing2<Point2>>() {
            return Some(Self::Along(from, ahead(seen.measurement())));
        }
        if let Some((seen, _)) = factor.downcast::<BearingRange2<Point2>>() {
            return Some(Self::At(from + seen.range() * ahead(seen.bearing())));
        }
        let (seen, _) = factor.downcast::<RelativePosition2>()?;
        Some(Self::At(flat(&pose.transform_point(&seen.measurement()))))
    }

    fn from_pose3(factor: &dyn Factor, pose: &Pose3, from: Vector3<f64>) -> Option<Self> {
        if let Some((seen, _)) = factor.downcast::<Bearing3<Point3>>() {
            return Some(Self::Along(from, pose.rotation().rotate(seen.measurement())));
        }
        if let Some((seen, _)) = factor.downcast::<BearingRange3<Point3>>() {
            let direction = pose.rotation().rotate(seen.direction());
            return Some(Self::At(from + seen.range() * direction));
        }
        let (seen, _) = factor.downcast::<RelativePosition3>()?;
        let sensor = *pose * *seen.robot_from_sensor();
        Some(Self::At(sensor.transform_point(&seen.measurement()).vector()))
    }
}

fn flat(point: &Point2) -> Vector3<f64> {
    Vector3::new(point.x(), point.y(), 0.0)
}

/// The range that a factor measures from a point or to one.
fn range(factor: &dyn Factor) -> Option<f64> {
    macro_rules! of {
        ($($a:ty, $b:ty, $dim:literal;)*) => {
            $(if let Some((range, _)) = factor.downcast::<Range<$a, $b, $dim>>() {
                return Some(range.measurement());
            })*
        };
    }
    of! {
        Pose2, Point2, 2;
        Point2, Pose2, 2;
        Point2, Point2, 2;
        Pose3, Point3, 3;
        Point3, Pose3, 3;
        Point3, Point3, 3;
    }
    None
}
