//! What comes in when.

use evergraph::Graph;
use evergraph::factors::RootShift;
use evergraph::formats::{LinearMeasurement, Quantity, Record};
use evergraph::model::{Kernel, LieGroup, Point2, Point3, Pose2, Pose3, Rot3};
use evergraph::replay::{Initial, Replay, ReplayOptions};

use crate::world::{Truth, World, sigma};

/// Lines of the factors of each step.
fn lines(world: &World) -> Vec<Vec<usize>> {
    let mut replay = Replay::new(&world.document(), &ReplayOptions::default()).unwrap();
    let mut graph = Graph::new();
    let mut values = std::collections::HashMap::new();
    let mut steps = Vec::new();
    let mut done = 0;
    loop {
        let mut change = graph.change();
        let mut estimate = |id| values.get(&id).cloned();
        let Some(step) = replay.next_step(&mut change, &mut estimate) else { break };
        step.unwrap();
        values.extend(change.new_variables().iter().cloned());
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
        steps.push(replay.factors()[done..].iter().map(|(_, line)| *line).collect());
        done = replay.factors().len();
    }
    steps
}

#[test]
fn a_measurement_comes_with_the_last_of_its_variables() {
    let mut world = World::default();
    world.drive2(0..4, Pose2::identity(), 0.2);
    world.range(2, 0);
    world.measure(Quantity::Heading, &[3], &[0.6]);
    world.range(1, 3);
    world.measure(Quantity::Heading, &[0], &[0.0]);
    assert_eq!(lines(&world), [vec![7], vec![1], vec![2, 4], vec![3, 5, 6]]);
}

#[test]
fn lines_with_times_come_in_their_order() {
    // As PyFactorGraph writes them: by type, each type by time.
    let mut world = World::default();
    world.truth.insert(0, Truth::Pose2(Pose2::identity()));
    world.truth.insert(1, Truth::Pose2(Pose2::new(1.0, 0.0, 0.3)));
    world.truth.insert(2, Truth::Pose2(Pose2::new(2.0, 0.0, 0.0)));
    for (from, to, time) in [(2, 0, 1.0), (0, 1, 2.0)] {
        world.edge(from, to);
        world.note(|line| line.set_time(Some(time)));
    }
    world.range(0, 1);
    world.note(|line| line.set_time(Some(3.0)));
    world.range(0, 2);
    world.note(|line| line.set_time(Some(2.0)));
    // Odometry of time 1 brings 0 and 2 in, that of time 2 pose 1; the ranges follow.
    assert_eq!(lines(&world), [vec![], vec![1], vec![2, 3, 4]]);
    let replayer = world.replay();
    let ids: Vec<u64> = replayer.replay().ids().map(|(id, _)| id).collect();
    assert_eq!(ids, [0, 2, 1]);
    world.check(&replayer);
}

#[test]
fn odometry_goes_before_what_is_seen_at_the_same_time() {
    let mut world = World::default();
    world.drive2(0..2, Pose2::identity(), 0.2);
    world.note(|line| line.set_time(Some(1.0)));
    world.landmark2(50, 4.0, 6.0);
    world.edge(1, 50);
    world.note(|line| line.set_time(Some(1.0)));
    world.lines.reverse();
    let replayer = world.replay();
    assert_eq!(replayer.replay().gauge_priors()[0].id, 0);
    assert_eq!(replayer.replay().ids().map(|(id, _)| id).collect::<Vec<_>>(), [0, 1, 50]);
}

