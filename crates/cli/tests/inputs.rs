//! Graphs from standard input and from compressed files, lines of other programs, and what is told of them.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::io::Write;
use std::process::{Command, Stdio};

use common::{Folder, SQUARE};
use flate2::Compression;
use flate2::write::GzEncoder;

fn deflated(text: &str) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(text.as_bytes()).unwrap();
    encoder.finish().unwrap()
}

/// Runs the program with bytes piped in; its exit code, output and messages.
fn piped(folder: &Folder, line: &str, bytes: &[u8]) -> (Option<i32>, String, String) {
    let mut command: Command = folder.command(line);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    // A program that does not read closes the pipe.
    let _ = child.stdin.take().unwrap().write_all(bytes);
    let output = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn standard_input_and_gzip_give_the_same_map_as_the_file() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("optimize square.g2o --output expected.g2o").done();
    let expected = folder.read("expected.g2o");
    let compressed = deflated(SQUARE);
    // The name says nothing of the compression.
    std::fs::write(folder.path("square.bin"), &compressed).unwrap();
    folder.run("optimize square.bin --output out.g2o").done();
    assert_eq!(folder.read("out.g2o"), expected);
    for bytes in [SQUARE.as_bytes(), &compressed] {
        for command in ["optimize - --output out.g2o", "convert - out.g2o", "info -", "replay -"] {
            let (code, _, err) = piped(&folder, command, bytes);
            assert_eq!(code, Some(0), "{command}: {err}");
        }
        piped(&folder, "optimize - --output out.g2o", bytes);
        assert_eq!(folder.read("out.g2o"), expected);
        let (code, out, err) = piped(&folder, "evaluate - --truth square.g2o", bytes);
        assert!(code == Some(0) && out.contains("0"), "{err}");
    }
    // TORO's edges before its vertices need a second look, which a pipe gives once only.
    let toro = "EDGE2 0 1 1 0 0 1 0 1 1 0 0\nVERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\n";
    let (code, out, err) = piped(&folder, "info -", toro.as_bytes());
    assert!(code == Some(0) && out.contains("TORO"), "{out}{err}");
}

#[test]
fn broken_streams_are_errors() {
    let folder = Folder::new();
    let compressed = deflated(SQUARE);
    let (code, out, err) = piped(&folder, "optimize -", &compressed[..compressed.len() / 2]);
    assert_eq!((code, out.as_str()), (Some(1), ""));
    assert!(err.contains("standard input: cannot be read"), "{err}");
    let (code, _, err) = piped(&folder, "optimize -", b"");
    assert!(code == Some(1) && err.contains("standard input"), "{err}");
}

#[test]
fn a_pipe_that_is_not_read_is_told() {
    let folder = Folder::new();
    let (code, _, err) = piped(&folder, "replay --max-steps 5", SQUARE.as_bytes());
    assert!(code == Some(0) && err.contains("Name `-`"), "{err}");
    let ran = folder.run("replay --max-steps 5").done();
    assert_eq!(ran.err, "");
}

#[test]
fn bad_lines_are_counted_and_the_way_on_is_named() {
    let folder = Folder::new();
    folder.write("bad.g2o", &format!("{SQUARE}EDGE_SE2 0 1 x\nWHAT 1\nEDGE_SE2 1 2 1\n"));
    let parts = ["bad.g2o:9", "2 more lines cannot be read", "--lenient"];
    folder.run("optimize bad.g2o").failed(1, &parts);
    let (_, _, err) = piped(&folder, "optimize -", folder.read("bad.g2o").as_bytes());
    assert!(err.contains("2 more lines"), "{err}");
    folder.write("one.g2o", &format!("{SQUARE}EDGE_SE2 0 1 x\n"));
    let ran = folder.run("optimize one.g2o").failed(1, &["one.g2o:9", "--lenient"]);
    assert!(!ran.err.contains("more line"), "{}", ran.err);
    folder.run("optimize bad.g2o --lenient").done();
}

