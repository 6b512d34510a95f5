//! Gauge, kernels, start values and order of small files.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::HashMap;

use evergraph_formats::{Dialect, Document, ReadOptions};
use evergraph_model::{Graph, Kernel, Pose2, Value};
use evergraph_replay::{Initial, Order, Replay, ReplayOptions, ReplayerError, StepKind};

fn parse(text: &str) -> Document {
    Document::parse("text", text.as_bytes(), &ReadOptions::default()).unwrap()
}

#[test]
fn the_gauge_is_held_once_for_each_component_or_where_fix_says() {
    let edges = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\nEDGE_SE2 7 8 1 0 0 1 0 0 1 0 1\n";
    let priors = |text: &str, options: &ReplayOptions| {
        let mut replay = Replay::new(&parse(text), options).unwrap();
        let step = replay.everything(&mut Graph::new().change()).unwrap();
        assert_eq!(step.gauge_priors, replay.gauge_priors());
        assert!(step.gauge_priors.iter().all(|p| replay.factors().iter().all(|f| f.0 != p.factor)));
        assert!(
            replay
                .fixed()
                .all(|(_, fixed)| replay.gauge_priors().iter().all(|p| p.variable != fixed))
        );
        let priors: Vec<u64> = step.gauge_priors.iter().map(|prior| prior.id).collect();
        (priors, replay.fixed().map(|(id, _)| id).collect::<Vec<u64>>())
    };
    let default = ReplayOptions::default();
    assert_eq!(priors(edges, &default), (vec![0, 7], vec![]));
    assert_eq!(priors(&format!("{edges}FIX 2\n"), &default), (vec![7], vec![2]));
    assert_eq!(priors(&format!("{edges}FIX 1 8 2\n"), &default), (vec![], vec![1, 2, 8]));
    assert_eq!(priors(edges, &default.with_prior(None)), (vec![], vec![]));
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = default.with_prior(Some(sigma));
        assert!(matches!(
            Replay::new(&parse(edges), &options),
            Err(ReplayerError::BadSetting { .. })
        ));
    }
}

