//! Our `error` is GTSAM's `graph.error()`: values printed by `tests/scripts/gtsam_error.py` with
//! GTSAM 4.3.0 for the vertices of the files.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::Replayer;
use evergraph::Settings;
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::Relinearization;
use evergraph_tests::{data_file, read};

fn check(test: &str, file: &str, gtsam: f64) {
    let Some(path) = data_file(test, file) else { return };
    let options = ReplayOptions::default().with_initial(Initial::FromFile);
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    let mut replayer = Replayer::new(&read(&path), &options, settings).unwrap();
    replayer.everything().unwrap();
    let error = replayer.objective_at_linearization().unwrap().error;
    assert!((error - gtsam).abs() <= 1e-9 * gtsam, "{file}: {error}, GTSAM {gtsam}");
}

#[test]
fn pose2() {
    check("pose2", "pose2d/intel.g2o", 276.9978977821);
    check("pose2", "pose2d/input_M3500_g2o.g2o", 1317356.27251191);
}

#[test]
fn pose3() {
    check("pose3", "pose3d/parking-garage.g2o", 8363.60194812);
    check("pose3", "pose3d/sphere2500.g2o", 1305657.71180609);
    check("pose3", "pose3d/duderstadt.g2o", 181.32064951532);
    check("pose3", "pose3d/smallGrid3D.g2o", 83894.3334355331);
}
