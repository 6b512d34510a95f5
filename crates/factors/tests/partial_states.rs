//! Ranges, bearings, planar motion, differences and combinations: what they mean on numbers that
//! can be checked by hand, and what their constructors refuse.

mod common;

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use common::{close, key, keys, level, linearize, residual, unit, values};
use evergraph_factors::{
    Attitude, Bearing2, Bearing3, BearingRange2, BearingRange3, Depth, DepthDifference,
    FactorError, HeadingDifference, PartialBetween, PlanarMotion, Range, TranslationDifference2,
    TranslationDifference3,
};
use evergraph_model::{Factor, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Rot3, Value};
use nalgebra::{DMatrix, Vector3};

#[test]
fn a_range_is_the_distance_of_two_positions() {
    let (pose, point) = (Pose2::new(1.0, 2.0, 2.5), Point2::new(4.0, 6.0));
    let (a, b) = keys(&pose, &point);
    let factor = Range::new(a, b, 4.5, Noise::isotropic(1, 0.1).unwrap()).unwrap();
    close(&residual(&factor, &values(&pose, &point)), &[5.0]);
    assert_eq!(factor.name(), "Range<Pose2, Point2>");
    assert_eq!((factor.a(), factor.b(), factor.measurement()), (a.id(), b.id(), 4.5));
    let (jacobian, _) = linearize(&factor, &values(&pose, &point));
    // Along the unit vector (0.6, 0.8) for the point; minus that, in the robot's axes, for the pose.
    close(&jacobian.as_slice()[3..], &[6.0, 8.0]);
    let towards = pose.rotation().inverse_rotate(&nalgebra::Vector2::new(-6.0, -8.0));
    close(&jacobian.as_slice()[..3], &[towards.x, towards.y, 0.0]);
    let (pose, point) = (level(1.0, 2.0, 3.0, 1.0), Point3::new(3.0, 5.0, 9.0));
    let (a, b) = keys(&point, &pose);
    let factor = Range::new(a, b, 7.0, unit(1)).unwrap();
    close(&residual(&factor, &values(&point, &pose)), &[0.0]);
}

#[test]
fn huge_and_tiny_distances_are_measured_too() {
    for scale in [1e-11, 1e-6, 1e200, 1e300] {
        let (a, b) = (Point2::new(0.0, 0.0), Point2::new(3.0 * scale, 4.0 * scale));
        let (from, to) = keys(&a, &b);
        let factor = Range::new(from, to, 0.0, unit(1)).unwrap();
        let (jacobian, residual) = linearize(&factor, &values(&a, &b));
        assert!((residual[0] / scale - 5.0).abs() < 1e-14);
        close(jacobian.as_slice(), &[-0.6, -0.8, 0.6, 0.8]);
    }
    // Closer than rounding there is no direction.
    let (a, b) = (Point2::new(0.0, 0.0), Point2::new(3e-33, 4e-33));
    let (from, to) = keys(&a, &b);
    let factor = Range::new(from, to, 20.0, unit(1)).unwrap();
    let (jacobian, residual) = linearize(&factor, &values(&a, &b));
    assert_eq!(residual[0], -20.0);
    close(jacobian.as_slice(), &[0.0; 4]);
}

#[test]
fn a_bearing_turns_from_the_x_axis_to_the_y_axis() {
    // Facing +y; the target is as far ahead as it is to the left.
    let (pose, target) = (Pose2::new(1.0, 2.0, FRAC_PI_2), Point2::new(-1.0, 4.0));
    let (a, b) = keys(&pose, &target);
    let at = values(&pose, &target);
    let factor = Bearing2::new(a, b, 0.5, unit(1)).unwrap();
    close(&residual(&factor, &at), &[FRAC_PI_4 - 0.5]);
    assert_eq!(factor.name(), "Bearing2<Point2>");
    let range = 8_f64.sqrt();
    let factor = BearingRange2::new(a, b, 0.5, 2.0, unit(2)).unwrap();
    close(&residual(&factor, &at), &[FRAC_PI_4 - 0.5, range - 2.0]);
    assert_eq!((factor.bearing(), factor.range()), (0.5, 2.0));
    // Turning left moves the target right by as much.
    let (jacobian, _) = linearize(&factor, &at);
    close(jacobian.column(2).as_slice(), &[-1.0, 0.0]);
}

