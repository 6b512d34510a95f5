//! A measurement of each kind, taken at the truth with a little noise.

use std::sync::Arc;

use evergraph::factors::autodiff::{Number, Parameters, Residual, Transform2, Vector2};
use evergraph::factors::catalogue::{Catalogue, DataError, StoredResidual};
use evergraph::factors::*;
use evergraph::model::{
    Factor, Kernel, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Robust, Rot3,
};
use nalgebra::{DMatrix, DVector, Vector3};

use super::{Kind, Variable, Wiggle};

/// How to take one kind of measurement.
#[derive(Clone, Copy, Debug)]
pub struct Maker {
    /// The factor's name, and what it is put on where there is a choice.
    pub name: &'static str,
    /// The variables that it takes.
    pub kinds: &'static [Kind],
    make: Make,
}

type Make = fn(&[Variable], &mut Wiggle, Option<Kernel>) -> Arc<dyn Factor>;

impl Maker {
    /// Takes the measurement, under the kernel if there is one.
    ///
    /// # Panics
    /// When the variables are not of [`kinds`](Self::kinds).
    pub fn make(
        &self,
        variables: &[Variable],
        wiggle: &mut Wiggle,
        kernel: Option<Kernel>,
    ) -> Arc<dyn Factor> {
        (self.make)(variables, wiggle, kernel)
    }
}

fn wrap<F: Factor>(factor: Result<F, FactorError>, kernel: Option<Kernel>) -> Arc<dyn Factor> {
    let factor = factor.unwrap_or_else(|error| panic!("{error}"));
    match kernel {
        Some(kernel) => Arc::new(Robust::new(factor, kernel)),
        None => Arc::new(factor),
    }
}

fn noise(sigmas: &[f64]) -> Noise {
    Noise::from_sigmas(sigmas).unwrap_or_else(|error| panic!("{error}"))
}

/// Correlated noise, as files have it.
fn correlated(dim: usize, sigma: f64) -> Noise {
    let root = DMatrix::from_fn(dim, dim, |i, j| match i.cmp(&j) {
        std::cmp::Ordering::Less => 0.2 / sigma,
        std::cmp::Ordering::Equal => (1.0 + 0.1 * i as f64) / sigma,
        std::cmp::Ordering::Greater => 0.0,
    });
    Noise::from_sqrt_information(&root).unwrap_or_else(|error| panic!("{error}"))
}

fn p2(x: nalgebra::Vector2<f64>) -> Point2 {
    Point2::new(x.x, x.y)
}

fn p3(x: Vector3<f64>) -> Point3 {
    Point3::new(x.x, x.y, x.z)
}

fn heading(pose: &Pose3) -> f64 {
    pose.rotation().roll_pitch_yaw()[2]
}

/// What a pose sees a point as.
fn seen2(pose: &Pose2, at: &Point2) -> (f64, f64) {
    let q = pose.inverse_transform_point(at);
    (q.y().atan2(q.x()), q.x().hypot(q.y()))
}

fn seen3(pose: &Pose3, at: &Point3, wiggle: &mut Wiggle) -> (Vector3<f64>, f64) {
    let q = pose.inverse_transform_point(at).vector();
    let noise = Vector3::from_vec(wiggle.vector(3, 0.02));
    // Two variables in one place have no direction between them; any will do.
    let direction = if q.norm() > 1e-3 { q.normalize() } else { Vector3::x() };
    (direction + noise, q.norm())
}

/// A linear factor as node removal makes it, of a rank below its width.
fn linear(variables: &[Variable], wiggle: &mut Wiggle, shift: RootShift) -> Linear {
    let points: Vec<_> = variables
        .iter()
        .map(|variable| {
            let truth = variable.truth();
            let step = wiggle.vector(truth.dim(), 0.05);
            (variable.id(), truth.retract(&step).expect("the step has its dimension"))
        })
        .collect();
    let width: usize = points.iter().map(|(_, value)| value.dim()).sum();
    let rows = (width / 2).max(1);
    let g = DMatrix::from_fn(rows, width, |i, j| {
        if i == j { 8.0 } else { 2.0 * ((i * 31 + j * 17) as f64).sin() }
    });
    let offset = DVector::from_vec(wiggle.vector(width, 0.05));
    Linear::new(&points, shift, g, offset).unwrap_or_else(|error| panic!("{error}"))
}

/// A user's own measurement: the range to a mark with the offset and the drift of the clock among
/// the parameters.
#[derive(Debug)]
struct ClockRange {
    at: f64,
    range: f64,
}

