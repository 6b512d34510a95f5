//! PyFactorGraph's files: times, names, covariances, ranges of whatever the names say.

mod common;

use common::lines::{PYFG2, PYFG3};
use evergraph_formats::{
    Dialect, Document, FormatError, Kind, Quantity, ReadOptions, Record, WeightKind,
};

fn parse(text: &str) -> Document {
    Document::parse("text", text.as_bytes(), &ReadOptions::default())
        .unwrap_or_else(|error| panic!("{error}"))
}

fn error(text: &str) -> FormatError {
    Document::parse("text", text.as_bytes(), &ReadOptions::default())
        .expect_err("something is wrong")
}

fn written(document: &Document, dialect: Dialect) -> String {
    let mut text = Vec::new();
    document.write(&mut text, dialect).unwrap_or_else(|error| panic!("{error}"));
    String::from_utf8(text).expect("text is UTF-8")
}

fn symbol(letter: char, index: u64) -> u64 {
    u64::from(letter as u32) << 56 | index
}

/// The ends of the last line, a range.
fn range_of(text: &str) -> Vec<(u64, Kind)> {
    match parse(text).records().last() {
        Some(Record::Measurement(m)) if m.quantity == Quantity::Range => m.ends.to_vec(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_dialect_is_told_by_names() {
    for line in PYFG2.lines().chain(PYFG3.lines()).filter(|line| line.starts_with("VERTEX")) {
        assert_eq!(parse(line).dialect(), Dialect::Pyfg, "{line}");
    }
    for line in ["VERTEX_SE2 0 1 2 3", "VERTEX_XY 0 1 2", "VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1"] {
        assert_eq!(parse(line).dialect(), Dialect::G2o, "{line}");
    }
    // It stays what it is.
    let text = "VERTEX_SE2 1 A0 1 2 3\nVERTEX_SE2 0 1 2 3\n";
    assert!(matches!(error(text), FormatError::NotAName { .. }), "{}", error(text));
    let text = "VERTEX_SE2 0 1 2 3\nVERTEX_SE2 1 A0 1 2 3\n";
    assert!(matches!(error(text), FormatError::NotANumber { .. }), "{}", error(text));
}

#[test]
fn documents_say_what_the_file_says() {
    let document = parse(PYFG2);
    assert!(document.vertices_are_truth());
    assert!(!parse("VERTEX_SE2 0 1 2 3").vertices_are_truth());
    let summary = document.summary();
    assert_eq!((summary.poses, summary.landmarks, summary.measurements), (3, 2, 6));
    assert_eq!(document.kind(symbol('A', 1)), Some(Kind::Pose2));
    assert_eq!(document.kind(symbol('L', 0)), Some(Kind::Point2));
    let times: Vec<Option<f64>> = document.lines().iter().map(|line| line.time()).collect();
    assert_eq!(times[..5].iter().filter(|time| time.is_none()).count(), 1);
    assert_eq!(times[0], Some(1_248_362_857.7));
    match &document.lines()[7].record {
        Record::Edge { weight, .. } => assert_eq!(weight.kind, WeightKind::Covariance),
        other => panic!("{other:?}"),
    }
}

#[test]
fn ranges_are_between_what_lines_or_names_say() {
    let (a0, a1, l0) = (symbol('A', 0), symbol('A', 1), symbol('L', 0));
    let odometry2 = "EDGE_SE2 1 A0 A1 1 0 0 1 0 0 1 0 1\n";
    let odometry3 =
        "EDGE_SE3:QUAT 1 A0 A1 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";
    let range = "EDGE_RANGE 1 A0 L0 3 0.1\n";
    assert_eq!(range_of(&format!("{odometry2}{range}")), [(a0, Kind::Pose2), (l0, Kind::Point2)]);
    assert_eq!(range_of(&format!("{odometry3}{range}")), [(a0, Kind::Pose3), (l0, Kind::Point3)]);
    // The vertices come first, whatever the names say, and may stand after the range.
    let text = "EDGE_RANGE 1 L0 A1 3 0.1\nVERTEX_SE2 1 L0 0 0 0\nVERTEX_XY A1 1 1\n";
    let document = parse(text);
    let kinds: Vec<_> = document.lines()[0].record.ends().to_vec();
    assert_eq!(kinds, [(l0, Kind::Pose2), (a1, Kind::Point2)]);
    // Nothing says whether this is in the plane.
    assert!(matches!(error(range), FormatError::BadMeasurement { .. }), "{}", error(range));
    let text = "VERTEX_SE2 1 A0 0 0 0\nVERTEX_XYZ L0 0 0 0\nEDGE_RANGE 1 A0 L0 3 0.1\n";
    let message = error(text).to_string();
    assert!(message.contains("2D pose") && message.contains("3D landmark"), "{message}");
    let text = "VERTEX_SE2 1 A0 0 0 0\nEDGE_RANGE 1 A0 L0 3 0.1\n";
    assert!(matches!(error(text), FormatError::MissingVertex { .. }), "{}", error(text));
}

#[test]
fn what_is_wrong_is_named() {
    let good = "VERTEX_SE2 1 A0 0 0 0\nVERTEX_XY L0 1 1\n";
    for (line, word) in [
        ("EDGE_RANGE 1 A0 L0 -3 0.1", "range"),
        ("EDGE_RANGE 1 A0 L0 3 0", "covariance"),
        ("EDGE_RANGE 1 A0 L0 3 -0.1", "covariance"),
        ("EDGE_RANGE 1 A0 A0 3 0.1", "itself"),
        ("EDGE_RANGE 1 A0 L 3 0.1", "name"),
        ("EDGE_RANGE 1 A0 L007 3 0.1", "name"),
        ("EDGE_RANGE 1 A0 5 3 0.1", "name"),
        ("EDGE_RANGE x A0 L0 3 0.1", "field 1 (time)"),
        ("EDGE_RANGE nan A0 L0 3 0.1", "finite"),
        ("EDGE_RANGE 1 A0 L0 3", "4 fields"),
        ("VERTEX_SE2 2 A0 0 0 0", "before"),
        ("VERTEX_XY 2 L1 0 0 0", "3 or 4"),
        ("VERTEX_XY L1 0 x", "field 3 (y)"),
        ("VERTEX_XY 7 L1 0 x", "field 4 (y)"),
        ("VERTEX_SE2:PRIOR 2 A0 0 0 0 1 0 0 1 0 0", "covariance"),
        ("VERTEX_XY:PRIOR 2 A0 0 0 1 0 1", "2D landmark"),
        ("VERTEX_XY:PRIOR L0 0 0 1 0 1", "field 1 (time)"),
        ("FIX A0", "another dialect"),
        ("ROBUST huber 1 EDGE_RANGE 1 A0 L0 3 0.1", "kernel"),
    ] {
        let error = error(&format!("{good}{line}\n"));
        let message = error.to_string();
        assert!(message.starts_with("text:3: "), "{line}: {message}");
        assert!(message.contains(word), "{line}: {message}");
    }
}

#[test]
fn g2o_gets_the_same_graph() {
    let document = parse(PYFG2);
    let mut text = Vec::new();
    let summary = document.write(&mut text, Dialect::G2o).unwrap();
    assert_eq!(summary.dropped_times, document.lines().len() - 1);
    let text = String::from_utf8(text).unwrap();
    let (a1, l0) = (symbol('A', 1), symbol('L', 0));
    assert!(text.contains(&format!("\nFACTOR_RANGE_SE2_XY {a1} {l0} 3.5 11.11")), "{text}");
    assert!(text.contains("0.25 0 0 100 0 0 100 0 400\n"), "{text}");
    let again = parse(&text);
    assert_eq!(again.summary().measurements, document.summary().measurements);
    // And back: names are the same, times are made up.
    let mut back = Vec::new();
    let summary = again.write(&mut back, Dialect::Pyfg).unwrap();
    assert_eq!((summary.named, summary.added_times), (0, document.lines().len() - 2));
    let back = String::from_utf8(back).unwrap();
    assert!(back.starts_with("VERTEX_SE2 0 A0 1.25 3.5 -1.5\nVERTEX_SE2 1 A1 "), "{back}");
    // Only the range that named the landmark first names the pose first now.
    let mut ends = parse(&back).records().map(|r| r.ends().to_vec()).collect::<Vec<_>>();
    ends[11].reverse();
    assert!(ends.into_iter().eq(document.records().map(|r| r.ends().to_vec())));
}

#[test]
fn numbers_become_names() {
    let text = "VERTEX_SE2 3 0 0 0\nVERTEX_SE2 7 1 0 0\nVERTEX_XY 9 1 1\n\
                EDGE_SE2 3 7 1 0 0 4 0 0 4 0 16\nFACTOR_RANGE_SE2_XY 3 9 1.5 4\n";
    let mut out = Vec::new();
    let summary = parse(text).write(&mut out, Dialect::Pyfg).unwrap();
    assert_eq!((summary.named, summary.added_times), (3, 4));
    assert_eq!(
        String::from_utf8(out).unwrap(),
        "VERTEX_SE2 0 A3 0 0 0\nVERTEX_SE2 1 A7 1 0 0\nVERTEX_XY L9 1 1\n\
         EDGE_SE2 1 A3 A7 1 0 0 0.25 0 0 0.25 0 0.0625\nEDGE_RANGE 0 A3 L9 1.5 0.25\n"
    );
    let clash = format!("VERTEX_SE2 5 0 0 0\nVERTEX_SE2 {} 0 0 0\n", symbol('A', 5));
    let write = |text: &str| parse(text).write(&mut Vec::new(), Dialect::Pyfg).unwrap_err();
    assert!(matches!(write(&clash), FormatError::NameTaken { .. }), "{}", write(&clash));
    let nameless = format!("VERTEX_SE2 {} 0 0 0\n", u64::MAX);
    assert!(matches!(write(&nameless), FormatError::NoName { .. }), "{}", write(&nameless));
    let singular = "EDGE_SE2 0 1 1 0 0 1 1 0 1 0 0\n";
    assert!(write(singular).to_string().contains("covariance"), "{}", write(singular));
    for line in
        ["FIX 5", "FACTOR_HEADING_SE2 5 1 1", "ROBUST huber 1 EDGE_PRIOR_SE2 5 0 0 0 1 0 0 1 0 1"]
    {
        let error = write(&format!("VERTEX_SE2 5 0 0 0\n{line}\n"));
        assert!(matches!(error, FormatError::Unsupported { .. }), "{error}");
    }
    // A landmark whose name is a pose's needs its VERTEX line.
    let text = format!("FACTOR_RANGE_SE2_XY 3 {} 1.5 4\n", symbol('B', 1));
    assert!(write(&text).to_string().contains("VERTEX"), "{}", write(&text));
}

#[test]
fn priors_of_sensors_become_priors_of_robots() {
    // A sensor a metre ahead that looks to the left. It is at (5, 0, 0), turned like the world: the
    // robot looks to the right, and is a metre to the left of the sensor.
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let text = format!(
        "PARAMS_SE3OFFSET 0 1 0 0 0 0 {h} {h}\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n\
         EDGE_SE3_PRIOR 0 0 5 0 0 0 0 0 1 4 0 0 0 0 0 9 0 0 0 0 16 0 0 0 25 0 0 36 0 49\n"
    );
    let pyfg = written(&parse(&text), Dialect::Pyfg);
    let numbers: Vec<f64> =
        pyfg.lines().nth(1).unwrap().split(' ').skip(3).map(|w| w.parse().unwrap()).collect();
    let expected = [5.0, 1.0, 0.0, 0.0, 0.0, -h, h];
    assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{pyfg}");
    // In the sensor's axes the robot's x axis is -y, and so on; what is not known of the yaw is not
    // known of the robot's y either.
    let (xx, yy, ww, yw) = (numbers[7], numbers[13], numbers[27], numbers[17]);
    assert!((xx - 1.0 / 9.0).abs() < 1e-12, "{pyfg}");
    assert!((yy - (1.0 / 4.0 + 1.0 / 49.0)).abs() < 1e-12, "{pyfg}");
    assert!((ww - 1.0 / 49.0).abs() < 1e-12 && (yw.abs() - 1.0 / 49.0).abs() < 1e-12, "{pyfg}");
}

#[test]
fn added_times_are_ranks_of_poses_also_where_a_landmark_has_the_id_of_one() {
    let document = parse(
        "ODOMETRY 0 1 1 0 0 10 0 0 10 0 20\nODOMETRY 1 2 1 0 0 10 0 0 10 0 20\n\
         LANDMARK 0 2 1 1 10 0 10\n",
    );
    let text = written(&document, Dialect::Pyfg);
    let sighting = text.lines().find(|line| line.starts_with("EDGE_SE2_XY")).expect("a sighting");
    assert!(sighting.starts_with("EDGE_SE2_XY 0 A0 L2 "), "{sighting}");
}