#[test]
fn kernels_wrap_the_factors_of_the_file_only() {
    let document = parse("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
    let options = ReplayOptions::default().with_kernel(Some(Kernel::huber(1.0).unwrap()));
    let mut replay = Replay::new(&document, &options).unwrap();
    let mut change = Graph::new().change();
    replay.everything(&mut change).unwrap();
    let names: Vec<String> = change.new_factors().iter().map(|(_, factor)| factor.name()).collect();
    assert_eq!(names, ["Prior<Pose2>", "Robust<Between<Pose2>, Huber>"]);
}

/// What `remove` wrote from a graph under a kernel means the same when the kernel is asked for again.
#[test]
fn kernels_are_not_put_around_factors_that_have_one_or_are_sums() {
    let lines = [
        "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1",
        "ROBUST pseudo_huber 2 EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1",
        "FACTOR_LINEAR none 2 SE2 0 0 0 0 SE2 1 1 0 0 1 1 0 0 -1 0 0 0 0 0 0 0 0",
        "ROBUST huber 3 FACTOR_LINEAR none 2 SE2 0 0 0 0 SE2 1 1 0 0 1 1 0 0 -1 0 0 0 0 0 0 0 0",
        "EDGE_PRIOR_SE2 0 0 0 0 1 0 0 1 0 1",
    ];
    let document = parse(&lines.join("\n"));
    let options = ReplayOptions::default().with_kernel(Some(Kernel::huber(1.0).unwrap()));
    let mut replay = Replay::new(&document, &options).unwrap();
    let mut change = Graph::new().change();
    replay.everything(&mut change).unwrap();
    let lines: HashMap<_, _> = replay.factors().iter().copied().collect();
    let factors = change.new_factors().iter();
    let mut names: Vec<(usize, String)> =
        factors.filter_map(|(id, factor)| Some((*lines.get(id)?, factor.name()))).collect();
    names.sort_unstable();
    let expected = [
        (1, "Robust<Between<Pose2>, Huber>"),
        (2, "Robust<Between<Pose2>, PseudoHuber>"),
        (3, "Linear"),
        (4, "Robust<Linear, Huber>"),
        (5, "Prior<Pose2>"),
    ];
    assert_eq!(names, expected.map(|(line, name)| (line, name.to_string())));
}

#[test]
fn start_values_follow_the_estimate_in_either_direction() {
    let document =
        parse("VERTEX_SE2 0 3 0 0\nVERTEX_SE2 1 9 9 9\nEDGE_SE2 1 0 -1 0 0 1 0 0 1 0 1\n");
    let mut replay = Replay::new(&document, &ReplayOptions::default()).unwrap();
    let mut graph = Graph::new();
    let mut change = graph.change();
    replay.next_step(&mut change, &mut |_| None).unwrap().unwrap();
    assert_eq!(
        change.new_variables()[0].1.get::<Pose2>().unwrap().x(),
        3.0,
        "the first pose is at its vertex"
    );
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
    let mut change = graph.change();
    let moved = Value::new(&Pose2::new(10.0, 0.0, 0.0));
    replay.next_step(&mut change, &mut |_| Some(moved.clone())).unwrap().unwrap();
    assert_eq!(change.new_variables()[0].1.get::<Pose2>().unwrap().x(), 11.0);

    let options = ReplayOptions::default().with_initial(Initial::FromFile);
    let mut change = Graph::new().change();
    Replay::new(&document, &options).unwrap().everything(&mut change).unwrap();
    assert_eq!(change.new_variables()[1].1.get::<Pose2>().unwrap().x(), 9.0);

    let mut replay = Replay::new(&document, &ReplayOptions::default()).unwrap();
    let mut change = Graph::new().change();
    replay.next_step(&mut change, &mut |_| None).unwrap().unwrap();
    let error = replay.next_step(&mut change, &mut |_| None).unwrap().unwrap_err();
    assert!(matches!(error, ReplayerError::NoEstimate { id: 1, .. }), "{error}");
    assert!(replay.next_step(&mut change, &mut |_| None).is_none());
}

#[test]
fn poses_wait_until_something_connects_them() {
    // 2 and 1 hang together, but only 3 ties them to 0.
    let edge = |i: u64, j: u64| format!("EDGE_SE2 {i} {j} 1 0 0 1 0 0 1 0 1\n");
    let text = edge(1, 2) + &edge(3, 2) + &edge(0, 3) + &edge(4, 3);
    let mut replay = Replay::new(&parse(&text), &ReplayOptions::default()).unwrap();
    replay.everything(&mut Graph::new().change()).unwrap();
    assert_eq!(replay.ids().map(|(id, _)| id).collect::<Vec<_>>(), [0, 3, 2, 1, 4]);

    // The same in time order: 1 starts, being in the first line.
    let isam = text.replace("EDGE_SE2", "EDGE2");
    let mut replay = Replay::new(&parse(&isam), &ReplayOptions::default()).unwrap();
    replay.everything(&mut Graph::new().change()).unwrap();
    assert_eq!(replay.ids().map(|(id, _)| id).collect::<Vec<_>>(), [1, 2, 3, 0, 4]);
}

#[test]
fn parts_that_only_landmarks_tie_come_last() {
    let text = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 1 9 1 0 1 0 1\n\
                EDGE_SE2_XY 6 9 1 0 1 0 1\nEDGE_SE2_XY 5 8 1 0 1 0 1\n";
    let mut replay = Replay::new(&parse(text), &ReplayOptions::default()).unwrap();
    assert_eq!(replay.len(), 3);
    let step = replay.everything(&mut Graph::new().change()).unwrap();
    assert_eq!((step.factors, step.variables), (5, 6));
    // The second part can turn about the landmark that both see.
    let priors: Vec<_> =
        step.gauge_priors.iter().map(|prior| (prior.id, prior.directions, prior.weak)).collect();
    assert_eq!(priors, [(0, 3, false), (5, 1, true)]);
    assert_eq!(replay.ids().map(|(id, _)| id).collect::<Vec<_>>(), [0, 1, 9, 5, 8, 6]);
}

#[test]
fn edges_alone_get_the_vertices_of_a_replay() {
    let isam = parse("EDGE2 0 1 1 2 0 2 1 0 2 0 3\nEDGE2 1 2 1 0 0 2 1 0 2 0 3\n");
    let placed = evergraph_replay::with_start_vertices(&isam).unwrap();
    assert_eq!(placed.summary().vertices, 3);
    let mut out = Vec::new();
    placed.write(&mut out, Dialect::Toro).unwrap();
    let text = String::from_utf8(out).unwrap();
    assert!(text.starts_with("VERTEX2 0 0 0 0\nVERTEX2 1 1 2 0\nVERTEX2 2 2 2 0\n"), "{text}");
    assert_eq!(parse(&text).dialect(), Dialect::Toro);
}

/// Digits that printing rounded away make a matrix slightly negative; that is clipped, not refused.
#[test]
fn clipped_matrices_are_noise() {
    let text = "EDGE_SE2 0 1 1 0 0 3.33333 6.66667 10 13.3333 20 30\n";
    Replay::new(&parse(text), &ReplayOptions::default()).unwrap();
}

/// Five poses in a row and two closures, in TORO's lines.
fn row_with_closures(closures_last: bool) -> String {
    let edge = |i: u64, j: u64| format!("EDGE2 {i} {j} {} 0 0 1 0 1 1 0 0\n", j as i64 - i as i64);
    let vertices: String = (0..5).map(|k| format!("VERTEX2 {k} {k} 0 0\n")).collect();
    let rows = [(0, 1), (1, 2), (0, 2), (2, 3), (1, 3), (3, 4)];
    let is_closure = |(i, j): &(u64, u64)| j - i > 1;
    let mut order: Vec<(u64, u64)> = rows.to_vec();
    if closures_last {
        order.sort_by_key(is_closure);
    }
    vertices + &order.into_iter().map(|(i, j)| edge(i, j)).collect::<String>()
}

#[test]
fn closures_behind_the_odometry_arrive_with_their_poses() {
    let kinds = |text: &str| {
        let mut replay = Replay::new(&parse(text), &ReplayOptions::default()).unwrap();
        let (mut graph, mut values) = (Graph::new(), HashMap::new());
        let mut kinds = Vec::new();
        loop {
            let mut change = graph.change();
            let step = replay.next_step(&mut change, &mut |id| values.get(&id).cloned());
            let Some(step) = step else { break };
            kinds.push(step.unwrap().kind);
            values.extend(change.new_variables().iter().cloned());
            let staged = graph.stage(&change).unwrap();
            graph.commit(staged);
        }
        (replay.order(), kinds)
    };
    use StepKind::{Explore, Loop};
    let expected = vec![Explore, Explore, Loop, Loop, Explore];
    assert_eq!(kinds(&row_with_closures(false)), (Order::Lines, expected.clone()));
    assert_eq!(kinds(&row_with_closures(true)), (Order::IdsForLateEdges, expected.clone()));
    // g2o has no order.
    let g2o = row_with_closures(true).replace("VERTEX2", "VERTEX_SE2").replace("EDGE2", "EDGE_SE2");
    let g2o = g2o.replace("1 0 1 1 0 0\n", "1 0 0 1 0 1\n");
    assert_eq!(kinds(&g2o), (Order::Ids, expected));
}

#[test]
fn sightings_behind_the_odometry_do_too() {
    let mut text = row_with_closures(false).replace("EDGE2 0 2 2 0 0 1 0 1 1 0 0\n", "");
    text = text.replace("EDGE2 1 3 2 0 0 1 0 1 1 0 0\n", "");
    for pose in 0..5 {
        text += &format!("BR {pose} 9 0.5 {} 0.1 0.1\n", 5.0 - f64::from(pose) * 0.5);
    }
    let replay = Replay::new(&parse(&text), &ReplayOptions::default()).unwrap();
    assert_eq!(replay.order(), Order::IdsForLateEdges);
}
