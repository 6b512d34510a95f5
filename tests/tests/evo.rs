//! Our trajectory errors are evo's: `evo_error.txt` holds what `tests/scripts/evo_error.py` printed
//! with evo 1.38.1 for the files that this test writes to the folder `evo` of cargo's scratch folder
//! (`target/tmp`).
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write;
use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use evergraph::evaluate::{
    AbsoluteError, Alignment, Association, Map, PosePairs, RelativeError, RelativePairs, Start,
    Statistics,
};
use evergraph::formats::{ReadOptions, Stamps, Trajectory, TrajectoryFormat};
use evergraph::model::Rot3;
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::{BatchSettings, Status};
use evergraph::{Replayer, Settings};
use evergraph_tests::{data_dir, data_file, read};

/// What is compared, in the order of the script: of the absolute error as it is, with SE(3) and with
/// Sim(3) alignment rmse, mean, median, standard deviation, smallest, largest and sum of squares, the
/// same of the aligned rotation angle, then rmse of translation and rotation of the relative error
/// from pose to pose, and over 10 poses, consecutive and of all pairs.
fn ours(pairs: &PosePairs) -> Vec<f64> {
    let all = |s: &Statistics| [s.rmse, s.mean, s.median, s.std, s.min, s.max, s.sse];
    let mut values = vec![pairs.pairs().len() as f64];
    for alignment in [Alignment::None, Alignment::Rigid, Alignment::Similarity] {
        let aligned = pairs.align(alignment).unwrap();
        assert_eq!(aligned.ambiguity, None);
        let error = AbsoluteError::of(pairs, &aligned.similarity).unwrap();
        values.extend(all(&error.translation));
        if alignment == Alignment::Rigid {
            values.extend(all(&error.rotation));
        }
    }
    for (delta, all) in [(1, false), (10, false), (10, true)] {
        let delta = NonZeroUsize::new(delta).unwrap();
        let error =
            RelativeError::of(pairs, RelativePairs::default().with_delta(delta).with_all(all))
                .unwrap();
        values.extend([error.translation.rmse, error.rotation.rmse]);
    }
    values
}

/// The values that evo gave.
fn evos(name: &str) -> Vec<f64> {
    let lines = include_str!("evo_error.txt").lines();
    let line = lines.filter_map(|line| line.split_once(' ')).find(|line| line.0 == name);
    let (_, numbers) = line.unwrap_or_else(|| panic!("evo_error.txt has no {name}"));
    numbers.split(' ').map(|x| x.parse().unwrap()).collect()
}

/// Compares with evo's values, to `tolerance` relative, and leaves files for the script.
fn check(name: &str, estimate: &Trajectory, truth: &Trajectory, tolerance: f64) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("evo");
    fs::create_dir_all(&folder).unwrap();
    let by = Association::of(estimate, truth);
    let values = ours(&PosePairs::new(estimate, truth, by).unwrap());
    let file = |end: &str| folder.join(format!("{name}.{end}"));
    estimate.save(file("estimate.tum")).unwrap();
    truth.save(file("truth.tum")).unwrap();
    if by == Association::Id {
        estimate.save(file("estimate.kitti")).unwrap();
        truth.save(file("truth.kitti")).unwrap();
        // Written without times, a pose's time is its id: the files say the same by time.
        let read = |end| Trajectory::read(file(end), TrajectoryFormat::Tum).unwrap();
        let (estimate, truth) = (read("estimate.tum"), read("truth.tum"));
        let again = PosePairs::new(&estimate, &truth, Association::of(&estimate, &truth)).unwrap();
        assert_eq!(ours(&again), values, "{name}");
    }
    let text = values.iter().fold(String::new(), |mut text, x| {
        writeln!(text, "{x:?}").unwrap();
        text
    });
    fs::write(file("ours.txt"), text).unwrap();
    let evo = evos(name);
    assert_eq!(values.len(), evo.len(), "{name}");
    for (k, (ours, evo)) in values.iter().zip(&evo).enumerate() {
        let close = (ours - evo).abs() <= tolerance * evo.abs() + 1e-12;
        assert!(close, "{name}, value {k}: {ours}, evo {evo}");
    }
}

/// How well two ways to an optimum agree: the smallest of 3500 rotation errors to 3e-6.
const OPTIMUM: f64 = 1e-5;

