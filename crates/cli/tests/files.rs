//! `evergraph info`, `convert` and `simulate`, and the samples.

mod common;

use std::fs;
use std::io::Read;
use std::process::Stdio;

use common::{Folder, SQUARE, TWO_PARTS, number, sample};

#[test]
fn info_counts_what_is_there() {
    let folder = Folder::new();
    let more = format!(
        "{SQUARE}EDGE_SE2 1 0 -1 0 -1.5708 1 0 0 1 0 1\nVERTEX_SE2 8 0 0 0\nVERTEX_XY 9 1 1\n\
         EDGE_SE2_XY 8 9 1 1 1 0 1\nFIX 1\n"
    );
    folder.write("more.g2o", &more);
    let ran = folder.run("info more.g2o --report out.json").done();
    assert!(ran.out.contains("from 8") && ran.out.contains("g2o"), "{}", ran.out);
    let report = folder.json("out.json");
    for (field, expected) in [
        ("poses", 5),
        ("landmarks", 1),
        ("pose_edges", 5),
        ("landmark_edges", 1),
        ("vertices", 6),
        ("fixed", 1),
        ("repeated_pairs", 1),
        ("repeated_edges", 1),
    ] {
        assert_eq!(report[field], expected, "{field}");
    }
    assert_eq!(report["pose_ids"], serde_json::json!([0, 8]));
    assert_eq!(report["components"].as_array().map(Vec::len), Some(2));
}

#[test]
fn info_evaluates_both_conventions() {
    let folder = Folder::with(
        "one.g2o",
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 2 0.5\nEDGE_SE2 0 1 0 0 0 1 0 0 1 0 4\n",
    );
    let ran = folder.run("info one.g2o --convention g2o --report out.json").done();
    assert!(ran.out.contains("g2o's convention") && ran.out.contains("1/2 sum"), "{}", ran.out);
    let at = &folder.json("out.json")["at_vertices"];
    assert!((number(at, "g2o_chi2") - 6.0).abs() < 1e-12);
    assert!((number(at, "chi2") - 2.0 * number(at, "error")).abs() < 1e-12);
    assert!(number(at, "chi2") > 6.0);
}

#[test]
fn lenient_reading_lists_what_it_skips() {
    let folder = Folder::with("bad.g2o", &format!("{SQUARE}WORMHOLE 1 2\n"));
    let ran = folder.run("info bad.g2o --lenient --report out.json").done();
    assert!(ran.err.contains("bad.g2o:9") && ran.err.contains("WORMHOLE"), "{}", ran.err);
    assert_eq!(folder.json("out.json")["skipped"], 1);
}

#[test]
fn converting_back_and_forth_keeps_the_graph() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("convert square.g2o same.g2o").done();
    assert_eq!(folder.read("same.g2o"), SQUARE);
    folder.run("convert square.g2o a.graph --report out.json").done();
    assert_eq!(folder.json("out.json")["lines"], 8);
    folder.run("convert a.graph back.g2o").done();
    assert_eq!(folder.read("back.g2o"), SQUARE);
    let ran = folder.run("convert square.g2o a.txt").done();
    assert!(ran.err.contains("no lines for 4 vertices"), "{}", ran.err);
    assert!(folder.read("a.txt").starts_with("EDGE2 0 1 1 0 1.5708 10 0 0 10 0 20\n"));
    folder.run("convert a.txt b.g2o --isam-matrix sqrt").done();
    folder.run("convert a.txt b.dat").failed(1, &["b.dat"]);
    assert!(!folder.list().iter().any(|name| name.ends_with(".tmp") || name == "b.dat"));
}

#[test]
fn matrices_are_read_as_told() {
    let folder = Folder::with("a.txt", "EDGE2 0 1 1 0 0 4 0 0 4 0 4\n");
    for (kind, written) in [("sqrt", "16"), ("information", "4"), ("covariance", "0.25")] {
        folder.run(&format!("convert a.txt b.g2o --isam-matrix {kind}")).done();
        let text = folder.read("b.g2o");
        assert!(
            text.trim_end().ends_with(&format!(" {written} 0 0 {written} 0 {written}")),
            "{text}"
        );
    }
}

