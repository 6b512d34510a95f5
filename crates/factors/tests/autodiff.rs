//! Residuals differentiated automatically against the same ones by hand, and users' own.

#![allow(
    clippy::unwrap_used,
    reason = "the lint knows tests by their attribute; the generic helpers here have none"
)]

mod common;

use common::{POINTS, Sample, Source, close, key, keys, linearize, residual, unit, values};
use evergraph_factors::autodiff::{
    AutoDiff, Dual64, Number, Parameters, Residual, Rotation2, Rotation3, Transform2, Transform3,
    norm, wrap_angle,
};
use evergraph_factors::{Between, FactorError, Heading3};
use evergraph_model::testing::{assert_jacobian, check_gradient};
use evergraph_model::{
    Factor, Graph, Kernel, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Robust, Rot2, Rot3,
    Value, VectorN,
};
use nalgebra::{SVector, Vector2, Vector3};

/// `Log(z⁻¹ a⁻¹ b)`, as a user would write it.
#[derive(Clone, Debug)]
struct Relative<G>(G);

macro_rules! relative {
    ($group:ident, $seen:ident, $rows:literal, $log:expr) => {
        impl Residual<$rows> for Relative<$group> {
            type Variables = ($group, $group);
            const NAME: &'static str = "Relative";

            fn evaluate<T: Number>(&self, (a, b): ($seen<T>, $seen<T>)) -> [T; $rows] {
                let error = $seen::from(self.0).between(&a.between(&b)).log();
                $log(error)
            }
        }
    };
}
relative!(Rot2, Rotation2, 1, |angle| [angle]);
relative!(Rot3, Rotation3, 3, <[T; 3]>::from);
relative!(Pose2, Transform2, 3, <[T; 3]>::from);
relative!(Pose3, Transform3, 6, <[T; 6]>::from);

/// The same numbers as the factor by hand, to rounding of what goes in.
fn as_by_hand<G, const N: usize>(i: G, j: G, z: G, noise: Noise)
where
    G: LieGroup<N>,
    Relative<G>: Residual<
            N,
            Variables: evergraph_factors::autodiff::Variables<
                Keys = (evergraph_model::Key<G>, evergraph_model::Key<G>),
            >,
        >,
{
    let (a, b) = keys(&i, &j);
    let by_hand = Between::new(a, b, z, noise.clone()).unwrap();
    let automatic = AutoDiff::new((a, b), Relative(z), noise).unwrap();
    let at = values(&i, &j);
    let ((jacobian, error), (expected_jacobian, expected_error)) =
        (linearize(&automatic, &at), linearize(&by_hand, &at));
    let scale = 1.0 + expected_jacobian.amax();
    let deviation = (&jacobian - &expected_jacobian).amax() / scale;
    assert!(deviation < 1e-12, "{deviation:e} {i:?} {j:?} {z:?}");
    let deviation = (error - expected_error).amax() / scale;
    assert!(deviation < 1e-12, "{deviation:e} {i:?} {j:?} {z:?}");
}

fn as_by_hand_anywhere<G: Sample<N>, const N: usize>(seed: u64)
where
    Relative<G>: Residual<
            N,
            Variables: evergraph_factors::autodiff::Variables<
                Keys = (evergraph_model::Key<G>, evergraph_model::Key<G>),
            >,
        >,
{
    let mut source = Source::new(seed);
    for _ in 0..POINTS {
        let (i, z, error) =
            (G::sample(&mut source), G::sample(&mut source), G::sample(&mut source));
        as_by_hand(i, i.compose(&z).compose(&error), z, source.noise(N));
        // Without any error, where roots have no derivative.
        as_by_hand(i, i.compose(&z), z, unit(N));
        as_by_hand(i, i, G::identity(), unit(N));
    }
}

#[test]
fn between_is_the_same_as_by_hand() {
    as_by_hand_anywhere::<Rot2, 1>(1);
    as_by_hand_anywhere::<Rot3, 3>(2);
    as_by_hand_anywhere::<Pose2, 3>(3);
    as_by_hand_anywhere::<Pose3, 6>(4);
}

/// A beacon heard with a clock that is off and a scale that is off; three kinds of variables.
#[derive(Clone, Debug)]
struct BiasedRange {
    antenna_in_robot: Point3,
    range: f64,
}

impl Residual<1> for BiasedRange {
    type Variables = (Pose3, Point3, Parameters<2>);
    const NAME: &'static str = "BiasedRange";

