//! Small graphs whose right answers are known, from GTSAM or by hand.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use common::{Folder, case};
use serde_json::Value;

/// Runs the program on a case; its report and its output file.
fn solved(folder: &Folder, line: &str) -> (Value, String) {
    folder.run(&format!("{line} --report report.json --output out.g2o")).done();
    (folder.json("report.json"), folder.read("out.g2o"))
}

/// The numbers of a vertex.
fn vertex(graph: &str, id: &str) -> Vec<f64> {
    let line = graph.lines().find(|line| {
        let mut words = line.split_whitespace();
        words.next().is_some_and(|tag| tag.starts_with("VERTEX")) && words.next() == Some(id)
    });
    line.unwrap().split_whitespace().skip(2).map(|word| word.parse().unwrap()).collect()
}

#[track_caller]
fn near(actual: &[f64], expected: &[f64], tolerance: f64) {
    let close = |(a, e): (&f64, &f64)| (a - e).abs() <= tolerance;
    assert!(
        actual.len() == expected.len() && actual.iter().zip(expected).all(close),
        "{actual:?} is not {expected:?}"
    );
}

#[track_caller]
fn error_is(report: &Value, expected: f64, tolerance: f64) {
    let error = report["error"].as_f64().unwrap();
    assert!((error - expected).abs() <= tolerance, "{error} is not {expected}");
}

/// Weak measurements are measurements: no prior is put beside them.
#[test]
fn a_gauge_prior_holds_only_what_no_factor_informs() {
    let folder = Folder::new();
    for command in ["optimize", "replay"] {
        for (name, pose, heading) in [("compass.g2o", "0", 0.0), ("weakprior1.g2o", "0", 0.0)] {
            let (report, graph) = solved(&folder, &format!("{command} {}", case(name)));
            error_is(&report, 0.0, 1e-12);
            near(&vertex(&graph, pose)[2..], &[heading], 1e-9);
            assert_eq!(report["gauge_prior"], Value::Null, "{name}");
        }
    }
    let (report, graph) = solved(&folder, &format!("optimize {}", case("weakprior_two.g2o")));
    error_is(&report, 0.007_272_79, 1e-8);
    near(&vertex(&graph, "1")[2..], &[0.054_550_2], 1e-5);
    near(&vertex(&graph, "2")[2..], &[0.127_275], 1e-5);
    let line = format!("optimize {} --method dogleg", case("straight3d_gps.g2o"));
    let (report, _) = solved(&folder, &line);
    error_is(&report, 19.5323, 5e-4);
}

#[test]
fn a_partial_gauge_is_the_same_before_and_after_removal() {
    let folder = Folder::new();
    let file = case("compare_partial_gauge.g2o");
    let remove = format!("remove {file} --fraction 0.5 --topology dense");
    let (removed, _) = solved(&folder, &remove);
    folder.run(&format!("compare {file} out.g2o --report compare.json")).done();
    for report in [removed, folder.json("compare.json")] {
        // The reduced graph's optimum lies elsewhere along the direction that is known least: linear factors
        // do not bend. So the mean is not compared.
        let divergence = report["kld_covariance"].as_f64().unwrap();
        assert!(divergence.abs() < 1e-5, "{divergence}");
    }
}

#[test]
fn fixed_vertices_stay_where_they_are() {
    let folder = Folder::new();
    for command in ["optimize", "replay"] {
        let (report, graph) = solved(&folder, &format!("{command} {}", case("fix_two.g2o")));
        error_is(&report, 62_500.0, 1e-6);
        assert_eq!(vertex(&graph, "0"), [0.0, 0.0, 0.0]);
        assert_eq!(vertex(&graph, "2"), [2.5, 0.0, 0.0]);
        assert!(graph.contains("FIX 0") && graph.contains("FIX 2"), "{graph}");
        assert_eq!((&report["gauge_prior"], &report["fixed"]), (&Value::Null, &2.into()));
        // Its own output is at the optimum.
        folder.write("again.g2o", &graph);
        let (report, again) = solved(&folder, &format!("{command} again.g2o"));
        error_is(&report, 62_500.0, 1e-6);
        near(&vertex(&again, "1"), &vertex(&graph, "1"), 1e-12);

        let (report, graph) = solved(&folder, &format!("{command} {}", case("fix_landmarks.g2o")));
        error_is(&report, 0.0, 1e-12);
        near(&vertex(&graph, "0"), &[3.0, 2.0, 0.3], 1e-6);
        assert_eq!(vertex(&graph, "101"), [10.0, 0.0]);
    }
}