/// The commands of data/README.md give the files that are there.
#[test]
fn samples_regenerate_bit_for_bit() {
    let folder = Folder::new();
    let readme = fs::read_to_string(sample("README.md")).unwrap();
    let commands: Vec<&str> =
        readme.lines().filter_map(|line| line.trim().strip_prefix("evergraph simulate ")).collect();
    assert_eq!(commands.len(), 3);
    for command in commands {
        let name = command.rsplit(' ').next().unwrap();
        folder.run(&format!("simulate {command}")).done();
        let shipped = fs::read_to_string(sample(name)).unwrap();
        assert!(folder.read(name) == shipped, "{name} differs from what its command gives");
        assert!(shipped.len() < 1_500_000, "{name}");
    }
}

#[test]
fn worlds_have_a_truth_and_obey_their_options() {
    let folder = Folder::new();
    for shape in ["manhattan", "city", "sphere", "torus"] {
        let line = format!(
            "simulate {shape} --poses 300 --seed 3 --output w.g2o --truth t.g2o --report out.json"
        );
        folder.run(&line).done();
        assert_eq!(folder.json("out.json")["poses"], 300);
        assert_eq!(folder.read("t.g2o").lines().count(), 300);
        folder.run("replay w.g2o").done();
    }
    folder.run("simulate city --poses 300 --landmarks --landmark-density 0.1 --output w.g2o --report out.json").done();
    assert!(number(&folder.json("out.json"), "landmarks") > 5.0);
    folder
        .run("simulate city --poses 300 --closure-probability 0 --output w.g2o --report out.json")
        .done();
    assert_eq!(folder.json("out.json")["closures"], 0);
    folder.run("simulate city --poses 30 --odometry-sigmas 0.5,0.25,0.125 --output w.g2o").done();
    assert!(folder.read("w.g2o").contains(" 4 0 0 16 0 64\n"));
}

#[test]
fn bad_files_are_told_by_line_and_field() {
    let folder = Folder::new();
    for command in ["replay", "optimize", "info"] {
        let failed = |name: &str, parts: &[&str]| {
            folder.run(&format!("{command} {name}")).failed(1, parts);
        };
        failed("none.g2o", &["none.g2o", "cannot be read"]);
        folder.write("nan.g2o", &SQUARE.replace("VERTEX_SE2 1 1.1", "VERTEX_SE2 1 NaN"));
        failed("nan.g2o", &["nan.g2o:2", "field 2 (x)", "not finite"]);
        folder.write("cut.g2o", &SQUARE[..SQUARE.len() - 8]);
        failed("cut.g2o", &["cut.g2o:8", "cut off"]);
        folder.write("tag.g2o", &format!("{SQUARE}WORMHOLE 1 2\n"));
        failed("tag.g2o", &["tag.g2o:9", "WORMHOLE"]);
        folder.write("empty.g2o", "");
        failed("empty.g2o", &["empty.g2o", "no vertex or edge"]);
    }
}

#[test]
fn usage_errors_end_with_2() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    for (line, part) in [
        ("", "Usage"),
        ("fly", "fly"),
        ("replay two.g2o --relinearize maybe", "maybe"),
        ("replay two.g2o --relinearize-every 0", "0"),
        ("replay two.g2o --relinearize never --fluid-every 3", "evergraph replay"),
        ("replay two.g2o --kernel cauchy:1", "cauchy"),
        ("replay two.g2o --kernel huber:-1", "huber"),
        ("replay two.g2o --robust=cauchy", "cauchy"),
        ("replay two.g2o --robust=huber:x", "`x` is no number"),
        ("replay two.g2o --robust=huber:0", "huber"),
        // A value goes after `=` only.
        ("replay --robust huber two.g2o", "--robust=huber"),
        ("replay two.g2o --robust --kernel huber:1", "--kernel"),
        ("replay two.g2o --plain", "--output"),
        ("completions", "SHELL"),
        ("completions cmd", "cmd"),
        ("replay two.g2o --prior -1", "standard deviation"),
        ("replay two.g2o --prior 1e-160", "between 1e-75 and 1e75"),
        ("replay two.g2o --prior 1e160", "between 1e-75 and 1e75"),
        ("replay two.g2o --threads 0", "threads"),
        ("replay two.g2o --step-errors", "--steps"),
        ("replay two.g2o --quiet --verbose", "--quiet"),
        ("optimize", "FILE"),
        ("convert two.g2o", "OUTPUT"),
        ("simulate sphere --landmarks --output w.g2o", "evergraph simulate"),
        ("simulate sphere --odometry-sigmas 1,2 --output w.g2o", "needs 6"),
    ] {
        folder.run(line).failed(2, &[part]);
    }
    folder.run("simulate city --poses 1 --output w.g2o").failed(1, &["at least 2"]);
    assert_eq!(folder.list(), ["two.g2o"]);
}