#[test]
fn bearings_wrap() {
    for (seen, measured, expected) in [
        (3.0, -3.0, 6.0 - 2.0 * PI),
        (-3.0, 3.0, 2.0 * PI - 6.0),
        (PI, 0.0, PI),
        (1.0, 101.0 * PI, 1.0 - PI),
    ] {
        let (pose, target) =
            (Pose2::identity(), Point2::new(2.0 * f64::cos(seen), 2.0 * f64::sin(seen)));
        let (a, b) = keys(&pose, &target);
        let factor = Bearing2::new(a, b, measured, unit(1)).unwrap();
        let error = residual(&factor, &values(&pose, &target))[0];
        assert!((error - expected).abs() < 1e-12 && error > -PI && error <= PI, "{seen} {error}");
    }
}

#[test]
fn a_direction_in_space_is_measured_on_the_sphere() {
    let (pose, target) = (level(1.0, 0.0, 0.0, FRAC_PI_2), Point3::new(1.0, 3.0, 0.0));
    let (a, b) = keys(&pose, &target);
    let at = values(&pose, &target);
    // Straight ahead; the measurement is somewhere in the horizontal or the vertical plane.
    for angle in [0.0, 1e-9, 0.3, 2.0, PI - 1e-6] {
        for direction in [
            Vector3::new(f64::cos(angle), f64::sin(angle), 0.0),
            Vector3::new(f64::cos(angle), 0.0, f64::sin(angle)),
        ] {
            let factor = Bearing3::new(a, b, 7.0 * direction, unit(2)).unwrap();
            let error = residual(&factor, &at);
            assert!((error[0].hypot(error[1]) - angle).abs() < 1e-12, "{angle}: {error:?}");
            assert!((factor.measurement() - direction).amax() < 1e-15);
            let factor = BearingRange3::new(a, b, direction, 2.5, unit(3)).unwrap();
            close(&residual(&factor, &at), &[error[0], error[1], 0.5]);
        }
    }
    // The same chart as an attitude's: a target at z is a known direction from the origin.
    let pose = Pose3::new(Rot3::from_roll_pitch_yaw(0.3, -0.5, 1.0), Vector3::zeros());
    let (target, measured) = (Point3::new(0.0, 0.0, 5.0), Vector3::new(0.2, -0.4, 0.7));
    let (a, b) = keys(&pose, &target);
    let bearing = Bearing3::new(a, b, measured, unit(2)).unwrap();
    let attitude = Attitude::new(key(&pose), Vector3::z(), measured, unit(2)).unwrap();
    assert_eq!(bearing.basis(), attitude.basis());
    close(&residual(&bearing, &values(&pose, &target)), &residual(&attitude, &[Value::new(&pose)]));
}

