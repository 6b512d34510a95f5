//! A change is applied whole or not at all: every refused change leaves every bit as it was, says
//! what is wrong, and does not stand in the way of the next.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::factors::{BetweenPose2, GpsPosition2, RelativePosition2};
use evergraph::model::{Arguments, GraphError, Linearization, VariableType};
use evergraph::prelude::*;
use evergraph::solver::Singular;
use evergraph_tests::check_against_batch;

fn noise(sigma: f64) -> Noise {
    Noise::isotropic(3, sigma).unwrap()
}

/// Ten poses on a line with a prior and a loop closure.
fn chain() -> (Smoother, Vec<Key<Pose2>>) {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut poses: Vec<Key<Pose2>> = Vec::new();
    for k in 0..10 {
        let mut change = smoother.change();
        poses.push(change.add_variable(&Pose2::new(k as f64 + 0.1, 0.05, 0.01)));
        match k {
            0 => change.add_factor(Prior::new(poses[0], Pose2::identity(), noise(0.01)).unwrap()),
            _ => change.add_factor(
                BetweenPose2::new(poses[k - 1], poses[k], Pose2::new(1.0, 0.0, 0.0), noise(0.1))
                    .unwrap(),
            ),
        };
        if k == 9 {
            change.add_factor(
                BetweenPose2::new(poses[9], poses[2], Pose2::new(-7.0, 0.1, 0.0), noise(0.1))
                    .unwrap(),
            );
        }
        smoother.apply(change).unwrap();
    }
    (smoother, poses)
}

/// Applies a change that must be refused, and checks that nothing has changed by it.
fn refused(smoother: &mut Smoother, change: Change) -> SmootherError {
    let before = smoother.fingerprint();
    let (variables, factors) = (smoother.graph().variable_count(), smoother.graph().factor_count());
    let error = smoother.apply(change).unwrap_err();
    assert_eq!(smoother.fingerprint(), before, "a refused change must leave every bit: {error}");
    assert_eq!(
        (smoother.graph().variable_count(), smoother.graph().factor_count()),
        (variables, factors)
    );
    check_against_batch(smoother, "after a refused change");
    error
}

/// A factor whose residual or Jacobian is not a number.
#[derive(Debug)]
struct Broken {
    key: [VariableId; 1],
    in_jacobian: bool,
}

