//! What the residuals mean, on numbers that can be checked by hand, and what constructors refuse.

mod common;

use std::f64::consts::{FRAC_PI_2, PI};

use common::{close, key, keys, linearize, residual, unit, values};
use evergraph_factors::{
    Attitude, BetweenPose2, BetweenPose3, Depth, FactorError, GpsPosition2, GpsPosition3, Heading2,
    Heading3, PartialBetweenPose3, Prior, RelativePosition2, RelativePosition3, RollPitch,
};
use evergraph_model::testing::{assert_jacobian, check_gradient};
use evergraph_model::{
    Factor, Kernel, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Robust, Rot3, Value, VectorN,
};
use nalgebra::{Vector3, Vector6};

#[test]
fn between_measures_the_second_from_the_first() {
    // At (1, 2) facing +y; the other is two metres ahead and one to the left.
    let (i, j) = (Pose2::new(1.0, 2.0, FRAC_PI_2), Pose2::new(0.0, 4.0, PI));
    let (from, to) = keys(&i, &j);
    let exact = BetweenPose2::new(from, to, Pose2::new(2.0, 1.0, FRAC_PI_2), unit(3)).unwrap();
    close(&residual(&exact, &values(&i, &j)), &[0.0, 0.0, 0.0]);
    // Half a metre short: z says 1.5 ahead.
    let short = BetweenPose2::new(from, to, Pose2::new(1.5, 1.0, 0.0), unit(3)).unwrap();
    let error = residual(&short, &values(&i, &j));
    // Log of a quarter turn with translation (0.5, 0): θ/2 cot(θ/2) = π/4.
    close(&error, &[0.5 * PI / 4.0, -0.5 * PI / 4.0, FRAC_PI_2]);
    assert_eq!(short.name(), "Between<Pose2>");
    assert_eq!(short.keys(), [from.id(), to.id()]);
    assert_eq!((short.from(), short.to()), (from.id(), to.id()));
}

