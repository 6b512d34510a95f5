//! Nodes removed from public graphs at their optimum.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::model::{Pose2, VariableId};
use evergraph::removal::{Offset, Options, Order, Recovery, Removal};
use evergraph::solver::{BatchSettings, Relinearization};
use evergraph::{Settings, Smoother};
use evergraph_tests::{data_file, read, replay};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

const FILE: &str = "pose2d/manhattanOlson3500.txt";

/// The graph of the file at its optimum, and its poses in a random order.
fn optimum(test: &str) -> Option<(Smoother, Vec<VariableId>)> {
    let document = read(&data_file(test, FILE)?);
    let relinearization = Relinearization::BOTH;
    let mut replayer =
        replay(&document, Settings::default().with_relinearization(relinearization), |_, _| ());
    let exact = BatchSettings::default().with_relative_decrease(1e-15).with_max_iterations(30);
    replayer.smoother_mut().optimize(&exact).unwrap();
    let smoother = replayer.into_smoother();
    // All but the pose that holds the map.
    let mut poses: Vec<VariableId> = smoother.graph().variables().skip(1).collect();
    poses.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
    Some((smoother, poses))
}

/// Root mean square and largest distance between the positions of two maps.
fn shift(full: &Smoother, reduced: &Smoother) -> (f64, f64) {
    let (mut sum, mut largest, mut count) = (0.0, 0.0_f64, 0);
    for id in reduced.graph().variables() {
        let pose =
            |smoother: &Smoother| -> Pose2 { smoother.estimate_value(id).unwrap().get().unwrap() };
        let (before, after) = (pose(full), pose(reduced));
        let d = (before.x() - after.x()).hypot(before.y() - after.y());
        (sum, largest, count) = (sum + d * d, largest.max(d), count + 1);
    }
    ((sum / f64::from(count)).sqrt(), largest)
}

fn remove(smoother: &mut Smoother, nodes: &[VariableId], options: Options) {
    let plan = Removal::new(smoother.graph(), &smoother.estimates().unwrap())
        .with_options(options)
        .plan_many(nodes, Order::Given)
        .unwrap();
    smoother.apply(plan.into_change()).unwrap();
    smoother.optimize(&BatchSettings::default()).unwrap();
}

#[test]
fn removal_at_the_optimum_moves_nothing() {
    let Some((full, poses)) = optimum("removal_at_the_optimum_moves_nothing") else { return };
    for (options, share) in [
        (Options::tree(), 0.1),
        (Options::tree(), 0.5),
        (Options::tree(), 0.9),
        (Options::dense(), 0.1),
        (Options::dense(), 0.5),
        (Options::tree().with_recovery(Recovery::Nonlinear), 0.1),
        (Options::tree().with_recovery(Recovery::Nonlinear), 0.5),
        (Options::tree().with_recovery(Recovery::Nonlinear), 0.9),
    ] {
        let mut reduced = full.clone();
        let nodes = &poses[..(share * poses.len() as f64) as usize];
        remove(&mut reduced, nodes, options);
        assert_eq!(reduced.graph().variable_count() + nodes.len(), full.graph().variable_count());
        let (_, largest) = shift(&full, &reduced);
        assert!(largest < 1e-5, "{share} {options:?}: {largest}");
    }
}

/// What the papers lose by putting each new measurement at the linearization point.
#[test]
fn the_papers_offset_shifts_the_map() {
    let Some((full, poses)) = optimum("the_papers_offset_shifts_the_map") else { return };
    let mut reduced = full.clone();
    let options = Options::dense().with_offset(Offset::Zero);
    remove(&mut reduced, &poses[..poses.len() / 10], options);
    let (rms, _) = shift(&full, &reduced);
    assert!((0.05..1.0).contains(&rms), "{rms}");
}

/// Node by node in the live tree, each an ordinary update that is priced beforehand.
#[test]
fn nodes_go_one_by_one() {
    let Some((full, poses)) = optimum("nodes_go_one_by_one") else { return };
    let mut smoother = full.clone();
    let mut stale = None;
    for &node in &poses[..60] {
        let mut covariances = smoother.covariances();
        let mut removal = Removal::new(smoother.graph(), &smoother).priced_by(&mut covariances);
        let plan = removal.plan(node).unwrap();
        assert!(plan.price().unwrap() >= -1e-9, "{:?}", plan.price());
        let again = removal.plan(node).unwrap();
        let report = smoother.apply(plan.into_change()).unwrap();
        assert!(report.batch.is_none());
        stale = Some(again);
    }
    let before = smoother.fingerprint();
    assert!(smoother.apply(stale.unwrap().into_change()).is_err(), "the node is gone");
    assert_eq!(smoother.fingerprint(), before);
    assert!(shift(&full, &smoother).1 < 1e-4);
}
