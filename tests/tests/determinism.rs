//! The same bits on any number of threads: estimates, linearization points and every entry of R.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::num::NonZeroU32;

use evergraph::Settings;
use evergraph::model::VariableId;
use evergraph::removal::{Options, Order, Removal};
use evergraph::solver::{BatchSettings, Relinearization};
use evergraph_tests::{data_file, read, replay};

fn same_bits(test: &str, file: &str) {
    let Some(path) = data_file(test, file) else { return };
    let document = read(&path);
    let fingerprints = [1, 2, 4].map(|threads| {
        let mut relinearization = Relinearization::BOTH;
        relinearization.batch = NonZeroU32::new(500);
        let settings =
            Settings::default().with_threads(threads).with_relinearization(relinearization);
        let mut trace = Vec::new();
        let mut replayer = replay(&document, settings, |steps, replayer| {
            if steps % 500 == 0 {
                trace.push(replayer.smoother().fingerprint());
            }
        });
        trace.push(replayer.smoother().fingerprint());
        replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
        trace.push(replayer.smoother().fingerprint());
        trace
    });
    assert_eq!(fingerprints[0], fingerprints[1], "{file}: 1 and 2 threads");
    assert_eq!(fingerprints[0], fingerprints[2], "{file}: 1 and 4 threads");
}

#[test]
fn manhattan() {
    same_bits("manhattan", "pose2d/manhattanOlson3500.txt");
}

#[test]
fn city() {
    same_bits("city", "pose2d/city10000.txt");
}

#[test]
fn sphere() {
    same_bits("sphere", "pose3d/sphere2500.g2o");
}

/// Half of the poses removed from a graph whose largest cliques are shared among threads.
#[test]
fn removals() {
    let Some(path) = data_file("removals", "pose3d/sphere2500.g2o") else { return };
    let document = read(&path);
    let fingerprints = [1, 2, 4].map(|threads| {
        let settings =
            Settings::default().with_threads(threads).with_relinearization(Relinearization::NEVER);
        let mut smoother = replay(&document, settings, |_, _| ()).into_smoother();
        let mut trace = Vec::new();
        for (options, share) in [(Options::default(), 3), (Options::dense(), 7)] {
            let nodes: Vec<VariableId> =
                smoother.graph().variables().skip(1).step_by(share).collect();
            let estimates = smoother.estimates().unwrap();
            let plan = Removal::new(smoother.graph(), &estimates)
                .with_options(options)
                .plan_many(&nodes, Order::MinDegree)
                .unwrap();
            smoother.apply(plan.into_change()).unwrap();
            trace.push(smoother.fingerprint());
        }
        smoother.optimize(&BatchSettings::default()).unwrap();
        trace.push(smoother.fingerprint());
        trace
    });
    assert_eq!(fingerprints[0], fingerprints[1], "1 and 2 threads");
    assert_eq!(fingerprints[0], fingerprints[2], "1 and 4 threads");
}
