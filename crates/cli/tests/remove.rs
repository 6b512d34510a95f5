//! `evergraph remove`.

mod common;

use std::path::PathBuf;

use common::{Folder, SQUARE, TWO_PARTS, check_reduction as check, number, sample};
use serde_json::Value;

/// Intel, where the data is at hand.
fn intel() -> Option<String> {
    let folder = std::env::var_os("EVERGRAPH_DATA")?;
    Some(PathBuf::from(folder).join("pose2d/intel.g2o").display().to_string())
}

/// The times of each node, too.
#[track_caller]
fn check_times(report: &Value) {
    for field in ["time_per_node_ms", "plan_ms", "apply_ms"] {
        let times = &report[field];
        let [mean, p50, p99, max] = ["mean", "p50", "p99", "max"].map(|it| number(times, it));
        assert!(0.0 < p50 && p50 <= p99 && p99 <= max && 0.0 < mean && mean <= max, "{times}");
    }
}

#[test]
fn a_tree_of_half_of_intel() {
    let Some(file) = intel() else { return };
    let folder = Folder::new();
    let ran = folder
        .run(&format!("remove {file} --fraction 0.5 --seed 1 --output half.g2o --report out.json"))
        .done();
    for part in ["864 nodes", "kept for rank", "sum of prices", "KLD, covariance", "shift [m]"] {
        assert!(ran.out.contains(part), "{}", ran.out);
    }
    let report = folder.json("out.json");
    check(&report);
    check_times(&report);
    assert_eq!((&report["removed"], &report["variables_after"]), (&864.into(), &864.into()));
    assert_eq!(report["kept"], Value::Array(Vec::new()));
    assert_eq!(report["removed_ids"].as_array().map(Vec::len), Some(864));
    let kld = number(&report, "kld_covariance");
    assert!(kld > 1.0 && number(&report, "price_sum") > 0.3 * kld, "{report}");
    assert!(number(&report, "price_sum") < 3.0 * kld, "{report}");
    assert!(number(&report, "max_shift_m") < 1e-5, "{report}");

    // Read again, the two files differ by the same.
    folder.run(&format!("compare {file} half.g2o --report again.json")).done();
    let again = folder.json("again.json");
    check(&again);
    assert!((number(&again, "kld_covariance") - kld).abs() < 1e-4 * kld, "{again}");
    assert!(number(&again, "max_shift_m") < 1e-5);
    assert_eq!(again["factors_after"], report["factors_after"]);
}

#[test]
fn dense_removal_at_the_optimum_loses_nothing() {
    let Some(file) = intel() else { return };
    let folder = Folder::new();
    let line = "--fraction 0.1 --topology dense --report out.json";
    folder.run(&format!("remove {file} {line}")).done();
    let report = folder.json("out.json");
    check(&report);
    assert!(number(&report, "kld_covariance").abs() < 1e-6, "{report}");
    assert!(number(&report, "price_sum").abs() < 1e-6, "{report}");
    assert!(number(&report, "max_shift_m") < 1e-5, "{report}");
}

#[test]
fn modes_orders_and_choices() {
    let folder = Folder::new();
    let file = sample("manhattan-landmarks.g2o");
    let mut loss = Vec::new();
    for options in [
        "--fraction 0.05 --order min-loss",
        "--fraction 0.05 --order min-degree",
        "--fraction 0.05",
        "--fraction 0.05 --recovery nonlinear",
        "--fraction 0.05 --mode isam",
        "--fraction 0.05 --offset paper",
        "--fraction 0.05 --no-price --relinearize never",
    ] {
        folder.run(&format!("remove {file} {options} --report out.json")).done();
        let report = folder.json("out.json");
        check(&report);
        loss.push((options, number(&report, "kld_covariance"), number(&report, "max_shift_m")));
        assert_eq!(report["price_sum"].is_null(), options.contains("no-price"), "{report}");
    }
    // The same nodes are chosen each time; chance is no better than looking.
    assert!(loss[0].1 < loss[2].1 && loss[1].1 < loss[2].1, "{loss:?}");
    for (options, _, shift) in &loss {
        let moves = options.contains("isam") || options.contains("paper");
        assert_eq!(*shift > 1e-5, moves, "{loss:?}");
    }
}

