//! Accuracy near zero and near half a turn, where the closed forms fail.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use proptest::prelude::*;

use super::coefficients::{
    inverse_jacobian_with_prime, jacobian, jacobian_prime, small_arctangent,
};
use super::*;
use crate::testing::{check_lie_group, check_manifold};
use crate::{LieGroup, Manifold};

/// Angles from far below rounding to half a turn, dense around every switch of formula.
fn angles() -> Vec<f64> {
    let mut angles: Vec<f64> = (-200..=0).map(|k| 10_f64.powf(k as f64 * 0.1)).collect();
    angles.extend((1..=314).map(|k| k as f64 * 0.01));
    angles.extend([1.0 - 1e-15, 1.0, 1.0 + 1e-15, 0.1, 1e-160, 1e-310, 0.0]);
    angles.extend((1..=16).map(|k| PI - 10_f64.powi(-k)));
    angles.push(PI);
    angles
}

/// The whole power series, which converges for every angle here: ascending terms of
/// `Σ (-1)ᵏ xᵏ weight(k) / (2k + first)!`.
fn entire(x: f64, first: usize, weight: impl Fn(f64) -> f64) -> f64 {
    let mut term = 1.0 / (1..=first).map(|n| n as f64).product::<f64>();
    let mut sum = 0.0;
    for k in 0..40 {
        sum += term * weight(k as f64);
        term *= -x / ((first + 2 * k + 1) * (first + 2 * k + 2)) as f64;
    }
    sum
}

/// |B₂ₖ|/(2k)! = 2 ζ(2k)/(2π)²ᵏ.
fn bernoulli(k: i32) -> f64 {
    let zeta: f64 = match k {
        1 => PI * PI / 6.0,
        2 => PI.powi(4) / 90.0,
        3 => PI.powi(6) / 945.0,
        _ => (1..200).rev().map(|n| (n as f64).powi(-2 * k)).sum(),
    };
    2.0 * zeta / (2.0 * PI).powi(2 * k)
}

#[test]
fn coefficients_agree_with_their_whole_series() {
    let relative = |a: f64, b: f64| (a - b).abs() / b.abs();
    for theta in angles() {
        let x = theta * theta;
        let (b, c) = jacobian(x);
        assert!(relative(b, entire(x, 2, |_| 1.0)) < 1e-14, "b at {theta}");
        assert!(relative(c, entire(x, 3, |_| 1.0)) < 1e-14, "c at {theta}");
        // 2 d/dx xᵏ = 2k xᵏ⁻¹: shift the series by one term.
        let (b_prime, c_prime) = jacobian_prime(x);
        assert!(relative(b_prime, -entire(x, 4, |k| 2.0 * (k + 1.0))) < 1e-13, "b' at {theta}");
        assert!(relative(c_prime, -entire(x, 5, |k| 2.0 * (k + 1.0))) < 1e-13, "c' at {theta}");
        let (gamma, gamma_prime) = inverse_jacobian_with_prime(x);
        let series: f64 = (1..60).rev().map(|k| bernoulli(k) * x.powi(k - 1)).sum();
        let slope: f64 =
            (2..60).rev().map(|k| 2.0 * (k - 1) as f64 * bernoulli(k) * x.powi(k - 2)).sum();
        assert!(relative(gamma, series) < 1e-14, "gamma at {theta}");
        assert!(
            relative(gamma_prime, slope) < 2e-13,
            "gamma' at {theta}: {}",
            relative(gamma_prime, slope)
        );
    }
}

#[test]
fn the_series_of_the_arc_tangent_agrees_with_the_function() {
    let mut sums = 0;
    for tangent in angles() {
        if let Some(ratio) = small_arctangent(tangent * tangent) {
            assert!((tangent * ratio - tangent.atan()).abs() <= 5e-16 * tangent, "{tangent}");
            sums += 1;
        }
    }
    assert!(sums > 100);
    assert_eq!(small_arctangent(f64::NAN), None);
}

#[test]
fn logarithms_of_what_is_not_finite_are_not_finite() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for place in 0..7 {
            let mut storage = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.9];
            storage[place] = bad;
            let log = Pose3::identity().between(&Pose3::load(&storage)).log();
            assert!(log.iter().any(|x| !x.is_finite()), "{storage:?}");
        }
        for place in 0..4 {
            let mut storage = [1.0, 2.0, 0.99, 0.1];
            storage[place] = bad;
            let log = Pose2::identity().between(&Pose2::load(&storage)).log();
            assert!(log.iter().any(|x| !x.is_finite()), "{storage:?}");
        }
    }
}

