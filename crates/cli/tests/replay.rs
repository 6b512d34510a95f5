//! `evergraph replay`.

mod common;

use common::{Folder, SQUARE, TWO_PARTS, number, sample};

#[test]
fn without_a_file_the_sample_is_replayed() {
    let folder = Folder::new();
    let ran = folder.run("replay --max-steps 200 --report out.json").done();
    assert!(ran.out.contains("manhattan3500.g2o"), "{}", ran.out);
    let report = folder.json("out.json");
    assert_eq!(report["dataset"], "manhattan3500.g2o");
    assert_eq!((&report["steps"], &report["status"]), (&200.into(), &"stopped".into()));
}

/// The reference optima of data/README.md.
#[test]
fn samples_end_at_their_optima() {
    let folder = Folder::new();
    for (name, optimum) in
        [("manhattan3500.g2o", 3260.124691315), ("manhattan-landmarks.g2o", 4599.287073088)]
    {
        folder.run(&format!("replay {} --report out.json", sample(name))).done();
        let report = folder.json("out.json");
        let error = number(&report, "error");
        assert!(error > optimum - 1e-6 && error < optimum * (1.0 + 1e-4), "{name}: {error}");
        assert_eq!(report["status"], "converged");
        // serde_json reads numbers of 17 digits to within a bit.
        let off = number(&report, "chi2") - 2.0 * error;
        assert!(off.abs() <= 4.0 * f64::EPSILON * error, "{report}");
    }
}

#[test]
fn the_report_has_every_field() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("replay square.g2o --report out.json --final-batch").done();
    let report = folder.json("out.json");
    for (field, expected) in [
        ("schema", 1.into()),
        ("command", "replay".into()),
        ("dataset", "square.g2o".into()),
        ("steps", 4.into()),
        ("variables", 4.into()),
        ("factors", 4.into()),
        ("status", "converged".into()),
    ] {
        let expected: serde_json::Value = expected;
        assert_eq!(report[field], expected, "{field}");
    }
    for field in ["error", "chi2", "relinearizations", "factor_nnz", "fill_percent"] {
        number(&report, field);
    }
    for field in ["update_s", "mean_ms", "p50_ms", "p99_ms", "max_ms", "total_s"] {
        assert!(number(&report["time"], field) > 0.0, "{field}");
    }
    assert_eq!(report["gauge_prior"]["variable"], 0);
    assert_eq!(report["gauge_prior"]["sigmas"], serde_json::json!([0.01, 0.01, 0.01]));
    number(&report["gauge_prior"], "error");
    assert!(report["settings"]["solver"]["relinearization"]["fluid"].is_object());
    assert!(report["convention"].as_str().unwrap().contains("1/2 sum"));
    let memory = &report["peak_rss_mb"];
    assert!(if cfg!(target_os = "linux") { memory.is_f64() } else { memory.is_null() });
}

#[test]
fn fill_and_times_are_what_they_say() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("replay square.g2o --report out.json").done();
    let report = folder.json("out.json");
    // 12 scalars in one small clique or a few: never more than the full triangle.
    let (nnz, fill) = (number(&report, "factor_nnz"), number(&report, "fill_percent"));
    assert!((fill - 100.0 * nnz / 78.0).abs() < 1e-9 && fill <= 100.0);
    let time = &report["time"];
    assert!((4.0 * number(time, "mean_ms") / 1e3 - number(time, "update_s")).abs() < 1e-12);
    assert!(number(time, "p50_ms") <= number(time, "p99_ms"));
    assert!(number(time, "p99_ms") <= number(time, "max_ms"));
    assert!(number(time, "update_s") <= number(time, "total_s"));
}

#[test]
fn steps_are_listed() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("replay square.g2o --steps steps.csv --relinearize-every 2").done();
    let text = folder.read("steps.csv");
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let header =
        "step,kind,variables,factors,update_ms,cliques_eliminated,variables_relinearized,error";
    assert_eq!(text.lines().next(), Some(header));
    let kinds: Vec<&str> = lines[1..].iter().map(|line| line[1]).collect();
    assert_eq!(kinds, ["explore", "batch", "explore", "batch"]);
    let counts: Vec<[&str; 3]> = lines[1..].iter().map(|l| [l[0], l[2], l[3]]).collect();
    assert_eq!(counts, [["1", "1", "0"], ["2", "2", "1"], ["3", "3", "2"], ["4", "4", "4"]]);
    assert!(lines[1..].iter().all(|line| line[7].is_empty() && line[4].parse::<f64>().is_ok()));

    folder.run("replay square.g2o --steps steps.csv --step-errors --report out.json").done();
    let text = folder.read("steps.csv");
    let last: f64 = text.lines().last().unwrap().rsplit(',').next().unwrap().parse().unwrap();
    // Summed by two routes: equal but for rounding.
    let error = number(&folder.json("out.json"), "error");
    assert!((last - error).abs() <= 1e-11 * error, "{last} {error}");
    assert!(text.lines().nth(4).unwrap().contains(",loop,"));
    // The first pose has no measurements, whose sum is 0 and not -0.
    assert!(text.lines().nth(1).unwrap().ends_with(",0"), "{text}");
}

