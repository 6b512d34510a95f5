//! `evergraph evaluate`, `evergraph audit`, and `--trajectory`.

mod common;

use common::{Folder, SQUARE, TWO_PARTS, number, sample};

const TRUTH: &str = "\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2 0 0
VERTEX_SE2 3 2 1 0
VERTEX_XY 9 5 5
";

#[test]
fn errors_are_those_of_the_definitions() {
    let folder = Folder::with("truth.g2o", TRUTH);
    // Pose 2 is 0.3 m off; the landmark is 0.5 m off; landmark 10 is not in the truth.
    let moved = TRUTH.replace("2 2 0 0", "2 2.3 0 0").replace("9 5 5", "9 5.3 5.4");
    folder.write("map.g2o", &format!("{moved}VERTEX_XY 10 1 1\n"));
    let ran =
        folder.run("evaluate map.g2o --truth truth.g2o --align none --report out.json").done();
    for part in ["map.g2o", "truth.g2o", "4 of 4", "ATE", "RPE", "by id", "none"] {
        assert!(ran.out.contains(part), "{part} is not in {}", ran.out);
    }
    let report = folder.json("out.json");
    assert_eq!((&report["command"], &report["dataset"]), (&"evaluate".into(), &"map.g2o".into()));
    let near = |x: f64, expected: f64| assert!((x - expected).abs() < 1e-12, "{x}, not {expected}");
    let ate = &report["ate"]["translation"];
    near(number(ate, "rmse"), 0.15);
    near(number(ate, "max"), 0.3);
    near(number(&report["ate"]["rotation"], "max"), 0.0);
    near(number(&report["rpe"]["translation"], "rmse"), 0.3 * (2.0_f64 / 3.0).sqrt());
    near(number(&report["landmarks"]["distance"], "mean"), 0.5);
    assert_eq!(
        (&report["landmarks"]["unknown"], &report["landmarks"]["missing"]),
        (&1.into(), &0.into())
    );
    // Between 0 and 2 the motion is 0.3 m off, between 1 and 3 it is not.
    folder.run("evaluate map.g2o --truth truth.g2o --delta 2 --all-pairs --report out.json").done();
    let report = folder.json("out.json");
    near(number(&report["rpe"]["translation"], "mean"), 0.15);
    assert_eq!(report["rpe"]["translation"]["count"], 2);
}

#[test]
fn alignments_take_out_what_they_may() {
    let folder = Folder::with("truth.g2o", TRUTH);
    let turned = "VERTEX_SE2 0 5 5 1.5707963267948966\nVERTEX_SE2 1 5 7 1.5707963267948966\n\
                  VERTEX_SE2 2 5 9 1.5707963267948966\nVERTEX_SE2 3 3 9 1.5707963267948966\n";
    folder.write("twice.g2o", turned);
    let rmse = |align: &str| {
        let line =
            format!("evaluate twice.g2o --truth truth.g2o --align {align} --report out.json");
        folder.run(&line).done();
        let report = folder.json("out.json");
        (number(&report["ate"]["translation"], "rmse"), number(&report["alignment"], "scale"))
    };
    let (none, first, rigid, scale) = (rmse("none"), rmse("first"), rmse("rigid"), rmse("scale"));
    assert!(none.0 > first.0 && first.0 > rigid.0 && rigid.0 > 0.1, "{none:?} {first:?} {rigid:?}");
    assert!(scale.0 < 1e-12 && (scale.1 - 0.5).abs() < 1e-12 && rigid.1 == 1.0, "{scale:?}");
}

#[test]
fn trajectories_are_paired_by_time() {
    let folder =
        Folder::with("truth.tum", "10 0 0 0 0 0 0 1\n11 1 0 0 0 0 0 1\n12 1 1 0 0 0 0 1\n");
    folder.write("map.tum", "10.05 0 0 0 0 0 0 1\n11.05 1 0 0 0 0 0 1\n12.05 1 1 0 0 0 0 1\n");
    let line = "evaluate map.tum --truth truth.tum --report out.json";
    folder.run(line).failed(1, &["map.tum", "truth.tum", "partner"]);
    folder.run(&format!("{line} --max-difference 0.1")).done();
    assert_eq!(folder.json("out.json")["poses"]["matched"], 3);
}

#[test]
fn what_a_solver_writes_can_be_evaluated() {
    let folder = Folder::new();
    folder.run("simulate manhattan --poses 300 --seed 3 --output w.g2o --truth t.g2o").done();
    folder.run("optimize w.g2o --output map.g2o --trajectory map.tum --quiet").done();
    folder.run("replay w.g2o --final-batch --trajectory map.kitti --quiet").done();
    let rmse = |map: &str| {
        folder.run(&format!("evaluate {map} --truth t.g2o --report out.json")).done();
        number(&folder.json("out.json")["ate"]["translation"], "rmse")
    };
    let (graph, tum, kitti) = (rmse("map.g2o"), rmse("map.tum"), rmse("map.kitti"));
    assert!(graph > 1e-4 && graph < 1.0, "{graph}");
    assert!((graph - tum).abs() < 1e-9 && (graph - kitti).abs() < 1e-6, "{graph} {tum} {kitti}");
    // The guess is worse than what optimization made of it.
    assert!(rmse("w.g2o") > graph);
    assert_eq!(folder.read("map.kitti").lines().count(), 300);
}

