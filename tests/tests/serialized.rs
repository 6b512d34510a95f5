//! Keys, estimates, reports and settings as data.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::prelude::*;
use serde_json::{Value as Json, json};

#[test]
fn keys_estimates_and_reports_are_data() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut change = smoother.change();
    let pose = change.add_variable(&Pose2::new(1.0, 2.0, 0.0));
    let landmark = change.add_variable(&Point2::new(3.0, -4.0));
    change.add_factor(
        Prior::new(pose, Pose2::new(1.0, 2.0, 0.0), Noise::isotropic(3, 0.1).unwrap()).unwrap(),
    );
    change.add_factor(
        Prior::new(landmark, Point2::new(3.0, -4.0), Noise::isotropic(2, 0.1).unwrap()).unwrap(),
    );
    let report = smoother.apply(change).unwrap();

    // A key is its id, and reads back as the key that it was.
    let text = serde_json::to_string(&pose).unwrap();
    assert_eq!(text, serde_json::to_string(&pose.id()).unwrap());
    let read: Key<Pose2> = serde_json::from_str(&text).unwrap();
    assert_eq!(read, pose);
    // A key of the wrong type can be read, and is refused when it is used.
    let wrong: Key<Point2> = serde_json::from_str(&text).unwrap();
    let error = smoother.estimate(wrong).unwrap_err();
    assert!(matches!(error, SmootherError::Graph(_)), "{error}");

    // Estimates are a list of id, type and numbers.
    let estimates = serde_json::to_value(smoother.estimates().unwrap()).unwrap();
    let list: Vec<(VariableId, String, Vec<f64>)> = serde_json::from_value(estimates).unwrap();
    assert_eq!(list.len(), 2);
    assert_eq!((list[0].0, list[1].0), (pose.id(), landmark.id()));
    assert_eq!((list[0].1.as_str(), list[1].1.as_str()), (Pose2::NAME, Point2::NAME));
    assert_eq!(list[1].2.len(), 2);
    for (&number, expected) in list[1].2.iter().zip([3.0, -4.0]) {
        assert!((number - expected).abs() < 1e-12, "{number} for {expected}");
    }

    let data = serde_json::to_value(&report).unwrap();
    assert_eq!(data["rank"], 5);
    assert_eq!(data["new_variables"], json!([pose, landmark]));
    assert_eq!(data.get("batch"), Some(&Json::Null));
    assert_eq!(data.get("relinearization_refused"), Some(&Json::Null));

    let batch = smoother.optimize(&BatchSettings::default()).unwrap();
    let data = serde_json::to_value(batch).unwrap();
    assert_eq!(data["status"], "converged");
    assert!(data["iterations"].is_u64(), "{data}");
}

#[test]
fn settings_are_data() {
    let settings = Settings::default()
        .with_elimination(Elimination::Qr)
        .with_relinearization(Relinearization::BACKGROUND)
        .with_back_substitution_tolerance(1e-5)
        .with_threads(3);
    let text = serde_json::to_string(&settings).unwrap();
    assert_eq!(serde_json::from_str::<Settings>(&text).unwrap(), settings);
    let batch = BatchSettings::default()
        .with_method(Method::Dogleg)
        .with_max_iterations(7)
        .with_relative_decrease(0.1);
    let text = serde_json::to_string(&batch).unwrap();
    assert_eq!(serde_json::from_str::<BatchSettings>(&text).unwrap(), batch);
}