#[test]
fn kernels_of_the_file_go_before_those_of_the_options() {
    let mut world = World::default();
    world.drive2(0..2, Pose2::identity(), 0.2);
    world.range(0, 1);
    world.range(1, 0);
    world.note(|line| line.set_kernel(Some(Kernel::pseudo_huber(2.0).unwrap())));
    world.position(1);
    world.measure(Quantity::Heading, &[1], &[0.2]);
    world.note(|line| line.set_kernel(Some(Kernel::huber(3.0).unwrap())));
    let options = ReplayOptions::default().with_kernel(Some(Kernel::huber(1.0).unwrap()));
    let mut replay = Replay::new(&world.document(), &options).unwrap();
    let mut change = Graph::new().change();
    replay.everything(&mut change).unwrap();
    let names: Vec<String> = change.new_factors().iter().map(|(_, f)| f.name()).collect();
    assert_eq!(
        names,
        [
            "Robust<Between<Pose2>, Huber>",
            "Robust<Range<Pose2, Pose2>, Huber>",
            "Robust<Range<Pose2, Pose2>, PseudoHuber>",
            "GpsPosition2",
            "Robust<Heading2, Huber>",
        ]
    );
}

/// Two robots that saw the same landmarks, nowhere each other.
fn two_robots() -> World {
    let mut world = World::default();
    world.drive2(0..8, Pose2::identity(), 0.2);
    world.drive2(20..28, Pose2::new(12.0, -5.0, 2.6), -0.2);
    world
}

#[test]
fn a_part_starts_where_it_fits() {
    let mut world = two_robots();
    world.landmark2(50, 4.0, 6.0);
    world.landmark2(51, 9.0, 1.0);
    for landmark in [50, 51] {
        world.edge(3, landmark);
        world.edge(25, landmark);
    }
    // No solver: the start values alone are the truth.
    let mut replay = Replay::new(&world.document(), &ReplayOptions::default()).unwrap();
    let mut change = Graph::new().change();
    replay.everything(&mut change).unwrap();
    for ((id, _), (_, value)) in replay.ids().zip(change.new_variables()) {
        let truth = world.truth[&id].value();
        let far = truth.storage().iter().zip(value.storage()).any(|(a, b)| (a - b).abs() > 1e-6);
        assert!(!far, "{id}: {value:?} instead of {truth:?}");
    }
    let replayer = world.replay();
    assert_eq!(replayer.replay().len(), 9, "the second robot is one step");
    assert_eq!(replayer.replay().gauge_priors().len(), 1);
    world.check(&replayer);
}

#[test]
fn parts_that_only_ranges_tie_are_placed_by_them() {
    let mut world = two_robots();
    for (a, b) in [(0, 20), (2, 21), (4, 23), (6, 24), (7, 27), (1, 25), (5, 20)] {
        world.range(a, b);
    }
    let replayer = world.replay();
    assert_eq!(replayer.replay().gauge_priors().len(), 1);
    world.check(&replayer);
}

#[test]
fn a_part_that_is_only_determined_with_the_next_comes_with_it() {
    // Each sees one landmark of the first robot, and the third robot twice.
    let mut world = two_robots();
    world.drive2(40..44, Pose2::new(3.0, 9.0, -1.0), 0.1);
    for (id, (x, y)) in [(50, (4.0, 6.0)), (51, (9.0, 1.0))] {
        world.landmark2(id, x, y);
        world.edge(3, id);
    }
    world.edge(25, 50);
    world.edge(41, 51);
    world.landmark2(52, 1.0, 7.0);
    world.edge(26, 52);
    world.edge(43, 52);
    let replayer = world.replay();
    assert_eq!(replayer.replay().len(), 9);
    assert_eq!(replayer.replay().ids().count(), 8 + 8 + 4 + 3);
}

/// A relative linear factor on poses, exact at their truth.
fn linear(world: &mut World, ids: &[u64]) {
    let points: Vec<_> = ids.iter().map(|id| (*id, world.truth[id].coordinates())).collect();
    let (columns, rows) = (3 * ids.len(), 3 * (ids.len() - 1));
    let entry = |i, j| if j == i + 3 { 10.0 } else { 0.0 };
    let sqrt_information = (0..rows).flat_map(|i| (0..columns).map(move |j| entry(i, j))).collect();
    world.add(Record::Linear(Box::new(LinearMeasurement {
        points,
        root_shift: RootShift::Root,
        rows,
        sqrt_information,
        offset: vec![0.0; columns],
    })));
}

