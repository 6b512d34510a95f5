//! TUM and KITTI files: what they say comes back, and what they cannot say is refused.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use TrajectoryFormat::{Kitti, Tum};
use evergraph_formats::{
    Coordinates, Dialect, Document, FormatError, Line, ReadOptions, Record, Stamps, Trajectory,
    TrajectoryError, TrajectoryFormat,
};
use evergraph_model::{LieGroup, Manifold, Point3, Pose2, Pose3, Value};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn parse(text: &str, format: TrajectoryFormat) -> Result<Trajectory, TrajectoryError> {
    Trajectory::parse("f.txt", text.as_bytes(), format)
}

fn written(trajectory: &Trajectory, format: TrajectoryFormat) -> String {
    let mut bytes = Vec::new();
    trajectory.write(&mut bytes, format).unwrap();
    String::from_utf8(bytes).unwrap()
}

fn random_poses(seed: u64) -> Vec<(u64, Value)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut pose = |size: f64| {
        let tangent: [f64; 6] =
            std::array::from_fn(|k| rng.random_range(-1.0..1.0) * if k < 3 { size } else { 1.8 });
        Pose3::exp(&tangent.into())
    };
    [1e-9, 1.0, 1e3, 1e7]
        .into_iter()
        .cycle()
        .zip(0..200)
        .map(|(s, id)| (id, Value::new(&pose(s))))
        .collect()
}

fn storage(pose: &Pose3) -> Vec<u64> {
    let mut numbers = [0.0; 7];
    pose.store(&mut numbers);
    numbers.iter().map(|x| x.to_bits()).collect()
}

#[test]
fn tum_keeps_every_bit() {
    let first = Trajectory::of_estimates("poses", random_poses(1)).unwrap();
    let text = written(&first, Tum);
    let again = parse(&text, Tum).unwrap();
    assert_eq!(written(&again, Tum), text);
    assert_eq!(again.len(), 200);
    for (k, (a, b)) in first.poses().iter().zip(again.poses()).enumerate() {
        assert_eq!(storage(a), storage(b));
        assert_eq!(again.time_or_id(k), k as f64);
    }
}

#[test]
fn kitti_keeps_its_numbers_and_the_poses_to_rounding() {
    let first = Trajectory::of_estimates("poses", random_poses(2)).unwrap();
    let text = written(&first, Kitti);
    let again = parse(&text, Kitti).unwrap();
    assert_eq!(written(&again, Kitti), text);
    assert_eq!(again.ids().unwrap(), (0..200).collect::<Vec<u64>>());
    for (a, b) in first.poses().iter().zip(again.poses()) {
        assert_eq!(a.translation(), b.translation());
        assert!(a.rotation().between(&b.rotation()).log().norm() < 1e-15 * 10.0);
    }
}

#[test]
fn poses_of_the_plane_stay_there() {
    let poses = [0.0, 1.0, -3.0].map(|theta| Value::new(&Pose2::new(theta, 2.0, theta)));
    let first = Trajectory::of_estimates("poses", (7..).zip(poses)).unwrap();
    assert!(first.is_planar());
    for format in [Tum, Kitti] {
        assert!(parse(&written(&first, format), format).unwrap().is_planar(), "{format:?}");
    }
    assert!(!parse("0 0 0 0.1 0 0 0 1", Tum).unwrap().is_planar());
    assert!(!parse("0 0 0 0 0 1e-9 0 1", Tum).unwrap().is_planar());
}

