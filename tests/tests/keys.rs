//! Keys stay honest over a million lives of a slot.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::model::{FactorId, Graph, GraphError};
use evergraph::prelude::*;

const CYCLES: usize = 1_000_000;

#[test]
fn a_million_variables_come_and_go_in_a_few_slots() {
    let mut graph = Graph::new();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut previous: Option<(Key<Pose2>, FactorId)> = None;
    let mut first: Option<(Key<Pose2>, FactorId)> = None;
    for cycle in 0..CYCLES {
        let mut change = graph.change();
        let pose = change.add_variable(&Pose2::identity());
        let prior = Prior::new(pose, Pose2::identity(), noise.clone()).unwrap();
        let factor = change.add_factor(prior);
        if let Some((old, old_factor)) = previous {
            change.drop_factor(old_factor).drop_variable(old);
        }
        let staged = graph.stage(&change).unwrap();
        graph.commit(staged);
        if let Some((old, old_factor)) = previous {
            // The slot may be taken again, the key never is.
            assert!(old != pose && old_factor != factor, "cycle {cycle}");
            assert!(
                matches!(graph.factors_of(old.id()), Err(GraphError::UnknownVariable { variable }) if variable == old.id()),
                "cycle {cycle}"
            );
            assert!(graph.factor(old_factor).is_err(), "cycle {cycle}");
        }
        first.get_or_insert((pose, factor));
        previous = Some((pose, factor));
    }
    let (first_pose, first_factor) = first.unwrap();
    assert!(graph.factors_of(first_pose.id()).is_err() && graph.factor(first_factor).is_err());
    assert_eq!((graph.variable_count(), graph.factor_count()), (1, 1));
    assert!(graph.value_len() <= 64, "memory follows the living: {} numbers", graph.value_len());
    // A stale key in a change is refused by name.
    let mut change = graph.change();
    change.add_factor(Prior::new(first_pose, Pose2::identity(), noise).unwrap());
    let error = graph.stage(&change).unwrap_err();
    assert!(error.to_string().contains("it was removed, or"), "{error}");
}

#[test]
fn a_smoother_keeps_a_window_of_a_long_drive() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let ahead = Pose2::new(1.0, 0.0, 0.01);
    let mut window: std::collections::VecDeque<Key<Pose2>> = Default::default();
    for cycle in 0..100_000 {
        let mut change = smoother.change();
        let start = match window.back() {
            Some(&newest) => smoother.estimate(newest).unwrap().compose(&ahead),
            None => Pose2::identity(),
        };
        let pose = change.add_variable(&start);
        match window.back() {
            Some(&newest) => {
                change.add_factor(BetweenPose2::new(newest, pose, ahead, noise.clone()).unwrap())
            }
            None => change.add_factor(Prior::new(pose, start, noise.clone()).unwrap()),
        };
        window.push_back(pose);
        if window.len() > 5 {
            let oldest = window.pop_front().unwrap();
            change.drop_variable_and_factors(smoother.graph(), oldest).unwrap();
            let next = window[0];
            let at = smoother.estimate(next).unwrap();
            change.add_factor(Prior::new(next, at, noise.clone()).unwrap());
        }
        smoother.apply(change).unwrap_or_else(|error| panic!("cycle {cycle}: {error}"));
    }
    assert_eq!(smoother.graph().variable_count(), 5);
    assert!(smoother.graph().value_len() <= 5 * 64);
}
