//! Each thing that can be wrong with a line has an error of its own, with the line in it, and is
//! skipped when reading leniently.

use evergraph_formats::{Dialect, Document, FormatError, ReadOptions};

const GOOD: &str = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\n";

fn strict(text: &[u8]) -> Result<Document, FormatError> {
    Document::parse("f.g2o", text, &ReadOptions::default())
}

fn lenient(text: &[u8]) -> Result<Document, FormatError> {
    Document::parse("f.g2o", text, &ReadOptions::default().with_lenient(true))
}

/// `line` after the good lines is this error, at line 4, and is skipped leniently.
macro_rules! broken {
    ($name:ident, $line:expr, $error:pat, $($word:literal),*) => {
        #[test]
        fn $name() {
            let text = [GOOD.as_bytes(), $line.as_ref(), b"\n"].concat();
            let error = strict(&text).unwrap_err();
            assert!(matches!(error, $error), "{error:?}");
            let message = error.to_string();
            assert!(message.starts_with("f.g2o:4: "), "{message}");
            assert!(!message.contains('\n'), "{message}");
            $(assert!(message.contains($word), "`{}` is not in: {message}", $word);)*
            let document = lenient(&text).unwrap();
            assert_eq!((document.summary().skipped, document.records().len()), (1, 3));
            assert_eq!(document.skipped()[0].line, 4);
            assert_eq!(document.skipped()[0].error.to_string(), message);
        }
    };
}

