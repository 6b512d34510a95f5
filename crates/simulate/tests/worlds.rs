//! The worlds are what their page says: the same everywhere, true, and as noisy as they state.

mod common;

use std::time::{Duration, Instant};

use common::{Edge, Fingerprint, edges, poses2, poses3, records, vertices};
use evergraph_formats::{Coordinates, Dialect, Document, ReadOptions, Record};
use evergraph_model::{LieGroup, Point2, Pose2, Pose3};
use evergraph_simulate::{Grid, Landmarks, Shape, Surface, World, WorldError};

fn grid_with_landmarks(poses: u32, seed: u64) -> Grid {
    Grid::manhattan(poses, seed).with_landmarks(Some(Landmarks::default()))
}

/// Every kind of world, small.
fn all(poses: u32, seed: u64) -> [(&'static str, World); 5] {
    let made = "the presets are valid";
    [
        ("manhattan", Grid::manhattan(poses, seed).generate().expect(made)),
        ("city", Grid::city(poses, seed).generate().expect(made)),
        ("landmarks", grid_with_landmarks(poses, seed).generate().expect(made)),
        ("sphere", Surface::sphere(poses, seed).generate().expect(made)),
        ("torus", Surface::torus(poses, seed).generate().expect(made)),
    ]
}

/// These numbers may only change together with an entry in the changelog: published results name
/// worlds by seed.
#[test]
fn a_seed_names_the_same_bits_on_every_platform() {
    let expected: [(&str, u64); 5] = [
        ("manhattan", 0xcdcb_2982_c2e8_c53e),
        ("city", 0x9734_31a4_7c6c_4361),
        ("landmarks", 0x0ac8_9763_8a67_5631),
        ("sphere", 0x3194_80a8_48d4_26bf),
        ("torus", 0x1ced_9f9a_faa5_0703),
    ];
    let actual = all(600, 42).map(|(name, world)| (name, Fingerprint::of(&world)));
    assert_eq!(actual, expected, "\n{actual:#x?}");
    for (first, again) in all(600, 42).iter().zip(all(600, 42)) {
        assert_eq!(records(&first.1.document), records(&again.1.document), "{}", first.0);
    }
    for (first, other) in all(600, 42).iter().zip(all(600, 43)) {
        assert_ne!(records(&first.1.document), records(&other.1.document), "{}", first.0);
    }
}

#[test]
fn worlds_are_g2o_files() {
    for (name, world) in all(300, 7) {
        for document in [&world.document, &world.truth] {
            let mut bytes = Vec::new();
            document.write(&mut bytes, Dialect::G2o).expect("memory takes everything");
            let read = Document::parse(name, bytes.as_slice(), &ReadOptions::default());
            assert_eq!(records(&read.expect("g2o is read back")), records(document), "{name}");
        }
    }
}

#[test]
fn other_closures_leave_the_walk_and_the_odometry_alone() {
    let mut grid = Grid::city(1000, 5);
    let with = grid.generate().expect("valid");
    grid.closures.probability = 0.0;
    let without = grid.generate().expect("valid");
    assert_eq!(records(&with.truth), records(&without.truth));
    let odometry: Vec<Edge> =
        edges(&with).into_iter().filter(|edge| edge.to == edge.from + 1).collect();
    assert_eq!(odometry, edges(&without));
    assert_eq!(odometry.len(), 999);
}

#[test]
fn worlds_have_the_stated_sizes() {
    for (name, world) in all(10_000, 1) {
        let (poses, other): (Vec<_>, Vec<_>) = vertices(&world.truth)
            .into_iter()
            .partition(|(_, at)| !matches!(at, Coordinates::Point2(_)));
        assert_eq!(poses.len(), 10_000, "{name}");
        assert_eq!(other.is_empty(), name != "landmarks", "{name}");
        let closures = edges(&world)
            .iter()
            .filter(|edge| edge.to < 10_000 && edge.to != edge.from + 1)
            .count() as f64
            / 10_000.0;
        let expected = match name {
            "manhattan" | "landmarks" => 0.4..0.8,
            "city" => 0.8..1.4,
            _ => 0.95..1.0,
        };
        assert!(expected.contains(&closures), "{name}: {closures} closures a pose");
    }
}

#[test]
fn vertices_come_first_and_edges_in_time_order() {
    let gaps = [10, 10, 10, 26, 13];
    for ((name, world), gap) in all(2500, 3).into_iter().zip(gaps) {
        let ids: Vec<u64> = vertices(&world.document).iter().map(|(id, _)| *id).collect();
        assert_eq!(ids, (0..ids.len() as u64).collect::<Vec<_>>(), "{name}");
        let true_ids: Vec<u64> = vertices(&world.truth).iter().map(|(id, _)| *id).collect();
        assert_eq!(ids, true_ids, "{name}");
        assert!(
            records(&world.document)[ids.len()..]
                .iter()
                .all(|record| matches!(record, Record::Edge { .. })),
            "{name}"
        );
        // For each pose: odometry, closures with increasing ids, landmarks.
        let order: Vec<(u64, u32, u64)> = edges(&world)
            .iter()
            .map(|edge| match edge.to {
                landmark if landmark >= 2500 => (edge.from, 2, 0),
                to if to == edge.from + 1 => (to, 0, 0),
                to => {
                    assert!(to - edge.from >= gap, "{name}: {edge:?}");
                    (to, 1, edge.from)
                }
            })
            .collect();
        assert!(order.is_sorted(), "{name}");
        let odometry = order.iter().filter(|entry| entry.1 == 0).count();
        assert_eq!(odometry, 2499, "{name}");
    }
}

#[test]
fn landmarks_are_numbered_as_they_are_seen() {
    let world = grid_with_landmarks(2000, 8).generate().expect("valid");
    let mut next = 2000;
    for edge in edges(&world).iter().filter(|edge| edge.to >= 2000) {
        assert!(edge.to <= next, "{edge:?}");
        next = next.max(edge.to + 1);
    }
    assert_eq!(next as usize, vertices(&world.truth).len());
}

#[test]
fn a_grid_is_walked_in_unit_steps_inside_the_town() {
    let grid = Grid::manhattan(3000, 2);
    let half = f64::from(grid.block * grid.blocks);
    let poses = poses2(&grid.generate().expect("valid").truth);
    assert_eq!(poses[0], Pose2::identity());
    let block = f64::from(grid.block);
    for pose in &poses {
        assert!(pose.x().abs() <= half && pose.y().abs() <= half);
        assert!(pose.x() % block == 0.0 || pose.y() % block == 0.0, "off the streets: {pose:?}");
    }
    let mut turns = [0; 4];
    for pair in poses.windows(2) {
        let step = pair[0].between(&pair[1]);
        let heading = pair[1].rotation();
        assert_eq!(pair[1].x() - pair[0].x(), heading.cos().round());
        assert_eq!(pair[1].y() - pair[0].y(), heading.sin().round());
        turns[(step.theta() / std::f64::consts::FRAC_PI_2).round().rem_euclid(4.0) as usize] += 1;
    }
    assert!(turns[1] > 100 && turns[3] > 100 && turns[2] > 10 && turns[0] > 2000, "{turns:?}");
}

#[test]
fn closures_keep_to_radius_number_and_heading() {
    let mut grid = Grid::city(3000, 9);
    grid.closures.probability = 1.0;
    grid.closures.radius = 3.0;
    grid.closures.per_pose = 2;
    grid.closures.turn = 1.6;
    let world = grid.generate().expect("valid");
    let poses = poses2(&world.truth);
    let mut at_pose = vec![0; poses.len()];
    let mut quarter_turns = 0;
    for edge in edges(&world).iter().filter(|edge| edge.to != edge.from + 1) {
        let between = poses[edge.from as usize].between(&poses[edge.to as usize]);
        assert!(between.x().hypot(between.y()) <= 3.0 + 1e-12);
        assert!(between.theta().abs() <= 1.6);
        quarter_turns += usize::from(between.theta().abs() > 1.5);
        at_pose[edge.to as usize] += 1;
    }
    assert_eq!(at_pose.iter().max(), Some(&2));
    assert!(quarter_turns > 100, "{quarter_turns}");
}

#[test]
fn a_sphere_is_a_sphere_and_closes_to_the_ring_below() {
    let sphere = Surface::sphere(2500, 4);
    let Shape::Sphere { radius } = sphere.shape else { panic!("not a sphere") };
    let world = sphere.generate().expect("valid");
    let poses = poses3(&world.truth);
    for pose in &poses {
        let at = pose.translation().vector();
        assert!((at.norm() - radius).abs() < 1e-12 * radius);
        let up = pose.rotation().rotate(&[0.0, 0.0, 1.0].into());
        assert!((up - at / radius).norm() < 1e-12);
    }
    let equator = poses[1250].between(&poses[1251]).translation().vector();
    assert!((equator.norm() - 1.0).abs() < 0.01 && equator.x > 0.99, "{equator:?}");
    let closures: Vec<u64> = edges(&world)
        .iter()
        .filter(|edge| edge.to != edge.from + 1)
        .map(|edge| edge.to - edge.from)
        .collect();
    let below = closures.iter().filter(|&&age| age == u64::from(sphere.ring)).count();
    assert!(below > 2300, "{below} of {}", closures.len());
}

#[test]
fn a_torus_is_a_torus_and_closes_around_the_axis() {
    let torus = Surface::torus(2500, 4);
    let Shape::Torus { major, minor } = torus.shape else { panic!("not a torus") };
    let world = torus.generate().expect("valid");
    let poses = poses3(&world.truth);
    for pose in &poses {
        let at = pose.translation().vector();
        let out = at.xy().norm() - major;
        assert!((out.hypot(at.z) - minor).abs() < 1e-12 * major);
        let up = pose.rotation().rotate(&[0.0, 0.0, 1.0].into());
        assert!((at - minor * up).z.abs() < 1e-12 * major);
    }
    let step = poses[1250].between(&poses[1251]).translation().vector();
    assert!(step.x > 0.9 && step.norm() < 1.2, "{step:?}");
    // The last ring meets the first.
    assert!(edges(&world).iter().any(|edge| edge.to - edge.from > 2400));
}

#[test]
fn the_initial_guess_is_composed_odometry() {
    let world = grid_with_landmarks(800, 6).generate().expect("valid");
    let guess = poses2(&world.document);
    let points: Vec<_> = vertices(&world.document)[800..].to_vec();
    let mut seen = 0;
    assert_eq!(guess[0], Pose2::identity());
    for edge in edges(&world) {
        match edge.measurement {
            Coordinates::Pose2([x, y, theta]) if edge.to == edge.from + 1 => {
                let composed = guess[edge.from as usize].compose(&Pose2::new(x, y, theta));
                let off = composed.between(&guess[edge.to as usize]).log();
                assert!(off.norm() < 1e-12, "{off:?}");
            }
            Coordinates::Point2([x, y]) if edge.to == 800 + seen => {
                let (_, Coordinates::Point2(at)) = points[seen as usize] else {
                    panic!("a landmark is a point")
                };
                let placed = guess[edge.from as usize].transform_point(&Point2::new(x, y));
                assert!((placed.x() - at[0]).hypot(placed.y() - at[1]) < 1e-12);
                seen += 1;
            }
            _ => {}
        }
    }
    assert_eq!(seen as usize, points.len());
}

/// Checks that samples are N(0, diag σ²): means, deviations and correlations within five standard
/// errors.
fn check_noise<const N: usize>(name: &str, samples: &[[f64; N]], sigmas: &[f64; N]) {
    let count = samples.len() as f64;
    assert!(count > 2000.0, "{name}: {count} samples");
    for i in 0..N {
        let mean = samples.iter().map(|n| n[i] / sigmas[i]).sum::<f64>() / count;
        assert!(mean.abs() < 5.0 / count.sqrt(), "{name}[{i}]: mean {mean} sigma");
        for j in 0..=i {
            let products = samples.iter().map(|n| n[i] / sigmas[i] * n[j] / sigmas[j]);
            let covariance = products.sum::<f64>() / count;
            let (expected, variance) = if i == j { (1.0, 2.0) } else { (0.0, 1.0) };
            let off: f64 = covariance - expected;
            let limit = 5.0 * (variance / count).sqrt();
            assert!(off.abs() < limit, "{name}[{i}, {j}]: {covariance}, expected {expected}");
        }
    }
}

/// The diagonal of an edge's information, whose other entries are zero.
fn diagonal(edge: &Edge, n: usize) -> Vec<f64> {
    let mut entries = edge.weight.entries.iter();
    let mut diagonal = Vec::new();
    for row in 0..n {
        diagonal.push(*entries.next().expect("a full triangle"));
        assert!(entries.by_ref().take(n - row - 1).all(|&entry| entry == 0.0));
    }
    assert_eq!(entries.next(), None);
    diagonal
}

#[test]
fn noise_in_2d_is_what_the_information_says() {
    let mut grid = grid_with_landmarks(6000, 10);
    grid.odometry = [0.05, 0.01, 0.02];
    grid.closures.sigmas = [0.2, 0.1, 0.3];
    grid.closures.probability = 0.1;
    let sightings = Landmarks::default().with_sigmas([0.3, 0.03]);
    grid.landmarks = Some(sightings.clone());
    let world = grid.generate().expect("valid");
    let poses = poses2(&world.truth);
    let places: Vec<_> = vertices(&world.truth);
    let (mut odometry, mut closures, mut points) = (Vec::new(), Vec::new(), Vec::new());
    for edge in edges(&world) {
        let from = poses[edge.from as usize];
        match (edge.measurement, places[edge.to as usize].1) {
            (Coordinates::Pose2([x, y, theta]), _) => {
                let exact = from.between(&poses[edge.to as usize]);
                let noise = exact.between(&Pose2::new(x, y, theta)).log().into();
                let (samples, sigmas) = if edge.to == edge.from + 1 {
                    (&mut odometry, grid.odometry)
                } else {
                    (&mut closures, grid.closures.sigmas)
                };
                samples.push(noise);
                assert_eq!(diagonal(&edge, 3), sigmas.map(|sigma| 1.0 / (sigma * sigma)));
            }
            (Coordinates::Point2(measured), Coordinates::Point2([x, y])) => {
                let exact = from.inverse_transform_point(&Point2::new(x, y));
                points.push([measured[0] - exact.x(), measured[1] - exact.y()]);
                let expected = sightings.sigmas.map(|sigma| 1.0 / (sigma * sigma));
                assert_eq!(diagonal(&edge, 2), expected);
            }
            other => panic!("no such edge in 2D: {other:?}"),
        }
    }
    check_noise("odometry", &odometry, &grid.odometry);
    check_noise("closures", &closures, &grid.closures.sigmas);
    check_noise("landmarks", &points, &sightings.sigmas);
}

#[test]
fn noise_in_3d_is_what_the_information_says() {
    let mut sphere = Surface::sphere(6000, 11);
    sphere.odometry = [0.05, 0.01, 0.02, 0.3, 0.1, 0.2];
    sphere.closures.sigmas = [0.5, 0.1, 0.2, 0.01, 0.05, 0.1];
    let world = sphere.generate().expect("valid");
    let poses = poses3(&world.truth);
    let (mut odometry, mut closures) = (Vec::new(), Vec::new());
    for edge in edges(&world) {
        let exact = poses[edge.from as usize].between(&poses[edge.to as usize]);
        let measured: Pose3 = common::pose3(&edge.measurement);
        let (samples, sigmas) = if edge.to == edge.from + 1 {
            (&mut odometry, sphere.odometry)
        } else {
            (&mut closures, sphere.closures.sigmas)
        };
        samples.push(exact.between(&measured).log().into());
        assert_eq!(diagonal(&edge, 6), sigmas.map(|sigma| 1.0 / (sigma * sigma)));
    }
    check_noise("odometry", &odometry, &sphere.odometry);
    check_noise("closures", &closures, &sphere.closures.sigmas);
}

#[test]
fn two_poses_are_a_world() {
    for (name, world) in all(2, 1) {
        let poses = vertices(&world.truth);
        assert!(poses.len() >= 2, "{name}");
        assert_eq!(edges(&world).iter().filter(|edge| edge.to == 1).count(), 1, "{name}");
    }
}

/// The variant and fields of the error that must come, to compare: errors have no equality.
fn refused(world: Result<World, WorldError>) -> String {
    format!("{:?}", world.map(|_| ()).expect_err("must be refused"))
}

#[test]
fn bad_parameters_are_typed_errors() {
    let grid = |alter: &dyn Fn(&mut Grid)| {
        let mut grid = grid_with_landmarks(100, 1);
        alter(&mut grid);
        refused(grid.generate())
    };
    let surface = |alter: &dyn Fn(&mut Surface)| {
        let mut torus = Surface::torus(100, 1);
        alter(&mut torus);
        refused(torus.generate())
    };
    let sight = |alter: &dyn Fn(&mut Landmarks)| {
        let mut landmarks = Landmarks::default();
        alter(&mut landmarks);
        grid(&|grid| grid.landmarks = Some(landmarks.clone()))
    };
    for poses in [0, 1] {
        let expected = format!("{:?}", WorldError::TooFewPoses { poses });
        assert_eq!(refused(Grid::manhattan(poses, 1).generate()), expected);
        assert_eq!(refused(Grid::city(poses, 1).generate()), expected);
        assert_eq!(refused(Surface::sphere(poses, 1).generate()), expected);
        assert_eq!(refused(Surface::torus(poses, 1).generate()), expected);
    }
    let too_small = |parameter, value: f64, least: f64| {
        format!("{:?}", WorldError::TooSmall { parameter, value, least })
    };
    assert_eq!(grid(&|grid| grid.block = 0), too_small("block", 0.0, 1.0));
    assert_eq!(grid(&|grid| grid.blocks = 0), too_small("blocks", 0.0, 1.0));
    assert_eq!(surface(&|torus| torus.ring = 2), too_small("ring", 2.0, 3.0));
    assert_eq!(
        surface(&|torus| torus.shape = Shape::Torus { major: 1.0, minor: 2.0 }),
        too_small("shape.major", 1.0, 2.0)
    );
    assert_eq!(sight(&|field| field.density = -1.0), too_small("landmarks.density", -1.0, 0.0));
    let not_positive =
        |parameter, value: f64| format!("{:?}", WorldError::NotPositive { parameter, value });
    assert_eq!(
        grid(&|grid| grid.closures.radius = f64::INFINITY),
        not_positive("closures.radius", f64::INFINITY)
    );
    assert_eq!(grid(&|grid| grid.closures.turn = 0.0), not_positive("closures.turn", 0.0));
    assert_eq!(sight(&|field| field.range = 0.0), not_positive("landmarks.range", 0.0));
    assert_eq!(
        surface(&|torus| torus.shape = Shape::Sphere { radius: -1.0 }),
        not_positive("shape.radius", -1.0)
    );
    let no_probability =
        |parameter, value: f64| format!("{:?}", WorldError::NotAProbability { parameter, value });
    assert_eq!(grid(&|grid| grid.turn = 1.5), no_probability("turn", 1.5));
    assert_eq!(
        surface(&|torus| torus.closures.probability = -0.1),
        no_probability("closures.probability", -0.1)
    );
    assert_eq!(
        sight(&|field| field.probability = 2.0),
        no_probability("landmarks.probability", 2.0)
    );
    for value in [0.0, -1.0, f64::INFINITY, f64::NAN, 1e-200, 1e200] {
        let bad = |parameter, component| {
            format!("{:?}", WorldError::BadSigma { parameter, component, value })
        };
        assert_eq!(grid(&|grid| grid.odometry[1] = value), bad("odometry", 1));
        assert_eq!(surface(&|torus| torus.odometry[5] = value), bad("odometry", 5));
        assert_eq!(grid(&|grid| grid.closures.sigmas[2] = value), bad("closures.sigmas", 2));
        assert_eq!(sight(&|field| field.sigmas[0] = value), bad("landmarks.sigmas", 0));
    }
    assert_eq!(grid(&|grid| grid.turn = f64::NAN), no_probability("turn", f64::NAN));
    assert_eq!(
        grid(&|grid| grid.closures.radius = f64::NAN),
        not_positive("closures.radius", f64::NAN)
    );
    let crowded = WorldError::TooManyLandmarks { count: 1e12 * 32.0 * 32.0, limit: u32::MAX - 100 };
    let landmarks = Landmarks::default().with_density(1e12);
    let error = grid(&|grid| {
        (grid.block, grid.blocks) = (4, 4);
        grid.landmarks = Some(landmarks.clone());
    });
    assert_eq!(error, format!("{crowded:?}"));
    let error = surface(&|torus| torus.shape = Shape::Sphere { radius: f64::MAX });
    assert!(error.starts_with("Unwritable"), "{error}");
}

/// The fastest of three runs, to keep other work on the machine out.
fn fastest(generate: impl Fn()) -> Duration {
    let timed = |_| {
        let start = Instant::now();
        generate();
        start.elapsed()
    };
    (0..3).map(timed).min().expect("three runs")
}

/// Eight times the poses in less than 24 times the time; quadratic growth would be 64.
#[test]
fn time_is_linear_even_where_everyone_meets() {
    let growth = |poses: u32, make: &dyn Fn(u32)| {
        let small = fastest(|| make(poses));
        let large = fastest(|| make(8 * poses));
        large.as_secs_f64() / small.as_secs_f64()
    };
    let city = growth(10_000, &|poses| drop(Grid::city(poses, 1).generate().expect("valid")));
    assert!(city < 24.0, "city: {city}");
    // One block of one meter: nine places.
    let crowd = growth(2_000, &|poses| {
        let mut crowd = Grid::manhattan(poses, 1).with_block(1).with_blocks(1);
        crowd.landmarks = Some(Landmarks::default().with_density(100.0));
        drop(crowd.generate().expect("valid"));
    });
    assert!(crowd < 24.0, "crowd: {crowd}");
    let sphere =
        growth(10_000, &|poses| drop(Surface::sphere(poses, 1).generate().expect("valid")));
    assert!(sphere < 24.0, "sphere: {sphere}");
}