#[test]
fn every_subcommand_has_help_with_examples() {
    let folder = Folder::new();
    let ran = folder.run("--help").done();
    assert!(ran.out.contains("Exit codes"));
    for command in [
        "replay",
        "optimize",
        "evaluate",
        "audit",
        "bench",
        "info",
        "convert",
        "simulate",
        "completions",
    ] {
        let ran = folder.run(&format!("{command} --help")).done();
        assert!(ran.out.contains(&format!("Examples:\n  evergraph {command}")), "{}", ran.out);
    }
}

#[test]
fn shells_get_completions_of_every_command() {
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let ran = folder.run(&format!("completions {shell}")).done();
        for word in ["evergraph", "replay", "evaluate", "relinearize-every", "trajectory"] {
            assert!(ran.out.contains(word), "{shell}: {word}");
        }
    }
}

#[test]
fn plain_files_hold_what_other_readers_know() {
    let folder = Folder::new();
    let own = "ROBUST huber 1.0 EDGE_SE2 0 1 1.1 0 1.5 1 0 0 1 0 1\n";
    folder.write("robust.g2o", &format!("{SQUARE}{own}"));
    folder.run("convert robust.g2o same.g2o").done();
    assert!(folder.read("same.g2o").contains("ROBUST"));
    let ran = folder.run("convert robust.g2o plain.g2o --plain --report out.json").done();
    assert!(ran.err.contains("ROBUST") && ran.err.contains("--plain"), "{}", ran.err);
    assert_eq!(folder.json("out.json")["left_out"]["ROBUST"], 1);
    folder.run("optimize robust.g2o --output solved.g2o --plain").done();
    for name in ["plain.g2o", "solved.g2o"] {
        let text = folder.read(name);
        assert!(!text.contains("ROBUST") && text.matches("EDGE").count() == 5, "{name}: {text}");
    }
}

#[test]
fn py_factor_graph_is_read_and_written() {
    let folder = Folder::with("square.g2o", SQUARE);
    let ran = folder.run("convert square.g2o square.pyfg").done();
    assert!(ran.err.contains("became names"), "{}", ran.err);
    assert!(folder.read("square.pyfg").contains(" A3 "));
    folder.run("optimize square.pyfg --format pyfg --output map.pyfg --report a.json").done();
    folder.run("optimize square.g2o --report b.json").done();
    let (a, b) = (folder.json("a.json"), folder.json("b.json"));
    assert!((number(&a, "error") - number(&b, "error")).abs() < 1e-9);
    assert_eq!(a["settings"]["reading"]["format"], "pyfg");
    assert!(folder.read("map.pyfg").contains("VERTEX_SE2"));
}

