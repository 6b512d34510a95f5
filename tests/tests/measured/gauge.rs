//! What holds a map in the world.

use evergraph::formats::{Quantity, Record};
use evergraph::model::{Pose2, Pose3, Rot3};
use evergraph::replay::{Initial, ReplayOptions};

use crate::world::World;

fn tumbled(heading: f64) -> Pose3 {
    let rotation = Rot3::from_roll_pitch_yaw(0.3, -0.2, heading);
    Pose3::new(rotation, evergraph::model::Point3::new(20.0, -30.0, 5.0))
}

#[test]
fn positions_alone_hold_the_map_once_the_robot_has_moved() {
    for k in 0..12 {
        let heading = 0.5 * f64::from(k);
        let mut plane = World::default();
        plane.drive2(0..12, Pose2::new(30.0, -8.0, heading), 0.2);
        let mut space = World::default();
        space.drive3(0..12, tumbled(heading));
        for mut world in [plane, space] {
            (0..12).for_each(|id| world.position(id));
            let replayer = world.replay();
            assert!(replayer.replay().gauge_priors().is_empty());
            assert!((4..12).contains(&replayer.replay().len()), "{}", replayer.replay().len());
            world.check(&replayer);
            world.check(&world.batch(Initial::FromOdometry));
        }
    }
}

#[test]
fn positions_that_begin_late_hold_all_that_came_before() {
    let mut world = World::default();
    world.drive2(0..20, Pose2::new(30.0, -8.0, 2.0), 0.1);
    (10..20).for_each(|id| world.position(id));
    let replayer = world.replay();
    assert!(replayer.replay().gauge_priors().is_empty());
    assert!(replayer.replay().len() < 10);
    world.check(&replayer);
}

#[test]
fn antennas_beside_the_robot_tell_its_heading() {
    let mut world = World::default();
    world.drive2(0..5, Pose2::new(30.0, -8.0, 3.0), 0.2);
    for arm in [3.0, -3.0] {
        let antenna = world.pose2(0).transform_point(&evergraph::model::Point2::new(arm, 0.0));
        let numbers = [antenna.x(), antenna.y(), arm, 0.0];
        world.measure(Quantity::AntennaPosition, &[0], &numbers);
    }
    let replayer = world.replay();
    assert!(replayer.replay().gauge_priors().is_empty());
    assert_eq!(replayer.replay().len(), 5, "one pose suffices");
    world.check(&replayer);
}

#[test]
fn what_is_free_beside_depth_and_attitude_gets_the_prior() {
    for (with_heading, directions) in [(true, 2), (false, 3)] {
        let mut world = World::default();
        let heading = if with_heading { 1.0 } else { 0.0 };
        let rotation = Rot3::from_roll_pitch_yaw(0.3, -0.2, heading);
        world.drive3(0..10, Pose3::new(rotation, evergraph::model::Point3::new(0.0, 0.0, -40.0)));
        for id in 0..10 {
            let x = world.pose3(id);
            let [roll, pitch, yaw] = x.rotation().roll_pitch_yaw();
            world.measure(Quantity::Depth, &[id], &[x.z()]);
            world.measure(Quantity::RollPitch, &[id], &[roll, pitch]);
            if with_heading {
                world.measure(Quantity::Heading, &[id], &[yaw]);
            }
        }
        let replayer = world.replay();
        let priors = replayer.replay().gauge_priors();
        assert_eq!((priors.len(), priors[0].id, priors[0].directions), (1, 0, directions));
        assert_eq!(replayer.replay().len(), 10);
        assert!(replayer.gauge_error().unwrap() < 1e-9, "{}", replayer.gauge_error().unwrap());
        assert!(replayer.error().unwrap() < 1e-9, "{}", replayer.error().unwrap());
        if with_heading {
            world.check(&replayer);
        }
    }
}

#[test]
fn fix_holds_whatever_else_is_measured() {
    let mut world = World::default();
    world.drive2(0..6, Pose2::new(0.0, 0.0, 0.0), 0.2);
    (0..6).for_each(|id| world.position(id));
    world.add(Record::Fix { id: 0 });
    let replayer = world.replay();
    assert!(replayer.replay().gauge_priors().is_empty());
    assert_eq!(replayer.replay().fixed().map(|(id, _)| id).collect::<Vec<_>>(), [0]);
    assert_eq!(replayer.replay().len(), 6);
    world.check(&replayer);
}

#[test]
fn each_component_has_its_own_gauge() {
    let mut world = World::default();
    world.drive2(0..8, Pose2::new(30.0, -8.0, 2.0), 0.2);
    (0..8).for_each(|id| world.position(id));
    world.drive2(20..25, Pose2::new(0.0, 0.0, 0.0), 0.2);
    let replayer = world.replay();
    let priors = replayer.replay().gauge_priors();
    assert_eq!((priors.len(), priors[0].id, priors[0].directions), (1, 20, 3));
    world.check(&replayer);
}

#[test]
fn a_prior_of_the_file_replaces_the_gauge_prior() {
    let mut world = World::default();
    world.drive3(0..5, tumbled(2.5));
    world.prior(2);
    let replayer = world.replay();
    assert!(replayer.replay().gauge_priors().is_empty());
    assert_eq!(replayer.replay().len(), 3, "poses 0 to 2 come together");
    world.check(&replayer);
}

#[test]
fn without_priors_none_is_added() {
    let mut world = World::default();
    world.drive2(0..5, Pose2::new(1.0, 2.0, 3.0), 0.2);
    world.position(0);
    let options = ReplayOptions::default().with_prior(None);
    let mut replay = evergraph::replay::Replay::new(&world.document(), &options).unwrap();
    let step = replay.everything(&mut evergraph::Graph::new().change()).unwrap();
    assert!(step.gauge_priors.is_empty() && replay.gauge_priors().is_empty());
}

#[test]
fn known_beacons_hold_a_robot_that_only_ranges() {
    for far in [0.0, 80_000.0] {
        let mut world = World::default();
        world.drive2(0..12, Pose2::new(far + 3.0, 4.0 - far, 2.0), 0.3);
        for (id, (x, y)) in [(100, (0.0, 0.0)), (101, (15.0, 0.0)), (102, (5.0, 12.0))] {
            world.landmark2(id, far + x, y - far);
            world.prior(id);
            (0..12).for_each(|pose| world.range(pose, id));
        }
        let replayer = world.replay();
        assert!(replayer.replay().gauge_priors().is_empty());
        world.check(&replayer);
    }
}
