//! Each line of each dialect, and what it becomes in the others.

mod common;

use evergraph_formats::{
    Coordinates, Dialect, Document, EntryOrder, FormatError, G2oRotation, ReadOptions, Record,
    WeightKind, WriteOptions,
};
use evergraph_model::{Pose2, Value};

fn parse(text: &str) -> Document {
    Document::parse("text", text.as_bytes(), &ReadOptions::default())
        .unwrap_or_else(|error| panic!("{error}"))
}

fn written(document: &Document, dialect: Dialect) -> String {
    let mut text = Vec::new();
    document.write(&mut text, dialect).unwrap_or_else(|error| panic!("{error}"));
    String::from_utf8(text).expect("text is UTF-8")
}

const UPPER: &str = "1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 5 0 6";

#[test]
fn lines_of_equal_dialects_are_written_as_they_were() {
    for text in common::lines::ALL {
        let document = parse(text);
        assert_eq!(written(&document, document.dialect()), *text);
    }
}

#[test]
fn synonyms_are_one_line() {
    let lines = ["EDGE2", "ODOMETRY", "Constraint2"]
        .map(|tag| parse(&format!("{tag} 0 1 1 0 0 1 0 0 1 0 1\n")));
    assert!(
        lines.iter().all(|d| d.dialect() == Dialect::Isam && d.records().eq(lines[0].records()))
    );
}

#[test]
fn the_first_line_tells_edge2_of_toro_from_isam() {
    let edge = "EDGE2 0 1 1 0 0 1 2 5 3 0 0\n";
    let toro = parse(&format!("VERTEX2 0 0 0 0\nVERTEX2 1 0 0 0\n{edge}"));
    let isam = parse(edge);
    let weight = |d: &Document| match d.records().last() {
        Some(Record::Edge { weight, .. }) => weight.clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(
        (weight(&toro).kind, weight(&toro).order),
        (WeightKind::Information, EntryOrder::Toro)
    );
    assert_eq!(
        (weight(&isam).kind, weight(&isam).order),
        (WeightKind::SquareRoot, EntryOrder::UpperTriangle)
    );
    let options = ReadOptions::default().with_format(Some(Dialect::Toro));
    let forced = Document::parse("text", edge.as_bytes(), &options).unwrap();
    assert_eq!(weight(&forced), weight(&toro));
}

#[test]
fn fix_takes_several_ids_and_large_ids_are_ids() {
    let document = parse(
        "VERTEX_SE2 18446744073709551615 0 0 0\nVERTEX_SE2 6989586621679009792 0 0 0\nFIX 18446744073709551615 6989586621679009792\n",
    );
    assert_eq!(document.summary().fixed, 2);
}

#[test]
fn information_becomes_a_square_root_and_back() {
    let document = parse("EDGE_SE2 0 1 1 0 0 4 2 0 5 0 9\n");
    assert_eq!(written(&document, Dialect::Isam), "EDGE2 0 1 1 0 0 2 1 0 2 0 3\n");
    let isam = parse("EDGE2 0 1 1 0 0 2 1 0 2 0 3\n");
    assert_eq!(written(&isam, Dialect::G2o), "EDGE_SE2 0 1 1 0 0 4 2 0 5 0 9\n");
    let toro = written(&common::with_poses(&isam), Dialect::Toro);
    assert!(toro.ends_with("EDGE2 0 1 1 0 0 4 2 5 9 0 0\n"));
}

#[test]
fn singular_information_becomes_a_square_root() {
    let document = parse("EDGE_SE2 0 1 1 0 0 1 1 0 1 0 0\n");
    let text = written(&document, Dialect::Isam);
    let back = written(&parse(&text), Dialect::G2o);
    let numbers: Vec<f64> = back.split_whitespace().skip(6).map(|w| w.parse().unwrap()).collect();
    let expected = [1.0, 1.0, 0.0, 1.0, 0.0, 0.0];
    assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-14), "{back}");
}

#[test]
fn sensor_offsets_are_folded_into_measurements() {
    // A sensor half a metre up that looks to the left: a quarter turn about z.
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let document = parse(&format!(
        "PARAMS_SE3OFFSET 4 0 0 0.5 0 0 {h} {h}\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_TRACKXYZ 1 0 0 0\n\
         EDGE_SE3_TRACKXYZ 0 1 4 1 0 0 4 0 0 9 0 16\n"
    ));
    let mut out = Vec::new();
    let summary = document.write(&mut out, Dialect::Isam).unwrap();
    assert_eq!((summary.lines, summary.dropped_vertices), (1, 2));
    let text = String::from_utf8(out).unwrap();
    let numbers: Vec<f64> = text.split_whitespace().skip(3).map(|w| w.parse().unwrap()).collect();
    let expected = [0.0, 1.0, 0.5, 3.0, 0.0, 0.0, 2.0, 0.0, 4.0];
    assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{text}");
}

