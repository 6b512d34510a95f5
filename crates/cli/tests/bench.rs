//! `evergraph bench`.

mod common;

use common::{Folder, SQUARE, TWO_PARTS, number, sample};
use serde_json::Value;

const PHASES: [&str; 10] = [
    "stage",
    "detach",
    "linearize",
    "gather",
    "order",
    "symbolic",
    "assemble",
    "eliminate",
    "install",
    "solve",
];

/// The phases of a report, which have to be all of them, and the share outside.
#[track_caller]
fn shares(report: &Value) -> (Vec<f64>, f64) {
    let profile = &report["profile"];
    let phases = profile["phases"].as_array().expect("a profile has phases");
    let names: Vec<&str> = phases.iter().filter_map(|it| it["phase"].as_str()).collect();
    assert_eq!(names, PHASES);
    (phases.iter().map(|it| number(it, "share")).collect(), number(&profile["outside"], "share"))
}

#[test]
fn a_replay_is_profiled_by_phase() {
    let folder = Folder::new();
    let file = sample("manhattan3500.g2o");
    let line = format!("bench {file} --max-steps 200 --repeats 2 --threads 1 --report out.json");
    let ran = folder.run(&line).done();
    for phase in PHASES {
        assert!(ran.out.contains(&format!("│ {phase} ")), "{phase}: {}", ran.out);
    }
    assert!(ran.out.contains("us / step") && ran.out.contains("outside"), "{}", ran.out);
    let report = folder.json("out.json");
    assert_eq!((&report["command"], &report["mode"]), (&"bench".into(), &"replay".into()));
    assert_eq!((&report["steps"], &report["repeats"]), (&200.into(), &2.into()));
    assert_eq!(report["dataset"], "manhattan3500.g2o");
    assert!(number(&report, "cliques_per_step") >= 1.0);
    for field in ["update_s", "mean_ms", "p50_ms", "p99_ms", "max_ms", "total_s"] {
        assert!(number(&report["time"], field) > 0.0, "{field}");
    }
    // The parts are the whole.
    let (phases, outside) = shares(&report);
    let whole: f64 = phases.iter().sum();
    assert!(phases.iter().all(|&share| share > 0.0), "{phases:?}");
    assert!((whole + outside - 1.0).abs() < 1e-9, "{whole} {outside}");
}

/// The profile changes nothing that is computed.
#[test]
fn it_ends_where_a_replay_ends() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("bench square.g2o --repeats 2 --report bench.json").done();
    folder.run("replay square.g2o --report replay.json").done();
    let [bench, replay] = ["bench.json", "replay.json"].map(|name| folder.json(name));
    for field in ["error", "chi2", "steps", "variables", "factors", "relinearizations"] {
        assert_eq!(bench[field], replay[field], "{field}");
    }
}

#[test]
fn a_batch_is_profiled_too() {
    let folder = Folder::with("square.g2o", SQUARE);
    let ran = folder.run("bench square.g2o --batch --report bench.json").done();
    assert!(ran.out.contains("us / iteration"), "{}", ran.out);
    folder.run("optimize square.g2o --report optimize.json").done();
    let [bench, optimize] = ["bench.json", "optimize.json"].map(|name| folder.json(name));
    assert_eq!((&bench["mode"], &bench["repeats"]), (&"batch".into(), &3.into()));
    assert_eq!(bench["batch"]["status"], "converged");
    assert_eq!(bench["batch"]["iterations"], optimize["iterations"]);
    assert_eq!(bench["error"], optimize["error"]);
    assert!(shares(&bench).0.iter().sum::<f64>() > 0.0);
}

#[test]
fn options_that_do_not_go_together_are_refused() {
    let folder = Folder::with("square.g2o", SQUARE);
    for (line, part) in [
        ("bench", "<FILE>"),
        ("bench square.g2o --repeats 0", "--repeats"),
        ("bench square.g2o --batch --relinearize never", "--batch"),
        ("bench square.g2o --batch --fluid-every 3", "--batch"),
        ("bench square.g2o --batch --max-steps 3", "--batch"),
        ("bench square.g2o --relinearize never --fluid-every 3", "--fluid-every"),
    ] {
        folder.run(line).failed(2, &[part]);
    }
}

#[test]
fn a_bad_problem_is_explained() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    folder.run("bench none.g2o").failed(1, &["none.g2o"]);
    for mode in ["", "--batch"] {
        let ran = folder.run(&format!("bench two.g2o --prior none {mode}"));
        ran.failed(1, &["two.g2o", "component of pose 10 lies (3 poses", "--prior none"]);
    }
    folder.run("bench two.g2o --report no/out.json").failed(1, &["no/out.json"]);
}

#[test]
fn shells_complete_it() {
    let folder = Folder::new();
    let ran = folder.run("completions bash").done();
    assert!(ran.out.contains("evergraph,bench)") && ran.out.contains("--repeats"));
}