#[test]
fn times_come_from_a_file_of_their_own() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.write("times.csv", "id,timestamp\n0,100.5\n1,101.5\n2,102.5\n3,103.5\n");
    folder.run("optimize square.g2o --trajectory map.tum --times times.csv").done();
    let text = folder.read("map.tum");
    let times: Vec<&str> = text.lines().filter_map(|line| line.split(' ').next()).collect();
    assert_eq!(times, ["100.5", "101.5", "102.5", "103.5"]);
    // Without times a pose's id stands for it.
    folder.run("replay square.g2o --trajectory map.tum").done();
    assert!(folder.read("map.tum").lines().nth(3).is_some_and(|line| line.starts_with("3 ")));
}

#[test]
fn a_trajectory_that_cannot_be_is_found_before_the_work() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.write("short.csv", "0,1\n1,2\n");
    folder.write("equal.csv", "0,1\n1,2\n2,2\n3,4\n");
    for command in ["replay", "optimize"] {
        let line =
            |rest: &str| format!("{command} square.g2o --output map.g2o --trajectory {rest}");
        folder.run(&line("map.txt")).failed(2, &["map.txt", ".tum or .kitti"]);
        folder.run(&line("none/map.tum")).failed(1, &["none/map.tum", "folder"]);
        folder.run(&line("map.tum --times none.csv")).failed(1, &["none.csv"]);
        folder.run(&line("map.tum --times short.csv")).failed(1, &["pose 2", "short.csv"]);
        folder.run(&line("map.tum --times equal.csv")).failed(1, &["same time 2"]);
        folder.run(&format!("{command} square.g2o --times short.csv")).failed(2, &["--trajectory"]);
    }
    assert_eq!(folder.list(), ["equal.csv", "short.csv", "square.g2o"]);
}

#[test]
fn bad_evaluations_say_why() {
    let folder = Folder::with("truth.g2o", TRUTH);
    folder.write("map.g2o", TRUTH);
    for (line, part) in [
        ("evaluate map.g2o", "--truth"),
        ("evaluate map.g2o --truth truth.g2o --align maybe", "maybe"),
        ("evaluate map.g2o --truth truth.g2o --delta 0", "--delta"),
        ("evaluate map.g2o --truth truth.g2o --max-difference -1", "--max-difference"),
        ("audit map.g2o --every 0", "--every"),
        ("audit map.g2o --relinearize never --fluid-every 3", "evergraph audit"),
        ("audit", "FILE"),
    ] {
        folder.run(line).failed(2, &[part]);
    }
    folder.run("evaluate none.g2o --truth truth.g2o").failed(1, &["none.g2o", "cannot be read"]);
    folder.run("evaluate map.g2o --truth truth.g2o --delta 9").failed(1, &["9 apart"]);
    folder.run("evaluate map.g2o --truth truth.g2o --report no/r.json").failed(1, &["no/r.json"]);
    assert_eq!(folder.list(), ["map.g2o", "truth.g2o"]);
}

#[test]
fn an_audit_compares_along_the_way() {
    let folder = Folder::new();
    let file = sample("manhattan3500.g2o");
    folder.run("simulate manhattan --poses 250 --seed 2 --output w.g2o").done();
    let ran = folder.run("audit w.g2o --every 100 --steps a.csv --report out.json").done();
    assert!(ran.out.contains("3 times") && ran.out.contains("worst"), "{}", ran.out);
    let text = folder.read("a.csv");
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines[0], ["step", "error", "optimum", "relative_excess", "status"]);
    let steps: Vec<&str> = lines[1..].iter().map(|line| line[0]).collect();
    assert_eq!(steps, ["100", "200", "250"]);
    let report = folder.json("out.json");
    let parse = |text: &str| text.parse::<f64>().unwrap();
    let excesses: Vec<f64> = lines[1..].iter().map(|line| parse(line[3])).collect();
    for line in &lines[1..] {
        let (error, optimum) = (parse(line[1]), parse(line[2]));
        assert!(
            (parse(line[3]) - (error - optimum) / optimum).abs() < 1e-12 && line[4] == "converged"
        );
    }
    assert!(excesses.iter().all(|x| (-1e-9..1e-2).contains(x)), "{excesses:?}");
    let mean = excesses.iter().sum::<f64>() / 3.0;
    assert!((number(&report, "mean_relative_excess") - mean).abs() < 1e-12);
    let worst = excesses.iter().fold(f64::MIN, |a, &b| a.max(b));
    let reported = number(&report["worst"], "relative_excess");
    assert!((reported - worst).abs() <= 1e-15, "{reported} {worst}");
    assert_eq!((&report["steps"], &report["every"]), (&250.into(), &100.into()));

    // Linearization points that never move leave more to gain.
    folder.run("audit w.g2o --every 100 --relinearize never --report never.json").done();
    let never = number(&folder.json("never.json"), "mean_relative_excess");
    assert!(never > 2.0 * mean.max(1e-9), "{never} and {mean}");
    folder.run(&format!("audit {file} --steps none/a.csv")).failed(1, &["none/a.csv", "folder"]);
    folder.write("two.g2o", TWO_PARTS);
    folder.run("audit two.g2o --prior none").failed(1, &["two.g2o", "--prior none"]);
}

