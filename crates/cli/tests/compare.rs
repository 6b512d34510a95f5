//! `evergraph compare`.

mod common;

use common::{Folder, SQUARE, check_reduction as check, number};
use serde_json::Value;

/// A second component beside [`SQUARE`], with a landmark, and one of the square's own.
const AND_CHAIN: &str = "\
VERTEX_XY 7 0.5 0.5
VERTEX_SE2 20 5 0 0
VERTEX_SE2 21 6 0 0.1
VERTEX_SE2 22 7 0.1 0.2
VERTEX_XY 27 6.5 0.5
EDGE_SE2_XY 0 7 0.5 0.5 50 0 50
EDGE_SE2_XY 2 7 0.5 0.6 50 0 50
EDGE_SE2 20 21 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 21 22 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 22 20 -2 0.1 -0.2 100 0 0 100 0 400
EDGE_SE2_XY 21 27 0.5 0.5 50 0 50
EDGE_SE2_XY 22 27 -0.5 0.6 50 0 50
";

/// A graph without some of its variables and all that was measured of them.
fn without(text: &str, ids: &[u64]) -> String {
    let names_one = |line: &&str| {
        let mut words = line.split(' ');
        let ends = if words.next().is_some_and(|tag| tag.starts_with("EDGE")) { 2 } else { 1 };
        words.take(ends).any(|word| word.parse().is_ok_and(|id| ids.contains(&id)))
    };
    text.lines().filter(|line| !names_one(line)).map(|line| format!("{line}\n")).collect()
}

/// The report of a comparison.
#[track_caller]
fn compared(full: &str, reduced: &str) -> Value {
    let folder = Folder::with("full.g2o", full);
    folder.write("reduced.g2o", reduced);
    folder.run("compare full.g2o reduced.g2o --report out.json").done();
    let report = folder.json("out.json");
    check(&report);
    report
}

#[test]
fn graphs_that_do_not_belong_together() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.write(
        "other.g2o",
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 9 1 0 0\nEDGE_SE2 0 9 1 0 0 1 0 0 1 0 1\n",
    );
    folder
        .run("compare square.g2o other.g2o")
        .failed(1, &["other.g2o", "no reduced graph of square.g2o", "9 is not"]);
    // Links were dropped: what was known between the parts is gone.
    let broken: String = SQUARE
        .lines()
        .filter(|line| !line.starts_with("EDGE_SE2 1") && !line.starts_with("EDGE_SE2 3"))
        .map(|line| format!("{line}\n"))
        .collect();
    folder.write("broken.g2o", &broken);
    folder.run("compare square.g2o broken.g2o").failed(1, &["broken.g2o", "2 parts"]);
    let landmark = "VERTEX_SE2 0 0 0 0\nVERTEX_XY 1 1 0\nEDGE_SE2_XY 0 1 1 0 1 0 1\n";
    folder.write("kinds.g2o", landmark);
    folder.run("compare square.g2o kinds.g2o").failed(1, &["kinds.g2o", "a landmark in the other"]);
}

/// Another program may have removed the pose that we hold.
#[test]
fn the_anchor_moves_with_the_reduced_graph() {
    let folder = Folder::with("square.g2o", SQUARE);
    // The chain 1 to 3 of it: what 0 knew is lost, and nothing else.
    let of_0 = |line: &&str| line.starts_with("VERTEX_SE2 0") || line.starts_with("EDGE_SE2 0");
    let rest: String = SQUARE
        .lines()
        .filter(|line| !of_0(line) && !line.starts_with("EDGE_SE2 3 0"))
        .map(|line| format!("{line}\n"))
        .collect();
    folder.write("rest.g2o", &rest);
    folder.run("compare square.g2o rest.g2o --report out.json").done();
    let report = folder.json("out.json");
    check(&report);
    assert!(number(&report, "kld_covariance") > 1e-3, "{report}");
    assert!(number(&report, "kld_covariance") < 10.0, "{report}");
    assert_eq!(report["removed"], 1);
}