#[test]
fn poses_are_kept_one_in_k() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("remove square.g2o --keep-every 2 --report out.json --output out.g2o").done();
    let report = folder.json("out.json");
    check(&report);
    let mut ids: Vec<u64> = report["removed_ids"]
        .as_array()
        .map(|ids| ids.iter().filter_map(Value::as_u64).collect())
        .unwrap_or_default();
    ids.sort_unstable();
    assert_eq!(ids, [1, 3]);
    let text = folder.read("out.g2o");
    assert!(text.contains("VERTEX_SE2 0 ") && text.contains("VERTEX_SE2 2 "), "{text}");
    assert!(!text.contains("VERTEX_SE2 1 ") && !text.contains("VERTEX_SE2 3 "), "{text}");
}

#[test]
fn a_list_is_followed_in_its_order() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.write("list.txt", "# nodes\n3\n\n1\r\n");
    folder.run("remove square.g2o --nodes list.txt --report out.json").done();
    let report = folder.json("out.json");
    assert_eq!(report["removed_ids"], Value::from(vec![3, 1]));
    assert_eq!(report["settings"]["order"], "given");
}

/// As PyFactorGraph files have them, as messages print them, and as numbers.
#[test]
fn a_list_may_name_nodes() {
    let text = "\
VERTEX_SE2 0 A0 0 0 0
VERTEX_SE2 1 A1 1 0 0
VERTEX_SE2 2 A12 2 0 0
VERTEX_XY L0 1 1
EDGE_SE2 1 A0 A1 1 0 0 0.01 0 0 0.01 0 0.0025
EDGE_SE2 2 A1 A12 1 0 0 0.01 0 0 0.01 0 0.0025
EDGE_SE2_XY 1 A0 L0 1 1 0.01 0 0.01
EDGE_SE2_XY 2 A12 L0 -1 1 0.01 0 0.01
";
    let folder = Folder::with("map.pyfg", text);
    let (a1, a12, l0) = (65_u64 << 56 | 1, 65_u64 << 56 | 12, 76_u64 << 56);
    for list in [
        "L0\nA12\n".to_string(),
        format!("{l0}\nA12\r\n"),
        format!("# as printed\nL0 ({l0})\n  A12 ({a12})  \n"),
    ] {
        folder.write("list.txt", &list);
        folder.run("remove map.pyfg --nodes list.txt --report out.json").done();
        assert_eq!(folder.json("out.json")["removed_ids"], Value::from(vec![l0, a12]), "{list}");
    }
    for (list, parts) in [
        ("A1\nA2\n".into(), ["list.txt:2", "A2 (4683743612465315842) is no variable of map.pyfg"]),
        ("A1\nA01\n".into(), ["list.txt:2", "`A01` is not an id"]),
        ("A1\n\nL0 (7)\n".into(), ["list.txt:3", "`L0 (7)` is not an id"]),
        (format!("A1\n{a1}\n"), ["list.txt:2", "was given before, in line 1"]),
        ("A1\nA0\n".into(), ["list.txt:2", "holds the gauge"]),
    ] {
        folder.write("list.txt", &list);
        folder.run("remove map.pyfg --nodes list.txt").failed(1, &parts);
    }
}