#[test]
fn bad_lines_of_either_map_are_told() {
    let folder = Folder::with("map.g2o", "VERTEX_SE2 0 0 0 0\nODD 1\nVERTEX_SE2 1 1 0 0\n");
    folder.write("truth.g2o", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 nan 0 0\n");
    folder.run("evaluate map.g2o --truth truth.g2o").failed(1, &["map.g2o:2"]);
    let ran = folder.run("evaluate map.g2o --truth truth.g2o --lenient").done();
    assert!(ran.err.contains("map.g2o:2") && ran.err.contains("truth.g2o:3"), "{}", ran.err);
    assert_eq!(folder.run("evaluate map.g2o --truth truth.g2o --lenient -q").done().err, "");
}

/// `count` lines of a TUM file.
fn tum(count: usize, line: impl Fn(f64) -> [f64; 3]) -> String {
    let pose = |k| {
        let [x, y, z] = line(f64::from(k));
        format!("{k} {x} {y} {z} 0 0 0 1\n")
    };
    (0..count as u32).map(pose).collect()
}

#[test]
fn a_robot_that_stands_still_gets_no_scale_and_a_warning() {
    let folder = Folder::new();
    // Rounding of the mean must not be taken for a shape.
    let still = tum(20, |_| [0.1, 0.2, 0.3]);
    let around = tum(20, |k| [k.cos(), (k * 1.3).sin(), (0.7 * k).sin()]);
    let noise =
        |s: f64| tum(20, move |k| [1.0 + 1e-3 * (s * k).sin(), 1e-3 * (s * k * k).cos(), 2.0]);
    for (estimate, truth) in
        [(&still, &around), (&around, &still), (&still, &still), (&noise(7.3), &noise(3.1))]
    {
        folder.write("map.tum", estimate);
        folder.write("truth.tum", truth);
        for align in ["rigid", "scale"] {
            let line = "evaluate map.tum --truth truth.tum --report out.json --align";
            let ran = folder.run(&format!("{line} {align}")).done();
            assert!(ran.err.contains("determine no rotation"), "{}", ran.err);
            assert_eq!(ran.err.contains("no scale"), align == "scale", "{}", ran.err);
            let report = folder.json("out.json");
            assert_eq!(report["alignment"]["undetermined"], "rotation_and_scale");
            assert_eq!(number(&report["alignment"], "scale"), 1.0);
            assert!(number(&report["ate"]["rotation"], "rmse") < 1e-9);
        }
    }
}

#[test]
fn positions_on_a_line_leave_the_rotation_about_it() {
    let folder = Folder::with("map.tum", &tum(20, |k| [k, 2.0 * k, 0.5 * k]));
    folder.write("truth.tum", &tum(20, |k| [k + 3.0, 2.0 * k, 0.5 * k]));
    let ran = folder.run("evaluate map.tum --truth truth.tum --report out.json").done();
    assert!(ran.err.contains("lie on a line"), "{}", ran.err);
    let report = folder.json("out.json");
    assert_eq!(report["alignment"]["undetermined"], "rotation_about_line");
    assert!(number(&report["ate"]["translation"], "rmse") < 1e-9);
    assert!(number(&report["ate"]["rotation"], "rmse") < 1e-9);
}

#[test]
fn maps_that_cannot_be_compared_are_an_error() {
    let folder = Folder::with("plane.g2o", TRUTH);
    folder.write("space.tum", &tum(4, |k| [k, 0.0, 0.1 * k]));
    folder.write("stamped.tum", "10.25 0 0 0 0 0 0 1\n11.5 1 0 0 0 0 0 1\n");
    for (a, b) in [("plane.g2o", "space.tum"), ("space.tum", "plane.g2o")] {
        let ran = folder.run(&format!("evaluate {a} --truth {b}"));
        ran.failed(1, &["plane.g2o", "space.tum", "poses of the plane", "poses in space"]);
    }
    for (a, b) in [("plane.g2o", "stamped.tum"), ("stamped.tum", "plane.g2o")] {
        let ran = folder.run(&format!("evaluate {a} --truth {b}"));
        ran.failed(1, &["plane.g2o", "stamped.tum", "time stamps", "--times"]);
    }
}