#[test]
fn numbers_whose_squares_overflow_are_told_with_their_line() {
    let folder = Folder::new();
    folder.write("truth.tum", "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n");
    let last = SQUARE.lines().count() + 1;
    let i6 = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
    for line in [
        "EDGE_SE2 0 2 1e150 0 0 1 0 0 1 0 1",
        "EDGE_SE2 0 2 0 0 0 1e200 0 0 1 0 1",
        "VERTEX_SE2 9 0 -1e150 0",
        "VERTEX_XY 9 1e150 0",
        "EDGE_SE2_XY 0 9 1e150 0 1 0 1",
        "EDGE_PRIOR_SE2_XY 0 1e150 0 1 0 1",
        "EDGE_BEARING_SE2_XY 0 9 1e150 1",
        "VERTEX_TRACKXYZ 9 0 0 1e150",
        &format!("EDGE_SE3:QUAT 10 11 0 1e150 0 0 0 0 1 {i6}"),
    ] {
        folder.write("far.g2o", &format!("{SQUARE}{line}\n"));
        for command in ["info", "optimize", "replay", "evaluate --truth truth.tum"] {
            let ran = folder.run(&format!("{command} far.g2o"));
            ran.failed(1, &[&format!("far.g2o:{last}"), "too large", "field"]);
        }
    }
    folder
        .write("far.graph", "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1e150 0 0 1 0 1 1 0 0\n");
    folder.run("optimize far.graph").failed(1, &["far.graph:3", "`1e150`"]);
    folder.write("far.txt", "EDGE2 0 1 1e150 0 0 1 0 0 1 0 1\n");
    folder.run("optimize far.txt").failed(1, &["far.txt:1", "`1e150`"]);
    folder.write("far.tum", "0 0 0 0 0 0 0 1\n1 1e150 0 0 0 0 0 1\n");
    folder.run("evaluate far.tum --truth truth.tum").failed(1, &["far.tum:2", "`1e150`"]);
}

#[test]
fn residuals_whose_squares_overflow_are_told_with_their_variables() {
    let far =
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1e60 0 0\nEDGE_SE2 0 1 0 0 0 1e100 0 0 1e100 0 1e100\n";
    let folder = Folder::with("far.g2o", far);
    let ran = folder.run("optimize far.g2o --init file");
    ran.failed(1, &["far.g2o", "between 0 and 1", "squares overflow"]);
}

#[test]
fn verbose_says_what_happens() {
    let folder = Folder::with("square.g2o", SQUARE);
    let ran = folder.run("optimize square.g2o --verbose").done();
    for part in ["read square.g2o (g2o)", "step taken", "error=", "batch done"] {
        assert!(ran.err.contains(part), "{part} is not in {}", ran.err);
    }
    assert!(!ran.out.contains("step taken") && !ran.err.contains('\x1b'));
    let steps = |line: &str| folder.run(line).done().err.matches("applied").count();
    assert_eq!(steps("replay square.g2o -vvv"), 4);
    assert_eq!(steps("replay square.g2o -vv"), 0);
    let with = |directives: &str, line: &str| {
        let ran = folder.command(line).env("RUST_LOG", directives).output().unwrap();
        String::from_utf8(ran.stderr).unwrap()
    };
    assert!(with("evergraph_solver=trace", "replay square.g2o").contains("applied"));
    assert!(!with("off", "optimize square.g2o -v").contains("step taken"));
    let odd = with("evergraph=loud", "optimize square.g2o -v");
    assert!(odd.contains("RUST_LOG") && odd.contains("step taken"), "{odd}");
    assert_eq!(with("evergraph=trace", "replay square.g2o --quiet"), "");
}

/// As `evergraph info FILE | true` does.
#[test]
fn a_closed_pipe_is_no_failure() {
    let folder = Folder::with("square.g2o", SQUARE);
    for line in ["info square.g2o", "replay square.g2o", "--help"] {
        let mut command = folder.command(line);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut err = String::new();
        child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
        assert_eq!((child.wait().unwrap().code(), err.as_str()), (Some(0), ""), "{line}");
    }
}

#[test]
fn converting_a_matrix_that_rounding_made_indefinite_keeps_the_optimum() {
    let folder = Folder::with(
        "clipped.g2o",
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1.3 0.2 0.4\n\
         EDGE_SE2 0 1 1 0 0 1.23457e+10 1.23457e+10 1.11111e+03 1.23456e+10 1.11110e+03 1.00000e-03\n\
         EDGE_SE2 0 1 1.2 0.1 0.3 4 0 0 4 0 4\n",
    );
    folder.run("convert clipped.g2o clipped.txt").done();
    let error = |file: &str| {
        folder.run(&format!("optimize {file} --quiet --report out.json")).done();
        folder.json("out.json")["error"].as_f64().expect("a number")
    };
    let (before, after) = (error("clipped.g2o"), error("clipped.txt"));
    assert!((before - after).abs() < 1e-6 * before, "{before} became {after}");
}
