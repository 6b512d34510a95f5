//! Landmarks that no single sighting places.

use evergraph::Replayer;
use evergraph::model::{LieGroup, Point3, Pose2, Pose3};
use evergraph::replay::{Initial, ReplayOptions, StepKind};
use evergraph::solver::Settings;

use crate::world::{Truth, World};

/// After how many steps each landmark came in.
fn arrival(world: &World, landmark: u64) -> Option<usize> {
    let mut replayer =
        Replayer::new(&world.document(), &ReplayOptions::default(), Settings::default()).unwrap();
    let mut steps = 0;
    while replayer.step().unwrap().is_some() {
        steps += 1;
        if replayer.replay().landmark(landmark).is_some() {
            return Some(steps);
        }
    }
    None
}

/// Poses 0 to 9 in a line along x.
fn straight() -> World {
    let mut world = World::default();
    for id in 0..10_u32 {
        let x = Pose2::new(f64::from(id), 0.0, 0.0);
        world.truth.insert(u64::from(id), Truth::Pose2(x));
    }
    (1..10).for_each(|id| world.edge(id - 1, id));
    world
}

#[test]
fn one_bearing_holds_a_landmark_back_and_two_with_parallax_place_it() {
    let mut plane = straight();
    plane.landmark2(50, 4.0, 6.0);
    let mut space = World::default();
    space.drive3(0..10, Pose3::identity());
    space.landmark3(50, 4.0, 6.0, 2.0);
    for mut world in [plane, space] {
        world.bearing(0, 50);
        let replayer = world.replay();
        assert_eq!(replayer.replay().held_back(), 1);
        assert_eq!(replayer.replay().held_back_ids().collect::<Vec<_>>(), [50]);
        assert_eq!(replayer.replay().factors().len(), 9);
        let solution = replayer.solution(&world.document()).unwrap();
        assert_eq!((solution.summary().poses, solution.summary().landmarks), (10, 0));
        world.check(&replayer);

        world.bearing(6, 50);
        assert_eq!(arrival(&world, 50), Some(7));
        let replayer = world.replay();
        assert_eq!((replayer.replay().held_back(), replayer.replay().factors().len()), (0, 11));
        world.check(&replayer);
        world.check(&world.batch(Initial::FromOdometry));
    }
}

#[test]
fn parallel_bearings_do_not_place_a_landmark() {
    let mut world = straight();
    world.landmark2(50, 5000.0, 1.0);
    (0..10).for_each(|pose| world.bearing(pose, 50));
    assert_eq!(world.replay().replay().held_back(), 1);
}

#[test]
fn a_narrow_baseline_does_not_place_a_landmark() {
    // From a metre apart, at 0.01 rad, 60 m ahead are known to 50.
    let mut world = straight();
    world.landmark2(50, 0.5, 60.0);
    (0..2).for_each(|pose| world.bearing(pose, 50));
    assert_eq!(world.replay().replay().held_back(), 1);
    world.bearing(9, 50);
    assert_eq!(arrival(&world, 50), Some(10));
}

#[test]
fn ranges_that_contradict_each_other_place_nothing() {
    let mut world = World::default();
    world.drive2(0..30, Pose2::identity(), 0.2);
    world.landmark2(50, 1.0, 4.0);
    (0..30).for_each(|pose| world.range(pose, 50));
    assert_eq!(world.replay().replay().held_back(), 0);
    let mut measured = 0;
    for line in &mut world.lines {
        if let evergraph::formats::Record::Measurement(range) = &mut line.record {
            // Fifteen standard deviations, to either side.
            range.numbers[0] += if measured % 2 == 0 { 1.5 } else { -1.5 };
            measured += 1;
        }
    }
    assert_eq!((measured, world.replay().replay().held_back()), (30, 1));
}

#[test]
fn bearings_that_do_not_meet_place_nothing() {
    // The second looks the other way.
    let mut world = straight();
    world.landmark2(50, 4.0, 6.0);
    world.bearing(0, 50);
    world.landmark2(51, 4.0, -6.0);
    world.bearing(6, 51);
    let mut ids = 0;
    for line in &mut world.lines {
        if let evergraph::formats::Record::Measurement(measurement) = &mut line.record {
            measurement.ends[1].0 = 50;
            ids += 1;
        }
    }
    world.truth.remove(&51);
    assert_eq!(ids, 2);
    assert_eq!(world.replay().replay().held_back(), 1);
}