/// The map that odometry makes.
fn odometry(path: &Path) -> Trajectory {
    let start = Start::of(&read(path), Initial::FromOdometry).unwrap();
    Trajectory::of_estimates("odometry", start.values()).unwrap()
}

/// The best map of a file.
fn optimum(path: &Path) -> Trajectory {
    let document = read(path);
    let mut replayer =
        Replayer::new(&document, &ReplayOptions::default(), Settings::default()).unwrap();
    while replayer.step().unwrap().is_some() {}
    let report = replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
    assert_eq!(report.status, Status::Converged);
    Trajectory::of_document(&replayer.solution(&document).unwrap()).unwrap()
}

fn truth(path: PathBuf) -> Trajectory {
    Map::read(path, None, &ReadOptions::default()).unwrap().trajectory
}

#[test]
fn manhattan() {
    let Some(data) = data_dir("manhattan") else { return };
    let truth = truth(data.join("pose2d/manhattanOlson3500_groundtruth.txt"));
    let file = data.join("pose2d/manhattanOlson3500.txt");
    check("manhattan_odometry", &odometry(&file), &truth, 1e-9);
    check("manhattan_optimum", &optimum(&file), &truth, OPTIMUM);
}

#[test]
fn sphere() {
    let Some(data) = data_dir("sphere") else { return };
    let truth = truth(data.join("pose3d/sphere2500_groundtruth.txt"));
    let file = data.join("pose3d/sphere2500.txt");
    check("sphere_odometry", &odometry(&file), &truth, 1e-9);
    check("sphere_optimum", &optimum(&file), &truth, OPTIMUM);
}

/// Columns 5 to 7 of the ground truth are roll, pitch and yaw, whatever its first line says; and the
/// times of both files differ by some milliseconds.
#[test]
fn nclt() {
    let Some(data) = data_dir("nclt") else { return };
    let file = data.join("nclt/2012-01-08_gt_trajectory.txt");
    let refused = Trajectory::read(&file, TrajectoryFormat::Tum).unwrap_err().to_string();
    assert!(refused.contains("the length of the quaternion is"), "{refused}");

    let lines = fs::read_to_string(file).unwrap();
    let tum = lines.lines().filter(|line| !line.starts_with('#')).fold(
        String::new(),
        |mut text, line| {
            let words: Vec<&str> = line.split(' ').collect();
            let angle = |k: usize| words[k].parse::<f64>().unwrap();
            let rotation = Rot3::from_roll_pitch_yaw(angle(4), angle(5), angle(6));
            let [qx, qy, qz, qw] = rotation.quaternion();
            writeln!(text, "{} {qx} {qy} {qz} {qw}", words[..4].join(" ")).unwrap();
            text
        },
    );
    let truth = Trajectory::parse("ground truth", tum.as_bytes(), TrajectoryFormat::Tum).unwrap();
    let odometry = data.join("nclt/2012-01-08_odom_trajectory.txt");
    let odometry = Trajectory::read(odometry, TrajectoryFormat::Tum).unwrap();
    check("nclt", &odometry, &truth, 1e-9);
}

/// A graph whose times come from a file of their own, and a truth of other instants.
#[test]
fn bicocca() {
    let Some(graph) = data_file("bicocca", "pose2d/B25b_0.500.g2o") else { return };
    let folder = graph.parent().unwrap();
    let times = fs::read_to_string(folder.join("B25b_timestamps.txt")).unwrap();
    let csv =
        times.lines().enumerate().fold("id,timestamp\n".to_owned(), |mut text, (id, time)| {
            writeln!(text, "{id},{}", time.trim()).unwrap();
            text
        });
    let stamps = Stamps::parse("times", csv.as_bytes()).unwrap();
    let estimate = Map::of_document(&read(&graph)).unwrap().with_stamps(&stamps).unwrap();

    let truth = fs::read_to_string(folder.join("Bicocca_2009-02-25b-GT-extended.csv")).unwrap();
    let tum = truth.lines().fold(String::new(), |mut text, line| {
        let words: Vec<&str> = line.split(',').map(str::trim).collect();
        let half = 0.5 * words[3].parse::<f64>().unwrap();
        let (sin, cos) = half.sin_cos();
        writeln!(text, "{} {} {} 0 0 0 {sin} {cos}", words[0], words[1], words[2]).unwrap();
        text
    });
    let truth = Trajectory::parse("ground truth", tum.as_bytes(), TrajectoryFormat::Tum).unwrap();
    check("bicocca", &estimate.trajectory, &truth, 1e-9);
}