#[test]
fn what_printing_rounded_away_is_restored() {
    let tum = parse("\u{feff}# t x y z q\n\n1\t0 0 0 0.71 0 0 0.71\r\n", Tum).unwrap();
    let half = 0.5_f64.sqrt();
    assert!((tum.poses()[0].rotation().quaternion()[0] - half).abs() < 1e-15);
    // A turn of 30 degrees in three digits, and of single precision in nine.
    for text in [
        "0.866 -0.500 0.000 1 0.500 0.866 0.000 2 0.000 0.000 1.000 3",
        "0.866025388 -0.5 0 1 0.5 0.866025388 0 2 0 0 1 3",
    ] {
        let pose = parse(text, Kitti).unwrap().poses()[0];
        let angle = pose.rotation().log();
        assert!((angle.z - 30_f64.to_radians()).abs() < 1e-3 && angle.xy().norm() == 0.0);
        assert_eq!(pose.translation(), Point3::new(1.0, 2.0, 3.0));
        assert!((pose.rotation().matrix().determinant() - 1.0).abs() < 1e-14);
    }
}

/// The last line of `text` is this error, which names it.
macro_rules! broken {
    ($name:ident, $format:expr, $text:expr, $error:pat, $($word:literal),*) => {
        #[test]
        fn $name() {
            let error = parse($text, $format).unwrap_err();
            assert!(matches!(error, $error), "{error:?}");
            let message = error.to_string();
            let line = $text.lines().count();
            assert!(message.starts_with(&format!("f.txt:{line}: ")), "{message}");
            assert_eq!(error.place().unwrap().line, line);
            $(assert!(message.contains($word), "`{}` is not in: {message}", $word);)*
        }
    };
}

broken!(
    short,
    Tum,
    "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0",
    TrajectoryError::FieldCount { .. },
    "7 fields, not 8",
    "timestamp tx"
);
broken!(long, Tum, "1 0 0 0 0 0 0 1 9", TrajectoryError::FieldCount { .. }, "9 fields");
broken!(kitti_as_tum, Tum, "1 0 0 0 0 1 0 0 0 0 1 0", TrajectoryError::FieldCount { .. }, "12");
broken!(
    word,
    Tum,
    "# c\n1 0 x0 0 0 0 0 1",
    TrajectoryError::Format(FormatError::NotANumber { .. }),
    "field 3 (ty) of TUM",
    "`x0`"
);
broken!(
    comma,
    Tum,
    "1,0 0 0 0 0 0 0 1",
    TrajectoryError::Format(FormatError::NotANumber { .. }),
    "field 1 (timestamp)"
);
broken!(
    nan,
    Tum,
    "1 0 0 0 0 0 0 nan",
    TrajectoryError::Format(FormatError::NotFinite { .. }),
    "field 8 (qw)"
);
broken!(
    huge,
    Kitti,
    "1 0 0 1e999 0 1 0 0 0 0 1 0",
    TrajectoryError::Format(FormatError::NotFinite { .. }),
    "field 4 (tx) of KITTI"
);
broken!(zero_quaternion, Tum, "1 0 0 0 0 0 0 0", TrajectoryError::NotUnit { .. }, "is 0, not 1");
broken!(
    euler_angles,
    Tum,
    "1 0 0 0 0.1 0.2 -3.0 0",
    TrajectoryError::NotUnit { .. },
    "qx qy qz qw"
);
broken!(
    backwards,
    Tum,
    "1 0 0 0 0 0 0 1\n0.5 0 0 0 0 0 0 1",
    TrajectoryError::NotAscending { .. },
    "0.5",
    "after 1"
);
broken!(
    standstill,
    Tum,
    "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1",
    TrajectoryError::NotAscending { .. },
    "after 1"
);
broken!(
    reflection,
    Kitti,
    "1 0 0 0 0 1 0 0 0 0 -1 0",
    TrajectoryError::NotARotation { .. },
    "determinant is -1"
);
broken!(
    scaled,
    Kitti,
    "1.001 0 0 0 0 1.001 0 0 0 0 1.001 0",
    TrajectoryError::NotARotation { .. },
    "2.001e-3"
);
broken!(
    sheared,
    Kitti,
    "1 0.01 0 0 0 1 0 0 0 0 1 0",
    TrajectoryError::NotARotation { .. },
    "1.000e-2"
);
broken!(columns, Kitti, "0 0 0 0 0 0 0 0 0 0 0 0", TrajectoryError::NotARotation { .. }, "r11 r12");
broken!(
    binary,
    Tum,
    "1 0 0 0 0 0 0 1\n1 0\0 0 0 0 0 0 1",
    TrajectoryError::Format(FormatError::NotText { .. }),
    "not text"
);