    fn evaluate<T: Number>(
        &self,
        (pose, beacon, bias): (Transform3<T>, Vector3<T>, SVector<T, 2>),
    ) -> [T; 1] {
        let antenna = pose.transform_point(&self.antenna_in_robot.vector().map(T::from));
        [norm(&(beacon - antenna)) * bias[1].exp() + bias[0] - self.range]
    }
}

/// A camera on an arm sees a point: four variables, all rotations and points among them.
#[derive(Clone, Debug)]
struct ArmCamera(Point3);

impl Residual<3> for ArmCamera {
    type Variables = (Pose3, Rot3, Rot2, Point3);
    const NAME: &'static str = "ArmCamera";

    fn evaluate<T: Number>(
        &self,
        (robot, shoulder, elbow, point): (Transform3<T>, Rotation3<T>, Rotation2<T>, Vector3<T>),
    ) -> [T; 3] {
        let seen = shoulder.inverse_rotate(&robot.inverse_transform_point(&point));
        let planar = elbow.inverse_rotate(&Vector2::new(seen.x, seen.y));
        let error = Vector3::new(planar.x, planar.y, seen.z) - self.0.vector().map(T::from);
        error.into()
    }
}

/// The heading of a line through two points seen from a pose in the plane.
#[derive(Clone, Debug)]
struct LineHeading(f64);

impl Residual<1> for LineHeading {
    type Variables = (Pose2, Point2, Point2);
    const NAME: &'static str = "LineHeading";

    fn evaluate<T: Number>(&self, (pose, p, q): (Transform2<T>, Vector2<T>, Vector2<T>)) -> [T; 1] {
        let way = q - p;
        [wrap_angle(way.y.atan2(way.x) - pose.heading() - self.0)]
    }
}

#[test]
fn residuals_of_users_pass_the_check() {
    let mut source = Source::new(5);
    for _ in 0..POINTS / 4 {
        let (pose, beacon) = (Pose3::sample(&mut source), source.point3());
        let bias = VectorN::new([source.uniform(-1.0, 1.0), source.uniform(-0.1, 0.1)]);
        let mut change = Graph::new().change();
        let keys =
            (change.add_variable(&pose), change.add_variable(&beacon), change.add_variable(&bias));
        let range = BiasedRange { antenna_in_robot: source.point3(), range: 20.0 };
        let factor = AutoDiff::new(keys, range, source.noise(1)).unwrap();
        let at = [Value::new(&pose), Value::new(&beacon), Value::new(&bias)];
        assert_jacobian(&factor, &at);
        check_gradient(&Robust::new(factor, Kernel::huber(0.5).unwrap()), &at).unwrap();

        let (shoulder, elbow) = (Rot3::sample(&mut source), Rot2::sample(&mut source));
        let keys = (
            change.add_variable(&pose),
            change.add_variable(&shoulder),
            change.add_variable(&elbow),
            change.add_variable(&beacon),
        );
        let factor = AutoDiff::new(keys, ArmCamera(source.point3()), source.noise(3)).unwrap();
        let at =
            [Value::new(&pose), Value::new(&shoulder), Value::new(&elbow), Value::new(&beacon)];
        assert_jacobian(&factor, &at);

        let (pose, p, q) = (Pose2::sample(&mut source), source.point2(), source.point2());
        let keys = (change.add_variable(&pose), change.add_variable(&p), change.add_variable(&q));
        let way = q.vector() - p.vector();
        let measured = way.y.atan2(way.x) - pose.theta() - source.angle();
        let factor = AutoDiff::new(keys, LineHeading(measured), source.noise(1)).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose), Value::new(&p), Value::new(&q)]);
    }
}

#[derive(Clone, Debug)]
struct Heading(f64);

impl Residual<1> for Heading {
    type Variables = (Pose3,);
    const NAME: &'static str = "Heading";

    fn evaluate<T: Number>(&self, (pose,): (Transform3<T>,)) -> [T; 1] {
        [wrap_angle(pose.rotation().heading() - self.0)]
    }
}

#[test]
fn a_heading_is_the_same_as_by_hand() {
    let mut source = Source::new(6);
    for _ in 0..POINTS {
        let (pose, psi, noise) = (Pose3::sample(&mut source), source.angle(), source.noise(1));
        let at = [Value::new(&pose)];
        let by_hand = Heading3::new(key(&pose), psi, noise.clone()).unwrap();
        let automatic = AutoDiff::new((key(&pose),), Heading(psi), noise).unwrap();
        let ((jacobian, error), (expected, expected_error)) =
            (linearize(&automatic, &at), linearize(&by_hand, &at));
        let scale = 1.0 + expected.amax();
        assert!((jacobian - &expected).amax() < 1e-12 * scale * scale);
        assert!((error - expected_error).amax() < 1e-12 * scale);
    }
}