fn axes() -> [Vector3<f64>; 4] {
    [Vector3::x(), -Vector3::y(), Vector3::z(), Vector3::new(1.0, -2.0, 0.5)].map(|v| v.normalize())
}

#[test]
fn rotation_vectors_survive_the_round_trip_at_any_angle() {
    for axis in axes() {
        for theta in angles() {
            let back = Rot3::exp(&(theta * axis)).log();
            // At half a turn both signs of the axis are the same rotation.
            let error = (back - theta * axis).norm().min(if PI - theta < 1e-5 {
                (back + theta * axis).norm()
            } else {
                f64::INFINITY
            });
            assert!(error <= 1e-15 + 4e-16 * theta, "{theta} about {axis:?}: {error:e}");
            // The other quaternion of the same rotation.
            let [x, y, z, w] = Rot3::exp(&(theta * axis)).quaternion();
            let opposite = Rot3::from_quaternion(-x, -y, -z, -w).unwrap().log();
            assert!((opposite - back).norm().min((opposite + back).norm()) <= 2e-15, "{theta}");
        }
    }
}

#[test]
fn tangents_of_poses_survive_the_round_trip_at_any_angle() {
    for theta in angles() {
        if PI - theta < 1e-15 {
            continue;
        }
        for sign in [1.0, -1.0] {
            let d = Vector3::new(3.0, -7.0, sign * theta);
            assert!((Pose2::exp(&d).log() - d).norm() < 1e-14, "{theta}");
        }
        for axis in axes() {
            let r = theta * axis;
            let d = Vector6::new(3.0, -7.0, 5.0, r.x, r.y, r.z);
            let error = (Pose3::exp(&d).log() - d).norm();
            assert!(error < 4e-14, "{theta} about {axis:?}: {error:e}");
        }
    }
}

/// `Σ (-ad)ᵏ/(k + 1)!`, the right Jacobian by definition.
fn right_jacobian_series<const N: usize>(ad: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let mut term = SMatrix::<f64, N, N>::identity();
    let mut sum = term;
    for k in 1..60 {
        term = term * -ad / (k + 1) as f64;
        sum += term;
    }
    sum
}

#[test]
fn right_jacobians_agree_with_their_series_from_zero_to_half_a_turn() {
    for theta in angles() {
        let d = Vector3::new(3.0, -7.0, theta);
        let ad = Matrix3::new(0.0, -theta, d.y, theta, 0.0, -d.x, 0.0, 0.0, 0.0);
        let series = right_jacobian_series(&ad);
        assert!((Pose2::right_jacobian(&d) - series).amax() < 2e-14, "{theta}");
        let product = Pose2::right_jacobian_inverse(&d) * series;
        assert!((product - Matrix3::identity()).amax() < 5e-14, "{theta}");
        for axis in axes() {
            let phi = theta * axis;
            let rho = Vector3::new(3.0, -7.0, 5.0);
            let mut ad = Matrix6::zeros();
            ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&skew(&phi));
            ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&skew(&phi));
            ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&skew(&rho));
            let d = Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z);
            let series = right_jacobian_series(&ad);
            let error = (Pose3::right_jacobian(&d) - series).amax();
            assert!(error < 5e-14, "{theta} about {axis:?}: {error:e}");
            let error = (Pose3::right_jacobian_inverse(&d) * series - Matrix6::identity()).amax();
            assert!(error < 2e-13, "{theta} about {axis:?}: {error:e}");
            let series = right_jacobian_series(&skew(&phi));
            assert!((Rot3::right_jacobian(&phi) - series).amax() < 1e-14);
            let product = Rot3::right_jacobian_inverse(&phi) * series;
            assert!((product - Matrix3::identity()).amax() < 1e-14);
        }
    }
}

#[test]
fn angles_are_in_the_half_open_interval() {
    assert_eq!(Rot2::from_angle(-PI).angle(), PI);
    assert_eq!(Rot2::from_direction(-1.0, -0.0).unwrap().angle(), PI);
    assert_eq!(wrap_angle(-PI), PI);
    assert_eq!(wrap_angle(PI), PI);
    assert!((wrap_angle(7.0) - (7.0 - 2.0 * PI)).abs() < 1e-15);
    assert_eq!(wrap_angle(0.1), 0.1);
    assert_eq!(Pose2::new(0.0, 0.0, -PI).theta(), PI);
}

