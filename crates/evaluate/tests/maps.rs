//! Maps from files and worlds, and their landmarks.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;

use evergraph_evaluate::{
    AbsoluteError, Alignment, Association, EvaluateError, LandmarkError, Map, PosePairs, Similarity,
};
use evergraph_formats::{Dialect, Document, ReadOptions, TrajectoryFormat};
use evergraph_model::{LieGroup, Point2, Point3, Pose3, Value};
use evergraph_simulate::{Grid, Landmarks};

fn ate(estimate: &Map, truth: &Map) -> AbsoluteError {
    let (estimate, truth) = (&estimate.trajectory, &truth.trajectory);
    let pairs = PosePairs::new(estimate, truth, Association::of(estimate, truth)).unwrap();
    let aligned = pairs.align(Alignment::Rigid).unwrap();
    AbsoluteError::of(&pairs, &aligned.similarity).unwrap()
}

/// The same truth as vertices, as noise-free edges without vertices, as TUM and as KITTI.
#[test]
fn truth_has_many_forms() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let world = Grid::city(80, 5).generate().unwrap();
    let truth = Map::of_document(&world.truth).unwrap();
    let poses = truth.trajectory.poses();
    let edge = |from: usize, to: usize| {
        let z = poses[from].between(&poses[to]);
        let yaw = z.rotation().roll_pitch_yaw()[2];
        format!("EDGE2 {from} {to} {:.6} {:.6} {yaw:.6} 20 0 0 20 0 50\n", z.x(), z.y())
    };
    let odometry = (1..80).map(|k| edge(k - 1, k));
    let isam: String = odometry.chain((30..80).map(|k| edge(k, k - 30))).collect();
    fs::write(folder.join("truth.txt"), &isam).unwrap();
    truth.trajectory.save(folder.join("truth.tum")).unwrap();
    truth.trajectory.save(folder.join("truth.kitti")).unwrap();
    for name in ["truth.txt", "truth.tum", "truth.kitti"] {
        let read = Map::read(folder.join(name), None, &ReadOptions::default()).unwrap();
        let error = ate(&read, &truth);
        assert_eq!(error.poses.len(), 80, "{name}");
        assert!(error.translation.max < 1e-3 && error.rotation.max < 1e-4, "{name}: {error:?}");
    }
    let forced =
        Map::read(folder.join("truth.tum"), Some(TrajectoryFormat::Kitti), &ReadOptions::default());
    assert!(matches!(forced, Err(EvaluateError::Trajectory(_))));
}

#[test]
fn noisy_edges_are_no_truth() {
    let world = Grid::city(200, 5).generate().unwrap();
    let mut isam = Vec::new();
    world.document.write(&mut isam, Dialect::Isam).unwrap();
    let document = Document::parse("noisy.txt", isam.as_slice(), &ReadOptions::default()).unwrap();
    let error = Map::of_document(&document).unwrap_err();
    assert!(
        matches!(error, EvaluateError::Contradiction { sigmas, .. } if sigmas > 1.0),
        "{error}"
    );
    assert!(error.to_string().starts_with("noisy.txt: cannot serve as truth"));
}

#[test]
fn landmarks_are_measured_in_the_frame_of_the_poses() {
    let mut world = Grid::city(60, 5);
    world.landmarks = Some(Landmarks::default());
    let world = world.generate().unwrap();
    let truth = Map::of_document(&world.truth).unwrap();
    assert!(truth.landmarks.len() > 5);
    // The whole map, turned by a quarter and one landmark 2 m off, one unknown, one missing.
    let turn = Similarity {
        scale: 1.0,
        motion: Pose3::new(
            evergraph_model::Rot3::from_roll_pitch_yaw(0.0, 0.0, 1.5),
            Point3::new(3.0, 4.0, 0.0),
        ),
    };
    let pose = |(id, pose): (&u64, &Pose3)| (*id, Value::new(&turn.transform_pose(pose)));
    let ids = truth.trajectory.ids().unwrap();
    let mut values: Vec<(u64, Value)> =
        ids.iter().zip(truth.trajectory.poses()).map(pose).collect();
    let off = *truth.landmarks.keys().next().unwrap();
    let missing = *truth.landmarks.keys().last().unwrap();
    for (&id, point) in &truth.landmarks {
        let moved = turn.transform_point(point);
        let x = moved.x() + if id == off { 2.0 } else { 0.0 };
        if id != missing {
            values.push((id, Value::new(&Point2::new(x, moved.y()))));
        }
    }
    values.push((1 << 40, Value::new(&Point2::new(0.0, 0.0))));
    let estimate = Map::of_estimates("estimate", values).unwrap();
    let pairs = PosePairs::new(&estimate.trajectory, &truth.trajectory, Association::Id).unwrap();
    let aligned = pairs.align(Alignment::Rigid).unwrap().similarity;
    let error =
        LandmarkError::of(&estimate.landmarks, &truth.landmarks, &aligned).unwrap().unwrap();
    assert_eq!((error.unknown, error.missing), (1, 1));
    assert_eq!(error.distance.count, truth.landmarks.len() - 1);
    assert!((error.distance.max - 2.0).abs() < 1e-9 && error.distance.median < 1e-9);
    let nothing = LandmarkError::of(&estimate.landmarks, &Default::default(), &aligned).unwrap();
    assert_eq!(nothing, None);
}