#[test]
fn fixed_vertices_survive_removal() {
    let folder = Folder::new();
    let path = case("fix_landmarks.g2o");
    let (_, graph) = solved(&folder, &format!("remove {path} --fraction 0.4"));
    assert_eq!(graph.lines().filter(|line| line.starts_with("FIX")).count(), 3, "{graph}");
    folder.write("list", "100\n");
    let refused = folder.run(&format!("remove {path} --nodes list"));
    refused.failed(1, &["100 is fixed or holds the gauge", "list:1"]);
}

#[test]
fn landmarks_are_placed_once_they_are_determined() {
    let folder = Folder::new();
    for command in ["optimize", "replay"] {
        let (report, graph) =
            solved(&folder, &format!("{command} {}", case("rank1_sightings.g2o")));
        error_is(&report, 0.0, 1e-12);
        near(&vertex(&graph, "100"), &[5.0, 5.0], 1e-6);
        assert_eq!(report["held_back"], 0);
        let (report, graph) =
            solved(&folder, &format!("{command} {}", case("factor_graph_small.pyfg")));
        error_is(&report, 0.0, 1e-9);
        let landmark = graph.lines().find(|line| line.starts_with("VERTEX_XY")).unwrap();
        let id = landmark.split_whitespace().nth(1).unwrap();
        near(&vertex(&graph, id), &[11.0, 19.0], 1e-4);
    }
}

#[test]
fn directions_that_nothing_measures_get_a_weak_prior() {
    let folder = Folder::new();
    for command in ["optimize", "replay"] {
        let path = case("standing_robot.pyfg");
        let ran = folder.run(&format!("{command} {path} --report report.json")).done();
        assert!(ran.err.contains("no measurement determines 1 direction"), "{}", ran.err);
        assert!(ran.err.contains("B0"), "{}", ran.err);
        error_is(&folder.json("report.json"), 0.0, 1e-9);
        // Without priors it is an error that names the heading, and nothing else.
        let refused = folder.run(&format!("{command} {path} --prior none"));
        refused.failed(1, &["--prior"]);
    }
}

#[test]
fn the_final_batch_ends_where_optimize_does() {
    let folder = Folder::new();
    for last in ["--final-batch", "--final-batch=best"] {
        let (report, _) = solved(&folder, &format!("replay {} {last}", case("gps_bad_start.g2o")));
        error_is(&report, 70_682.942, 1e-2);
        assert_eq!(report["status"], "converged");
        let is_compared = !report["final_batch"]["compared"].is_null();
        assert_eq!(is_compared, last.ends_with("best"));
    }
}

#[test]
fn a_pose_with_a_prior_of_its_own_can_be_removed() {
    let folder = Folder::new();
    folder.write("list", "2\n");
    let path = case("prior_only_remove.g2o");
    let (report, graph) = solved(&folder, &format!("remove {path} --nodes list"));
    assert_eq!((report["removed"].as_u64(), report["kld_total"].as_f64()), (Some(1), Some(0.0)));
    assert!(!graph.contains("VERTEX_SE2 2"), "{graph}");
    assert!(graph.contains("EDGE_SE2 0 1"), "{graph}");
}

#[test]
fn weights_that_are_far_apart_leave_every_pose_determined() {
    let folder = Folder::new();
    for elimination in ["qr", "cholesky"] {
        for command in ["optimize", "replay"] {
            let path = case("weights_1e18.g2o");
            let line = format!("{command} {path} --elimination {elimination}");
            let (report, graph) = solved(&folder, &line);
            error_is(&report, 2.25e-8, 1e-13);
            near(&vertex(&graph, "1"), &[1.0, 0.0, 0.0], 1e-9);
            near(&vertex(&graph, "2"), &[2.15, 0.0, 0.0], 1e-6);
            near(&vertex(&graph, "3"), &[3.15, 0.0, 0.0], 1e-6);
        }
    }
}