#[test]
fn a_million_compositions_stay_on_the_group() {
    let step2 = Pose2::new(0.1, 0.0, 0.7);
    let step3 = Pose3::exp(&Vector6::new(0.1, 0.0, 0.0, 0.3, -0.5, 0.7));
    let (mut pose2, mut pose3) = (Pose2::identity(), Pose3::identity());
    for _ in 0..1_000_000 {
        pose2 = pose2 * step2;
        pose3 = pose3 * step3;
    }
    assert!((pose2.rotation().cos().hypot(pose2.rotation().sin()) - 1.0).abs() < 1e-15);
    let norm: f64 = pose3.rotation().quaternion().iter().map(|q| q * q).sum();
    assert!((norm - 1.0).abs() < 1e-15);
}

#[test]
fn quaternions_of_any_length_are_taken_and_none_of_zero() {
    let expected = Rot3::from_quaternion(1.0, 2.0, 3.0, 4.0).unwrap();
    for scale in [1e-300, 1e-10, 1e10, 1e300] {
        let scaled = Rot3::from_quaternion(scale, 2.0 * scale, 3.0 * scale, 4.0 * scale).unwrap();
        assert!(expected.between(&scaled).log().norm() < 1e-15);
    }
    assert!(matches!(
        Rot3::from_quaternion(0.0, 0.0, 0.0, 0.0),
        Err(GeometryError::ZeroNorm { .. })
    ));
    assert!(matches!(
        Rot3::from_quaternion(0.0, f64::NAN, 0.0, 1.0),
        Err(GeometryError::NotFinite { .. })
    ));
    assert!(matches!(Rot2::from_direction(0.0, 0.0), Err(GeometryError::ZeroNorm { .. })));
    assert!(matches!(
        Rot2::from_direction(f64::INFINITY, 0.0),
        Err(GeometryError::NotFinite { .. })
    ));
}

#[test]
fn matrices_that_are_no_rotations_are_refused() {
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    assert!(matches!(Rot3::from_matrix(&mirror), Err(GeometryError::NotARotation { .. })));
    assert!(matches!(
        Rot3::from_matrix(&(2.0 * Matrix3::identity())),
        Err(GeometryError::NotARotation { .. })
    ));
    let mut nan = Matrix3::identity();
    nan[(0, 1)] = f64::NAN;
    assert!(matches!(Rot3::from_matrix(&nan), Err(GeometryError::NotFinite { .. })));
}

#[test]
fn roll_pitch_yaw_at_the_pole_gives_the_same_rotation() {
    for pitch in [PI / 2.0, -PI / 2.0] {
        let rotation = Rot3::from_roll_pitch_yaw(0.4, pitch, -1.1);
        let [roll, pitch, yaw] = rotation.roll_pitch_yaw();
        assert_eq!(roll, 0.0);
        assert!(rotation.between(&Rot3::from_roll_pitch_yaw(roll, pitch, yaw)).log().norm() < 1e-7);
    }
}

fn angle() -> impl Strategy<Value = f64> {
    prop_oneof![-3.13..3.13, -1e-5..1e-5, 3.0..3.13, -3.13..-3.0]
}

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![-10.0..10.0, -1000.0..1000.0]
}

prop_compose! {
    fn rotation_vector()(x in -1.0..1.0, y in -1.0..1.0, z in 0.01..1.0, angle in angle()) -> Vector3<f64> {
        Vector3::new(x, y, z).normalize() * angle
    }
}

prop_compose! {
    fn tangent3()(t in [coordinate(), coordinate(), coordinate()], r in rotation_vector()) -> Vector6<f64> {
        Vector6::new(t[0], t[1], t[2], r.x, r.y, r.z)
    }
}

prop_compose! {
    fn tangent2()(t in [coordinate(), coordinate()], r in angle()) -> Vector3<f64> {
        Vector3::new(t[0], t[1], r)
    }
}