impl Residual<1> for ClockRange {
    type Variables = (Pose2, Point2, Parameters<4>);
    const NAME: &'static str = "ClockRange";

    fn evaluate<T: Number>(
        &self,
        (pose, mark, clock): (Transform2<T>, Vector2<T>, nalgebra::SVector<T, 4>),
    ) -> [T; 1] {
        let seen = pose.inverse_transform_point(&mark);
        let squared = seen.x * seen.x + seen.y * seen.y + 0.01;
        [squared.sqrt() + clock[1] + clock[3] * self.at - self.range]
    }
}

impl StoredResidual<1> for ClockRange {
    fn numbers(&self) -> Vec<f64> {
        vec![self.at, self.range]
    }

    fn from_numbers(numbers: &[f64]) -> Result<Self, DataError> {
        match *numbers {
            [at, range] => Ok(Self { at, range }),
            _ => Err(DataError::Numbers { expected: 2, actual: numbers.len() }),
        }
    }
}

/// A catalogue with the types of all [`MAKERS`].
///
/// # Panics
/// When a name is taken.
pub fn catalogue() -> Catalogue {
    let mut catalogue = Catalogue::standard();
    let registered = catalogue.register_factor::<AutoDiff<ClockRange, 1>>();
    registered.unwrap_or_else(|error| panic!("{error}"));
    catalogue
}

macro_rules! maker {
    ($name:literal, [$($kind:ident $key:ident $truth:ident),+], |$wiggle:ident| $factor:expr) => {
        Maker {
            name: $name,
            kinds: &[$(Kind::$kind),+],
            make: |variables, $wiggle, kernel| match variables {
                [$(Variable::$kind($key, $truth)),+] => {
                    $(let _ = (&$key, &$truth);)+
                    wrap($factor, kernel)
                }
                other => panic!("{} is not for {other:?}", $name),
            },
        }
    };
}

macro_rules! linear_maker {
    ($name:literal, [$($kind:ident),+], $shift:expr) => {
        Maker {
            name: $name,
            kinds: &[$(Kind::$kind),+],
            make: |variables, wiggle, kernel| wrap(Ok(linear(variables, wiggle, $shift)), kernel),
        }
    };
}