#[test]
fn landmarks_in_space_get_an_offset_and_ids_of_their_own_in_g2o() {
    let document = parse("EDGE3 0 1 1 0 0 0 0 0\nPOINT3 1 1 1 2 3\nPOINT3 1 7 1 2 3\n");
    assert_eq!((document.summary().poses, document.summary().landmarks), (2, 2));
    let mut out = Vec::new();
    assert_eq!(document.write(&mut out, Dialect::G2o).unwrap().renumbered_landmarks, 1);
    let text = String::from_utf8(out).unwrap();
    assert!(text.starts_with("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n"), "{text}");
    assert!(text.contains("EDGE_SE3_TRACKXYZ 1 8 0 1 2 3 1 0 0 1 0 1\n"), "{text}");
    assert!(text.contains("EDGE_SE3_TRACKXYZ 1 7 0 1 2 3 1 0 0 1 0 1\n"), "{text}");
    parse(&text);
}

#[test]
fn other_readers_get_what_they_know() {
    let document = parse(common::lines::G2O);
    let mut text = Vec::new();
    let options = WriteOptions::default().with_plain(true);
    let summary = document.write_with(&mut text, Dialect::G2o, &options).unwrap();
    let text = String::from_utf8(text).unwrap();
    assert!(!["FACTOR_", "GEODETIC", "ROBUST"].iter().any(|own| text.contains(own)), "{text}");
    assert_eq!((summary.left_out["GEODETIC_ORIGIN"], summary.left_out["ROBUST"]), (1, 1));
    assert_eq!((summary.left_out["FACTOR_LINEAR"], summary.left_out["FACTOR_RANGE_SE2"]), (4, 2));
    let left_out: usize = summary.left_out.values().sum();
    assert_eq!(summary.lines + left_out - 1, document.lines().len());
    assert_eq!(text.lines().count(), summary.lines);
    // The line that stood under a kernel is there without it.
    assert!(text.contains("\nEDGE_SE2 1 0 0.1 0.2 0.3 1 0 0 1 0 1\n"), "{text}");
    assert_eq!(parse(&text).summary().vertices, document.summary().vertices);
    let all = document.write(&mut Vec::new(), Dialect::G2o).unwrap();
    assert_eq!((all.lines, all.left_out.len()), (document.lines().len(), 0));
}

#[test]
fn vertices_alone_are_no_isam_file() {
    let document = parse("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\n");
    let mut out = Vec::new();
    let error = document.write(&mut out, Dialect::Isam).unwrap_err();
    assert!(matches!(error, FormatError::NothingToWrite { .. }) && out.is_empty(), "{error}");
}

#[test]
fn each_factor_is_refused_where_it_does_not_fit() {
    let all: Vec<&str> = common::lines::G2O.lines().collect();
    let frame: Vec<&str> = all
        .iter()
        .copied()
        .filter(|l| l.starts_with("VERTEX") || l.starts_with("PARAMS"))
        .collect();
    for line in all.iter().filter(|line| !frame.contains(line)) {
        if ["EDGE_SE2", "EDGE_SE3:", "EDGE_SE3_TRACK"].iter().any(|tag| line.starts_with(tag)) {
            continue;
        }
        let document = parse(&format!("{}\n{line}\n", frame.join("\n")));
        for dialect in [Dialect::Isam, Dialect::Pyfg] {
            let holds = dialect == Dialect::Pyfg
                && [
                    "EDGE_PRIOR_SE2 ",
                    "EDGE_SE3_PRIOR",
                    "EDGE_PRIOR_XY",
                    "EDGE_POINTXYZ_P",
                    "FACTOR_RANGE",
                ]
                .iter()
                .any(|tag| line.starts_with(tag));
            match document.write(&mut Vec::new(), dialect) {
                Ok(_) => assert!(holds, "{line} in {dialect}"),
                Err(error) => {
                    assert!(!holds && matches!(error, FormatError::Unsupported { .. }), "{error}");
                    assert!(error.to_string().contains("files cannot hold "), "{error}");
                }
            }
        }
    }
}