broken!(
    short_line,
    "EDGE_SE2 0 1 1 0 0 100 0 0 100 0",
    FormatError::FieldCount { .. },
    "10 fields",
    "11",
    "I33"
);
broken!(
    long_line,
    "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400 5",
    FormatError::FieldCount { .. },
    "12 fields"
);
broken!(truncated_tag, "EDGE_SE", FormatError::UnknownTag { .. }, "`EDGE_SE`");
broken!(tag_alone, "EDGE_SE2", FormatError::FieldCount { .. }, "0 fields");
broken!(fix_nothing, "FIX", FormatError::FieldCount { .. }, "1 or more");
broken!(
    not_a_number,
    "VERTEX_SE2 2 0 abc 0",
    FormatError::NotANumber { .. },
    "field 3 (y)",
    "`abc`"
);
broken!(comma, "VERTEX_SE2 2 0,5 0 0", FormatError::NotANumber { .. }, "`0,5`");
broken!(nan, "VERTEX_SE2 2 0 0 nan", FormatError::NotFinite { .. }, "field 4 (theta)", "`nan`");
broken!(infinity, "EDGE_SE2 0 1 inf 0 0 100 0 0 100 0 400", FormatError::NotFinite { .. }, "`inf`");
broken!(too_large, "EDGE_SE2 0 1 1 0 0 1e999 0 0 100 0 400", FormatError::NotFinite { .. }, "I11");
broken!(
    large_measurement,
    "EDGE_SE2 0 1 0 -1e150 0 100 0 0 100 0 400",
    FormatError::TooLarge { limit: 1e75, .. },
    "field 4 (y)",
    "`-1e150`",
    "squares"
);
broken!(
    large_value,
    "VERTEX_SE3:QUAT 2 0 0 1e76 0 0 0 1",
    FormatError::TooLarge { limit: 1e75, .. },
    "field 4 (z)"
);
broken!(
    large_landmark,
    "EDGE_SE2_XY 0 2 1e76 0 1 0 1",
    FormatError::TooLarge { limit: 1e75, .. },
    "field 3 (x)"
);
broken!(
    large_information,
    "EDGE_SE2 0 1 1 0 0 1e160 0 0 100 0 400",
    FormatError::TooLarge { limit: 1e150, .. },
    "I11"
);
broken!(
    large_with_its_weight,
    "EDGE_SE2 0 1 1e70 0 0 1e100 0 0 100 0 400",
    FormatError::TooLarge { .. },
    "1e70",
    "beyond 1e25"
);
broken!(negative_id, "VERTEX_SE2 -1 0 0 0", FormatError::NotAnId { .. }, "`-1`");
broken!(fractional_id, "VERTEX_SE2 1.5 0 0 0", FormatError::NotAnId { .. }, "`1.5`");
broken!(
    huge_id,
    "VERTEX_SE2 18446744073709551616 0 0 0",
    FormatError::NotAnId { .. },
    "18446744073709551615"
);
broken!(bad_fix, "FIX 0 x", FormatError::NotAnId { .. }, "field 2", "`x`");
broken!(
    duplicate,
    "VERTEX_SE2 1 2 0 0",
    FormatError::Duplicate { first: 2, .. },
    "vertex 1",
    "line 2"
);
broken!(
    missing,
    "EDGE_SE2 0 5 1 0 0 100 0 0 100 0 400",
    FormatError::MissingVertex { id: 5, .. },
    "vertex 5"
);
broken!(missing_fix, "FIX 8", FormatError::MissingVertex { id: 8, .. }, "vertex 8");
broken!(
    self_edge,
    "EDGE_SE2 1 1 1 0 0 100 0 0 100 0 400",
    FormatError::SelfEdge { id: 1, .. },
    "itself"
);
broken!(
    wrong_kind,
    "EDGE_SE2_XY 0 1 1 0 1 0 1",
    FormatError::WrongKind { id: 1, .. },
    "2D landmark",
    "2D pose"
);
broken!(
    no_offset,
    "EDGE_SE3_TRACKXYZ 0 1 4 1 0 0 1 0 0 1 0 1",
    FormatError::MissingOffset { id: 4, .. },
    "4"
);
broken!(
    indefinite,
    "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1",
    FormatError::NotPositive { .. },
    "information",
    "semi-definite",
    "-1.0"
);
broken!(
    negative,
    "EDGE_SE2 0 1 1 0 0 -100 0 0 100 0 400",
    FormatError::NotPositive { .. },
    "-1.000e2"
);
broken!(
    indefinite_beyond_digits,
    "EDGE_SE2 0 1 1 0 0 1.00000 1.00100 0.00000 1.00000 0.00000 1.00000",
    FormatError::NotPositive { .. },
    "digits"
);
broken!(
    zero_quaternion,
    "VERTEX_SE3:QUAT 3 0 0 0 0 0 0 0",
    FormatError::ZeroQuaternion { .. },
    "0 0 0 1"
);
broken!(
    other_dialect,
    "EDGE2 0 1 1 0 0 4 0 4 9 0 0",
    FormatError::MixedDialects { .. },
    "EDGE2",
    "VERTEX_SE2"
);
broken!(unknown, "EDGE_SIM3 0 1", FormatError::UnknownTag { .. }, "`EDGE_SIM3`");
broken!(not_utf8, b"EDGE_SE2 \xFF\xFE 1", FormatError::NotText { .. }, "UTF-8");
broken!(nul, b"EDGE_SE2 0 1 1 0 \x000 100 0 0 100 0 400", FormatError::NotText { .. }, "NUL");
broken!(nuls, [0_u8; 5000], FormatError::NotText { .. }, "NUL");
broken!(endless, [b'9'; (1 << 20) + 5], FormatError::LineTooLong { .. }, "1048576");
broken!(
    endless_digits,
    [b"FIX 0." as &[u8], &[b'1'; 5000]].concat(),
    FormatError::NotAnId { .. },
    "…"
);

