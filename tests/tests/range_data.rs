//! The public files with ranges: to beacons whose place nobody knows, and between robots.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and says what it saw"
)]

use std::time::Instant;

use evergraph::formats::{Document, Record};
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::BatchSettings;
use evergraph::{Replayer, Settings};
use evergraph_tests::{data_file, read, replay};

/// Distances of the landmarks from their VERTEX lines, which are the truth.
fn landmark_errors(document: &Document, replayer: &Replayer) -> Vec<f64> {
    let landmarks = document.records().filter_map(|record| match record {
        Record::Vertex { id, at } if !at.kind().is_pose() => {
            let variable = replayer.replay().landmark(*id)?;
            let estimate = replayer.smoother().estimate_value(variable).unwrap();
            let off = estimate.storage().iter().zip(at.numbers()).map(|(x, y)| (x - y).powi(2));
            Some(off.sum::<f64>().sqrt())
        }
        _ => None,
    });
    landmarks.collect()
}

/// The error of the optimum next to the truth.
fn from_truth(document: &Document) -> f64 {
    let options = ReplayOptions::default().with_initial(Initial::FromFile);
    let mut replayer = Replayer::new(document, &options, Settings::default()).unwrap();
    replayer.everything().unwrap();
    replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
    replayer.error().unwrap()
}

fn drive(test: &str, file: &str) -> Option<(Document, Replayer)> {
    let path = data_file(test, file)?;
    let document = read(&path);
    let start = Instant::now();
    let mut replayer = replay(&document, Settings::default(), |_, _| ());
    let (took, error) = (start.elapsed(), replayer.error().unwrap());
    let report = replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
    println!(
        "{file}: {} steps in {took:.1?}, error {error:.2}, optimized {:.2} ({:?}), held back {}, \
         landmarks off by {:.2?} m, {} gauge priors",
        replayer.replay().len(),
        replayer.error().unwrap(),
        report.status,
        replayer.replay().held_back(),
        landmark_errors(&document, &replayer),
        replayer.replay().gauge_priors().len(),
    );
    let (error, from_truth) = (replayer.error().unwrap(), from_truth(&document));
    assert!(error <= from_truth * (1.0 + 1e-3), "{file}: {error}, from the truth {from_truth}");
    Some((document, replayer))
}

#[test]
fn plaza_places_its_four_beacons() {
    let Some((document, replayer)) = drive("plaza_places_its_four_beacons", "range/plaza1.pyfg")
    else {
        return;
    };
    let errors = landmark_errors(&document, &replayer);
    assert_eq!((errors.len(), replayer.replay().held_back()), (4, 0));
    assert!(errors.iter().all(|error| *error < 5.0), "{errors:?}");
}

#[test]
fn the_drone_places_its_beacon() {
    let Some((document, replayer)) =
        drive("the_drone_places_its_beacon", "range/single_drone.pyfg")
    else {
        return;
    };
    let errors = landmark_errors(&document, &replayer);
    assert_eq!((errors.len(), replayer.replay().held_back()), (1, 0));
    // It flies about close to the beacon: the optimum that is best, better than the one next to the
    // truth, has it 3.7 m off.
    assert!(errors.iter().all(|error| *error < 5.0), "{errors:?}");
}

#[test]
fn five_robots_come_one_after_the_other() {
    let Some((document, replayer)) =
        drive("five_robots_come_one_after_the_other", "range/mrclam5a.pyfg")
    else {
        return;
    };
    assert_eq!(replayer.poses(), document.summary().poses);
    assert_eq!(replayer.replay().held_back(), 0);
    let errors = landmark_errors(&document, &replayer);
    assert!(errors.len() > 10 && errors.iter().all(|error| *error < 2.0), "{errors:?}");
}