#[test]
fn transforms_do_what_poses_do() {
    let mut source = Source::new(7);
    for _ in 0..100 {
        let (a, b, p) = (Pose3::sample(&mut source), Pose3::sample(&mut source), source.point3());
        let (ta, tb) = (Transform3::<f64>::from(a), Transform3::<f64>::from(b));
        let same = |t: Transform3<f64>, pose: Pose3| {
            assert!((t.translation() - pose.translation().vector()).amax() < 1e-12);
            assert!((t.rotation().matrix() - pose.rotation().matrix()).amax() < 1e-14);
            assert!((t.log() - pose.log()).amax() < 1e-11);
        };
        same(ta.compose(&tb), a * b);
        same(ta.inverse(), a.inverse());
        same(ta.between(&tb), a.between(&b));
        assert!((ta.transform_point(&p.vector()) - (a * p).vector()).amax() < 1e-12);
        let back = ta.inverse_transform_point(&p.vector());
        assert!((back - a.inverse_transform_point(&p).vector()).amax() < 1e-12);

        let (a, b, p) = (Pose2::sample(&mut source), Pose2::sample(&mut source), source.point2());
        let (ta, tb) = (Transform2::<f64>::from(a), Transform2::<f64>::from(b));
        let same = |t: Transform2<f64>, pose: Pose2| {
            assert!((t.translation() - pose.translation().vector()).amax() < 1e-12);
            assert!((t.rotation().matrix() - pose.rotation().matrix()).amax() < 1e-14);
            assert!((t.log() - pose.log()).amax() < 1e-11);
        };
        same(ta.compose(&tb), a * b);
        same(ta.inverse(), a.inverse());
        same(ta.between(&tb), a.between(&b));
        assert!((ta.transform_point(&p.vector()) - (a * p).vector()).amax() < 1e-12);
        let back = ta.inverse_transform_point(&p.vector());
        assert!((back - a.inverse_transform_point(&p).vector()).amax() < 1e-12);
    }
}

#[test]
fn lengths_and_angles_keep_their_derivatives_at_the_edges() {
    let at = |x: f64, y: f64| norm(&Vector2::new(Dual64::new(x, 1.0), Dual64::new(y, 0.0)));
    assert_eq!((at(0.0, 0.0).re, at(0.0, 0.0).eps), (0.0, 0.0));
    for scale in [1e-300, 1.0, 1e300] {
        let length = at(3.0 * scale, 4.0 * scale);
        close(&[length.re / scale, length.eps], &[5.0, 0.6]);
    }
    assert!(at(f64::NAN, f64::NAN).re.is_nan());
    let wrapped = wrap_angle(Dual64::new(7.0, 1.0));
    close(&[wrapped.re, wrapped.eps], &[7.0 - 2.0 * std::f64::consts::PI, 1.0]);
}

#[test]
fn it_is_a_factor_like_others() {
    let pose = Pose3::identity();
    let error = AutoDiff::new((key(&pose),), Heading(0.0), unit(2)).unwrap_err();
    assert_eq!(error, FactorError::NoiseDimension { factor: "Heading", expected: 1, actual: 2 });
    let noise = Noise::isotropic(1, 0.1).unwrap();
    let factor = AutoDiff::new((key(&pose),), Heading(0.5), noise.clone()).unwrap();
    close(&residual(&factor, &[Value::new(&pose)]), &[-5.0]);
    assert_eq!((factor.name(), factor.residual_dim()), ("Heading".to_string(), 1));
    assert_eq!((factor.inner().0, factor.noise()), (0.5, &noise));
    assert!(factor.accepts(0, Value::new(&pose).kind(), 6));
    assert!(!factor.accepts(1, Value::new(&pose).kind(), 6));
    assert!(!factor.accepts(0, Value::new(&Pose2::identity()).kind(), 3));
    // Parameters of another length would be read beyond their end.
    let bias = Value::new(&VectorN::zeros(3));
    let mut change = Graph::new().change();
    let keys = (
        change.add_variable(&pose),
        change.add_variable(&Point3::identity()),
        change.add_variable(&VectorN::zeros(2)),
    );
    let range = BiasedRange { antenna_in_robot: Point3::identity(), range: 1.0 };
    let factor = AutoDiff::new(keys, range, unit(1)).unwrap();
    assert!(factor.accepts(2, bias.kind(), 2) && !factor.accepts(2, bias.kind(), 3));
    assert_eq!(factor.keys(), [keys.0.id(), keys.1.id(), keys.2.id()]);
}
