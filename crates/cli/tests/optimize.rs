//! `evergraph optimize`.

mod common;

use common::{Folder, SQUARE, TWO_PARTS, number, sample};

/// The reference optima of data/README.md.
#[test]
fn samples_reach_their_optima() {
    let folder = Folder::new();
    for (name, factors, optimum) in [
        ("manhattan3500.g2o", 5720, 3260.124691315),
        ("sphere2500.g2o", 4973, 7394.489497815),
        ("manhattan-landmarks.g2o", 5591, 4599.287073088),
    ] {
        folder.run(&format!("optimize {} --report out.json", sample(name))).done();
        let report = folder.json("out.json");
        let error = number(&report, "error");
        assert!((error / optimum - 1.0).abs() < 1e-9, "{name}: {error}");
        assert_eq!((&report["status"], &report["factors"]), (&"converged".into(), &factors.into()));
    }
}

#[test]
fn methods_and_starts_agree() {
    let folder = Folder::with("square.g2o", SQUARE);
    let mut errors = Vec::new();
    for options in [
        "",
        "--method gn",
        "--method dogleg",
        "--init odometry",
        "--init chordal",
        "--elimination qr",
    ] {
        folder.run(&format!("optimize square.g2o {options} --report out.json")).done();
        let report = folder.json("out.json");
        assert_eq!(report["command"], "optimize");
        assert!(number(&report, "iterations") >= 1.0);
        assert!(number(&report, "gradient_norm") < 1e-3);
        assert!(number(&report, "initial_error") > number(&report, "error"));
        errors.push(number(&report, "error"));
    }
    assert!(errors.iter().all(|error| (error - errors[0]).abs() < 1e-9), "{errors:?}");
}

/// From a start far off: the report says where it came from, and the file's fixed pose stays.
#[test]
fn a_chordal_start_needs_no_vertices() {
    let folder = Folder::new();
    folder
        .run("simulate sphere --poses 400 --odometry-sigmas 0.3,0.3,0.3,0.1,0.1,0.1 -o w.g2o")
        .done();
    let errors = ["file", "chordal"].map(|init| {
        folder.run(&format!("optimize w.g2o --init {init} --report out.json")).done();
        let report = folder.json("out.json");
        assert_eq!(report["settings"]["initial"], init);
        assert_eq!(report["status"], "converged");
        (number(&report, "initial_error"), number(&report, "error"))
    });
    assert!((errors[0].1 / errors[1].1 - 1.0).abs() < 1e-9, "{errors:?}");
    assert!(errors[1].0 < 0.01 * errors[0].0 && errors[1].0 < 3.0 * errors[1].1, "{errors:?}");
    // An iSAM file has no vertices at all.
    folder.run("convert w.g2o w.txt --quiet").done();
    folder.run("optimize w.txt --init chordal --output map.g2o --report out.json").done();
    assert!((number(&folder.json("out.json"), "error") / errors[1].1 - 1.0).abs() < 1e-6);
    let text = folder.read("map.g2o");
    assert_eq!(text.lines().filter(|line| line.starts_with("VERTEX_SE3:QUAT ")).count(), 400);
}

#[test]
fn the_initial_error_is_that_of_the_file() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("optimize square.g2o --report out.json").done();
    folder.run("info square.g2o --report info.json").done();
    let initial = number(&folder.json("out.json"), "initial_error");
    let info = number(&folder.json("info.json")["at_vertices"], "error");
    assert!((initial - info).abs() < 1e-9 * info);
}

#[test]
fn an_optimization_that_is_cut_short_says_so() {
    let folder = Folder::new();
    let file = sample("manhattan3500.g2o");
    let ran = folder.run(&format!("optimize {file} --max-iterations 1 --report out.json")).done();
    assert!(ran.out.contains("not converged (the iterations were used up)"), "{}", ran.out);
    assert_eq!(folder.json("out.json")["status"], "not_converged");
}

#[test]
fn the_output_is_an_optimum() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("optimize square.g2o --output map.g2o --report first.json").done();
    folder.run("optimize map.g2o --report second.json").done();
    let [first, second] = ["first.json", "second.json"].map(|name| folder.json(name));
    assert!((number(&second, "initial_error") - number(&first, "error")).abs() < 1e-9);
}

#[test]
fn without_a_prior_the_component_is_named() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    let ran = folder.run("optimize two.g2o --prior none --report out.json");
    ran.failed(1, &["two.g2o", "component of pose 10 lies (3 poses", "--prior none"]);
    assert_eq!(folder.json("out.json")["status"], "singular");
}