/// Each of these lines after good ones in space and in the plane is an error that says so.
#[test]
fn factors_that_cannot_be_are_named() {
    let good = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 2 0 0\n\
                VERTEX_SE3:QUAT 10 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 11 0 0 0 0 0 0 1\n\
                PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nGEODETIC_ORIGIN 48 11 0\n";
    for (line, word) in [
        ("EDGE_PRIOR_SE2 0 1 2 3 1 0 0 1 0", "9 fields"),
        ("EDGE_PRIOR_SE2 10 1 2 3 1 0 0 1 0 1", "2D pose"),
        ("EDGE_PRIOR_SE2 5 1 2 3 1 0 0 1 0 1", "vertex 5"),
        ("EDGE_PRIOR_SE2 0 1 2 3 1 2 0 1 0 1", "semi-definite"),
        ("EDGE_PRIOR_SE2 0 1 2 3 1 0 0 1 0 x", "field 10 (I33)"),
        ("EDGE_SE3_PRIOR 10 3 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1", "offset 3"),
        (
            "EDGE_SE3_PRIOR 10 0 0 0 0 0 0 0 0 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1",
            "quaternion",
        ),
        ("EDGE_SE3_XYZ_PRIOR 10 1 2 3 1 0 0 1 0", "10 or 11"),
        ("EDGE_SE3_XYZ_PRIOR 10 1 2 3 1 0 0 1 0 x", "field 10 (I33)"),
        ("EDGE_SE3_XYZ_PRIOR 10 0 1 2 y 1 0 0 1 0 1", "field 5 (z)"),
        ("EDGE_SE3_XYZ_PRIOR 10 4 1 2 3 1 0 0 1 0 1", "offset 4"),
        ("EDGE_BEARING_SE2_XY 0 1 0.5 1", "2D landmark"),
        ("EDGE_POINTXY 2 2 0 0 1 0 1", "itself"),
        ("FACTOR_RANGE_SE2 0 1 -0.1 1", "range of the FACTOR_RANGE_SE2 line is -0.1"),
        ("FACTOR_RANGE_SE2 0 0 0.1 1", "itself"),
        ("FACTOR_RANGE_SE2 0 1 0.1 -1", "semi-definite"),
        ("FACTOR_BEARING_RANGE_SE2_XY 0 2 1 -1 1 0 1", "range"),
        ("FACTOR_BEARING_SE3 10 11 0 0 0 1 0 1", "direction"),
        ("FACTOR_ATTITUDE_SE3 10 0 0 1 0 0 0 1 0 1", "measured direction"),
        ("FACTOR_ATTITUDE_SE3 10 0 0 0 0 0 1 1 0 1", "world direction"),
        ("FACTOR_DEPTH_SE3 0 1 1", "3D pose"),
        ("FACTOR_PARTIAL_SE2 0 1 0 0 0 0", "field 3 (k)"),
        ("FACTOR_PARTIAL_SE2 0 1 4 0 0 0", "from 1 to 3"),
        ("FACTOR_PARTIAL_SE2 0 1 18446744073709551615 0 0 0", "from 1 to 3"),
        ("FACTOR_PARTIAL_SE2 0 1 1 0 0 0 1 z 0 1", "field 8 (A)"),
        ("FACTOR_PARTIAL_SE2 0 1 2 0 0 0 1 0 0 0 1 0 1 0", "14 fields"),
        ("FACTOR_LINEAR up 1 XY 2 0 0 1 1 1 0 0", "none, root, inverse_root"),
        ("FACTOR_LINEAR none 0", "(n)"),
        ("FACTOR_LINEAR none 9999999999999 XY 2 0 0 1 1 1 0 0", "(n)"),
        ("FACTOR_LINEAR none 1 SIM3 2 0 0 1 1 1 0 0", "SE2, SE3, XY, XYZ"),
        ("FACTOR_LINEAR none 1 XY 2 0 0 9999999999 1 1 0 0", "(q)"),
        ("FACTOR_LINEAR none 1 XY 2 0 0 0 0 0", "(q)"),
        ("FACTOR_LINEAR none 1 XY 2 0 0 1 1 1 0", "10 fields"),
        ("FACTOR_LINEAR none 1 XY 2 0 0 1 1 1 0 0 0", "12 fields"),
        ("FACTOR_LINEAR none 1 XY 2 0 0 1 nan 1 0 0", "(G)"),
        ("FACTOR_LINEAR none 1 XY 2 0 0 1 1 1 0 b", "(d')"),
        ("FACTOR_LINEAR root 1 XY 2 0 0 1 1 1 0 0", "no pose"),
        ("FACTOR_LINEAR none 1 XY 0 0 0 1 1 1 0 0", "2D landmark"),
        ("FACTOR_LINEAR none 2 XY 2 0 0 XY 2 0 0 1 1 1 1 1 0 0 0 0", "itself"),
        ("GEODETIC_ORIGIN 48 11 0", "line 7"),
        ("GEODETIC_ORIGIN 91 11 0", "latitude"),
        ("GEODETIC_ORIGIN 48 inf 0", "longitude"),
        ("ROBUST", "kernel"),
        ("ROBUST huber 1.345", "threshold"),
        ("ROBUST huber 0 FACTOR_RANGE_SE2 0 1 1 1", "threshold"),
        ("ROBUST huber x FACTOR_RANGE_SE2 0 1 1 1", "`x`"),
        ("ROBUST cauchy 1 FACTOR_RANGE_SE2 0 1 1 1", "huber and pseudo_huber"),
        ("ROBUST huber 1 FIX 0", "no factor"),
        ("ROBUST huber 1 VERTEX_SE2 7 0 0 0", "no factor"),
        ("ROBUST huber 1 ROBUST huber 1 FACTOR_RANGE_SE2 0 1 1 1", "`ROBUST`"),
        ("ROBUST huber 1 EQUIV 1 2", "`EQUIV`"),
        ("ROBUST huber 1 FACTOR_RANGE_SE2 0 1 x 1", "field 3 (range)"),
    ] {
        let text = format!("{good}{line}\n");
        let message = strict(text.as_bytes()).unwrap_err().to_string();
        assert!(message.starts_with("f.g2o:8: "), "{line}: {message}");
        assert!(message.contains(word), "{line}: {message}");
        assert_eq!(lenient(text.as_bytes()).unwrap().summary().skipped, 1, "{line}");
    }
}