/// Derivatives are compared on tangents of moderate length: on kilometres the numerical ones are
/// rounding.
fn short<const N: usize>(tangents: &[SVector<f64, N>]) -> Vec<SVector<f64, N>> {
    tangents.iter().map(|d| d.map(|x| if x.abs() > PI { x % PI } else { x })).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn pose2_is_a_group(d in proptest::collection::vec(tangent2(), 3)) {
        let elements: Vec<_> = d.iter().map(Pose2::exp).collect();
        prop_assert_eq!(check_lie_group(&elements, &short(&d)), Ok(()));
    }

    #[test]
    fn pose3_is_a_group(d in proptest::collection::vec(tangent3(), 3)) {
        let elements: Vec<_> = d.iter().map(Pose3::exp).collect();
        prop_assert_eq!(check_lie_group(&elements, &short(&d)), Ok(()));
    }

    #[test]
    fn rot3_is_a_group(d in proptest::collection::vec(rotation_vector(), 3)) {
        let elements: Vec<_> = d.iter().map(Rot3::exp).collect();
        prop_assert_eq!(check_lie_group(&elements, &d), Ok(()));
    }

    #[test]
    fn rot2_is_a_group(d in proptest::collection::vec(angle(), 3)) {
        let d: Vec<_> = d.into_iter().map(SVector::<f64, 1>::new).collect();
        let elements: Vec<_> = d.iter().map(Rot2::exp).collect();
        prop_assert_eq!(check_lie_group(&elements, &d), Ok(()));
    }

    #[test]
    fn points_are_groups(a in [coordinate(), coordinate(), coordinate()], b in [coordinate(), coordinate(), coordinate()]) {
        let three = [Point3::from(a), Point3::from(b)];
        prop_assert_eq!(check_lie_group(&three, &[b.into()]), Ok(()));
        let two = [Point2::new(a[0], a[1]), Point2::new(b[0], b[1])];
        prop_assert_eq!(check_lie_group(&two, &[[b[0], b[1]].into()]), Ok(()));
    }

    #[test]
    fn vectors_are_a_manifold(a in proptest::collection::vec(coordinate(), 5), b in proptest::collection::vec(coordinate(), 5)) {
        let points = [VectorN::new(a), VectorN::new(b.clone())];
        prop_assert_eq!(check_manifold(&points, &[b]), Ok(()));
    }

    #[test]
    fn poses_act_on_points_as_groups(d in proptest::collection::vec(tangent3(), 2), p in [coordinate(), coordinate(), coordinate()]) {
        let (a, b, p) = (Pose3::exp(&d[0]), Pose3::exp(&d[1]), Point3::from(p));
        let scale = 1e-12 * (1.0 + p.vector().norm() + d[0].norm() + d[1].norm());
        prop_assert!(((a * b * p).vector() - (a * (b * p)).vector()).norm() < scale);
        prop_assert!((a.inverse_transform_point(&(a * p)).vector() - p.vector()).norm() < scale);
        let r = a.rotation();
        prop_assert!((r.matrix() * p.vector() - r.rotate(&p.vector())).norm() < scale);
        let (a, b) = (Pose2::new(d[0][0], d[0][1], d[0][2]), Pose2::new(d[1][0], d[1][1], d[1][2]));
        let p = Point2::new(p.x(), p.y());
        prop_assert!(((a * b * p).vector() - (a * (b * p)).vector()).norm() < scale);
        prop_assert!((a.inverse_transform_point(&(a * p)).vector() - p.vector()).norm() < scale);
        let r = a.rotation();
        prop_assert!((r.matrix() * p.vector() - r.rotate(&p.vector())).norm() < scale);
    }

    #[test]
    fn matrices_and_euler_angles_name_the_same_rotation(d in rotation_vector()) {
        let rotation = Rot3::exp(&d);
        let from_matrix = Rot3::from_matrix(&rotation.matrix()).unwrap();
        prop_assert!(rotation.between(&from_matrix).log().norm() < 1e-14);
        let [roll, pitch, yaw] = rotation.roll_pitch_yaw();
        // The angles lose digits towards the pole, as one over the cosine of the pitch.
        let tolerance = 1e-14 / pitch.cos();
        prop_assert!(rotation.between(&Rot3::from_roll_pitch_yaw(roll, pitch, yaw)).log().norm() < tolerance);
        let about = |axis: Vector3<f64>, angle: f64| Rot3::exp(&(angle * axis));
        let product = about(Vector3::z(), yaw) * about(Vector3::y(), pitch) * about(Vector3::x(), roll);
        prop_assert!(rotation.between(&product).log().norm() < tolerance);
    }

    #[test]
    fn stored_poses_come_back_as_they_were(d in tangent3()) {
        let pose = Pose3::exp(&d);
        let mut storage = [0.0; 7];
        pose.store(&mut storage);
        prop_assert_eq!(Pose3::load(&storage), pose);
    }
}