#[test]
fn ranges_from_along_a_line_fit_two_places() {
    let mut world = straight();
    world.landmark2(50, 4.0, 6.0);
    (0..10).for_each(|pose| world.range(pose, 50));
    assert_eq!(world.replay().replay().held_back(), 1, "it may be on either side");

    // Pose 10 is off the line.
    world.truth.insert(10, Truth::Pose2(Pose2::new(9.0, 4.0, 1.0)));
    world.edge(9, 10);
    world.range(10, 50);
    assert_eq!(arrival(&world, 50), Some(11));
    let replayer = world.replay();
    assert_eq!((replayer.replay().held_back(), replayer.replay().factors().len()), (0, 21));
    world.check(&replayer);
    world.check(&world.batch(Initial::FromOdometry));
}

#[test]
fn ranges_from_a_plane_fit_two_places() {
    let mut world = World::default();
    let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0), (-3.0, 2.0)];
    for (id, (x, y)) in (0..).zip(corners) {
        let at = Pose3::new(LieGroup::identity(), Point3::new(x, y, 0.0));
        world.truth.insert(id, Truth::Pose3(at));
    }
    (1..5).for_each(|id| world.edge(id - 1, id));
    world.landmark3(50, 2.0, 1.0, 5.0);
    (0..5).for_each(|pose| world.range(pose, 50));
    assert_eq!(world.replay().replay().held_back(), 1, "it may be above or below");

    let above = Pose3::new(LieGroup::identity(), Point3::new(0.0, 0.0, 4.0));
    world.truth.insert(5, Truth::Pose3(above));
    world.edge(4, 5);
    world.range(5, 50);
    assert_eq!(arrival(&world, 50), Some(6));
    world.check(&world.replay());
}

#[test]
fn a_landmark_starts_at_its_vertex_if_told_so() {
    let mut world = straight();
    world.landmark2(50, 4.0, 6.0);
    (0..10).for_each(|pose| world.range(pose, 50));
    for truth in world.truth.clone() {
        let (id, at) = (truth.0, truth.1.coordinates());
        world.add(evergraph::formats::Record::Vertex { id, at });
    }
    let replayer = world.batch(Initial::FromFile);
    assert_eq!(replayer.replay().held_back(), 0, "the vertex says on which side it is");
    world.check(&replayer);

    let mut world = straight();
    world.landmark2(50, 4.0, 6.0);
    world.range(0, 50);
    for truth in world.truth.clone() {
        let (id, at) = (truth.0, truth.1.coordinates());
        world.add(evergraph::formats::Record::Vertex { id, at });
    }
    assert_eq!(
        world.batch(Initial::FromFile).replay().held_back(),
        1,
        "it is still not determined"
    );
}

#[test]
fn bearing_and_range_together_place_a_landmark_at_once() {
    let mut plane = straight();
    plane.landmark2(50, 4.0, 6.0);
    let mut space = World::default();
    space.drive3(0..10, Pose3::identity());
    space.landmark3(50, 4.0, 6.0, 2.0);
    for mut world in [plane, space] {
        world.bearing_range(3, 50);
        assert_eq!(arrival(&world, 50), Some(4));
        world.bearing_range(7, 50);
        let mut replayer =
            Replayer::new(&world.document(), &ReplayOptions::default(), Settings::default())
                .unwrap();
        let mut kinds = Vec::new();
        while let Some(done) = replayer.step().unwrap() {
            kinds.push(done.step.kind);
        }
        let loops: Vec<usize> = (0..10).filter(|&step| kinds[step] == StepKind::Loop).collect();
        assert_eq!(loops, [7]);
        world.check(&world.replay());
    }
}

#[test]
fn landmarks_tied_to_landmarks_follow_them() {
    let mut world = straight();
    world.landmark2(50, 4.0, 6.0);
    world.landmark2(51, 7.0, 6.0);
    world.landmark2(52, 7.0, 9.0);
    use evergraph::formats::Quantity::Between;
    world.measure(Between, &[52, 51], &[0.0, -3.0]);
    world.measure(Between, &[50, 51], &[3.0, 0.0]);
    world.bearing(0, 50);
    assert_eq!(world.replay().replay().held_back(), 3);
    world.bearing(6, 50);
    assert_eq!([50, 51, 52].map(|id| arrival(&world, id)), [Some(7); 3]);
    world.check(&world.replay());
}

#[test]
fn landmarks_that_nobody_sees_stay_out() {
    let mut world = straight();
    world.landmark2(50, 4.0, 6.0);
    world.prior(50);
    let replayer = world.replay();
    assert_eq!(replayer.replay().held_back(), 1);
    assert_eq!(replayer.replay().gauge_priors().len(), 1);
    world.check(&replayer);
}
