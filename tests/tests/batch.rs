//! The three batch methods, and honest answers when they do not converge.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::factors::autodiff::{AutoDiff, Number, Parameters, Residual, Vector2};
use evergraph::optimize_to_the_end;
use evergraph::prelude::*;
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::simulate::Surface;
use evergraph::solver::Reason;
use evergraph_tests::{References, data_dir, data_file, read};

/// The whole graph at its odometry, in one change.
fn loaded(document: &Document, elimination: Elimination) -> Replayer {
    let settings = Settings::default()
        .with_relinearization(Relinearization::NEVER)
        .with_elimination(elimination);
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
                let settings = BatchSettings::default().with_method(method);
                let report = replayer.smoother_mut().optimize(&settings).unwrap();
                assert!(report.error <= report.initial_error, "{file}, {method:?}: {report:?}");
                assert!(
                    (replayer.smoother().error().unwrap() - report.error).abs()
                        <= 1e-12 * report.error
                );
                match report.status {
                    Status::Converged => {
                        let off = replayer.error().unwrap() / references.error(file) - 1.0;
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
                    other => panic!("{file}, {method:?}: ended as {other:?}"),
                }
            }
        }
    }
}

#[test]
fn the_iteration_limit_is_reported() {
    let Some(data) = data_dir("the_iteration_limit_is_reported") else { return };
    let mut replayer = loaded(&read(&data.join("pose2d/intel.g2o")), Elimination::Cholesky);
    let settings = BatchSettings::default().with_max_iterations(1);
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
    assert!(smoother.estimates().unwrap().is_empty());
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
        let report = smoother.optimize(&BatchSettings::default().with_method(method)).unwrap();
        assert_eq!(report.status, Status::Converged, "{method:?}: {report:?}");
        assert!(report.iterations < 20 && report.error < 1e-9, "{method:?}: {report:?}");
    }
}

/// `½ (x + 1)² + ½ (λx² + x - 1)²`, least at 0: the second residual bends so much that a full step goes
/// from x to `λx`. Far from nothing else measures, so that the error is large.
#[derive(Debug)]
struct Bent(f64);

impl Residual<3> for Bent {
    type Variables = (Parameters<2>,);
    const NAME: &'static str = "Bent";

    fn evaluate<T: Number>(&self, (x,): (Vector2<T>,)) -> [T; 3] {
        [x[0] + 1.0, x[0] * x[0] * self.0 + x[0] - 1.0, x[1] * 0.0 + 1e4]
    }
}

/// Full steps overshoot, and damped ones end in rounding: that is the end all the same.
#[test]
fn where_full_steps_overshoot_rounding_ends_it() {
    for bend in [-1.5, -4.0] {
        for method in [Method::LevenbergMarquardt, Method::Dogleg] {
            let mut smoother = Smoother::new(Settings::default()).unwrap();
            let mut change = smoother.change();
            let x = change.add_variable(&VectorN::new([0.3, 0.0]));
            let noise = Noise::isotropic(3, 1.0).unwrap();
            change.add_factor(AutoDiff::new((x,), Bent(bend), noise).unwrap());
            let still = Noise::isotropic(2, 1e3).unwrap();
            change.add_factor(Prior::new(x, VectorN::new([0.0, 0.0]), still).unwrap());
            smoother.apply(change).unwrap();
            let settings = BatchSettings::default()
                .with_method(method)
                .with_relative_decrease(0.0)
                .with_max_iterations(300);
            let report = smoother.optimize(&settings).unwrap();
            assert_eq!(report.status, Status::Converged, "{bend} {method:?} {report:?}");
            let x = smoother.estimate(x).unwrap();
            assert!(x.vector()[0].abs() < 1e-3, "{bend} {method:?} {x:?}");
        }
    }
}

/// A long trajectory with few closures bends so easily that damping by 1e-7 holds it fast, and full steps from
/// its odometry go too far.
#[test]
fn damping_goes_down_with_what_long_trajectories_need() {
    let mut sphere = Surface::sphere(15_000, 1);
    sphere.closures.probability = 0.0003;
    let mut replayer = loaded(&sphere.generate().unwrap().document, Elimination::Cholesky);
    let report = replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
    assert_eq!(report.status, Status::Converged, "{report:?}");
    assert!(report.iterations <= 20, "{report:?}");
    assert!((report.error / 42.238_221_411_4 - 1.0).abs() < 1e-9, "{report:?}");
}

/// Between false loop closures damped steps crawl, and dogleg goes on.
#[test]
fn false_loop_closures_are_brought_to_the_end() {
    let test = "false_loop_closures_are_brought_to_the_end";
    let Some(path) = data_file(test, "pose2d/Bovisa04_odometry_bow_tr.g2o") else { return };
    let options = ReplayOptions::default().with_initial(Initial::FromFile);
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    let mut replayer = Replayer::new(&read(&path), &options, settings).unwrap();
    replayer.everything().unwrap();
    let smoother = replayer.smoother_mut();
    let report = optimize_to_the_end(smoother).unwrap();
    assert_eq!(report.status, Status::Converged, "{report:?}");
    let same = |a: f64, b: f64| (a - b).abs() < 1e-9 * b;
    assert!(report.iterations > 100 && same(report.initial_error, 697_090.349_609), "{report:?}");
    assert!(report.error < 17_500.0 && same(report.error, smoother.error().unwrap()), "{report:?}");
    // It is where another one ends at once.
    let again = optimize_to_the_end(smoother).unwrap();
    assert!(again.iterations < 10 && report.error - again.error < 1e-6, "{again:?}");
}
