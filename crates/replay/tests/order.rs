//! The order in which real graphs are replayed, and the values that they start from.

#[path = "../../formats/tests/common/mod.rs"]
mod common;

use std::collections::{HashMap, HashSet};

use evergraph_formats::{Dialect, Document, ReadOptions, Record};
use evergraph_model::{Arguments, FactorId, Graph, Value, VariableId};
use evergraph_replay::{Initial, Replay, ReplayOptions, Step, StepKind};

/// A replay in which start values stay the estimate.
struct Run {
    replay: Replay,
    graph: Graph,
    values: HashMap<VariableId, Value>,
    steps: Vec<Step>,
    /// Poses' ids in the order of arrival.
    poses: Vec<u64>,
}

fn replay(document: &Document, options: &ReplayOptions) -> Run {
    let mut run = Run {
        replay: Replay::new(document, options).unwrap_or_else(|error| panic!("{error}")),
        graph: Graph::new(),
        values: HashMap::new(),
        steps: Vec::new(),
        poses: Vec::new(),
    };
    loop {
        let mut change = run.graph.change();
        let mut estimate = |id: VariableId| run.values.get(&id).cloned();
        let Some(step) = run.replay.next_step(&mut change, &mut estimate) else { break };
        let step = step.unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(step.variables, change.new_variables().len());
        assert_eq!(step.factors + step.gauge_priors.len(), change.new_factors().len());
        run.values.extend(change.new_variables().iter().cloned());
        let staged = run.graph.stage(&change).expect("the change fits");
        run.graph.commit(staged);
        run.steps.push(step);
    }
    run.poses = run
        .replay
        .ids()
        .filter(|(id, v)| run.replay.pose(*id) == Some(*v))
        .map(|(id, _)| id)
        .collect();
    run
}

fn error_of(graph: &Graph, values: &HashMap<VariableId, Value>, factor: FactorId) -> f64 {
    let factor = graph.factor(factor).expect("the factor is there");
    let storages: Vec<&[f64]> = factor.keys().iter().map(|key| values[key].storage()).collect();
    let mut residual = vec![0.0; factor.residual_dim()];
    factor.residual(&Arguments::new(&storages), &mut residual);
    factor.error(&residual)
}

/// Each edge joins poses that are there, each pose but the first of a component comes in by an edge
/// to an earlier one, and nothing is lost.
fn check_order(document: &Document, run: &Run, what: &str) {
    let summary = document.summary();
    let factors: usize = run.steps.iter().map(|step| step.factors).sum();
    let all = summary.pose_edges + summary.landmark_edges + summary.measurements;
    assert_eq!(factors, all, "{what}");
    assert_eq!(run.replay.factors().len(), factors, "{what}");
    let variables: usize = run.steps.iter().map(|step| step.variables).sum();
    assert_eq!(
        variables,
        summary.poses + summary.landmarks - run.replay.unseen_landmarks(),
        "{what}"
    );
    assert_eq!((run.replay.len(), run.poses.len()), (summary.poses, summary.poses), "{what}");
    let lines: HashSet<usize> = run.replay.factors().iter().map(|(_, line)| *line).collect();
    assert_eq!(lines.len(), factors, "{what}: each line once");

    let arrival: HashMap<u64, usize> =
        run.poses.iter().enumerate().map(|(at, id)| (*id, at)).collect();
    let mut tied = vec![false; run.poses.len()];
    for record in document.records() {
        if let Record::Edge { from, to, measurement, .. } = record
            && measurement.kind().is_pose()
        {
            tied[arrival[from].max(arrival[to])] = true;
        }
    }
    for (id, _) in run.replay.fixed().filter(|(id, _)| arrival.contains_key(id)) {
        tied[arrival[&id]] = true;
    }
    let roots = tied.iter().filter(|tied| !**tied).count();
    assert_eq!(roots, run.replay.gauge_priors().len(), "{what}: one gauge prior for each part");
}