#[test]
fn a_pipe_gets_the_table_and_no_bar() {
    let folder = Folder::with("square.g2o", SQUARE);
    let ran = folder.run("replay square.g2o").done();
    assert_eq!(ran.err, "");
    for part in
        ["square.g2o", "error", "chi2", "convention", "gauge prior", "p99", "fill", "status"]
    {
        assert!(ran.out.contains(part), "{part}");
    }
    assert!(!ran.out.contains('\r') && !ran.out.contains('\x1b'));
    let quiet = folder.run("replay square.g2o --quiet").done();
    assert_eq!((quiet.out.as_str(), quiet.err.as_str()), ("", ""));
}

/// The estimate that was written costs what the report says, and reading it back gives its bits.
#[test]
fn the_output_holds_the_estimate() {
    let folder = Folder::with("square.g2o", SQUARE);
    for name in ["map.g2o", "map.graph", "map.toro"] {
        folder.run(&format!("replay square.g2o --output {name} --report out.json")).done();
        folder.run(&format!("info {name} --report info.json")).done();
        let (report, info) = (folder.json("out.json"), folder.json("info.json"));
        let difference = number(&report, "error") - number(&info["at_vertices"], "error");
        assert!(difference.abs() < 1e-12, "{name}: {difference}");
    }
    let edges = |text: &str| text.lines().filter(|l| l.starts_with("EDGE")).collect::<String>();
    assert_eq!(edges(&folder.read("map.g2o")), edges(SQUARE));
    // An iSAM file has no vertices; the measurements are there.
    let ran = folder.run("replay square.g2o --output map.txt").done();
    assert!(ran.err.contains("no lines for 4 vertices"), "{}", ran.err);
    assert_eq!(folder.read("map.txt").lines().count(), 4);
}

#[test]
fn a_replay_that_stops_writes_what_has_come_in() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.write("two.g2o", TWO_PARTS);
    folder.run("replay square.g2o --max-steps 2 --output part.g2o").done();
    let text = folder.read("part.g2o");
    assert_eq!(text.lines().filter(|l| l.starts_with("VERTEX")).count(), 2);
    assert_eq!(text.lines().filter(|l| l.starts_with("EDGE")).count(), 1);
    folder.run("replay two.g2o --max-steps 4 --output part.g2o").done();
    folder.run("replay part.g2o").done();
}

#[test]
fn policies_and_solvers_agree_on_the_square() {
    let folder = Folder::with("square.g2o", SQUARE);
    let mut errors = Vec::new();
    for options in [
        "",
        "--relinearize every",
        "--relinearize every --relinearize-every 1",
        "--relinearize fluid --relinearize-threshold 0.001 --fluid-every 1",
        "--relinearize never",
        "--elimination qr",
        "--initial file",
        "--full-estimate",
        "--threads 1",
        "--threads 2",
    ] {
        folder.run(&format!("replay square.g2o {options} --final-batch --report out.json")).done();
        errors.push(number(&folder.json("out.json"), "error"));
    }
    assert!(errors.iter().all(|error| (error - errors[0]).abs() < 1e-9), "{errors:?}");
    assert_eq!(errors[8].to_bits(), errors[9].to_bits());
    folder.run("replay square.g2o --relinearize never --report out.json").done();
    assert_eq!(folder.json("out.json")["relinearizations"], 0);
    folder.run("replay square.g2o --relinearize every --report out.json").done();
    assert_eq!(folder.json("out.json")["settings"]["solver"]["relinearization"]["batch"], 100);
}

#[test]
fn a_kernel_lowers_the_error_and_leaves_chi2_in_its_convention() {
    let folder = Folder::new();
    folder.write("bent.g2o", &SQUARE.replace("3 0 1.05", "3 0 4.05"));
    folder.run("replay bent.g2o --final-batch --report plain.json").done();
    for (option, kernel) in [
        ("--robust", "huber:1.345"),
        ("--robust=huber", "huber:1.345"),
        ("--robust=huber:1.0", "huber:1"),
        ("--robust=pseudo-huber:0.5", "pseudo-huber:0.5"),
        ("--kernel pseudo-huber:1.0", "pseudo-huber:1"),
    ] {
        folder.run(&format!("replay bent.g2o --final-batch {option} --report out.json")).done();
        let (plain, robust) = (folder.json("plain.json"), folder.json("out.json"));
        assert_eq!(robust["settings"]["kernel"], kernel);
        assert!(number(&robust, "error") < number(&plain, "error"));
        assert!(number(&robust, "chi2") > number(&plain, "chi2"));
    }
}