#[test]
fn nothing_is_no_trajectory() {
    for text in ["", "\n# only a comment\n"] {
        assert!(matches!(parse(text, Tum), Err(TrajectoryError::NoPose { .. })));
    }
    let long = format!("1 0 0 0 0 0 0 {}1", "0".repeat(20_000));
    let error = parse(&long, Tum).unwrap_err();
    assert!(matches!(error, TrajectoryError::Format(FormatError::LineTooLong { .. })), "{error:?}");
    let missing = Trajectory::read("/no/such/file.tum", Tum).unwrap_err();
    assert!(missing.to_string().contains("/no/such/file.tum: cannot be read"), "{missing}");
}

#[test]
fn no_bytes_panic() {
    let good = "1.5 0.25 -3e2 4 0.5 0.5 0.5 0.5\n2.5 1 2 3 0 0 0 1\n";
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut refused = 0;
    for _ in 0..3000 {
        let mut bytes = good.as_bytes().to_vec();
        for _ in 0..rng.random_range(1..4) {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = rng.random_range(0..=255);
        }
        for format in [Tum, Kitti] {
            refused += usize::from(Trajectory::parse("f", bytes.as_slice(), format).is_err());
        }
    }
    assert!(refused > 3000, "{refused}");
}

#[test]
fn estimates_have_to_make_a_trajectory() {
    let pose = |x: f64| Value::new(&Pose2::new(x, 0.0, 0.0));
    let of = |values: Vec<(u64, Value)>| Trajectory::of_estimates("m", values);
    let landmark = Value::new(&Point3::new(0.0, 0.0, 0.0));
    let mixed = of(vec![(9, pose(9.0)), (4, landmark.clone()), (3, pose(3.0))]).unwrap();
    assert_eq!((mixed.ids(), mixed.poses()[0].x()), (Some(&[3, 9][..]), 3.0));
    assert!(matches!(of(vec![(4, landmark)]), Err(TrajectoryError::NoPose { .. })));
    let twice = of(vec![(4, pose(0.0)), (4, pose(1.0))]);
    assert!(matches!(twice, Err(TrajectoryError::DuplicatePose { id: 4, .. })));
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(matches!(of(vec![(4, pose(bad))]), Err(TrajectoryError::BadPose { id: 4, .. })));
        let turned = Value::new(&Pose2::new(0.0, 0.0, bad));
        assert!(matches!(of(vec![(5, turned)]), Err(TrajectoryError::BadPose { id: 5, .. })));
    }
}

fn stamps(text: &str) -> Result<Stamps, TrajectoryError> {
    Stamps::parse("times.csv", text.as_bytes())
}

#[test]
fn times_by_id_put_poses_in_order() {
    let poses = Trajectory::of_estimates("m", random_poses(4).into_iter().take(3)).unwrap();
    let timed = poses.with_stamps(&stamps("id,timestamp\n0,5\n\n# c\n1, 4.5\n2,7\n8,1\n").unwrap());
    let timed = timed.unwrap();
    assert_eq!((timed.ids(), timed.times()), (Some(&[1, 0, 2][..]), Some(&[4.5, 5.0, 7.0][..])));
    assert_eq!(timed.poses()[0], poses.poses()[1]);
    let kitti = parse(&written(&poses, Kitti), Kitti).unwrap();
    let again = kitti.with_stamps(&stamps("0,5\n1,4.5\n2,7").unwrap()).unwrap();
    assert_eq!(written(&again, Kitti), written(&timed, Kitti));

    let missing = poses.with_stamps(&stamps("0,1\n1,2\n").unwrap()).unwrap_err();
    assert_eq!(
        missing.to_string(),
        "m: pose 2 has no time in times.csv; give every pose one, or none"
    );
    let tum = parse("0 0 0 0 0 0 0 1", Tum).unwrap();
    assert!(matches!(tum.with_stamps(&stamps("0,1").unwrap()), Err(TrajectoryError::NoIds { .. })));
    let equal = poses.with_stamps(&stamps("0,1\n1,2\n2,2\n").unwrap()).unwrap();
    let error = equal.write(&mut Vec::new(), Tum).unwrap_err();
    assert!(error.to_string().contains("poses 1 and 2 have the same time 2"), "{error}");
}

