//! Users' code that panics, or gives numbers that are not finite, in any step: each failure is an
//! error that leaves the state as it was, and none loses a change that was applied.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{
    Arguments, Factor, GraphError, Key, LieGroup, Linearization, Manifold, Noise, Point2, Pose2,
    VariableId, VariableType,
};
use evergraph_solver::{
    BatchSettings, Fluid, Method, Relinearization, Settings, Smoother, SmootherError,
};

/// Calls that succeed before one panics; `u32::MAX` for never.
type Fuse = Arc<AtomicU32>;

fn burn(fuse: &Fuse) {
    let left = fuse.load(Ordering::Relaxed);
    assert!(left > 0, "the user's mistake");
    if left < u32::MAX {
        fuse.store(left - 1, Ordering::Relaxed);
    }
}

/// `‖p‖ = 1`, which panics when its fuse is burnt.
#[derive(Debug)]
struct Circle {
    key: [VariableId; 1],
    fuse: Fuse,
}

impl Factor for Circle {
    fn name(&self) -> String {
        "Circle".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.key
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Point2>()
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        burn(&self.fuse);
        let p: Point2 = at.get(0);
        out[0] = 10.0 * (p.x().hypot(p.y()) - 1.0);
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
        let p: Point2 = at.get(0);
        let norm = p.x().hypot(p.y());
        out.block_mut(0).copy_from_slice(&[10.0 * p.x() / norm, 10.0 * p.y() / norm]);
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// A number that cannot be moved beyond 10: `retract` panics from there, and from 5 it gives NaN.
#[derive(Clone, Debug, PartialEq)]
struct Touchy(f64);

impl Manifold for Touchy {
    const NAME: &'static str = "Touchy";
    const COMPONENTS: &'static [&'static str] = &["x"];
    fn dim(&self) -> usize {
        1
    }
    fn storage_len(&self) -> usize {
        1
    }
    fn store(&self, out: &mut [f64]) {
        out[0] = self.0;
    }
    fn load(storage: &[f64]) -> Self {
        Self(storage[0])
    }
    fn retract(&self, delta: &[f64]) -> Self {
        let x = self.0 + delta[0];
        assert!(x < 10.0, "too far");
        Self(if x < 5.0 { x } else { f64::NAN })
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        out[0] = other.0 - self.0;
    }
}

/// A measurement of a [`Touchy`].
#[derive(Debug)]
struct Near {
    key: [VariableId; 1],
    at: f64,
}

impl Factor for Near {
    fn name(&self) -> String {
        "Near".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.key
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Touchy>()
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out[0] = at.get::<Touchy>(0).0 - self.at;
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
        out.block_mut(0)[0] = 1.0;
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

fn every(n: u32) -> NonZeroU32 {
    NonZeroU32::new(n).unwrap()
}

fn smoother(relinearization: Relinearization) -> Smoother {
    Smoother::new(Settings::default().with_relinearization(relinearization)).unwrap()
}

/// Checks after every change, spread over so many.
fn fluid(spread: u32) -> Relinearization {
    let fluid = Fluid::new(0.01, 1.0, every(1));
    let mut policy = Relinearization::BOTH;
    (policy.fluid, policy.sweep, policy.spread) = (Some(fluid), None, every(spread));
    policy
}

/// A chain of poses beside a point on a circle whose factor has a fuse.
fn world(relinearization: Relinearization) -> (Smoother, Key<Point2>, Key<Pose2>, Fuse) {
    let mut smoother = smoother(relinearization);
    let fuse: Fuse = Arc::new(AtomicU32::new(u32::MAX));
    let mut change = smoother.change();
    let point = change.add_variable(&Point2::new(3.0, 1.0));
    let pose = change.add_variable(&Pose2::identity());
    let weak = Noise::isotropic(2, 3.0).unwrap();
    change.add_factor(Prior::new(point, Point2::new(2.0, 2.0), weak).unwrap());
    change.add_factor(Circle { key: [point.id()], fuse: Arc::clone(&fuse) });
    let noise = Noise::isotropic(3, 0.1).unwrap();
    change.add_factor(Prior::new(pose, Pose2::identity(), noise).unwrap());
    smoother.apply(change).unwrap();
    (smoother, point, pose, fuse)
}

fn is_panic(error: &SmootherError) -> bool {
    matches!(error, SmootherError::Graph(
        GraphError::FactorPanicked { message, .. } | GraphError::VariablePanicked { message, .. }
    ) if message.contains("mistake") || message.contains("too far"))
}

#[test]
fn a_panic_in_a_change_leaves_every_bit() {
    let (mut smoother, point, pose, fuse) = world(Relinearization::NEVER);
    let before = smoother.fingerprint();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    for kind in 0..3 {
        fuse.store(0, Ordering::Relaxed);
        let mut change = smoother.change();
        let next = change.add_variable(&Pose2::new(1.0, 0.0, 0.0));
        let z = Pose2::new(1.0, 0.0, 0.0);
        change.add_factor(BetweenPose2::new(pose, next, z, noise.clone()).unwrap());
        match kind {
            0 => _ = change.add_factor(Circle { key: [point.id()], fuse: Arc::clone(&fuse) }),
            1 => _ = change.move_linearization_point(point, &Point2::new(0.0, 2.0)),
            _ => _ = change.fix(point),
        }
        let error = smoother.apply(change.clone()).unwrap_err();
        assert!(is_panic(&error), "{error}");
        assert_eq!(smoother.fingerprint(), before, "{error}");
        assert!(is_panic(&smoother.error().unwrap_err()));
        fuse.store(u32::MAX, Ordering::Relaxed);
        // The same change is fine when the factor is.
        smoother.clone().apply(change).unwrap();
    }
}

#[test]
fn a_panic_in_a_relinearization_gives_that_up_and_keeps_the_change() {
    for spread in [1, 3] {
        let mut given_up = 0;
        // The fuse burns in the step itself, in a check, in a slice, or when that takes effect.
        for calls in 0..4 {
            let (mut smoother, point, pose, fuse) = world(fluid(spread));
            let mut last = pose;
            for step in 1..12 {
                if step == 2 {
                    fuse.store(calls, Ordering::Relaxed);
                }
                let mut change = smoother.change();
                let z = Pose2::new(1.0, 0.0, 0.0);
                let pose = change.add_variable(&Pose2::new(f64::from(step), 0.0, 0.0));
                let noise = Noise::isotropic(3, 0.1).unwrap();
                change.add_factor(BetweenPose2::new(last, pose, z, noise).unwrap());
                let report = smoother.apply(change).unwrap();
                assert_eq!(report.new_variables(), [pose.id()]);
                if let Some(error) = &report.relinearization_refused {
                    assert!(is_panic(error), "{error}");
                    given_up += 1;
                }
                last = pose;
            }
            let at = smoother.estimate(last).unwrap();
            assert!((at.x() - 11.0).abs() < 1e-9 && smoother.estimate(point).is_ok());
            fuse.store(u32::MAX, Ordering::Relaxed);
            smoother.relinearize_batch().unwrap();
        }
        assert!(given_up > 0, "spread {spread}");
    }
}

#[test]
fn a_panic_in_a_batch_step_restores_everything() {
    for method in [Method::GaussNewton, Method::LevenbergMarquardt, Method::Dogleg] {
        for calls in 0..6 {
            let (mut smoother, _, _, fuse) = world(Relinearization::NEVER);
            let before = smoother.fingerprint();
            fuse.store(calls, Ordering::Relaxed);
            let settings = BatchSettings::default().with_method(method);
            let error = smoother.optimize(&settings).unwrap_err();
            assert!(is_panic(&error), "{error}");
            assert_eq!(smoother.fingerprint(), before, "{method:?}, {calls} calls");
        }
    }
    let (mut smoother, .., fuse) = world(Relinearization::every(every(2)));
    fuse.store(0, Ordering::Relaxed);
    let change = smoother.change();
    let report = smoother.apply(change).unwrap();
    assert!(is_panic(&report.relinearization_refused.unwrap()));
}

#[test]
fn retractions_that_fail_are_errors_of_every_question() {
    for (target, is_nan) in [(7.0, true), (50.0, false)] {
        let mut smoother = smoother(fluid(1));
        let mut change = smoother.change();
        let touchy = change.add_variable(&Touchy(1.0));
        change.add_factor(Near { key: [touchy.id()], at: target });
        let report = smoother.apply(change).unwrap();
        let is_expected = |error: &SmootherError| match error {
            SmootherError::Graph(GraphError::NonFiniteRetraction { .. }) => is_nan,
            error => is_panic(error),
        };
        let refused = report.relinearization_refused.unwrap();
        assert!(is_expected(&refused), "{refused}");
        let before = smoother.fingerprint();
        assert!(is_expected(&smoother.estimate(touchy).unwrap_err()));
        assert!(is_expected(&smoother.estimate_values(&[touchy]).unwrap_err()));
        assert!(is_expected(&smoother.estimates().unwrap_err()));
        assert!(is_expected(&smoother.error().unwrap_err()));
        assert!(is_expected(&smoother.error_of(|_| true).unwrap_err()));
        let factor = smoother.graph().factors_of(touchy).unwrap()[0];
        assert!(is_expected(&smoother.residual_of(factor).unwrap_err()));
        for _ in 0..2 {
            assert!(is_expected(&smoother.cached_estimates(0.0).unwrap_err()));
        }
        let mut change = smoother.change();
        change.fix(touchy);
        assert!(is_expected(&smoother.apply(change).unwrap_err()));
        assert_eq!(smoother.fingerprint(), before);
        // A measurement nearby brings it back.
        let mut change = smoother.change();
        for _ in 0..100 {
            change.add_factor(Near { key: [touchy.id()], at: 1.0 });
        }
        smoother.apply(change).unwrap();
        let expected = (100.0 + target) / 101.0;
        let cached = smoother.cached_estimates(0.0).unwrap().get(touchy).unwrap();
        assert!((cached.0 - expected).abs() < 1e-9);
        assert_eq!(smoother.estimate(touchy).unwrap(), cached);
    }
}

#[test]
fn single_factors_are_evaluated_at_the_estimate() {
    use evergraph_model::{Kernel, Robust};
    let mut smoother = smoother(Relinearization::NEVER);
    let mut change = smoother.change();
    let point = change.add_variable(&Point2::new(0.0, 0.0));
    let noise = || Noise::isotropic(2, 0.5).unwrap();
    let plain = Prior::new(point, Point2::new(0.0, 0.0), noise()).unwrap();
    let far = Prior::new(point, Point2::new(8.0, 6.0), noise()).unwrap();
    let plain = change.add_factor(plain);
    let robust = change.add_factor(Robust::new(far, Kernel::huber(1.0).unwrap()));
    smoother.apply(change).unwrap();
    let at = smoother.estimate(point).unwrap();
    let residual = smoother.residual_of(robust).unwrap();
    let expected = [(at.x() - 8.0) / 0.5, (at.y() - 6.0) / 0.5];
    assert!((residual[0] - expected[0]).abs() < 1e-12);
    assert!((residual[1] - expected[1]).abs() < 1e-12);
    let weight = smoother.weight_of(robust).unwrap();
    assert!((weight - 1.0 / residual.norm()).abs() < 1e-12, "Huber: k / ‖r‖");
    assert_eq!(smoother.weight_of(plain).unwrap(), 1.0);
    let linearization = smoother.linearization_of(robust).unwrap();
    assert!((&linearization.residual - &residual * weight.sqrt()).amax() < 1e-12);
    assert!((linearization.jacobians[0][(0, 0)] - weight.sqrt() / 0.5).abs() < 1e-12);
    let error = smoother.error_of_factor(robust).unwrap();
    assert!((error - (residual.norm() - 0.5)).abs() < 1e-12);
    let sum = error + smoother.error_of_factor(plain).unwrap();
    assert!((sum - smoother.error().unwrap()).abs() < 1e-12);
    assert_eq!(smoother.error_of(|f| f == robust).unwrap(), error);
}
