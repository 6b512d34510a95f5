//! The three batch methods, and honest answers when they do not converge.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::formats::ReplayOptions;
use evergraph::prelude::*;
use evergraph::solver::Reason;
use evergraph_tests::{References, data_dir, read};

/// The whole graph at its odometry, in one change.
fn loaded(document: &Document, elimination: Elimination) -> Replayer {
    let settings =
        Settings { relinearization: Relinearization::NEVER, elimination, ..Settings::default() };
    let mut replayer = Replayer::new(document, &ReplayOptions::default(), settings).unwrap();
    replayer.everything().unwrap();
    replayer
}

#[test]
fn every_method_finds_the_optimum() {
    let Some(data) = data_dir("every_method_finds_the_optimum") else { return };
    let references = References::read(&data);
    for (folder, file) in
        [("pose2d", "intel.g2o"), ("pose2d", "ringCity.g2o"), ("pose3d", "smallGrid3D.g2o")]
    {
        let document = read(&data.join(folder).join(file));
        for method in [Method::GaussNewton, Method::LevenbergMarquardt, Method::Dogleg] {
            for elimination in [Elimination::Cholesky, Elimination::Qr] {
                let mut replayer = loaded(&document, elimination);
                let settings = BatchSettings { method, ..BatchSettings::default() };
                let report = replayer.smoother_mut().optimize(&settings).unwrap();
                assert!(report.error <= report.initial_error, "{file}, {method:?}: {report:?}");
                assert!((replayer.smoother().error() - report.error).abs() <= 1e-12 * report.error);
                match report.status {
                    Status::Converged => {
                        let off = replayer.error() / references.error(file) - 1.0;
                        assert!(off < 1e-8, "{file}, {method:?}: {off} above the optimum");
                    }
                    // Undamped steps may fail far from the optimum, but must say so.
                    Status::NotConverged(reason) => {
                        assert_eq!(
                            (method, reason),
                            (Method::GaussNewton, Reason::ErrorWouldRise),
                            "{file}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn the_iteration_limit_is_reported() {
    let Some(data) = data_dir("the_iteration_limit_is_reported") else { return };
    let mut replayer = loaded(&read(&data.join("pose2d/intel.g2o")), Elimination::Cholesky);
    let settings = BatchSettings { max_iterations: 1, ..BatchSettings::default() };
    let report = replayer.smoother_mut().optimize(&settings).unwrap();
    assert_eq!(report.status, Status::NotConverged(Reason::IterationLimit));
    assert_eq!(report.iterations, 1);
}

#[test]
fn an_empty_graph_is_at_its_optimum() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let report = smoother.optimize(&BatchSettings::default()).unwrap();
    assert_eq!((report.status, report.error), (Status::Converged, 0.0));
    smoother.apply(smoother.change()).unwrap();
    assert!(smoother.estimates().is_empty());
}

/// Without a loop all measurements agree, and the error at the optimum is rounding.
#[test]
fn measurements_that_agree_exactly_converge() {
    for method in [Method::GaussNewton, Method::LevenbergMarquardt, Method::Dogleg] {
        let mut smoother = Smoother::new(Settings::default()).unwrap();
        let mut change = smoother.change();
        let noise = Noise::isotropic(3, 0.01).unwrap();
        let mut truth = Pose2::new(1e5, -3e4, 2.0);
        let mut pose = change.add_variable(&truth.compose(&Pose2::new(0.1, 0.2, 0.3)));
        change.add_factor(Prior::new(pose, truth, noise.clone()).unwrap());
        for k in 0..200 {
            let step = Pose2::new(1.0, 0.1, 0.3 * f64::from(k).sin());
            truth = truth.compose(&step);
            let next = change.add_variable(&truth.compose(&Pose2::new(0.2, -0.1, 0.1)));
            change.add_factor(BetweenPose2::new(pose, next, step, noise.clone()).unwrap());
            pose = next;
        }
        smoother.apply(change).unwrap();
        let report =
            smoother.optimize(&BatchSettings { method, ..BatchSettings::default() }).unwrap();
        assert_eq!(report.status, Status::Converged, "{method:?}: {report:?}");
        assert!(report.iterations < 20 && report.error < 1e-9, "{method:?}: {report:?}");
    }
}