#[test]
fn whitening_divides_by_sigma_in_tangent_order() {
    let pose = Pose3::identity();
    let sigmas = [0.1, 0.2, 0.5, 1.0, 2.0, 4.0];
    let x = Pose3::new(Rot3::identity(), Vector3::new(0.1, 0.2, 0.5));
    let prior = Prior::new(key(&pose), pose, Noise::from_sigmas(&sigmas).unwrap()).unwrap();
    close(&residual(&prior, &[Value::new(&x)]), &[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    let x = Pose3::new(Rot3::exp(&Vector3::new(0.0, 0.0, 0.4)), Vector3::zeros());
    close(&residual(&prior, &[Value::new(&x)]), &[0.0, 0.0, 0.0, 0.0, 0.0, 0.1]);
    assert!((prior.error(&residual(&prior, &[Value::new(&x)])) - 0.005).abs() < 1e-15);
}

#[test]
fn landmarks_are_seen_in_the_frame_of_the_sensor() {
    let pose = Pose2::new(1.0, 0.0, FRAC_PI_2);
    let point = Point2::new(1.0, 3.0);
    let (a, b) = keys(&pose, &point);
    let factor = RelativePosition2::new(a, b, Point2::new(3.0, 0.0), unit(2)).unwrap();
    close(&residual(&factor, &values(&pose, &point)), &[0.0, 0.0]);
    // The camera looks along its z axis, half a metre up on the robot.
    let camera = Rot3::from_roll_pitch_yaw(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let robot_from_sensor = Pose3::new(camera, Vector3::new(0.0, 0.0, 0.5));
    let (pose, point) = (Pose3::identity(), Point3::new(4.0, 1.0, 0.5));
    let (a, b) = keys(&pose, &point);
    let z = Point3::new(-1.0, 0.0, 4.0);
    let factor = RelativePosition3::with_sensor(a, b, z, robot_from_sensor, unit(3)).unwrap();
    close(&residual(&factor, &values(&pose, &point)), &[0.0, 0.0, 0.0]);
}

#[test]
fn gps_measures_the_antenna() {
    let pose = Pose2::new(10.0, 20.0, FRAC_PI_2);
    let arm = Point2::new(0.5, 0.0);
    let z = Point2::new(10.0, 20.5);
    let factor = GpsPosition2::with_lever_arm(key(&pose), z, arm, unit(2)).unwrap();
    close(&residual(&factor, &[Value::new(&pose)]), &[0.0, 0.0]);
    let pose =
        Pose3::new(Rot3::from_roll_pitch_yaw(0.0, -FRAC_PI_2, 0.0), Vector3::new(1.0, 2.0, 3.0));
    let z = Point3::new(1.0, 2.0, 3.0);
    let factor =
        GpsPosition3::with_lever_arm(key(&pose), z, Point3::new(2.0, 0.0, 0.0), unit(3)).unwrap();
    close(&residual(&factor, &[Value::new(&pose)]), &[0.0, 0.0, 2.0]);
}

#[test]
fn attitude_is_the_angle_between_directions() {
    let up = Vector3::z();
    for angle in [0.0, 1e-9, 1e-3, 0.19, 0.21, 1.0, 2.0, 3.0, PI - 1e-6] {
        let pose =
            Pose3::new(Rot3::from_roll_pitch_yaw(angle, 0.0, 0.7), Vector3::new(1.0, 2.0, 3.0));
        let factor = Attitude::new(key(&pose), up, 9.81 * up, unit(2)).unwrap();
        let error = residual(&factor, &[Value::new(&pose)]);
        assert!((error[0].hypot(error[1]) - angle).abs() < 1e-12, "{angle}: {error:?}");
    }
    // Upside down there is no direction to turn, but no NaN either.
    let pose = Pose3::new(Rot3::from_quaternion(1.0, 0.0, 0.0, 0.0).unwrap(), Vector3::zeros());
    let factor = Attitude::new(key(&pose), up, up, unit(2)).unwrap();
    close(&residual(&factor, &[Value::new(&pose)]), &[PI, 0.0]);
    let basis = factor.basis();
    assert!((basis.tr_mul(basis) - nalgebra::Matrix2::identity()).amax() < 1e-15);
    assert!((basis.transpose() * factor.measurement()).amax() < 1e-15);
}

#[test]
fn partial_states_measure_the_quantity() {
    let pose = Pose3::new(Rot3::from_roll_pitch_yaw(0.2, -0.4, 3.0), Vector3::new(1.0, 2.0, -30.0));
    let at = [Value::new(&pose)];
    close(&residual(&Depth::new(key(&pose), -31.0, unit(1)).unwrap(), &at), &[1.0]);
    close(&residual(&RollPitch::new(key(&pose), 0.1, -0.3, unit(2)).unwrap(), &at), &[0.1, -0.1]);
    close(&residual(&Heading3::new(key(&pose), -3.0, unit(1)).unwrap(), &at), &[6.0 - 2.0 * PI]);
    let pose = Pose2::new(0.0, 0.0, 3.0);
    let factor = Heading2::new(key(&pose), -3.0, unit(1)).unwrap();
    close(&residual(&factor, &[Value::new(&pose)]), &[6.0 - 2.0 * PI]);
}

#[test]
fn singular_places_give_zeros_and_no_nan() {
    let pole = Pose3::new(Rot3::from_quaternion(0.0, 1.0, 0.0, 1.0).unwrap(), Vector3::zeros());
    for factor in [
        Box::new(Heading3::new(key(&pole), 0.0, unit(1)).unwrap()) as Box<dyn Factor>,
        Box::new(RollPitch::new(key(&pole), 0.0, 0.0, unit(2)).unwrap()),
        Box::new(Attitude::new(key(&pole), Vector3::z(), Vector3::x(), unit(2)).unwrap()),
    ] {
        let (jacobian, residual) = linearize(factor.as_ref(), &[Value::new(&pole)]);
        let numbers = jacobian.iter().chain(&residual);
        assert!(numbers.clone().all(|x| x.is_finite()), "{}: {jacobian}", factor.name());
    }
}

#[test]
fn bad_numbers_are_refused_with_their_place() {
    let (pose, other) = (Pose2::identity(), Pose2::new(1.0, 0.0, 0.0));
    let (a, b) = keys(&pose, &other);
    let nan = Pose2::new(f64::NAN, 0.0, 0.0);
    let error = BetweenPose2::new(a, b, nan, unit(3)).unwrap_err();
    assert!(matches!(error, FactorError::NotFinite { what: "measurement", .. }), "{error}");
    let error = BetweenPose2::new(a, b, pose, unit(2)).unwrap_err();
    assert_eq!(error, FactorError::NoiseDimension { factor: "Between", expected: 3, actual: 2 });
    assert!(Prior::new(a, pose, unit(6)).is_err());
    assert!(Prior::new(key(&VectorN::zeros(2)), VectorN::zeros(2), unit(3)).is_err());
    assert!(Heading2::new(a, f64::INFINITY, unit(1)).is_err());
    assert!(GpsPosition2::new(a, Point2::new(0.0, f64::NAN), unit(2)).is_err());
    let (a, b) = keys(&Pose3::identity(), &Pose3::identity());
    for components in [&[][..], &[6], &[1, 0], &[2, 2]] {
        let noise = unit(components.len().max(1));
        let error =
            PartialBetweenPose3::new(a, b, Pose3::identity(), components, noise).unwrap_err();
        assert!(matches!(error, FactorError::Selection { dim: 6, .. }), "{error}");
    }
    assert!(PartialBetweenPose3::new(a, b, Pose3::identity(), &[0, 5], unit(3)).is_err());
    let error = Attitude::new(a, Vector3::zeros(), Vector3::z(), unit(2)).unwrap_err();
    assert!(matches!(error, FactorError::NoDirection { what: "world direction", .. }), "{error}");
}

#[test]
fn a_factor_takes_its_own_types_only() {
    let (pose, point) = (Pose2::identity(), Point2::identity());
    let (a, b) = keys(&pose, &point);
    let factor = RelativePosition2::new(a, b, point, unit(2)).unwrap();
    let [pose_value, point_value] = values(&pose, &point);
    assert!(factor.accepts(0, pose_value.kind(), 3) && factor.accepts(1, point_value.kind(), 2));
    assert!(!factor.accepts(1, pose_value.kind(), 3) && !factor.accepts(0, point_value.kind(), 2));
    assert!(!factor.accepts(2, point_value.kind(), 2));
    let prior = Prior::new(key(&VectorN::zeros(2)), VectorN::zeros(2), unit(2)).unwrap();
    let three = Value::new(&VectorN::zeros(3));
    assert!(prior.accepts(0, three.kind(), 2) && !prior.accepts(0, three.kind(), 3));
}

#[test]
fn under_a_kernel_the_gradient_is_that_of_the_loss() {
    let (i, j) = (Pose3::identity(), Pose3::exp(&Vector6::new(1.0, 2.0, 3.0, 0.3, -0.5, 0.2)));
    let (from, to) = keys(&i, &j);
    for kernel in [Kernel::huber(1.3).unwrap(), Kernel::pseudo_huber(0.7).unwrap()] {
        for scale in [1e-3, 1.0, 100.0] {
            let noise = Noise::isotropic(6, 1.0 / scale).unwrap();
            let inner = BetweenPose3::new(from, to, Pose3::identity(), noise).unwrap();
            assert_jacobian(&inner, &values(&i, &j));
            let robust = Robust::new(inner.clone(), kernel);
            check_gradient(&robust, &values(&i, &j)).unwrap();
            let twice = Robust::new(robust.clone(), Kernel::huber(0.4).unwrap());
            check_gradient(&twice, &values(&i, &j)).unwrap();
            assert_eq!(residual(&robust, &values(&i, &j)), residual(&inner, &values(&i, &j)));
            assert!(
                robust.error(&residual(&inner, &values(&i, &j)))
                    <= inner.error(&residual(&inner, &values(&i, &j)))
            );
        }
    }
}