#[test]
fn linear_factors_may_be_long() {
    // 600 columns and rows make 2.5 MB.
    let points: String = (0..200).map(|id| format!(" SE2 {id} 0 0 0")).collect();
    let line = |tag: &str, numbers: usize| {
        format!("{tag} none 200{points} 600{}\n", " 0.25".repeat(numbers))
    };
    let vertices: String = (0..200).map(|id| format!("VERTEX_SE2 {id} 0 0 0\n")).collect();
    for tag in ["FACTOR_LINEAR", "ROBUST huber 1 FACTOR_LINEAR"] {
        let text = format!("{vertices}{}", line(tag, 600 * 601));
        let document = strict(text.as_bytes()).unwrap();
        let mut out = Vec::new();
        document.write(&mut out, Dialect::G2o).unwrap();
        assert!(out == text.as_bytes());
    }
    let text = format!("{vertices}{}", line("FACTOR_LONG", 600 * 601));
    assert!(matches!(strict(text.as_bytes()), Err(FormatError::LineTooLong { .. })));
}

#[test]
fn toro_may_list_its_edges_first() {
    let (edge, vertices) = ("EDGE2 0 1 1 0 0 4 0 4 9 0 0\n", "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\n");
    let text = format!("{edge}{vertices}");
    for result in [strict(text.as_bytes()), lenient(text.as_bytes())] {
        // What cannot be read again is refused, leniently or not.
        let error = result.unwrap_err();
        assert!(matches!(error, FormatError::EdgesBeforeVertices { first: 1, .. }), "{error}");
        assert!(error.to_string().starts_with("f.g2o:2: "), "{error}");
    }
    let path = std::env::temp_dir().join(format!("edges-first-{}.graph", std::process::id()));
    std::fs::write(&path, &text).unwrap();
    for lenient in [false, true] {
        let options = ReadOptions::default().with_lenient(lenient);
        let document = Document::read(&path, &options).unwrap();
        assert_eq!((document.dialect(), document.summary().skipped), (Dialect::Toro, 0));
        assert_eq!(document.records().len(), 3);
    }
    std::fs::remove_file(&path).unwrap();
    // A tag of iSAM alone has settled it before.
    let text = format!("ODOMETRY 0 1 1 0 0 4 0 0 4 0 4\n{edge}{vertices}");
    let error = strict(text.as_bytes()).unwrap_err();
    assert!(matches!(error, FormatError::MixedDialects { .. }), "{error}");
    assert_eq!(lenient(text.as_bytes()).unwrap().dialect(), Dialect::Isam);
}