/// What is left of the others is measured as if the component had never been there.
#[test]
fn a_component_that_is_gone_as_a_whole_has_nothing_to_be_compared() {
    let full = SQUARE.to_string() + AND_CHAIN;
    let chain = [20, 21, 22, 27];
    let square = [0, 1, 2, 3, 7];
    // The gauge prior stays on the first pose, or moves with it.
    for (gone, also) in [
        (&chain[..], &[][..]),
        (&chain, &[7]),
        (&chain, &[3]),
        (&chain, &[0]),
        (&chain, &[0, 7]),
        (&square, &[]),
        (&square, &[27]),
        (&square, &[20]),
        (&square, &[20, 27]),
    ] {
        let rest = without(&full, gone);
        let reduced = without(&rest, also);
        let both = compared(&full, &reduced);
        let alone = compared(&rest, &reduced);
        assert_eq!((&both["components_gone"], &alone["components_gone"]), (&1.into(), &0.into()));
        assert_eq!(number(&both, "removed"), number(&alone, "removed") + gone.len() as f64);
        assert_eq!(both["degrees_of_freedom"], alone["degrees_of_freedom"]);
        assert_eq!(number(&both, "kld_covariance") > 1e-3, !also.is_empty(), "{also:?}: {both}");
        for field in ["kld_covariance", "kld_mean", "log_det_ratio", "max_shift_m"] {
            let (both, alone) = (number(&both, field), number(&alone, field));
            assert!(
                (both - alone).abs() < 1e-9 * (1.0 + alone.abs()),
                "{also:?}: {field} {both} {alone}"
            );
        }
    }
}

/// Where both components are kept, what each of them lost adds up, whichever gauge priors move.
#[test]
fn components_are_anchored_one_by_one() {
    let full = SQUARE.to_string() + AND_CHAIN;
    let loss = |gone: &[u64]| number(&compared(&full, &without(&full, gone)), "kld_covariance");
    for (square, chain) in [(3, 22), (0, 22), (3, 20), (0, 20)] {
        let both = loss(&[square, chain]);
        let sum = loss(&[square]) + loss(&[chain]);
        assert!((both - sum).abs() < 1e-9 * sum && sum > 1e-3, "{both} {sum}");
    }
}

#[test]
fn a_component_in_pieces_is_refused_beside_one_that_is_gone() {
    let full = SQUARE.to_string() + AND_CHAIN;
    let folder = Folder::with("full.g2o", &full);
    let without_edges = |text: &str, edges: &[&str]| -> String {
        let cut = |line: &&str| !edges.iter().any(|edge| line.starts_with(edge));
        text.lines().filter(cut).map(|line| format!("{line}\n")).collect()
    };
    let square = without(&full, &[7, 20, 21, 22, 27]);
    let pieces = without_edges(&square, &["EDGE_SE2 1", "EDGE_SE2 3"]);
    folder.write("pieces.g2o", &pieces);
    folder
        .run("compare full.g2o pieces.g2o")
        .failed(1, &["pieces.g2o", "2 parts", "poses 0, 2", "is lost"]);
    // As many priors as the full graph has, but of one component.
    folder.write("lone.g2o", &without_edges(&square, &["EDGE_SE2 2 3", "EDGE_SE2 3 0"]));
    folder.run("compare full.g2o lone.g2o").failed(1, &["lone.g2o", "2 parts", "poses 0, 3"]);
}

/// What holds a component in the world may be gone with it, but not from it.
#[test]
fn components_that_measurements_of_the_world_hold() {
    let held = SQUARE.to_string() + AND_CHAIN + "EDGE_PRIOR_SE2 20 3 1 0 100 0 0 100 0 400\n";
    let rest = without(&held, &[20, 21, 22, 27]);
    let report = compared(&held, &rest);
    assert_eq!(report["components_gone"], 1);
    assert!(number(&report, "kld_covariance").abs() < 1e-9, "{report}");

    let folder = Folder::with("full.g2o", &held);
    let loose: String = held
        .lines()
        .filter(|line| !line.starts_with("EDGE_PRIOR"))
        .map(|line| format!("{line}\n"))
        .collect();
    folder.write("loose.g2o", &loose);
    folder
        .run("compare full.g2o loose.g2o")
        .failed(1, &["loose.g2o", "where the part of pose 20 lies", "measurements"]);
}

/// A world with closures that are false.
fn with_outliers(folder: &Folder) -> String {
    folder.run("simulate manhattan --poses 150 --seed 4 --output world.g2o").done();
    let mut text = folder.read("world.g2o");
    for (from, to) in [(10, 90), (25, 140), (40, 77), (61, 120), (3, 132)] {
        text.push_str(&format!("EDGE_SE2 {from} {to} 1 0.5 0.3 400 0 0 400 0 2500\n"));
    }
    text
}