#[test]
fn times_are_read_strictly() {
    let cases = [
        ("id,timestamp\n0", "times.csv:2: the line has 1 fields, not 2"),
        ("0,1,2", "times.csv:1: the line has 3 fields"),
        ("0,1\nid,timestamp", "times.csv:2: field 1 (id) of the line is `id`, which is not an id"),
        ("-1,1", "times.csv:1: field 1 (id) of the line is `-1`"),
        ("0,x", "times.csv:1: field 2 (timestamp) of the line is `x`, which is not a number"),
        ("0,inf", "times.csv:1: field 2 (timestamp) of the line is `inf`, which is not finite"),
        ("0,1\n0,2", "times.csv:2: the time of pose 0 was given before, in line 1"),
    ];
    for (text, start) in cases {
        let message = stamps(text).unwrap_err().to_string();
        assert!(message.starts_with(start), "{message}");
    }
}

#[test]
fn a_document_gives_its_vertices_and_their_times() {
    let text =
        "VERTEX_SE2 5 1 2 4.5\nVERTEX_SE2 2 0 0 0\nVERTEX_XY 3 8 8\nEDGE_SE2_XY 2 3 1 1 1 0 1\n";
    let document = Document::parse("g", text.as_bytes(), &ReadOptions::default()).unwrap();
    let trajectory = Trajectory::of_document(&document).unwrap();
    assert_eq!((trajectory.ids(), trajectory.times()), (Some(&[2, 5][..]), None));
    let yaw = trajectory.poses()[1].rotation().roll_pitch_yaw()[2];
    assert!((yaw - (4.5 - std::f64::consts::TAU)).abs() < 1e-15);

    let line = |id, time| {
        let at = Coordinates::Pose2([id as f64, 0.0, 0.0]);
        let mut line = Line::from(Record::Vertex { id, at });
        line.set_time(time);
        line
    };
    let of = |times: [Option<f64>; 2]| {
        let lines = (0..).zip(times).map(|(id, time)| line(id, time));
        Trajectory::of_document(&Document::from_records("g", Dialect::G2o, lines).unwrap())
    };
    let timed = of([Some(2.0), Some(1.0)]).unwrap();
    assert_eq!((timed.ids(), timed.times()), (Some(&[1, 0][..]), Some(&[1.0, 2.0][..])));
    assert!(matches!(of([Some(2.0), None]), Err(TrajectoryError::NoTime { id: 1, .. })));
}

#[test]
fn content_tells_trajectories_from_graphs() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    let of = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        TrajectoryFormat::of_content(path).unwrap()
    };
    assert_eq!(of("a.txt", "# c\n\n  1 0 0 0 0 0 0 1\n"), Some(Tum));
    assert_eq!(of("b.txt", "\u{feff}-1e0 0 0 0 0 1 0 0 0 0 1 0\n"), Some(Kitti));
    assert_eq!(of("c.txt", ".5 0 0\n"), Some(Tum));
    assert_eq!(of("d.txt", "EDGE2 0 1 1 0 0 1 0 0 1 0 1\n"), None);
    assert_eq!(of("e.txt", "# c\n"), None);
}