#[test]
fn nothing_is_an_error() {
    for text in ["", "\n", "  \r\n\n", "# only a comment\n", "EQUIV 1 2\n"] {
        assert!(matches!(strict(text.as_bytes()), Err(FormatError::Empty { .. })), "{text:?}");
        assert!(matches!(lenient(text.as_bytes()), Err(FormatError::Empty { .. })), "{text:?}");
    }
    let error = lenient(b"\x7fELF\x02\x01\n\0\0\0\n").unwrap_err();
    assert!(matches!(error, FormatError::Empty { ignored: 2, .. }), "{error}");
    let error = Document::read("/nonexistent/f.g2o", &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().starts_with("/nonexistent/f.g2o: "), "{error}");
}

#[test]
fn white_space_of_any_kind_separates() {
    let text = GOOD.replace('\n', "\r\n").replace(' ', "  \t ");
    let plain = strict(GOOD.as_bytes()).unwrap();
    assert!(plain.records().eq(strict(text.as_bytes()).unwrap().records()));
    let text = format!("\u{feff}\n\n  {}", GOOD.trim_end().replace('\n', "  \n\n\t"));
    assert!(plain.records().eq(strict(text.as_bytes()).unwrap().records()));
}

#[test]
fn lines_in_any_encoding_may_be_comments() {
    let text = [b"# \xE9t\xE9\n", GOOD.as_bytes()].concat();
    assert_eq!(strict(&text).unwrap().summary().ignored["#"], 1);
}

#[test]
fn printed_digits_explain_small_negative_eigenvalues() {
    // Rank one, (1/3, 2/3, 1)ᵀ(1/3, 2/3, 1) times 30, to six digits in both notations.
    for weight in [
        "3.33333 6.66667 10 13.3333 20 30",
        "3.333333 6.666667 10.000000 13.333333 20.000000 30.000000",
    ] {
        let text = format!("EDGE_SE2 0 1 1 0 0 {weight}\n");
        let document = strict(text.as_bytes()).unwrap();
        assert_eq!(document.summary().clipped, 1, "{weight}");
        assert_eq!(document.summary().warnings().len(), 1);
    }
    // Singular, not negative: nothing to clip.
    let document = strict(b"EDGE_SE2 0 1 1 0 0 1 1 0 1 0 0\n").unwrap();
    assert_eq!(document.summary().clipped, 0);
}

#[test]
fn quaternions_off_unit_length_are_counted_and_kept() {
    let text = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1.01\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 0.9999\n";
    let document = strict(text.as_bytes()).unwrap();
    assert_eq!(document.summary().long_quaternions, 1);
    let mut out = Vec::new();
    document.write(&mut out, Dialect::G2o).unwrap();
    assert_eq!(out, text.as_bytes());
}

#[test]
fn covariances_have_to_be_definite() {
    let options =
        ReadOptions::default().with_isam_matrix(evergraph_formats::WeightKind::Covariance);
    let error =
        Document::parse("c", "EDGE2 0 1 1 0 0 0.1 0 0 0.1 0 0\n".as_bytes(), &options).unwrap_err();
    assert!(error.to_string().contains("covariance matrix"), "{error}");
    assert!(Document::parse("c", "EDGE2 0 1 1 0 0 0.1 0 0 0.1 0 1\n".as_bytes(), &options).is_ok());
}

#[test]
fn listed_lines_are_bounded_and_counted() {
    let text = GOOD.to_string() + &"nonsense\n".repeat(5000);
    let document = lenient(text.as_bytes()).unwrap();
    assert_eq!((document.summary().skipped, document.skipped().len()), (5000, 1000));
    assert!(document.summary().warnings()[0].contains("the first 1000"));
}