/// `remove` writes kernels and frozen weights into the file; the option adds nothing to those.
#[test]
fn robust_graphs_are_compared_as_they_were_when_nodes_were_removed() {
    let folder = Folder::new();
    let text = with_outliers(&folder);
    folder.write("noisy.g2o", &text);
    for (kernel, recovery) in [
        ("--robust", "glc"),
        ("--robust=huber:0.5", "glc"),
        ("--robust=pseudo-huber:0.7", "glc"),
        ("--robust=huber:0.5", "nonlinear"),
    ] {
        let removed = format!(
            "remove noisy.g2o {kernel} --recovery {recovery} --topology tree --fraction 0.4 --order min-degree"
        );
        folder.run(&format!("{removed} --output half.g2o --report removed.json")).done();
        let half = folder.read("half.g2o");
        let summary = if recovery == "glc" { "\nFACTOR_LINEAR" } else { "\nEDGE_SE2" };
        assert!(half.contains("\nROBUST") && half.contains(summary), "{half}");
        folder.run(&format!("compare noisy.g2o half.g2o {kernel} --report compared.json")).done();
        let (removed, compared) = (folder.json("removed.json"), folder.json("compared.json"));
        check(&compared);
        assert!(number(&removed, "kld_covariance") > 0.1, "{removed}");
        for field in ["kld_covariance", "kld_covariance_per_dof", "kld_total", "log_det_ratio"] {
            let (removed, compared) = (number(&removed, field), number(&compared, field));
            let off = (removed - compared).abs();
            assert!(off < 1e-6 * removed.abs(), "{kernel}: {field} {removed} {compared}");
        }
        assert!(number(&compared, "max_shift_m") < 1e-4, "{compared}");
        if recovery == "nonlinear" {
            continue;
        }
        // Linear factors say by themselves that they stand for others.
        folder.run("optimize half.g2o --report bare.json").done();
        folder.run(&format!("optimize half.g2o {kernel} --report again.json")).done();
        let [bare, again] = ["bare.json", "again.json"].map(|name| folder.json(name));
        assert_eq!(number(&bare, "error"), number(&again, "error"));
    }
}

/// Linear factors on many poses and landmarks at once hold the parts of a file together.
#[test]
fn dense_factors_are_read_back_as_what_they_are() {
    let folder = Folder::new();
    for world in ["manhattan --poses 120 --seed 3", "manhattan --poses 60 --seed 3 --landmarks"] {
        folder.run(&format!("simulate {world} --output full.g2o")).done();
        for topology in ["auto", "dense"] {
            let remove =
                format!("remove full.g2o --keep-every 3 --topology {topology} --output half.g2o");
            folder.run(&remove).done();
            let ran = folder.run("optimize half.g2o").done();
            assert!(!ran.err.contains("weak prior"), "{world} {topology}: {}", ran.err);
            folder.run("compare full.g2o half.g2o --report out.json").done();
            let report = folder.json("out.json");
            assert!(topology == "auto" || number(&report, "kld_total").abs() < 1e-6, "{report}");
        }
    }
}

/// A tree claims too much, and is told where; a conservative one is not.
#[test]
fn overconfidence_is_told_with_its_place() {
    let folder = Folder::new();
    folder.run("simulate manhattan --poses 200 --seed 3 --output full.g2o").done();
    let remove =
        "remove full.g2o --fraction 0.5 --topology tree --output half.g2o --report out.json";
    let told = folder.run(remove).done().out;
    assert!(told.contains("no: ") && told.contains(" marginals are too small"), "{told}");
    assert_eq!(folder.json("out.json")["is_conservative"], false);
    folder.run(&format!("{remove} --consistency conservative")).done();
    let report = folder.json("out.json");
    assert_eq!(report["is_conservative"], true, "{report}");
    assert!(number(&report, "log_det_ratio") > 0.0);
    assert!(number(&report["certificates"], "largest_eigenvalue") <= 1.0 + 1e-9);
    folder.run("compare full.g2o half.g2o --report out.json").done();
    assert_eq!(folder.json("out.json")["is_conservative"], true);
}
