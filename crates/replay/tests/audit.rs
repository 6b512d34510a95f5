//! Excess of an estimate over the batch optimum.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{LieGroup, Noise, Point2, Pose2};
use evergraph_replay::{Audit, AuditSample};
use evergraph_solver::{BatchSettings, Relinearization, Settings, Smoother, Status};

/// A loop of `poses` poses whose odometry turns too much, closed at the end.
fn bent_loop(poses: u32, sigma: f64) -> Smoother {
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    let mut smoother = Smoother::new(settings).unwrap();
    let noise = Noise::isotropic(3, sigma).unwrap();
    let turn = std::f64::consts::TAU / f64::from(poses);
    let step = Pose2::new(1.0, 0.0, 1.2 * turn);
    let mut change = smoother.change();
    let first = change.add_variable(&Pose2::new(0.0, 0.0, 0.0));
    change.add_factor(Prior::new(first, Pose2::new(0.0, 0.0, 0.0), noise.clone()).unwrap());
    smoother.apply(change).unwrap();
    let mut newest = first;
    for k in 1..poses {
        let mut change = smoother.change();
        let guess = smoother.estimate(newest).unwrap().compose(&step);
        let next = change.add_variable(&guess);
        change.add_factor(BetweenPose2::new(newest, next, step, noise.clone()).unwrap());
        if k + 1 == poses {
            let closure = Pose2::new(1.0, 0.0, turn);
            change.add_factor(BetweenPose2::new(next, first, closure, noise.clone()).unwrap());
        }
        smoother.apply(change).unwrap();
        newest = next;
    }
    smoother
}

#[test]
fn an_estimate_that_never_relinearizes_is_above_the_optimum() {
    let smoother = bent_loop(20, 0.1);
    let sample = AuditSample::take(&smoother, &BatchSettings::default(), |_| true).unwrap();
    assert_eq!((sample.step, sample.status), (20, Status::Converged));
    assert!(sample.relative_excess.unwrap() > 0.01, "{sample:?}");
    assert_eq!(sample.excess, sample.error - sample.optimum);
    // The smoother itself is as it was.
    assert_eq!(smoother.error().unwrap(), sample.error);
    let mut optimized = smoother.clone();
    let report = optimized.optimize(&BatchSettings::default()).unwrap();
    assert_eq!(report.error, sample.optimum);
    let settled = AuditSample::take(&optimized, &BatchSettings::default(), |_| true).unwrap();
    assert!(settled.relative_excess.unwrap().abs() < 1e-9, "{settled:?}");

    // Only some factors: all but the closure.
    let closure = smoother.graph().factors().map(|(id, _)| id).last().unwrap();
    let part = AuditSample::take(&smoother, &BatchSettings::default(), |id| id != closure).unwrap();
    assert!(part.error < sample.error && part.optimum < sample.optimum);

    let impatient = BatchSettings::default().with_max_iterations(1);
    let cut = AuditSample::take(&smoother, &impatient, |_| true).unwrap();
    assert!(matches!(cut.status, Status::NotConverged(_)));

    let mut audit = Audit::new();
    assert_eq!((audit.mean(), audit.worst()), (None, None));
    [settled, sample, settled].into_iter().for_each(|sample| audit.push(sample));
    assert!(audit.all_converged());
    assert_eq!(audit.worst(), Some(&sample));
    let mean = (sample.relative_excess.unwrap() + 2.0 * settled.relative_excess.unwrap()) / 3.0;
    assert!((audit.mean().unwrap() - mean).abs() < 1e-15);
    audit.push(cut);
    assert!(!audit.all_converged());
}

/// Points and differences are linear: there the incremental estimate is the optimum.
#[test]
fn a_linear_problem_has_no_excess() {
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    let mut smoother = Smoother::new(settings).unwrap();
    let noise = Noise::isotropic(2, 0.1).unwrap();
    let mut change = smoother.change();
    let point = change.add_variable(&Point2::new(5.0, -3.0));
    for x in [0.0, 1.0, 4.0] {
        change.add_factor(Prior::new(point, Point2::new(x, 1.0), noise.clone()).unwrap());
    }
    smoother.apply(change).unwrap();
    let sample = AuditSample::take(&smoother, &BatchSettings::default(), |_| true).unwrap();
    assert_eq!(sample.status, Status::Converged);
    assert!(sample.optimum > 1.0 && sample.relative_excess.unwrap().abs() < 1e-12, "{sample:?}");
    // Without disagreement the optimum is zero, and shares of it mean nothing.
    let exact = AuditSample::take(&smoother, &BatchSettings::default(), |_| false).unwrap();
    assert_eq!((exact.error, exact.optimum, exact.excess), (0.0, 0.0, 0.0));
    assert_eq!(exact.relative_excess, None);
}
