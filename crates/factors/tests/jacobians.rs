//! Every Jacobian against central differences at a thousand points, with rotations near zero and
//! near half a turn among them.

#![allow(
    clippy::unwrap_used,
    reason = "the lint knows tests by their attribute; the generic helpers here have none"
)]

mod common;

use common::{POINTS, Sample, Source, key, keys, values};
use evergraph_factors::{
    Attitude, Bearing2, Bearing3, BearingRange2, BearingRange3, Between, Depth, DepthDifference,
    GpsPosition2, GpsPosition3, Heading2, Heading3, HeadingDifference, LocalJacobian,
    PartialBetween, PlanarMotion, Positioned, Prior, Range, RelativePosition2, RelativePosition3,
    RollPitch, TranslationDifference2, TranslationDifference3,
};
use evergraph_model::testing::assert_jacobian;
use evergraph_model::{LieGroup, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VectorN};
use nalgebra::{DMatrix, Vector3};

fn prior<G: Sample<N> + LocalJacobian, const N: usize>(seed: u64) {
    let mut source = Source::new(seed);
    for _ in 0..POINTS {
        let z = G::sample(&mut source);
        let x = z.compose(&G::sample(&mut source));
        let factor = Prior::new(key(&x), z, source.noise(N)).unwrap();
        assert_jacobian(&factor, &[Value::new(&x)]);
    }
}

#[test]
fn priors() {
    prior::<Rot2, 1>(1);
    prior::<Rot3, 3>(2);
    prior::<Pose2, 3>(3);
    prior::<Pose3, 6>(4);
    prior::<Point2, 2>(5);
    prior::<Point3, 3>(6);
    let mut source = Source::new(7);
    for dim in 1..10 {
        let z = VectorN::new((0..dim).map(|_| source.uniform(-10.0, 10.0)).collect::<Vec<_>>());
        let x = VectorN::new((0..dim).map(|_| source.uniform(-10.0, 10.0)).collect::<Vec<_>>());
        let factor = Prior::new(key(&x), z, source.noise(dim)).unwrap();
        assert_jacobian(&factor, &[Value::new(&x)]);
    }
}

/// Two values whose error against `z` is any tangent, half a turn with it.
fn pair<G: Sample<N>, const N: usize>(source: &mut Source) -> (G, G, G) {
    let (i, z, error) = (G::sample(source), G::sample(source), G::sample(source));
    (i, i.compose(&z).compose(&error), z)
}

fn between<G: Sample<N>, const N: usize>(seed: u64) {
    let mut source = Source::new(seed);
    for _ in 0..POINTS {
        let (i, j, z) = pair::<G, N>(&mut source);
        let (from, to) = keys(&i, &j);
        let factor = Between::new(from, to, z, source.noise(N)).unwrap();
        assert_jacobian(&factor, &values(&i, &j));
    }
}

#[test]
fn between_everything() {
    between::<Rot2, 1>(11);
    between::<Rot3, 3>(12);
    between::<Pose2, 3>(13);
    between::<Pose3, 6>(14);
    between::<Point2, 2>(15);
    between::<Point3, 3>(16);
}

fn partial_between<G: Sample<N>, const N: usize>(seed: u64) {
    let mut source = Source::new(seed);
    for n in 0..POINTS {
        let (i, j, z) = pair::<G, N>(&mut source);
        let (from, to) = keys(&i, &j);
        // Every subset but the empty one in turn.
        let subset = n % ((1 << N) - 1) + 1;
        let components: Vec<usize> = (0..N).filter(|c| subset & (1 << c) != 0).collect();
        let noise = source.noise(components.len());
        let factor = PartialBetween::new(from, to, z, &components, noise).unwrap();
        assert_jacobian(&factor, &values(&i, &j));
        // More combinations than components among them.
        let rows = n % (N + 2) + 1;
        let combinations = DMatrix::from_fn(rows, N, |_, _| source.uniform(-2.0, 2.0));
        let noise = source.noise(rows);
        let factor = PartialBetween::with_combinations(from, to, z, combinations, noise).unwrap();
        assert_jacobian(&factor, &values(&i, &j));
    }
}

#[test]
fn between_some_components_and_combinations() {
    partial_between::<Pose2, 3>(21);
    partial_between::<Pose3, 6>(22);
}