#[test]
fn each_component_gets_a_prior() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    let ran = folder.run("replay two.g2o --report out.json --verbose").done();
    assert!(ran.err.contains("pose 10") && ran.err.contains("pose 20"), "{}", ran.err);
    let report = folder.json("out.json");
    assert_eq!(report["gauge_prior"]["variables"], serde_json::json!([10, 20]));
    assert_eq!(report["factors"], 3);
}

#[test]
fn without_a_prior_the_component_is_named() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    let ran = folder.run("replay two.g2o --prior none --report out.json");
    ran.failed(1, &["two.g2o", "component of pose 10", "3 poses", "--prior"]);
    let report = folder.json("out.json");
    assert_eq!(report["status"], "singular");
    assert_eq!(report["steps"], 0);
    assert!(report["gauge_prior"].is_null());
}

#[test]
fn a_number_whose_square_overflows_is_told_with_its_line() {
    let far = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2_XY 0 0 0 1 0 1\n\
               EDGE_PRIOR_SE2_XY 0 1e160 0 1 0 1\nEDGE_PRIOR_SE2_XY 1 1e160 0 1 0 1\n";
    let folder = Folder::with("far.g2o", far);
    for line in ["replay far.g2o", "replay far.g2o --relinearize never"] {
        let ran = folder.run(&format!("{line} --output map.g2o --report out.json"));
        ran.failed(1, &["far.g2o:3", "`1e160`", "too large"]);
    }
    assert_eq!(folder.list(), ["far.g2o"]);
}

#[test]
fn what_cannot_be_written_leaves_no_file() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("replay square.g2o --output map.xyz").failed(1, &["map.xyz", ".g2o"]);
    folder.run("replay square.g2o --output none/map.g2o").failed(1, &["none/map.g2o", "folder"]);
    folder.write("seen.g2o", "EDGE_SE2_XY 0 1 1 0 1 0 1\n");
    folder.run("replay seen.g2o --output map.graph").failed(1, &["TORO", "landmark"]);
    assert_eq!(folder.list(), ["seen.g2o", "square.g2o"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_device_is_written_and_stays_a_device() {
    use std::os::unix::fs::FileTypeExt;
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("replay square.g2o --report /dev/null --steps /dev/null").done();
    assert!(std::fs::metadata("/dev/null").unwrap().file_type().is_char_device());
}

#[test]
fn a_report_that_cannot_be_written_is_found_before_the_work() {
    let folder = Folder::with("square.g2o", SQUARE);
    let ran = folder.run("replay square.g2o --output map.g2o --report none/report.json");
    ran.failed(1, &["none/report.json", "folder"]);
    assert_eq!(folder.list(), ["square.g2o"]);
}

#[test]
fn the_output_of_a_cut_replay_keeps_how_the_file_was_read() {
    // Rotation weights in g2o's half angles, which TORO writes in radians: 400 becomes 100.
    let folder = Folder::with(
        "chain.g2o",
        "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 400 0 0 400 0 400\n\
         EDGE_SE3:QUAT 1 2 1 0 0 0 0 0 1 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 400 0 0 400 0 400\n",
    );
    folder.run("replay chain.g2o --g2o-rotation quaternion --max-steps 2 --output cut.toro").done();
    let cut = folder.read("cut.toro");
    let edges: Vec<&str> = cut.lines().filter(|line| line.starts_with("EDGE3")).collect();
    assert_eq!(edges.len(), 1, "{cut}");
    assert!(edges[0].ends_with(" 100 0 0 100 0 100"), "{cut}");
}

#[test]
fn the_output_of_a_cut_replay_holds_what_came_in() {
    let folder = Folder::with("chain.g2o", &format!("{TWO_PARTS}FIX 10\n"));
    folder.run("replay chain.g2o --max-steps 1 --output one.g2o").done();
    let one = folder.read("one.g2o");
    assert_eq!(one.lines().filter(|line| line.starts_with("VERTEX_SE2 10 ")).count(), 1, "{one}");
    assert!(one.contains("FIX 10") && !one.contains("EDGE"), "{one}");
    folder.run("info one.g2o").done();
}

#[test]
fn two_outputs_cannot_be_one_file() {
    let folder = Folder::with("square.g2o", SQUARE);
    let line = "replay square.g2o --report a.json --steps ./a.json";
    folder.run(line).failed(2, &["two of the files to write are ./a.json"]);
    assert_eq!(folder.list(), ["square.g2o"]);
    folder.run("replay square.g2o --report /dev/null --steps /dev/null").done();
}