#[test]
fn a_list_that_makes_no_sense_is_told_by_line() {
    let folder = Folder::with("square.g2o", SQUARE);
    for (list, parts) in [
        ("1\nthree\n", ["list.txt:2", "`three` is not an id"]),
        ("1\n2 3\n", ["list.txt:2", "`2 3` is not an id"]),
        ("1\n\n-2\n", ["list.txt:3", "`-2` is not an id"]),
        ("1\nnan\n", ["list.txt:2", "`nan` is not an id"]),
        ("1\n77\n", ["list.txt:2", "77 is no variable of square.g2o"]),
        ("1\n2\n1\n", ["list.txt:3", "1 was given before, in line 1"]),
        ("0\n", ["list.txt:1", "holds the gauge"]),
        ("# none\n", ["list.txt:1", "no id"]),
        ("1\n\u{0}\n", ["list.txt:2", "is not an id"]),
    ] {
        folder.write("list.txt", list);
        folder.run("remove square.g2o --nodes list.txt --output out.g2o").failed(1, &parts);
    }
    folder
        .run("remove square.g2o --nodes nowhere.txt")
        .failed(1, &["nowhere.txt", "cannot be read"]);
    assert_eq!(folder.list(), ["list.txt", "square.g2o"]);
}

#[test]
fn shares_that_are_none_are_usage_errors() {
    let folder = Folder::with("square.g2o", SQUARE);
    for options in [
        "--fraction 0",
        "--fraction -0.5",
        "--fraction 1.5",
        "--fraction nan",
        "--fraction inf",
        "--fraction half",
        "--keep-every 0",
        "--keep-every 2 --fraction 0.5",
        "",
        "--fraction 0.5 --topology ring",
        "--fraction 0.5 --seed -1",
    ] {
        let ran = folder.run(&format!("remove square.g2o {options}"));
        assert_eq!(ran.code, Some(2), "{options}: {}{}", ran.out, ran.err);
    }
    folder
        .run("remove square.g2o --fraction 0.01")
        .failed(1, &["square.g2o", "nothing is to be removed"]);
}

#[test]
fn bad_files_are_refused_as_elsewhere() {
    let folder = Folder::new();
    let cut = &SQUARE[..SQUARE.len() - 12];
    let bad = format!("{SQUARE}EDGE_SE2 0 2 nan 0 0 1 0 0 1 0 1\n");
    let huge = format!("{SQUARE}EDGE_SE2 0 2 1e200 0 0 1e200 0 0 1e200 0 1e200\n");
    for (text, parts) in [
        (cut, &["bad.g2o:8", "cut off"][..]),
        (&bad, &["bad.g2o:9", "not finite"]),
        (&huge, &["bad.g2o:9", "too large"]),
        ("", &["no vertex or edge line"]),
    ] {
        folder.write("bad.g2o", text);
        folder.run("remove bad.g2o --fraction 0.5 --output out.g2o").failed(1, parts);
        folder.run("compare bad.g2o bad.g2o").failed(1, parts);
    }
    assert_eq!(folder.list(), ["bad.g2o"]);
}

#[test]
fn parts_that_nothing_ties_together() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    folder.run("remove two.g2o --fraction 1 --report out.json --output out.g2o").done();
    let report = folder.json("out.json");
    check(&report);
    // The first pose of each holds it.
    assert_eq!((&report["removed"], &report["variables_after"]), (&3.into(), &2.into()));
    folder.run("compare two.g2o out.g2o --report again.json").done();
    assert!(number(&folder.json("again.json"), "kld_covariance").abs() < 1e-9);
    folder
        .run("remove two.g2o --fraction 0.5 --prior none")
        .failed(1, &["component of pose 10", "--prior none"]);
}

#[test]
fn the_last_pose_stays() {
    // Priors hold it, so that there is no gauge prior and every pose could go.
    let text = "\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_XY 7 2 1
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400
EDGE_PRIOR_SE2 0 0 0 0 100 0 0 100 0 400
EDGE_SE2_XY 0 7 2 1 10 0 10
EDGE_SE2_XY 1 7 1 1 10 0 10
";
    let folder = Folder::with("line.g2o", text);
    folder.write("list.txt", "1\n0\n");
    let ran = folder.run("remove line.g2o --nodes list.txt --report out.json").done();
    assert!(ran.out.contains("kept, the last pose"), "{}", ran.out);
    let report = folder.json("out.json");
    check(&report);
    let kept = &report["kept"][0];
    assert_eq!((&kept["variable"], &kept["reason"]), (&0.into(), &"last_pose".into()), "{report}");
    assert!(kept["message"].as_str().is_some_and(|it| it.contains("last pose")));
    assert_eq!(report["removed"], 1);
}