#[test]
fn landmarks() {
    let mut source = Source::new(31);
    for _ in 0..POINTS {
        let (pose, point) = (Pose2::sample(&mut source), source.point2());
        let (a, b) = keys(&pose, &point);
        let factor = RelativePosition2::new(a, b, source.point2(), source.noise(2)).unwrap();
        assert_jacobian(&factor, &values(&pose, &point));
        let (pose, point) = (Pose3::sample(&mut source), source.point3());
        let (a, b) = keys(&pose, &point);
        let factor = RelativePosition3::new(a, b, source.point3(), source.noise(3)).unwrap();
        assert_jacobian(&factor, &values(&pose, &point));
        let sensor = Pose3::sample(&mut source);
        let noise = source.noise(3);
        let factor = RelativePosition3::with_sensor(a, b, source.point3(), sensor, noise).unwrap();
        assert_jacobian(&factor, &values(&pose, &point));
    }
}

fn range<A, B, const D: usize, const M: usize, const N: usize>(source: &mut Source)
where
    A: Sample<M> + Positioned<D>,
    B: Sample<N> + Positioned<D>,
{
    let (a, b) = (A::sample(source), B::sample(source));
    let (from, to) = keys(&a, &b);
    let factor = Range::new(from, to, source.uniform(0.0, 50.0), source.noise(1)).unwrap();
    assert_jacobian(&factor, &values(&a, &b));
}

#[test]
fn ranges_between_everything() {
    let mut source = Source::new(81);
    for _ in 0..POINTS / 4 {
        range::<Pose2, Pose2, 2, 3, 3>(&mut source);
        range::<Pose2, Point2, 2, 3, 2>(&mut source);
        range::<Point2, Point2, 2, 2, 2>(&mut source);
        range::<Pose3, Pose3, 3, 6, 6>(&mut source);
        range::<Point3, Pose3, 3, 3, 6>(&mut source);
        range::<Point3, Point3, 3, 3, 3>(&mut source);
    }
}

fn bearings2<B: Sample<N> + Positioned<2>, const N: usize>(source: &mut Source) {
    let (pose, target) = (Pose2::sample(source), B::sample(source));
    let (a, b) = keys(&pose, &target);
    let seen = pose.rotation().inverse_rotate(&(target.position() - pose.position()));
    let bearing = seen.y.atan2(seen.x) - source.angle();
    let factor = Bearing2::new(a, b, bearing, source.noise(1)).unwrap();
    assert_jacobian(&factor, &values(&pose, &target));
    let (range, noise) = (source.uniform(0.0, 50.0), source.noise(2));
    let factor = BearingRange2::new(a, b, bearing, range, noise).unwrap();
    assert_jacobian(&factor, &values(&pose, &target));
}

fn bearings3<B: Sample<N> + Positioned<3>, const N: usize>(source: &mut Source) {
    let (pose, target) = (Pose3::sample(source), B::sample(source));
    let (a, b) = keys(&pose, &target);
    let seen = pose.rotation().inverse_rotate(&(target.position() - pose.position()));
    let axis = seen.cross(&source.direction()).normalize();
    let direction = Rot3::exp(&(source.angle() * axis)).rotate(&seen);
    let factor = Bearing3::new(a, b, direction, source.noise(2)).unwrap();
    assert_jacobian(&factor, &values(&pose, &target));
    let (range, noise) = (source.uniform(0.0, 50.0), source.noise(3));
    let factor = BearingRange3::new(a, b, direction, range, noise).unwrap();
    assert_jacobian(&factor, &values(&pose, &target));
}

#[test]
fn bearings_of_poses_and_points() {
    let mut source = Source::new(82);
    for _ in 0..POINTS / 2 {
        bearings2::<Pose2, 3>(&mut source);
        bearings2::<Point2, 2>(&mut source);
        bearings3::<Pose3, 6>(&mut source);
        bearings3::<Point3, 3>(&mut source);
    }
}

