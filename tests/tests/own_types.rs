//! The steps of the example `own_types`: a user's variable type and factor are added, optimized,
//! removed, saved and read back.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

#[allow(dead_code, reason = "its main function is not called here")]
#[path = "../../crates/evergraph/examples/own_types.rs"]
mod own_types;

use evergraph::factors::catalogue::{Catalogue, CatalogueError, DataError};
use evergraph::prelude::*;
use own_types::{SavedMap, WheelScale, catalogue, drive, thin_out};

fn distance(a: &Value, b: &Value) -> f64 {
    let mut apart = vec![0.0; a.dim()];
    a.kind().local(a.storage(), b.storage(), &mut apart);
    apart.iter().fold(0.0, |largest, x| largest.max(x.abs()))
}

#[test]
fn own_types_go_through_everything() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let (poses, [old_tyres, new_tyres]) = drive(&mut smoother).unwrap();
    for (tyres, truth) in [(old_tyres, 1.04), (new_tyres, 0.97)] {
        let mut apart = [0.0];
        smoother.estimate(tyres).unwrap().local(&WheelScale::load(&[truth]), &mut apart);
        assert!(apart[0].abs() < 0.005, "{apart:?}");
    }

    let poses_kept = poses[..=40].iter().step_by(2).chain(&poses[41..]).map(|pose| pose.id());
    let kept: Vec<VariableId> = poses_kept.chain([new_tyres.id()]).collect();
    let before: Vec<Value> = kept.iter().map(|id| smoother.estimate_value(*id).unwrap()).collect();
    thin_out(&mut smoother, &poses, old_tyres).unwrap();
    assert!(smoother.estimate(old_tyres).is_err());
    assert_eq!(smoother.graph().variables().count(), kept.len());
    // Removed at the optimum, they leave an optimum; what bends moves it by less than it is known.
    for (id, before) in kept.iter().zip(&before) {
        let apart = distance(before, &smoother.estimate_value(*id).unwrap());
        assert!(apart < 1e-3, "{id} moved by {apart}");
    }

    let catalogue = catalogue().unwrap();
    let saved = SavedMap::of(&smoother, &catalogue).unwrap();
    let text = serde_json::to_string(&saved).unwrap();
    assert!(text.contains("example.Odometer") && text.contains("\"Linear\""), "{text}");
    let read: SavedMap = serde_json::from_str(&text).unwrap();
    let (opened, new_ids) = read.open(&catalogue).unwrap();
    // All estimates are what they were, and with the same factors they are the optimum still.
    for id in &kept {
        let (old, new) =
            (smoother.estimate_value(*id).unwrap(), opened.estimate_value(new_ids[id]).unwrap());
        assert!(distance(&old, &new) < 1e-9, "{id}: {old:?} became {new:?}");
    }
    assert_eq!(opened.graph().factors().count(), smoother.graph().factors().count());
    let errors = [smoother.error().unwrap(), opened.error().unwrap()];
    assert!((errors[0] - errors[1]).abs() <= 1e-9 * errors[0].max(1.0), "{errors:?}");
}

#[test]
fn a_catalogue_without_them_says_what_is_missing() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let (poses, [old_tyres, _]) = drive(&mut smoother).unwrap();
    thin_out(&mut smoother, &poses, old_tyres).unwrap();
    let standard = Catalogue::standard();
    let value = smoother.estimate_value(smoother.graph().variables().nth(1).unwrap()).unwrap();
    assert!(matches!(
        standard.to_value_data(&value),
        Err(CatalogueError::UnknownVariable { name, .. }) if name == "example.WheelScale"
    ));
    // A linear factor of the library on a variable that the catalogue does not know.
    let linear = |error: &CatalogueError| matches!(error, CatalogueError::InvalidFactor { name, source: DataError::Value(_) } if name == "Linear");
    let errors =
        smoother.graph().factors().filter_map(|(_, factor)| standard.to_data(factor).err());
    let errors: Vec<CatalogueError> = errors.collect();
    assert!(errors.iter().any(linear), "{errors:?}");
    let unknown = |error: &CatalogueError| matches!(error, CatalogueError::UnknownFactor { name, .. } if name == "example.Odometer");
    assert!(errors.iter().any(unknown), "{errors:?}");
}
