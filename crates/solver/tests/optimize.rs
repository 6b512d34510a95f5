//! Batch optimization whose trust region has shrunk to rounding.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::Prior;
use evergraph_factors::autodiff::{AutoDiff, Number, Parameters, Residual, Vector2};
use evergraph_model::{Noise, VectorN};
use evergraph_solver::{BatchReport, BatchSettings, Method, Settings, Smoother, Status};

/// Optimizes one factor from a start; the report and the point.
fn optimized<R>(residual: R, start: [f64; 2], settings: &BatchSettings) -> (BatchReport, [f64; 2])
where
    R: Residual<3, Variables = (Parameters<2>,)> + std::fmt::Debug + Send + Sync + 'static,
{
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut change = smoother.change();
    let x = change.add_variable(&VectorN::new(start));
    let noise = Noise::isotropic(3, 1.0).unwrap();
    change.add_factor(AutoDiff::new((x,), residual, noise).unwrap());
    // Of no weight beside the residual.
    let weak = Noise::isotropic(2, 1e3).unwrap();
    change.add_factor(Prior::new(x, VectorN::new([0.0, 0.0]), weak).unwrap());
    smoother.apply(change).unwrap();
    let report = smoother.optimize(settings).unwrap();
    let found = smoother.estimate(x).unwrap();
    (report, [found.vector()[0], found.vector()[1]])
}

/// Two residuals whose full steps go from `x` to `-4x`, and a third so large that the error tells no
/// difference long before `x` is 0.
#[derive(Debug)]
struct Overshoots;

impl Residual<3> for Overshoots {
    type Variables = (Parameters<2>,);
    const NAME: &'static str = "Overshoots";

    fn evaluate<T: Number>(&self, (x,): (Vector2<T>,)) -> [T; 3] {
        [x[0] + 1.0, x[0] * x[0] * -4.0 + x[0] - 1.0, x[1] * 0.0 + 1e6]
    }
}

#[test]
fn a_trust_region_that_rounding_has_used_up_ends_it() {
    let settings = BatchSettings::default()
        .with_method(Method::Dogleg)
        .with_relative_decrease(0.0)
        .with_max_iterations(1000);
    let (report, found) = optimized(Overshoots, [0.3, 0.0], &settings);
    assert_eq!(report.status, Status::Converged, "{report:?}");
    assert!(report.iterations < 60 && found[0].abs() < 1e-2, "{report:?} {found:?}");
}