#[test]
fn differences_in_the_world() {
    let mut source = Source::new(83);
    for _ in 0..POINTS {
        let (i, j) = (Pose2::sample(&mut source), Pose2::sample(&mut source));
        let ((a, b), at) = (keys(&i, &j), values(&i, &j));
        let (d, noise) = (source.point2(), source.noise(2));
        assert_jacobian(&TranslationDifference2::new(a, b, d, noise).unwrap(), &at);

        let (i, j) = (Pose3::sample(&mut source), Pose3::sample(&mut source));
        let ((a, b), at) = (keys(&i, &j), values(&i, &j));
        let (d, noise) = (source.point3(), source.noise(3));
        assert_jacobian(&TranslationDifference3::new(a, b, d, noise).unwrap(), &at);
        let (d, noise) = (source.uniform(-50.0, 50.0), source.noise(1));
        assert_jacobian(&DepthDifference::new(a, b, d, noise).unwrap(), &at);
        let [[_, pitch_i, yaw_i], [_, pitch_j, yaw_j]] =
            [i, j].map(|pose| pose.rotation().roll_pitch_yaw());
        if pitch_i.cos() > 1e-2 && pitch_j.cos() > 1e-2 {
            let (d, noise) = (yaw_j - yaw_i - source.angle(), source.noise(1));
            assert_jacobian(&HeadingDifference::new(a, b, d, noise).unwrap(), &at);
        }
    }
}

#[test]
fn planar_motion() {
    let mut source = Source::new(84);
    for _ in 0..POINTS {
        let pose = Pose3::sample(&mut source);
        let (height, noise) = (source.uniform(-50.0, 50.0), source.noise(3));
        let factor = PlanarMotion::new(key(&pose), height, noise).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose)]);
    }
}

#[test]
fn gps() {
    let mut source = Source::new(41);
    for _ in 0..POINTS {
        let pose = Pose2::sample(&mut source);
        let (z, arm, noise) = (source.point2(), source.point2(), source.noise(2));
        let factor = GpsPosition2::with_lever_arm(key(&pose), z, arm, noise).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose)]);
        let pose = Pose3::sample(&mut source);
        let (z, arm, noise) = (source.point3(), source.point3(), source.noise(3));
        let factor = GpsPosition3::with_lever_arm(key(&pose), z, arm, noise).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose)]);
        let factor = GpsPosition3::new(key(&pose), z, source.noise(3)).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose)]);
    }
}

#[test]
fn parts_of_a_pose() {
    let mut source = Source::new(51);
    for _ in 0..POINTS {
        let pose = Pose3::sample(&mut source);
        let at = [Value::new(&pose)];
        let depth = source.uniform(-50.0, 50.0);
        assert_jacobian(&Depth::new(key(&pose), depth, source.noise(1)).unwrap(), &at);
        let [roll, pitch, yaw] = pose.rotation().roll_pitch_yaw();
        // Near the pole the angles turn by half a turn within any step.
        if pitch.cos() > 1e-2 {
            let psi = yaw - source.angle();
            assert_jacobian(&Heading3::new(key(&pose), psi, source.noise(1)).unwrap(), &at);
            let (roll, pitch) = (roll - source.angle(), pitch - source.uniform(-1.0, 1.0));
            assert_jacobian(
                &RollPitch::new(key(&pose), roll, pitch, source.noise(2)).unwrap(),
                &at,
            );
        }
        let pose = Pose2::sample(&mut source);
        let psi = pose.theta() - source.angle();
        let factor = Heading2::new(key(&pose), psi, source.noise(1)).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose)]);
    }
}

#[test]
fn attitude_at_any_angle_from_the_measurement() {
    let mut source = Source::new(61);
    for _ in 0..POINTS {
        let (pose, world) = (Pose3::sample(&mut source), source.direction());
        let seen = pose.rotation().inverse_rotate(&world);
        let axis = seen.cross(&source.direction()).normalize();
        let measured = Rot3::exp(&(source.angle() * axis)).rotate(&seen);
        let scaled = source.uniform(0.1, 20.0) * measured;
        let factor = Attitude::new(key(&pose), world, scaled, source.noise(2)).unwrap();
        assert_jacobian(&factor, &[Value::new(&pose)]);
    }
    // At the measurement itself.
    let pose = Pose3::sample(&mut source);
    let measured = pose.rotation().inverse_rotate(&Vector3::z());
    let factor = Attitude::new(key(&pose), Vector3::z(), measured, source.noise(2)).unwrap();
    assert_jacobian(&factor, &[Value::new(&pose)]);
}