#[test]
fn every_graph_replays_whole() {
    let Some(data) = common::data("every_graph_replays_whole") else { return };
    for path in common::graph_files(&data) {
        let document = common::read(&path);
        let run = replay(&document, &ReplayOptions::default());
        check_order(&document, &run, &path.display().to_string());

        let mut whole = Replay::new(&document, &ReplayOptions::default()).unwrap();
        let graph = Graph::new();
        let mut change = graph.change();
        let step = whole.everything(&mut change).unwrap();
        assert_eq!(step.factors, run.replay.factors().len(), "{}", path.display());
        let stepped: Vec<_> =
            run.replay.ids().map(|(id, v)| (id, run.values[&v].clone())).collect();
        let at_once: Vec<_> = whole
            .ids()
            .zip(change.new_variables())
            .map(|((id, _), (_, value))| (id, value.clone()))
            .collect();
        assert_eq!(stepped, at_once, "{}", path.display());
    }
}

#[test]
fn start_values_have_the_errors_of_the_references() {
    let Some(data) = common::data("start_values_have_the_errors_of_the_references") else { return };
    let text = std::fs::read_to_string(data.join("references.json")).unwrap();
    let references: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut compared = 0;
    for path in common::graph_files(&data) {
        let name = path.file_name().unwrap().to_str().unwrap();
        for (initial, field) in
            [(Initial::FromOdometry, "error_at_odometry"), (Initial::FromFile, "error_at_vertices")]
        {
            let Some(expected) = references[name][field].as_f64() else { continue };
            let run = replay(&common::read(&path), &ReplayOptions::default().with_initial(initial));
            let error: f64 = run
                .replay
                .factors()
                .iter()
                .map(|(f, _)| error_of(&run.graph, &run.values, *f))
                .sum();
            let off = (error / expected - 1.0).abs();
            assert!(off < 1e-10, "{name} {field}: {error} instead of {expected}");
            compared += 1;
        }
    }
    assert!(compared > 20, "{compared}");
}

#[test]
fn shuffled_g2o_files_arrive_by_id() {
    let Some(data) = common::data("shuffled_g2o_files_arrive_by_id") else { return };
    for name in ["pose2d/intel_943.g2o", "pose2d/killian.g2o", "landmark/world-2000-full.g2o"] {
        let document = common::read(&data.join(name));
        let run = replay(&document, &ReplayOptions::default());
        assert!(run.poses.is_sorted(), "{name}");
        let arrived_at: HashMap<u64, usize> =
            run.poses.iter().enumerate().map(|(at, id)| (*id, at)).collect();
        let mut step_of_line = HashMap::new();
        let mut lines = run.replay.factors().iter().map(|(_, line)| *line);
        for (at, step) in run.steps.iter().enumerate() {
            step_of_line.extend(lines.by_ref().take(step.factors).map(|line| (line, at)));
        }
        for evergraph_formats::Line { number: line, record, .. } in document.lines() {
            if let Record::Edge { from, to, measurement, .. } = record {
                let last = if measurement.kind().is_pose() { from.max(to) } else { from };
                assert_eq!(step_of_line[line], arrived_at[last], "{name}:{line}");
            }
        }
    }
}

#[test]
fn victoria_park_adds_landmarks_with_their_first_pose() {
    let Some(data) = common::data("victoria_park_adds_landmarks_with_their_first_pose") else {
        return;
    };
    let document = common::read(&data.join("landmark/victoriaPark.txt"));
    let run = replay(&document, &ReplayOptions::default());
    assert_eq!(run.steps.len(), 6969);
    // Lines 1 to 6: poses 0, 1, 2, 3 and 4; landmark 5 is seen from 4; pose 6 follows.
    let ids: Vec<u64> = run.replay.ids().take(7).map(|(id, _)| id).collect();
    assert_eq!(ids, [0, 1, 2, 3, 4, 5, 6]);
    assert_eq!(run.steps[4].variables, 2);
    assert_eq!((run.steps[4].factors, run.steps[4].kind), (2, StepKind::Explore));
    assert_eq!(run.replay.gauge_priors().len(), 1);
    assert_eq!(run.replay.landmark(5).unwrap(), run.replay.variable(5).unwrap());
    assert!(run.replay.pose(5).is_none());
    // Line 12 sees landmark 5 again, from pose 11.
    let again = run.poses.iter().position(|id| *id == 11).unwrap();
    assert_eq!(run.steps[again].kind, StepKind::Loop);
    assert!(run.poses.is_sorted());
}

