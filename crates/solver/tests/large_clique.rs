//! A bound on the cliques that an update eliminates.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{Key, LieGroup, Noise, Pose2};
use evergraph_solver::{Settings, Smoother, SmootherError};

/// A trajectory; then every pose of the second half is seen from one of the first, in random order.
fn drive(smoother: &mut Smoother, count: usize) -> Result<(), SmootherError> {
    let at = |k: usize| Pose2::new(k as f64, 0.0, 0.0);
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut keys: Vec<Key<Pose2>> = Vec::new();
    for k in 0..count {
        let mut change = smoother.change();
        keys.push(change.add_variable(&at(k)));
        if k == 0 {
            change.add_factor(Prior::new(keys[0], at(0), noise.clone()).unwrap());
        } else {
            let odometry =
                BetweenPose2::new(keys[k - 1], keys[k], at(k - 1).between(&at(k)), noise.clone());
            change.add_factor(odometry.unwrap());
        }
        if k > count / 2 {
            let other = (17 * k + 29 * (k / 3) + k * k / 5) % (count / 2);
            let z = at(other).between(&at(k));
            change.add_factor(BetweenPose2::new(keys[other], keys[k], z, noise.clone()).unwrap());
        }
        smoother.apply(change)?;
    }
    Ok(())
}

#[test]
fn an_update_beyond_the_bound_is_refused_and_changes_nothing() {
    let mut free = Smoother::new(Settings::default()).unwrap();
    drive(&mut free, 80).unwrap();

    let mut bounded = Smoother::new(Settings::default().with_largest_clique(Some(30))).unwrap();
    let error = drive(&mut bounded, 80).unwrap_err();
    let SmootherError::LargeClique { scalars, largest: 30 } = error else { panic!("{error}") };
    assert!(scalars > 30 && error.to_string().contains("loop closures"), "{error}");
    let steps = bounded.steps() as usize;
    assert!((41..80).contains(&steps), "{steps}");

    // The steps before are there, bit for bit, and the smoother goes on.
    let mut same = Smoother::new(Settings::default().with_largest_clique(Some(1000))).unwrap();
    drive(&mut same, 80).unwrap();
    assert_eq!(bounded.graph().variable_count(), steps);
    let last = bounded.graph().variables().last().unwrap();
    let before = bounded.estimate_value(last).unwrap();
    assert!(before.storage().iter().all(|x| x.is_finite()));
    let mut change = bounded.change();
    let next = change.add_variable(&Pose2::new(0.0, 0.0, 0.0));
    change.add_factor(
        Prior::new(next, Pose2::new(0.0, 0.0, 0.0), Noise::isotropic(3, 1.0).unwrap()).unwrap(),
    );
    bounded.apply(change).unwrap();
    assert_eq!(bounded.estimate_value(last).unwrap().storage(), before.storage());
    // The bound is no part of the arithmetic.
    let all = |smoother: &Smoother| -> Vec<f64> {
        let estimates = smoother.estimates().unwrap();
        estimates.iter().flat_map(|(_, value)| value.to_value().storage().to_vec()).collect()
    };
    assert_eq!(all(&same), all(&free));
}

#[test]
fn a_bound_of_zero_is_refused() {
    let error = Smoother::new(Settings::default().with_largest_clique(Some(0))).unwrap_err();
    assert!(error.to_string().contains("largest_clique"), "{error}");
}