/// Every factor of the library, on every kind of variable that it takes.
#[rustfmt::skip]
pub const MAKERS: &[Maker] = &[
    maker!("Prior<Pose2>", [Pose2 k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(3, 0.1))),
    maker!("Prior<Pose3>", [Pose3 k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(6, 0.1))),
    maker!("Prior<Point2>", [Point2 k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(2, 0.1))),
    maker!("Prior<Point3>", [Point3 k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(3, 0.1))),
    maker!("Prior<Rot2>", [Rot2 k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(1, 0.1))),
    maker!("Prior<Rot3>", [Rot3 k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(3, 0.1))),
    maker!("Prior<VectorN>", [Vector k x], |w| Prior::new(*k, w.near(x, 0.02), correlated(x.len(), 0.1))),
    maker!("Between<Pose2>", [Pose2 a x, Pose2 b y], |w| BetweenPose2::new(*a, *b, w.near(&x.between(y), 0.02), correlated(3, 0.05))),
    maker!("Between<Pose3>", [Pose3 a x, Pose3 b y], |w| BetweenPose3::new(*a, *b, w.near(&x.between(y), 0.02), correlated(6, 0.05))),
    maker!("Between<Point2>", [Point2 a x, Point2 b y], |w| BetweenPoint2::new(*a, *b, w.near(&x.between(y), 0.02), correlated(2, 0.05))),
    maker!("Between<Point3>", [Point3 a x, Point3 b y], |w| BetweenPoint3::new(*a, *b, w.near(&x.between(y), 0.02), correlated(3, 0.05))),
    maker!("Between<Rot2>", [Rot2 a x, Rot2 b y], |w| BetweenRot2::new(*a, *b, w.near(&x.between(y), 0.02), correlated(1, 0.05))),
    maker!("Between<Rot3>", [Rot3 a x, Rot3 b y], |w| BetweenRot3::new(*a, *b, w.near(&x.between(y), 0.02), correlated(3, 0.05))),
    maker!("PartialBetween<Pose2> x, theta", [Pose2 a x, Pose2 b y], |w| PartialBetweenPose2::new(*a, *b, w.near(&x.between(y), 0.02), &[0, 2], correlated(2, 0.05))),
    maker!("PartialBetween<Pose3> z, yaw", [Pose3 a x, Pose3 b y], |w| PartialBetweenPose3::new(*a, *b, w.near(&x.between(y), 0.02), &[2, 5], correlated(2, 0.05))),
    maker!("PartialBetween<Pose2> combined", [Pose2 a x, Pose2 b y], |w| PartialBetweenPose2::with_combinations(*a, *b, w.near(&x.between(y), 0.02), DMatrix::from_row_slice(2, 3, &[1.0, -0.5, 0.0, 0.0, 0.3, 1.0]), correlated(2, 0.05))),
    maker!("PartialBetween<Pose3> combined", [Pose3 a x, Pose3 b y], |w| PartialBetweenPose3::with_combinations(*a, *b, w.near(&x.between(y), 0.02), DMatrix::from_row_slice(1, 6, &[1.0, 0.5, 0.0, 0.0, 0.3, 1.0]), noise(&[0.05]))),
    maker!("RelativePosition2", [Pose2 a x, Point2 b y], |w| RelativePosition2::new(*a, *b, w.near(&x.inverse_transform_point(y), 0.02), correlated(2, 0.05))),
    maker!("RelativePosition3", [Pose3 a x, Point3 b y], |w| RelativePosition3::new(*a, *b, w.near(&x.inverse_transform_point(y), 0.02), correlated(3, 0.05))),
    maker!("RelativePosition3 with a sensor", [Pose3 a x, Point3 b y], |w| {
        let sensor = Pose3::new(Rot3::from_roll_pitch_yaw(-1.0, 0.2, 1.5), Point3::new(0.1, -0.2, 0.3));
        let seen = sensor.inverse_transform_point(&x.inverse_transform_point(y));
        RelativePosition3::with_sensor(*a, *b, w.near(&seen, 0.02), sensor, correlated(3, 0.05))
    }),
    maker!("GpsPosition2", [Pose2 k x], |w| GpsPosition2::new(*k, w.near(&x.translation(), 0.1), correlated(2, 0.3))),
    maker!("GpsPosition2 with a lever arm", [Pose2 k x], |w| {
        let arm = Point2::new(0.5, -0.2);
        GpsPosition2::with_lever_arm(*k, w.near(&x.transform_point(&arm), 0.1), arm, correlated(2, 0.3))
    }),
    maker!("GpsPosition3", [Pose3 k x], |w| GpsPosition3::new(*k, w.near(&x.translation(), 0.1), correlated(3, 0.3))),
    maker!("GpsPosition3 with a lever arm", [Pose3 k x], |w| {
        let arm = Point3::new(0.5, -0.2, 1.0);
        GpsPosition3::with_lever_arm(*k, w.near(&x.transform_point(&arm), 0.1), arm, correlated(3, 0.3))
    }),
    maker!("Depth", [Pose3 k x], |w| Depth::new(*k, x.z() + w.next(0.02), noise(&[0.05]))),
    maker!("Heading2", [Pose2 k x], |w| Heading2::new(*k, x.theta() + w.next(0.02), noise(&[0.05]))),
    maker!("Heading3", [Pose3 k x], |w| Heading3::new(*k, heading(x) + w.next(0.02), noise(&[0.05]))),
    maker!("RollPitch", [Pose3 k x], |w| {
        let [roll, pitch, _] = x.rotation().roll_pitch_yaw();
        RollPitch::new(*k, roll + w.next(0.02), pitch + w.next(0.02), correlated(2, 0.05))
    }),
    maker!("Attitude", [Pose3 k x], |w| {
        let down = Vector3::new(0.0, 0.0, -9.81);
        Attitude::new(*k, down, x.rotation().inverse_rotate(&down) + Vector3::from_vec(w.vector(3, 0.1)), correlated(2, 0.05))
    }),
    maker!("PlanarMotion", [Pose3 k x], |w| PlanarMotion::new(*k, x.z() + w.next(0.02), correlated(3, 0.3))),
    maker!("Range Pose2 Point2", [Pose2 a x, Point2 b y], |w| Range::new(*a, *b, (seen2(x, y).1 + w.next(0.02)).abs(), noise(&[0.1]))),
    maker!("Range Pose2 Pose2", [Pose2 a x, Pose2 b y], |w| Range::new(*a, *b, (seen2(x, &y.translation()).1 + w.next(0.02)).abs(), noise(&[0.1]))),
    maker!("Range Point2 Point2", [Point2 a x, Point2 b y], |w| Range::new(*a, *b, ((x.vector() - y.vector()).norm() + w.next(0.02)).abs(), noise(&[0.1]))),
    maker!("Range Pose3 Point3", [Pose3 a x, Point3 b y], |w| Range::new(*a, *b, ((x.translation().vector() - y.vector()).norm() + w.next(0.02)).abs(), noise(&[0.1]))),
    maker!("Range Pose3 Pose3", [Pose3 a x, Pose3 b y], |w| Range::new(*a, *b, ((x.translation().vector() - y.translation().vector()).norm() + w.next(0.02)).abs(), noise(&[0.1]))),
    maker!("Range Point3 Point3", [Point3 a x, Point3 b y], |w| Range::new(*a, *b, ((x.vector() - y.vector()).norm() + w.next(0.02)).abs(), noise(&[0.1]))),
    maker!("Bearing2 Point2", [Pose2 a x, Point2 b y], |w| Bearing2::new(*a, *b, seen2(x, y).0 + w.next(0.02), noise(&[0.05]))),
    maker!("Bearing2 Pose2", [Pose2 a x, Pose2 b y], |w| Bearing2::new(*a, *b, seen2(x, &y.translation()).0 + w.next(0.02), noise(&[0.05]))),
    maker!("Bearing3 Point3", [Pose3 a x, Point3 b y], |w| Bearing3::new(*a, *b, seen3(x, y, w).0, correlated(2, 0.05))),
    maker!("Bearing3 Pose3", [Pose3 a x, Pose3 b y], |w| Bearing3::new(*a, *b, seen3(x, &y.translation(), w).0, correlated(2, 0.05))),
    maker!("BearingRange2 Point2", [Pose2 a x, Point2 b y], |w| {
        let (bearing, range) = seen2(x, y);
        BearingRange2::new(*a, *b, bearing + w.next(0.02), range, correlated(2, 0.05))
    }),
    maker!("BearingRange2 Pose2", [Pose2 a x, Pose2 b y], |w| {
        let (bearing, range) = seen2(x, &y.translation());
        BearingRange2::new(*a, *b, bearing + w.next(0.02), range, correlated(2, 0.05))
    }),
    maker!("BearingRange3 Point3", [Pose3 a x, Point3 b y], |w| {
        let (direction, range) = seen3(x, y, w);
        BearingRange3::new(*a, *b, direction, range, correlated(3, 0.05))
    }),
    maker!("BearingRange3 Pose3", [Pose3 a x, Pose3 b y], |w| {
        let (direction, range) = seen3(x, &y.translation(), w);
        BearingRange3::new(*a, *b, direction, range, correlated(3, 0.05))
    }),
    maker!("DepthDifference", [Pose3 a x, Pose3 b y], |w| DepthDifference::new(*a, *b, y.z() - x.z() + w.next(0.02), noise(&[0.05]))),
    maker!("HeadingDifference", [Pose3 a x, Pose3 b y], |w| HeadingDifference::new(*a, *b, heading(y) - heading(x) + w.next(0.02), noise(&[0.05]))),
    maker!("TranslationDifference2", [Pose2 a x, Pose2 b y], |w| TranslationDifference2::new(*a, *b, w.near(&p2(y.translation().vector() - x.translation().vector()), 0.02), correlated(2, 0.1))),
    maker!("TranslationDifference3", [Pose3 a x, Pose3 b y], |w| TranslationDifference3::new(*a, *b, w.near(&p3(y.translation().vector() - x.translation().vector()), 0.02), correlated(3, 0.1))),
    maker!("AutoDiff of a pose, a point and parameters", [Pose2 a x, Point2 b y, Vector c clock], |w| {
        let at = 0.5 + w.next(0.5);
        let distance = seen2(x, y).1.hypot(0.1);
        let range = distance + clock.vector()[1] + clock.vector()[3] * at + w.next(0.02);
        AutoDiff::new((*a, *b, *c), ClockRange { at, range }, noise(&[0.05]))
    }),
    linear_maker!("Linear of a pose", [Pose2], RootShift::None),
    linear_maker!("Linear of poses in the plane", [Pose2, Pose2, Pose2], RootShift::Root),
    linear_maker!("Linear of poses in space", [Pose3, Pose3], RootShift::InverseRoot),
    linear_maker!("Linear of poses and points", [Pose3, Point3, Pose3], RootShift::Root),
    linear_maker!("Linear of the plane and space", [Pose2, Pose3, Point2, Point3], RootShift::None),
    linear_maker!("Linear of rotations and vectors", [Rot3, Vector, Rot2], RootShift::None),
];