#[test]
fn poses_of_a_second_robot_wait_for_a_connection() {
    let Some(data) = common::data("poses_of_a_second_robot_wait_for_a_connection") else { return };
    let path = data.join("pose3d/multirobot/blocks_world_4robots_fullGraph.g2o");
    let document = common::read(&path);
    let run = replay(&document, &ReplayOptions::default());
    check_order(&document, &run, "blocks world");
    assert_eq!(run.replay.gauge_priors().len(), 1, "one connected graph");
    assert_eq!(run.replay.gauge_priors()[0].id, run.poses[0]);
}

#[test]
fn vertices_are_replaced_by_estimates() {
    let Some(data) = common::data("vertices_are_replaced_by_estimates") else { return };
    for path in common::graph_files(&data) {
        let document = common::read(&path);
        let run = replay(&document, &ReplayOptions::default());
        let estimates = run.replay.ids().map(|(id, variable)| (id, run.values[&variable].clone()));
        let output = document.with_vertices(estimates).unwrap_or_else(|error| panic!("{error}"));
        let summary = output.summary();
        assert_eq!(summary.vertices, summary.poses + summary.landmarks, "{}", path.display());
        let mut text = Vec::new();
        output.write(&mut text, Dialect::G2o).unwrap();
        let again = Document::parse("output", text.as_slice(), &ReadOptions::default()).unwrap();
        assert_eq!(again.summary().vertices, summary.vertices, "{}", path.display());
        assert_eq!(again.summary().pose_edges, document.summary().pose_edges, "{}", path.display());
    }
}

/// Positions to a millimetre along 20 km of a straight line in space: what turning about it adds up
/// to is rounding, far above what a measurement would be.
#[test]
fn rounding_of_many_measurements_holds_nothing() {
    let (step, count) = ([0.6, 0.64, 0.48], 20_000);
    let mut text = String::new();
    for i in 0..count {
        if i > 0 {
            text += &format!(
                "EDGE_SE3:QUAT {} {i} {} {} {} 0 0 0 1 1e4 0 0 0 0 0 1e4 0 0 0 0 1e4 0 0 0 1e4 0 0 1e4 0 1e4\n",
                i - 1,
                step[0],
                step[1],
                step[2]
            );
        }
        let [x, y, z] = step.map(|x| x * f64::from(i));
        text += &format!("EDGE_SE3_XYZ_PRIOR {i} {x} {y} {z} 1e6 0 0 1e6 0 1e6\n");
    }
    let document = Document::parse("text", text.as_bytes(), &ReadOptions::default()).unwrap();
    let mut replay = Replay::new(&document, &ReplayOptions::default()).unwrap();
    let whole = replay.everything(&mut Graph::new().change()).unwrap();
    let directions: Vec<usize> = whole.gauge_priors.iter().map(|prior| prior.directions).collect();
    assert_eq!(directions, [1]);
}

/// Work that grew with the square of the length would take minutes here.
#[test]
fn work_grows_with_the_length_of_a_file() {
    let mut apart = String::new();
    for i in (0..200_000).step_by(2) {
        // With vertices no heading is looked for, which takes long, though no longer than linear.
        apart += &format!("VERTEX_SE2 {i} 0 0 0\nVERTEX_SE2 {} 1 0 0\n", i + 1);
        apart += &format!("EDGE_SE2 {i} {} 1 0 0 1 0 0 1 0 1\n", i + 1);
        apart += &format!("EDGE_PRIOR_SE2 {i} 0 0 0 1 0 0 1 0 1\n");
    }
    // Straight towards a landmark, which no bearing places.
    let mut ahead = String::from("EDGE_BEARING_SE2_XY 0 1000000 0 400\n");
    for i in 1..100_000 {
        ahead += &format!("EDGE_SE2 {} {i} 1 0 0 1 0 0 1 0 1\n", i - 1);
        ahead += &format!("EDGE_BEARING_SE2_XY {i} 1000000 0 400\n");
    }
    for (text, held_back) in [(apart, 0), (ahead, 1)] {
        let document = Document::parse("text", text.as_bytes(), &ReadOptions::default()).unwrap();
        let options = ReplayOptions::default().with_initial(Initial::FromFile);
        let mut replay = Replay::new(&document, &options).unwrap();
        replay.everything(&mut Graph::new().change()).unwrap();
        assert_eq!(replay.held_back(), held_back);
    }
}