#[test]
fn linear_factors_on_poses_are_odometry() {
    let mut world = World::default();
    world.drive2(0..7, Pose2::identity(), 0.3);
    world.lines.clear();
    world.edge(0, 1);
    linear(&mut world, &[1, 2]);
    linear(&mut world, &[5, 4, 3]);
    linear(&mut world, &[2, 3]);
    world.edge(3, 4);
    linear(&mut world, &[6, 3, 1]);
    assert_eq!(lines(&world), [vec![], vec![1], vec![2], vec![4], vec![5], vec![3], vec![6]]);
    let replayer = world.replay();
    assert_eq!(replayer.replay().gauge_priors().len(), 1);
    assert_eq!(replayer.replay().gauge_priors()[0].directions, 3);
    world.check(&replayer);
}

#[test]
fn partial_odometry_and_absolute_parts_make_a_chain() {
    let mut world = World::default();
    world.drive3(0..8, Pose3::identity());
    world.lines.clear();
    for id in 0..8 {
        let x = world.pose3(id);
        let [roll, pitch, yaw] = x.rotation().roll_pitch_yaw();
        world.measure(Quantity::Depth, &[id], &[x.z()]);
        world.measure(Quantity::RollPitch, &[id], &[roll, pitch]);
        if id == 0 {
            continue;
        }
        let before = world.pose3(id - 1);
        let [_, _, last_yaw] = before.rotation().roll_pitch_yaw();
        world.measure(Quantity::HeadingDifference, &[id - 1, id], &[yaw - last_yaw]);
        world.measure(Quantity::DepthDifference, &[id - 1, id], &[x.z() - before.z()]);
        let mut numbers = Truth::Pose3(before.between(&x)).coordinates().numbers().to_vec();
        numbers.extend([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        world.measure_with(Quantity::Partial, &[id - 1, id], &numbers, sigma(0.1, 2));
    }
    let replayer = world.replay();
    assert_eq!(replayer.replay().gauge_priors()[0].directions, 3);
    world.check(&replayer);
}

#[test]
fn priors_on_a_sensor_are_priors_on_the_robot() {
    let sensor = Pose3::new(Rot3::from_roll_pitch_yaw(0.4, 0.5, -2.0), Point3::new(0.5, -1.0, 2.0));
    let mut world = World::default();
    world.drive3(
        0..3,
        Pose3::new(Rot3::from_roll_pitch_yaw(1.0, 0.2, 3.0), Point3::new(9.0, 8.0, 7.0)),
    );
    world.add(Record::SensorOffset { id: 7, at: Truth::Pose3(sensor).coordinates() });
    for (quantity, rows) in [(Quantity::Prior, 6), (Quantity::Position, 3)] {
        let seen = world.pose3(1) * sensor;
        let seen = Truth::Pose3(seen);
        let numbers =
            if rows == 6 { seen.coordinates().numbers().to_vec() } else { seen.position() };
        world.measure_with(quantity, &[1], &numbers, sigma(0.1, rows));
        let Some(Record::Measurement(last)) = world.lines.last_mut().map(|line| &mut line.record)
        else {
            panic!("a measurement was added")
        };
        last.parameter = Some(7);
    }
    world.check(&world.replay());

    // Off the truth, the residual is that of the sensor's pose.
    let document = world.document();
    let mut replay = Replay::new(&document, &ReplayOptions::default()).unwrap();
    let mut change = Graph::new().change();
    replay.everything(&mut change).unwrap();
    let (_, factor) =
        change.new_factors().iter().find(|(_, factor)| factor.name() == "Prior<Pose3>").unwrap();
    let off = Pose3::exp(&[0.1, -0.2, 0.3, 0.2, -0.1, 0.15].into());
    let x = world.pose3(1) * off;
    let value = evergraph::model::Value::new(&x);
    let storages = [value.storage()];
    let mut residual = [0.0; 6];
    factor.residual(&evergraph::model::Arguments::new(&storages), &mut residual);
    let expected = 10.0 * (world.pose3(1) * sensor).between(&(x * sensor)).log();
    let length = residual.iter().map(|r| r * r).sum::<f64>().sqrt();
    assert!((length / expected.norm() - 1.0).abs() < 1e-9, "{length} {}", expected.norm());
}

#[test]
fn every_quantity_is_exact_at_the_truth() {
    use Quantity as Q;
    let mut plane = World::default();
    plane.drive2(0..4, Pose2::identity(), 0.4);
    plane.landmark2(50, 4.0, 6.0);
    plane.landmark2(51, -2.0, 3.0);
    let (a, b) = (plane.pose2(1), plane.pose2(2));
    let antenna = a.transform_point(&Point2::new(0.3, 0.2));
    plane.edge(1, 50);
    plane.edge(1, 51);
    [0, 50].into_iter().for_each(|id| plane.prior(id));
    plane.position(2);
    plane.measure(Q::AntennaPosition, &[1], &[antenna.x(), antenna.y(), 0.3, 0.2]);
    plane.measure(Q::Heading, &[2], &[b.theta()]);
    plane.measure(Q::Between, &[50, 51], &[-6.0, -3.0]);
    for (x, y) in [(0, 2), (1, 50), (50, 3), (51, 50)] {
        plane.range(x, y);
    }
    for target in [0, 51] {
        plane.bearing(3, target);
        plane.bearing_range(3, target);
    }
    plane.measure(Q::TranslationDifference, &[1, 2], &[b.x() - a.x(), b.y() - a.y()]);
    let z = a.between(&b);
    plane.measure(Q::Partial, &[1, 2], &[z.x(), z.y(), z.theta(), 1.0, 2.0, 3.0]);

    let mut space = World::default();
    space.drive3(0..4, Pose3::identity());
    space.landmark3(50, 4.0, 6.0, 1.0);
    space.landmark3(51, -2.0, 3.0, 4.0);
    let (a, b) = (space.pose3(1), space.pose3(2));
    let antenna = a.transform_point(&Point3::new(0.3, 0.2, 0.1));
    space.edge(1, 50);
    space.edge(1, 51);
    [0, 50].into_iter().for_each(|id| space.prior(id));
    space.position(2);
    let numbers = [antenna.x(), antenna.y(), antenna.z(), 0.3, 0.2, 0.1];
    space.measure(Q::AntennaPosition, &[1], &numbers);
    let [roll, pitch, yaw] = b.rotation().roll_pitch_yaw();
    space.measure(Q::Depth, &[2], &[b.z()]);
    space.measure(Q::Heading, &[2], &[yaw]);
    space.measure(Q::RollPitch, &[2], &[roll, pitch]);
    let up = b.rotation().inverse_rotate(&[0.0, 0.0, 1.0].into());
    space.measure(Q::Attitude, &[2], &[0.0, 0.0, 1.0, up.x, up.y, up.z]);
    space.measure(Q::PlanarMotion, &[0], &[0.0]);
    space.measure(Q::Between, &[50, 51], &[-6.0, -3.0, 3.0]);
    for (x, y) in [(0, 2), (1, 50), (50, 3), (51, 50)] {
        space.range(x, y);
    }
    for target in [0, 51] {
        space.bearing(3, target);
        space.bearing_range(3, target);
    }
    let last_yaw = a.rotation().roll_pitch_yaw()[2];
    space.measure(Q::DepthDifference, &[1, 2], &[b.z() - a.z()]);
    space.measure(Q::HeadingDifference, &[1, 2], &[yaw - last_yaw]);
    let way = [b.x() - a.x(), b.y() - a.y(), b.z() - a.z()];
    space.measure(Q::TranslationDifference, &[1, 2], &way);
    let mut numbers = Truth::Pose3(a.between(&b)).coordinates().numbers().to_vec();
    numbers.extend([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    space.measure(Q::Partial, &[1, 2], &numbers);

    for world in [plane, space] {
        let replayer = world.replay();
        let (factors, lines) = (replayer.replay().factors().len(), world.lines.len());
        assert_eq!(factors, lines, "each line is a factor");
        world.check(&replayer);
        world.check(&world.batch(Initial::FromOdometry));
    }
}