impl Factor for Broken {
    fn name(&self) -> String {
        "Broken".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.key
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Pose2>()
    }
    fn residual(&self, _: &Arguments<'_>, out: &mut [f64]) {
        out[0] = if self.in_jacobian { 0.0 } else { f64::INFINITY };
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
        out.block_mut(0)[1] = if self.in_jacobian { f64::NAN } else { 1.0 };
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

#[test]
fn a_variable_without_factors_is_named_with_its_free_directions() {
    let (mut smoother, _) = chain();
    let mut change = smoother.change();
    let lonely = change.add_variable(&Pose2::identity());
    let error = refused(&mut smoother, change);
    let SmootherError::Singular(Singular::Variables { variables }) = &error else {
        panic!("{error}")
    };
    assert_eq!(variables.len(), 1);
    assert_eq!((variables[0].variable, variables[0].free), (lonely.id(), 3));
    assert!(error.to_string().contains("3 of 3 directions unconstrained: x, y, theta"), "{error}");
}

#[test]
fn a_half_measured_variable_names_what_is_missing() {
    let (mut smoother, _) = chain();
    let mut change = smoother.change();
    let pose = change.add_variable(&Pose2::new(3.0, 1.0, 0.0));
    // A position says nothing about the heading.
    let position =
        GpsPosition2::new(pose, Point2::new(3.0, 1.0), Noise::isotropic(2, 0.1).unwrap());
    change.add_factor(position.unwrap());
    let error = refused(&mut smoother, change);
    assert!(
        error
            .to_string()
            .contains(&format!("{}: 1 of 3 directions unconstrained: theta", pose.id())),
        "{error}"
    );
}

#[test]
fn an_island_without_a_prior_is_a_component() {
    let (mut smoother, _) = chain();
    let mut change = smoother.change();
    let a = change.add_variable(&Pose2::identity());
    let b = change.add_variable(&Pose2::identity());
    change.add_factor(BetweenPose2::new(a, b, Pose2::new(1.0, 0.0, 0.2), noise(0.1)).unwrap());
    let error = refused(&mut smoother, change);
    let SmootherError::Singular(Singular::Component { count, free, .. }) = &error else {
        panic!("{error}")
    };
    assert_eq!((*count, *free), (2, 3));
    assert!(error.to_string().contains("Put a prior"), "{error}");
}

#[test]
fn dropping_the_last_prior_is_refused() {
    let (mut smoother, poses) = chain();
    let prior = smoother.graph().factors_of(poses[0].id()).unwrap()[0];
    let mut change = smoother.change();
    change.drop_factor(prior);
    let error = refused(&mut smoother, change);
    assert!(
        matches!(&error, SmootherError::Singular(Singular::Component { count: 10, .. })),
        "{error}"
    );
}

#[test]
fn dropping_a_bridge_is_refused() {
    let (mut smoother, poses) = chain();
    let bridge = smoother.graph().factors_of(poses[1].id()).unwrap()[0];
    let mut change = smoother.change();
    change.drop_factor(bridge);
    let error = refused(&mut smoother, change);
    assert!(
        matches!(&error, SmootherError::Singular(Singular::Component { count: 9, .. })),
        "{error}"
    );
}

#[test]
fn a_factor_that_is_not_finite_is_named() {
    for in_jacobian in [false, true] {
        let (mut smoother, poses) = chain();
        let mut change = smoother.change();
        change.add_factor(Broken { key: [poses[4].id()], in_jacobian });
        let error = refused(&mut smoother, change);
        assert!(
            matches!(&error, SmootherError::NonFinite { name, .. } if name == "Broken"),
            "{error}"
        );
        assert!(error.to_string().contains(&poses[4].id().to_string()), "{error}");
    }
}

#[test]
fn numbers_that_overflow_are_refused() {
    let (mut smoother, poses) = chain();
    for sigma in [1e-150, 1e-100] {
        let mut change = smoother.change();
        let far = Pose2::new(1e220, 0.0, 0.0);
        change.add_factor(Prior::new(poses[4], far, noise(sigma)).unwrap());
        refused(&mut smoother, change);
    }
}

#[test]
fn references_are_checked() {
    let (mut smoother, poses) = chain();
    let (other, other_poses) = chain();

    let mut change = smoother.change();
    change.add_factor(Prior::new(other_poses[0], Pose2::identity(), noise(1.0)).unwrap());
    let error = refused(&mut smoother, change);
    assert!(matches!(error, SmootherError::Graph(GraphError::Foreign { .. })), "{error}");

    let error = refused(&mut smoother, other.change());
    assert!(matches!(error, SmootherError::Graph(GraphError::Foreign { .. })), "{error}");

    let mut change = smoother.change();
    change.drop_variable(poses[9]);
    let error = refused(&mut smoother, change);
    assert!(matches!(error, SmootherError::Graph(GraphError::StillHeld { .. })), "{error}");

    let mut change = smoother.change();
    change.add_variable(&Pose2::new(f64::NAN, 0.0, 0.0));
    let error = refused(&mut smoother, change);
    assert!(matches!(error, SmootherError::Graph(GraphError::NonFiniteValue { .. })), "{error}");

    let version = smoother.graph().version(poses[5].id()).unwrap();
    let mut change = smoother.change();
    change.require(poses[5], version + 1);
    let error = refused(&mut smoother, change);
    assert!(matches!(error, SmootherError::Graph(GraphError::Stale { .. })), "{error}");

    // A landmark factor on two poses; only ids that lost their type can get that far.
    let factor = smoother.graph().factors_of(poses[3].id()).unwrap()[0];
    let mut change = smoother.change();
    change.drop_factor(factor).drop_factor(factor);
    let error = refused(&mut smoother, change);
    assert!(matches!(error, SmootherError::Graph(GraphError::Twice { .. })), "{error}");
}

#[test]
fn of_two_changes_made_at_once_both_are_applied_unless_one_requires_what_the_other_changes() {
    let (mut smoother, poses) = chain();
    let version = smoother.graph().version(poses[9]).unwrap();
    let mut changes = [(); 3].map(|()| {
        let mut change = smoother.change();
        let pose = change.add_variable(&Pose2::new(10.0, 0.0, 0.0));
        change.add_factor(
            BetweenPose2::new(poses[9], pose, Pose2::new(1.0, 0.0, 0.0), noise(0.1)).unwrap(),
        );
        Some(change)
    });
    smoother.apply(changes[0].take().unwrap()).unwrap();
    smoother.apply(changes[1].take().unwrap()).unwrap();
    let mut planned = changes[2].take().unwrap();
    planned.require(poses[9], version);
    let error = refused(&mut smoother, planned);
    assert!(matches!(error, SmootherError::Graph(GraphError::Stale { .. })), "{error}");
}

#[test]
fn keys_of_dropped_variables_fail_and_are_never_given_again() {
    let (mut smoother, poses) = chain();
    for _ in 0..100 {
        let mut change = smoother.change();
        let landmark = change.add_variable(&Point2::new(1.0, 1.0));
        let seen = RelativePosition2::new(
            poses[5],
            landmark,
            Point2::new(1.0, 1.0),
            Noise::isotropic(2, 0.1).unwrap(),
        );
        change.add_factor(seen.unwrap());
        smoother.apply(change).unwrap();
        check_against_batch(&smoother, "with a landmark");
        let mut change = smoother.change();
        change.drop_variable_and_factors(smoother.graph(), landmark).unwrap();
        smoother.apply(change).unwrap();
        assert!(matches!(
            smoother.estimate(landmark),
            Err(SmootherError::Graph(GraphError::UnknownVariable { .. }))
        ));
    }
    assert_eq!(smoother.graph().variable_slots(), 11, "memory follows the living, not the time");
    check_against_batch(&smoother, "after many landmarks");
}

#[test]
fn work_follows_what_is_touched() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut poses: Vec<Key<Pose2>> = Vec::new();
    for k in 0..1000 {
        let mut change = smoother.change();
        poses.push(change.add_variable(&Pose2::new(k as f64, 0.0, 0.0)));
        if k == 0 {
            change.add_factor(Prior::new(poses[0], Pose2::identity(), noise(0.01)).unwrap());
        } else {
            let step = Pose2::new(1.0, 0.0, 0.0);
            change.add_factor(BetweenPose2::new(poses[k - 1], poses[k], step, noise(0.1)).unwrap());
        }
        let report = smoother.apply(change).unwrap();
        assert!(
            report.variables_eliminated <= 8,
            "step {k} of a chain eliminated {}",
            report.variables_eliminated
        );
        assert_eq!(report.rank, 3 * (k + 1));
        assert!(report.smallest_pivot_ratio > 1e-9);
    }
}

#[test]
fn one_estimate_is_that_of_all() {
    let (smoother, poses) = chain();
    let all = smoother.estimates().unwrap();
    for pose in poses {
        assert_eq!(smoother.estimate(pose).unwrap(), all.get(pose).unwrap());
    }
}

#[test]
fn smoothers_move_between_threads() {
    fn send<T: Send>(_: &T) {}
    let (smoother, poses) = chain();
    send(&smoother);
    let moved = std::thread::spawn(move || smoother.estimate(poses[9]).unwrap());
    assert!(moved.join().unwrap().x() > 8.0);
}

#[test]
fn a_refused_change_with_an_empty_variable_leaves_nothing_behind() {
    // Empty ranges used to be given back twice, so that the next one lay outside of the array.
    let (mut smoother, _) = chain();
    let mut change = smoother.change();
    change.add_variable(&Pose2::identity());
    change.add_variable(&VectorN::zeros(0));
    refused(&mut smoother, change);
    let mut change = smoother.change();
    let empty = change.add_variable(&VectorN::zeros(0));
    smoother.apply(change).unwrap();
    assert!(smoother.estimate(empty).unwrap().is_empty());
    let mut change = smoother.change();
    change.drop_variable(empty);
    smoother.apply(change).unwrap();
    check_against_batch(&smoother, "after an empty variable");
}

#[test]
fn keys_of_a_clone_are_checked() {
    // No id that one mints is ever minted by the other.
    let (mut smoother, _) = chain();
    let mut clone = smoother.clone();
    let mut change = smoother.change();
    let pose = change.add_variable(&Pose2::identity());
    change.add_factor(Prior::new(pose, Pose2::identity(), noise(0.1)).unwrap());
    smoother.apply(change).unwrap();
    let mut change = clone.change();
    let point = change.add_variable(&Point2::new(0.0, 0.0));
    let at = Prior::new(point, Point2::new(0.0, 0.0), Noise::isotropic(2, 0.1).unwrap());
    change.add_factor(at.unwrap());
    clone.apply(change).unwrap();
    let error = clone.estimate(pose).unwrap_err();
    assert!(matches!(error, SmootherError::Graph(GraphError::UnknownVariable { .. })), "{error}");
    assert!(smoother.estimate(point).is_err() && clone.estimate(point).is_ok());
}

#[test]
fn memory_follows_the_living_in_large_changes_too() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut window: Vec<Key<Point2>> = Vec::new();
    for _ in 0..300 {
        let mut change = smoother.change();
        for &old in &window {
            change.drop_variable_and_factors(smoother.graph(), old).unwrap();
        }
        window = (0..50).map(|_| change.add_variable(&Point2::new(0.0, 0.0))).collect();
        for &point in &window {
            let at = Prior::new(point, Point2::new(1.0, 0.0), Noise::isotropic(2, 0.1).unwrap());
            change.add_factor(at.unwrap());
        }
        smoother.apply(change).unwrap();
    }
    let slots = (smoother.graph().variable_slots(), smoother.graph().factor_slots());
    assert!(slots.0 <= 400 && slots.1 <= 400, "50 living things in {slots:?} slots");
}

#[test]
fn no_iterations_is_no_step() {
    let (mut smoother, _) = chain();
    for method in [Method::GaussNewton, Method::LevenbergMarquardt, Method::Dogleg] {
        let settings = BatchSettings::default().with_method(method).with_max_iterations(0);
        let report = smoother.optimize(&settings).unwrap();
        assert_eq!((report.iterations, report.error), (0, report.initial_error));
    }
}