#[test]
fn where_there_is_no_derivative_it_is_zero() {
    let pose2 = Pose2::new(1.0, 2.0, 0.3);
    let (a, b) = keys(&pose2, &pose2.translation());
    let here = values(&pose2, &pose2.translation());
    let singular: [(Box<dyn Factor>, &[f64]); 3] = [
        (Box::new(Range::new(a, b, 2.0, unit(1)).unwrap()), &[-2.0]),
        (Box::new(Bearing2::new(a, b, 0.5, unit(1)).unwrap()), &[-0.5]),
        (Box::new(BearingRange2::new(a, b, 0.5, 2.0, unit(2)).unwrap()), &[-0.5, -2.0]),
    ];
    for (factor, expected) in &singular {
        let (jacobian, residual) = linearize(factor.as_ref(), &here);
        close(residual.as_slice(), expected);
        assert_eq!(jacobian.amax(), 0.0, "{}", factor.name());
    }
    let pose3 = level(1.0, 2.0, 3.0, 0.3);
    let (a, b) = keys(&pose3, &pose3.translation());
    let here = values(&pose3, &pose3.translation());
    let y = Vector3::y();
    let singular: [(Box<dyn Factor>, f64); 3] = [
        (Box::new(Range::new(a, b, 2.0, unit(1)).unwrap()), 2.0),
        // Straight ahead is a quarter turn from y.
        (Box::new(Bearing3::new(a, b, y, unit(2)).unwrap()), FRAC_PI_2),
        (Box::new(BearingRange3::new(a, b, y, 2.0, unit(3)).unwrap()), FRAC_PI_2.hypot(2.0)),
    ];
    for (factor, expected) in &singular {
        let (jacobian, residual) = linearize(factor.as_ref(), &here);
        assert!((residual.norm() - expected).abs() < 1e-12, "{residual}");
        assert_eq!(jacobian.amax(), 0.0, "{}", factor.name());
    }
    // Opposite to the measured direction: half a turn, whichever way round; the range goes on.
    let target = Point3::new(0.0, 0.0, 4.0);
    let (a, b) = keys(&Pose3::identity(), &target);
    let at = values(&Pose3::identity(), &target);
    let factor = Bearing3::new(a, b, -Vector3::z(), unit(2)).unwrap();
    let (jacobian, residual) = linearize(&factor, &at);
    close(residual.as_slice(), &[PI, 0.0]);
    assert_eq!(jacobian.amax(), 0.0);
    let factor = BearingRange3::new(a, b, -Vector3::z(), 1.0, unit(3)).unwrap();
    let (jacobian, residual) = linearize(&factor, &at);
    close(residual.as_slice(), &[PI, 0.0, 3.0]);
    close(jacobian.row(2).transpose().as_slice(), &[0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn planar_motion_measures_height_roll_and_pitch() {
    let pose = level(4.0, -7.0, 1.5, 2.0);
    let factor = PlanarMotion::new(key(&pose), 1.0, unit(3)).unwrap();
    close(&residual(&factor, &[Value::new(&pose)]), &[0.5, 0.0, 0.0]);
    for (roll, pitch) in [(0.3, 0.0), (0.0, 0.3), (-1.0, 0.0), (3.0, 0.0), (0.0, -1.5)] {
        let tilted = Pose3::new(Rot3::from_roll_pitch_yaw(roll, pitch, 2.0), [4.0, -7.0, 1.0]);
        close(&residual(&factor, &[Value::new(&tilted)]), &[0.0, roll, pitch]);
    }
    let upside_down = Pose3::new(Rot3::from_quaternion(1.0, 0.0, 0.0, 0.0).unwrap(), Vector3::z());
    let (jacobian, residual) = linearize(&factor, &[Value::new(&upside_down)]);
    close(residual.as_slice(), &[0.0, PI, 0.0]);
    assert_eq!(jacobian.rows(1, 2).amax(), 0.0);
    // Its rows are those of a depth and of an attitude with up as up.
    let pose = Pose3::new(Rot3::from_roll_pitch_yaw(0.4, -0.7, 2.0), [4.0, -7.0, 1.0]);
    let at = [Value::new(&pose)];
    let (planar, _) = linearize(&factor, &at);
    let depth = Depth::new(key(&pose), 1.0, unit(1)).unwrap();
    let up = Attitude::new(key(&pose), Vector3::z(), Vector3::z(), unit(2)).unwrap();
    assert_eq!(planar.rows(0, 1), linearize(&depth, &at).0);
    assert!((planar.rows(1, 2) - linearize(&up, &at).0).amax() < 1e-15);
}

#[test]
fn differences_are_the_second_less_the_first() {
    let (i, j) = (level(1.0, 2.0, -30.0, 3.0), level(4.0, 0.0, -28.0, -3.0));
    let (a, b) = keys(&i, &j);
    let at = values(&i, &j);
    let factor = DepthDifference::new(a, b, 1.5, unit(1)).unwrap();
    close(&residual(&factor, &at), &[0.5]);
    assert_eq!((factor.from(), factor.to(), factor.measurement()), (a.id(), b.id(), 1.5));
    let turned = 2.0 * PI - 6.0;
    let factor = HeadingDifference::new(a, b, 0.1, unit(1)).unwrap();
    close(&residual(&factor, &at), &[turned - 0.1]);
    let factor = HeadingDifference::new(a, b, turned - PI, unit(1)).unwrap();
    let error = residual(&factor, &at)[0];
    assert!((error.abs() - PI).abs() < 1e-12 && error > -PI);
    let factor = TranslationDifference3::new(a, b, Point3::new(3.0, -1.0, 0.0), unit(3)).unwrap();
    close(&residual(&factor, &at), &[0.0, -1.0, 2.0]);
    let (i, j) = (Pose2::new(1.0, 2.0, 0.7), Pose2::new(4.0, 0.0, -2.0));
    let (a, b) = keys(&i, &j);
    let factor = TranslationDifference2::new(a, b, Point2::new(3.0, -1.0), unit(2)).unwrap();
    close(&residual(&factor, &values(&i, &j)), &[0.0, -1.0]);
}

#[test]
fn combinations_mix_the_rows_of_a_between() {
    let (i, j) = (Pose2::new(1.0, 2.0, 0.4), Pose2::new(3.0, 2.5, 1.0));
    let (a, b) = keys(&i, &j);
    let z = Pose2::new(1.0, 0.0, 0.1);
    let at = values(&i, &j);
    let all = evergraph_factors::BetweenPose2::new(a, b, z, unit(3)).unwrap();
    let (full, error) = linearize(&all, &at);
    let rows = DMatrix::from_row_slice(2, 3, &[1.0, -2.0, 0.5, 0.0, 0.0, 3.0]);
    let noise = Noise::from_sigmas(&[0.5, 0.1]).unwrap();
    let weights = noise.sqrt_information().clone();
    let factor = PartialBetween::with_combinations(a, b, z, rows.clone(), noise.clone()).unwrap();
    assert_eq!((factor.combinations(), factor.noise()), (&rows, &noise));
    let (jacobian, residual) = linearize(&factor, &at);
    assert!((jacobian - &weights * &rows * full).amax() < 1e-13);
    assert!((residual - &weights * &rows * error).amax() < 1e-13);
    // Picking components is the special case.
    let picked = PartialBetween::new(a, b, z, &[0, 2], unit(2)).unwrap();
    let selection = DMatrix::from_row_slice(2, 3, &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!(picked.combinations(), &selection);
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let (pose, point) = (Pose2::identity(), Point2::identity());
    let (a, b) = keys(&pose, &point);
    for range in [-1e-9, -5.0] {
        let expected = |factor| Err(FactorError::NegativeRange { factor, range });
        assert_eq!(Range::new(a, b, range, unit(1)).map(|_| ()), expected("Range"));
        let both = BearingRange2::new(a, b, 0.0, range, unit(2)).map(|_| ());
        assert_eq!(both, expected("BearingRange2"));
    }
    assert!(Range::new(a, b, 0.0, unit(1)).is_ok());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let finite = |result: Result<(), FactorError>| {
            assert!(matches!(result, Err(FactorError::NotFinite { .. })), "{result:?}");
        };
        finite(Range::new(a, b, bad, unit(1)).map(|_| ()));
        finite(Bearing2::new(a, b, bad, unit(1)).map(|_| ()));
        finite(BearingRange2::new(a, b, bad, 1.0, unit(2)).map(|_| ()));
        finite(BearingRange2::new(a, b, 1.0, bad, unit(2)).map(|_| ()));
        let (i, j) = keys(&pose, &pose);
        finite(TranslationDifference2::new(i, j, Point2::new(bad, 0.0), unit(2)).map(|_| ()));
        let (i, j) = keys(&Pose3::identity(), &Pose3::identity());
        finite(TranslationDifference3::new(i, j, Point3::new(0.0, 0.0, bad), unit(3)).map(|_| ()));
        finite(DepthDifference::new(i, j, bad, unit(1)).map(|_| ()));
        finite(HeadingDifference::new(i, j, bad, unit(1)).map(|_| ()));
        finite(PlanarMotion::new(i, bad, unit(3)).map(|_| ()));
        finite(Bearing3::new(i, j, Vector3::new(bad, 1.0, 0.0), unit(2)).map(|_| ()));
        finite(BearingRange3::new(i, j, Vector3::x(), bad, unit(3)).map(|_| ()));
        let combination = DMatrix::from_element(1, 6, bad);
        finite(
            PartialBetween::with_combinations(i, j, Pose3::identity(), combination, unit(1))
                .map(|_| ()),
        );
    }
    let (i, j) = keys(&Pose3::identity(), &Pose3::identity());
    let direction = |result: Result<(), FactorError>| {
        assert!(matches!(result, Err(FactorError::NoDirection { what: "direction", .. })));
    };
    direction(Bearing3::new(i, j, Vector3::zeros(), unit(2)).map(|_| ()));
    direction(BearingRange3::new(i, j, Vector3::zeros(), 1.0, unit(3)).map(|_| ()));
    let range = BearingRange3::new(i, j, Vector3::x(), -1.0, unit(3)).unwrap_err();
    assert_eq!(range, FactorError::NegativeRange { factor: "BearingRange3", range: -1.0 });
}

#[test]
fn a_noise_of_another_dimension_is_refused() {
    let (pose, point) = (Pose2::identity(), Point2::identity());
    let (a, b) = keys(&pose, &point);
    let (i, j) = keys(&Pose3::identity(), &Pose3::identity());
    let (k, l) = keys(&pose, &pose);
    let x = Vector3::x();
    let results = [
        Range::new(a, b, 1.0, unit(2)).map(|_| ()),
        Bearing2::new(a, b, 1.0, unit(2)).map(|_| ()),
        BearingRange2::new(a, b, 1.0, 1.0, unit(1)).map(|_| ()),
        Bearing3::new(i, j, x, unit(3)).map(|_| ()),
        BearingRange3::new(i, j, x, 1.0, unit(2)).map(|_| ()),
        PlanarMotion::new(i, 1.0, unit(1)).map(|_| ()),
        DepthDifference::new(i, j, 1.0, unit(3)).map(|_| ()),
        HeadingDifference::new(i, j, 1.0, unit(6)).map(|_| ()),
        TranslationDifference2::new(k, l, point, unit(3)).map(|_| ()),
        TranslationDifference3::new(i, j, Point3::identity(), unit(6)).map(|_| ()),
        PartialBetween::with_combinations(k, l, pose, DMatrix::identity(2, 3), unit(3)).map(|_| ()),
    ];
    for result in results {
        assert!(matches!(result, Err(FactorError::NoiseDimension { .. })), "{result:?}");
    }
}

#[test]
fn combinations_have_to_combine_something() {
    let (a, b) = keys(&Pose2::identity(), &Pose2::identity());
    let new = |rows: DMatrix<f64>| {
        let noise = unit(rows.nrows().max(1));
        PartialBetween::with_combinations(a, b, Pose2::identity(), rows, noise).map(|_| ())
    };
    for (rows, columns) in [(0, 3), (2, 2), (1, 6), (1, 0)] {
        let result = new(DMatrix::from_element(rows, columns, 1.0));
        let expected =
            FactorError::Combinations { factor: "PartialBetween", rows, columns, dim: 3 };
        assert_eq!(result, Err(expected));
    }
    let mut rows = DMatrix::from_element(3, 3, 1.0);
    rows.row_mut(1).fill(0.0);
    assert_eq!(new(rows), Err(FactorError::EmptyCombination { factor: "PartialBetween", row: 1 }));
    // Dependent rows are measurements like others.
    assert!(new(DMatrix::from_element(4, 3, 1.0)).is_ok());
}
