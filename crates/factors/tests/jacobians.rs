//! Every Jacobian against central differences at a thousand points, with rotations near zero and
//! near half a turn among them.

#![allow(
    clippy::unwrap_used,
    reason = "the lint knows tests by their attribute; the generic helpers here have none"
)]

mod common;

use common::{POINTS, Sample, Source, key, keys, values};
use evergraph_factors::{
    Attitude, Between, Depth, GpsPosition2, GpsPosition3, Heading2, Heading3, LocalJacobian,
    PartialBetween, Prior, RelativePosition2, RelativePosition3, RollPitch,
};
use evergraph_model::testing::assert_jacobian;
use evergraph_model::{LieGroup, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VectorN};
use nalgebra::Vector3;

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
    }
}

#[test]
fn between_some_components() {
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