#[test]
fn half_angles_are_those_of_poses_only() {
    let text =
        format!("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nEDGE_SE3_PRIOR 0 0 1 0 0 0 0 0 1 {UPPER}\n");
    let options = ReadOptions::default().with_g2o_rotation(G2oRotation::Quaternion);
    let document = Document::parse("text", text.as_bytes(), &options).unwrap();
    assert_eq!(written(&document, Dialect::G2o), text);
    let pyfg = written(&document, Dialect::Pyfg);
    // Information 4, 5, 6 of half angles is 1, 1.25, 1.5 of angles.
    let last: Vec<f64> = pyfg.split_whitespace().map(|w| w.parse().unwrap_or(0.0)).collect();
    let last = &last[last.len() - 6..];
    let expected = [1.0, 0.0, 0.0, 0.8, 0.0, 1.0 / 1.5];
    assert!(last.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{pyfg}");
}

#[test]
fn toro_files_have_vertices() {
    let isam = parse("EDGE2 0 1 1 2 0 2 1 0 2 0 3\n");
    assert!(isam.needs_vertices(Dialect::Toro) && !isam.needs_vertices(Dialect::G2o));
    let error = isam.write(&mut Vec::new(), Dialect::Toro).unwrap_err();
    assert!(matches!(error, FormatError::NoVertices { .. }), "{error}");
    let at = |x, y| Value::new(&Pose2::new(x, y, 0.0));
    let placed = isam.with_vertices([(0, at(0.0, 0.0)), (1, at(1.0, 2.0))]).unwrap();
    let text = written(&placed, Dialect::Toro);
    assert_eq!(text, "VERTEX2 0 0 0 0\nVERTEX2 1 1 2 0\nEDGE2 0 1 1 2 0 4 2 5 9 0 0\n");
    assert_eq!(parse(&text).dialect(), Dialect::Toro);
}

#[test]
fn what_a_dialect_cannot_hold_is_an_error() {
    let landmark = parse("LANDMARK 0 1 1 1 1 0 1\n");
    let fixed = parse("VERTEX_SE2 0 0 0 0\nFIX 0\n");
    for (document, dialect) in
        [(&landmark, Dialect::Toro), (&fixed, Dialect::Toro), (&fixed, Dialect::Isam)]
    {
        let error = document.write(&mut Vec::new(), dialect).unwrap_err();
        assert!(matches!(error, FormatError::Unsupported { .. }), "{error}");
        assert!(error.to_string().starts_with("text:"), "{error}");
    }
    assert!(matches!(landmark.save("x.csv"), Err(FormatError::UnknownExtension { .. })));
}

#[test]
fn g2os_own_rotation_units_are_converted() {
    let text = format!("EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {UPPER}\n");
    let options = ReadOptions::default().with_g2o_rotation(G2oRotation::Quaternion);
    let document = Document::parse("text", text.as_bytes(), &options).unwrap();
    assert_eq!(written(&document, Dialect::G2o), text);
    let toro = written(&common::with_poses(&document), Dialect::Toro);
    assert!(toro.ends_with(" 1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 1 0 0 1.25 0 1.5\n"), "{toro}");
}

#[test]
fn numbers_are_short_and_exact() {
    let numbers = [1e-9, 0.1 + 0.2, -0.0, 1e75, 5e-324, 9.876543210123456e74, 123456.75, 1.0];
    for x in numbers {
        let record = Record::Vertex { id: 0, at: Coordinates::Point2([x, 0.0]) };
        let document = Document::from_records("made", Dialect::G2o, vec![record]).unwrap();
        let text = written(&document, Dialect::G2o);
        assert!(text.len() < 45, "{text}");
        let Record::Vertex { at, .. } = parse(&text).records().next().unwrap().clone() else {
            panic!()
        };
        assert_eq!(at.numbers()[0].to_bits(), x.to_bits());
    }
}

#[test]
fn estimates_keep_the_place_of_vertices() {
    let document =
        parse("VERTEX_SE2 1 0 0 0\n#\nVERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
    let at = |x: f64| Value::new(&Pose2::new(x, 0.0, 0.0));
    let output = document.with_vertices([(0, at(10.0)), (1, at(11.0))]).unwrap();
    assert_eq!(
        written(&output, Dialect::G2o),
        "VERTEX_SE2 1 11 0 0\nVERTEX_SE2 0 10 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    );
    let bare = parse("EDGE_SE2 5 3 1 0 0 1 0 0 1 0 1\n");
    let output = bare.with_vertices([(5, at(5.0)), (3, at(3.0))]).unwrap();
    assert!(
        written(&output, Dialect::G2o)
            .starts_with("VERTEX_SE2 3 3 0 0\nVERTEX_SE2 5 5 0 0\nEDGE_SE2")
    );
    assert!(matches!(
        bare.with_vertices([(5, at(5.0))]),
        Err(FormatError::MissingVertex { id: 3, .. })
    ));
    assert!(matches!(
        bare.with_vertices([(9, at(5.0))]),
        Err(FormatError::BadEstimate { id: 9, .. })
    ));
    assert!(bare.with_vertices([(5, at(5.0)), (5, at(5.0))]).is_err());
    assert!(
        bare.with_vertices([(5, Value::new(&evergraph_model::Point2::new(0.0, 0.0)))]).is_err()
    );
}