#[test]
fn what_is_passed_over_or_missing_is_told() {
    let folder = Folder::new();
    folder.write("equiv.g2o", &format!("# a comment\n{SQUARE}EQUIV 0 1\nEQUIV 1 2\n"));
    for command in
        ["replay equiv.g2o", "optimize equiv.g2o", "convert equiv.g2o out.g2o", "info equiv.g2o"]
    {
        let ran = folder.run(command).done();
        assert!(ran.err.contains("2 EQUIV lines were passed over"), "{command}: {}", ran.err);
        assert!(!ran.err.contains(" # lines"), "{command}: {}", ran.err);
    }
    folder.write("vertices.g2o", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n");
    let ran = folder.run("info vertices.g2o").done();
    assert!(ran.err.contains("no measurements"), "{}", ran.err);
    let path = common::case("hdl_tags.g2o");
    let parts = ["hdl_tags.g2o:3", "VERTEX_PLANE", "1 more line cannot", "--lenient"];
    folder.run(&format!("optimize {path}")).failed(1, &parts);
    let ran = folder.run(&format!("optimize {path} --lenient --output out.g2o")).done();
    assert!(ran.err.contains("2 bad lines") && ran.err.contains("EDGE_SE3_PLANE"), "{}", ran.err);
    // hdl_graph_slam's tag of a position, in g2o's words.
    assert!(
        folder.read("out.g2o").contains("EDGE_SE3_XYZ_PRIOR 0 0 0 0"),
        "{}",
        folder.read("out.g2o")
    );
}

const SIGHTINGS: &str = "\
VERTEX2 0 0 0 0
VERTEX2 1 1 0 0
EDGE2 0 1 1 0 0 100 0 100 100 0 0
BR 0 1 0.5 5 0.1 0.2
BR 1 1 0.61 4.15 0.1 0.2
";

/// A landmark of the id of a pose, as GTSAM's reader allows.
#[test]
fn bearings_and_ranges_of_toro_are_measurements() {
    let folder = Folder::with("a.graph", SIGHTINGS);
    folder.run("info a.graph --report info.json").done();
    let report = folder.json("info.json");
    assert_eq!((&report["poses"], &report["landmarks"]), (&2.into(), &1.into()));
    folder.run("convert a.graph same.graph").done();
    assert_eq!(folder.read("same.graph"), SIGHTINGS);
    folder.run("optimize a.graph --report toro.json").done();
    // Elsewhere the landmark has a vertex, and an id of its own.
    let ran = folder.run("convert a.graph b.g2o").done();
    assert!(ran.err.contains("1 vertices that the format needs"), "{}", ran.err);
    assert!(
        folder.read("b.g2o").contains("FACTOR_BEARING_RANGE_SE2_XY"),
        "{}",
        folder.read("b.g2o")
    );
    folder.run("optimize b.g2o --report g2o.json").done();
    let error = |name: &str| folder.json(name)["error"].as_f64().unwrap();
    assert!((error("toro.json") - error("g2o.json")).abs() < 1e-9);
    folder.run("convert b.g2o back.graph").done();
    assert_eq!(folder.read("back.graph").matches("BR ").count(), 2);
}

#[test]
fn bearings_and_ranges_that_toro_cannot_hold_are_refused() {
    let folder = Folder::new();
    for (sigma, told) in [("0", "above 0"), ("-1", "above 0"), ("nan", "not finite")] {
        let text = SIGHTINGS.replace("5 0.1 0.2", &format!("5 {sigma} 0.2"));
        folder.write("bad.graph", &text);
        folder.run("optimize bad.graph").failed(1, &["bad.graph:4", "BR", told]);
    }
    folder.write("short.graph", &SIGHTINGS.replace("5 0.1 0.2", "5 0.1"));
    folder.run("optimize short.graph").failed(1, &["short.graph:4", "BR"]);
    folder.write(
        "joint.g2o",
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 9 4 2\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n\
         FACTOR_BEARING_RANGE_SE2_XY 0 9 0.5 5 100 3 25\n",
    );
    folder.run("convert joint.g2o out.graph").failed(1, &["joint.g2o:5", "correlated"]);
}

#[test]
fn the_numbers_of_one_robots_keys_are_times() {
    let folder = Folder::new();
    let path = common::case("symbol_keys_tum.g2o");
    folder.run(&format!("optimize {path} --trajectory x.tum")).done();
    let text = folder.read("x.tum");
    let times: Vec<&str> = text.lines().filter_map(|line| line.split(' ').next()).collect();
    assert_eq!(times, ["0", "1", "2", "3", "4"]);
    // Two robots have no common time.
    let pose = |letter: char, k: u64| (u64::from(u32::from(letter)) << 56) + k;
    let mut text = String::new();
    for letter in ['a', 'b'] {
        for k in 0..2 {
            text += &format!("VERTEX_SE2 {} {k} 0 0\n", pose(letter, k));
        }
    }
    text += &format!("EDGE_SE2 {} {} 1 0 0 1 0 0 1 0 1\n", pose('a', 0), pose('a', 1));
    text += &format!("EDGE_SE2 {} {} 1 0 0 1 0 0 1 0 1\n", pose('b', 0), pose('b', 1));
    folder.write("two.g2o", &text);
    folder.run("optimize two.g2o --trajectory x.tum").failed(1, &["same time"]);
}

#[test]
fn options_name_the_values_that_they_take() {
    let folder = Folder::with("square.g2o", SQUARE);
    let usage = |line: &str, part: &str| {
        let ran = folder.run(line);
        assert!(ran.code == Some(2) && ran.err.contains(part), "{line}: {}", ran.err);
    };
    usage("replay square.g2o --relinearize-every 0", "a number of steps from 1");
    usage("replay --robust huber square.g2o", "--robust=huber");
    usage("optimize --robust huber square.g2o", "--robust=huber");
    for bound in ["0", "-3", "many"] {
        usage(&format!("replay square.g2o --largest-clique={bound}"), "a whole number above 0");
    }
    let refused = folder.run("replay square.g2o --largest-clique 5 --report out.json");
    refused.failed(1, &["clique", "--largest-clique"]);
    assert_eq!(folder.json("out.json")["status"], "too_dense");
    folder.run("replay square.g2o --largest-clique none").done();
}
