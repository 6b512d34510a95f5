//! Estimates and covariances that a plan is made from.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_model::{GraphError, Value, Values, VariableId};
use evergraph_removal::{Estimates, LinearizedEstimate, Options, Order, Removal, RemovalError};
use evergraph_solver::{Smoother, SmootherError};
use nalgebra::DMatrix;

/// A smoother, its estimates kept or copied, and a closure: all say the same.
#[test]
fn estimates_come_from_anything_that_has_them() {
    let (mut smoother, keys) = chain(6);
    let node = keys[2].id();
    let values = smoother.estimates().unwrap();
    let expected = Removal::new(smoother.graph(), &values).plan(node).unwrap();
    let closure = |id: VariableId| values.value(id).map(|value| value.to_value());
    let by_closure = Removal::new(smoother.graph(), &closure).plan(node).unwrap();
    assert_eq!(by_closure.steps(), expected.steps());
    // At the estimate, as the others are: a smoother also knows the linear model beside it.
    let options = Options::default().with_linear_within(0.0);
    let direct =
        Removal::new(smoother.graph(), &smoother).with_options(options).plan(node).unwrap();
    assert_eq!(direct.steps(), expected.steps());
    assert_eq!(direct.drift(&smoother).unwrap(), expected.drift(&values).unwrap());
    let kept = smoother.cached_estimates(0.0).unwrap();
    let by_kept = Removal::new(kept.graph(), &kept).with_options(options).plan(node).unwrap();
    assert_eq!(by_kept.steps(), expected.steps());
    let (_, foreign) = chain(2);
    let error = Removal::new(smoother.graph(), &smoother).plan(foreign[0]).unwrap_err();
    assert!(matches!(error, RemovalError::Graph(GraphError::Foreign { .. })), "{error}");
}

/// Estimates of one's own, one too few.
struct TooFew(Values);

impl Estimates for TooFew {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self.0.estimate(variable)
    }

    fn estimates_of(&self, variables: &[VariableId]) -> Result<Vec<Value>, GraphError> {
        self.0.estimates_of(&variables[1..])
    }
}

#[test]
fn estimates_that_are_too_few_are_refused() {
    let (smoother, keys) = chain(4);
    let few = TooFew(smoother.estimates().unwrap());
    let error = Removal::new(smoother.graph(), &few).plan(keys[1]).unwrap_err();
    assert!(matches!(error, RemovalError::EstimateCount { expected: 3, actual: 2 }), "{error}");
    let foreign = [keys[1].id(), chain(2).1[0].id()];
    let foreign_error = smoother.estimate_values(&foreign).unwrap_err();
    assert!(matches!(foreign_error, SmootherError::Graph(GraphError::Foreign { .. })));
    assert!(Estimates::estimates_of(&smoother, &foreign).is_err());
    assert!(smoother.estimate_values(&foreign[..0]).unwrap().is_empty());
}

/// Linearization points and steps of one's own.
struct Steps<F>(Smoother, F);

impl<F: Fn(&mut Vec<LinearizedEstimate>)> Estimates for Steps<F> {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        Estimates::estimate(&self.0, variable)
    }

    fn linearized(
        &self,
        variables: &[VariableId],
    ) -> Result<Option<Vec<LinearizedEstimate>>, GraphError> {
        let found = self.0.linearized(variables)?;
        Ok(found.map(|mut found| {
            self.1(&mut found);
            found
        }))
    }
}

#[test]
fn steps_that_are_none_are_refused() {
    let (smoother, keys) = chain(4);
    let plan = |spoil: fn(&mut Vec<LinearizedEstimate>), options| {
        let steps = Steps(smoother.clone(), spoil);
        // The ids of a clone are its own.
        Removal::new(steps.0.graph(), &steps).with_options(options).plan(keys[1])
    };
    let options = Options::default();
    assert!(plan(|_| (), options).is_ok());
    let error = plan(|found| drop(found.pop()), options).unwrap_err();
    assert!(matches!(error, RemovalError::EstimateCount { expected: 3, actual: 2 }), "{error}");
    let error = plan(|found| found[1].delta.truncate(2), options).unwrap_err();
    assert!(matches!(error, RemovalError::EstimateMismatch { dim: 2, .. }), "{error}");
    let any = options.with_linear_within(f64::INFINITY);
    for (options, bad) in [(options, f64::NAN), (any, f64::NAN), (any, f64::INFINITY)] {
        let spoil: fn(&mut Vec<LinearizedEstimate>) = match bad.is_nan() {
            true => |found| found[1].delta[0] = f64::NAN,
            false => |found| found[1].delta[0] = f64::INFINITY,
        };
        let error = plan(spoil, options).unwrap_err();
        assert!(matches!(error, RemovalError::NonFiniteEstimate { .. }), "{error}");
    }
    // So large a step that the linear model overflows.
    let error = plan(|found| found[1].delta[0] = f64::MAX, any).unwrap_err();
    assert!(matches!(error, RemovalError::NonFiniteFactor { .. }), "{error}");
    for bad in [f64::NAN, -1.0] {
        let error = plan(|_| (), options.with_linear_within(bad)).unwrap_err();
        assert!(matches!(error, RemovalError::Option { option: "linear_within", .. }), "{error}");
    }
}

/// A covariance that is none: indefinite, or not a number.
#[test]
fn covariances_that_are_none_are_refused() {
    let (smoother, keys) = chain(4);
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let mut joint = |ids: &[VariableId]| {
            let mut sigma = DMatrix::identity(3 * ids.len(), 3 * ids.len());
            sigma[(1, 1)] = bad;
            Ok::<_, String>(sigma)
        };
        for order in [Order::Given, Order::MinLoss] {
            let mut removal = Removal::new(smoother.graph(), &smoother).priced_by(&mut joint);
            let error = removal.plan_many(&[keys[1].id()], order).unwrap_err();
            assert!(matches!(error, RemovalError::Covariance { .. }), "{error}");
        }
    }
}
