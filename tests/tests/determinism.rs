//! The same bits on any number of threads: estimates, linearization points and every entry of R.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::num::NonZeroU32;

use evergraph::Settings;
use evergraph::solver::{BatchSettings, Relinearization};
use evergraph_tests::{data_file, read, replay};

fn same_bits(test: &str, file: &str) {
    let Some(path) = data_file(test, file) else { return };
    let document = read(&path);
    let fingerprints = [1, 2, 4].map(|threads| {
        let mut relinearization = Relinearization::BOTH;
        relinearization.batch = NonZeroU32::new(500);
        let settings = Settings { threads, relinearization, ..Settings::default() };
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