#[test]
fn what_a_format_cannot_hold_is_told() {
    let folder = Folder::with("square.g2o", SQUARE);
    for name in ["out.graph", "out.txt", "out.pyfg"] {
        folder
            .run(&format!("remove square.g2o --keep-every 2 --output {name}"))
            .failed(2, &["generic linear constraints", name, "--recovery nonlinear"]);
    }
    folder.run("remove square.g2o --keep-every 2 --output out.xyz").failed(1, &["extension"]);
    assert_eq!(folder.list(), ["square.g2o"]);
    // Ordinary edges fit into any.
    folder.run("remove square.g2o --keep-every 3 --recovery nonlinear --output out.graph").done();
    folder.run("compare square.g2o out.graph --report out.json").done();
    check(&folder.json("out.json"));
}

#[test]
fn what_is_read_is_not_written_over() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.write("other.g2o", SQUARE);
    folder.write("list.txt", "2\n");
    for line in [
        "remove square.g2o --keep-every 2 --report square.g2o",
        "remove square.g2o --keep-every 2 --output square.g2o",
        "remove square.g2o --nodes list.txt --report list.txt",
        "compare square.g2o other.g2o --report other.g2o",
    ] {
        folder.run(line).failed(2, &["is read here"]);
    }
    assert_eq!(folder.read("square.g2o"), SQUARE);
    assert_eq!(folder.read("other.g2o"), SQUARE);
}

/// Whatever the order, a node with too many neighbours is passed over and listed.
#[test]
fn large_blankets_stay() {
    let folder = Folder::new();
    let file = sample("manhattan-landmarks.g2o");
    for order in ["random", "min-loss", "given"] {
        let line = "--fraction 0.4 --largest-blanket 9 --report out.json";
        let ran = folder.run(&format!("remove {file} --order {order} {line}")).done();
        let report = folder.json("out.json");
        check(&report);
        assert!(number(&report, "largest_blanket") <= 4.0, "{order}");
        if order == "min-loss" {
            continue;
        }
        let large = |it: &&Value| it["reason"] == "large_blanket";
        let kept: Vec<&Value> = report["kept"].as_array().unwrap().iter().filter(large).collect();
        assert!(!kept.is_empty(), "{order}: {report}");
        let told = kept[0]["message"].as_str().unwrap();
        assert!(told.contains("--largest-blanket"), "{told}");
        // They are counted apart from those that the map would lose rank without.
        assert_eq!(report["kept_counts"]["large_blanket"], kept.len());
        assert_eq!(report["kept_counts"]["rank"], 0);
        let row = |of: &str| {
            let row = ran.out.lines().find(|line| line.contains(of));
            row.unwrap_or_else(|| panic!("{of} is not in {}", ran.out)).to_string()
        };
        assert!(row("--largest-blanket 9").contains(&format!(" {}: ", kept.len())));
        assert!(row("kept for rank").contains(" 0 "));
    }
}

#[test]
fn composition_says_what_it_cannot_do() {
    let folder = Folder::new();
    let file = sample("manhattan-landmarks.g2o");
    folder
        .run(&format!("remove {file} --fraction 0.05 --recovery composition --topology dense"))
        .failed(1, &["edges on a tree"]);
    folder
        .run(&format!("remove {file} --fraction 0.05 --recovery composition"))
        .failed(1, &["cannot be composed", "glc"]);
}

#[test]
fn removal_may_begin_before_the_optimum() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("remove square.g2o --keep-every 2 --no-optimize --report out.json").done();
    let report = folder.json("out.json");
    check(&report);
    assert_eq!(report["settings"]["optimized_first"], false);
}
