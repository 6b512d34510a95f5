//! Estimates that are kept between questions: within the tolerance of the exact ones whatever
//! happens to the graph, and nothing depends on who has looked.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::prelude::*;
use evergraph_tests::world::{Operation, World};
use evergraph_tests::{read, repository};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How far the kept estimates are from the exact ones, in the tangent space of each variable.
fn largest_error(smoother: &mut Smoother, tolerance: f64) -> f64 {
    let exact = smoother.estimates().unwrap();
    let kept = smoother.cached_estimates(tolerance).unwrap();
    assert_eq!(kept.iter().count(), exact.len());
    let mut largest = 0.0_f64;
    for (id, value) in exact.iter() {
        let mut error = vec![0.0; value.dim()];
        value.kind().local(value.storage(), kept.value(id).unwrap().storage(), &mut error);
        largest = error.iter().fold(largest, |largest, e| largest.max(e.abs()));
    }
    largest
}

/// Whether kept estimates without a tolerance are the exact ones.
fn is_exact(smoother: &mut Smoother) -> bool {
    let exact = smoother.estimates().unwrap();
    let kept = smoother.cached_estimates(0.0).unwrap();
    exact.iter().zip(kept.iter()).all(|(exact, kept)| exact == kept)
}

fn operation(rng: &mut ChaCha8Rng) -> Operation {
    let mut pick = || rng.random_range(0..1000_usize);
    let (which, maker) = (pick(), pick());
    match rng.random_range(0..28_u8) {
        0..8 => {
            Operation::Extend { kind: rng.random(), from: which, turn: rng.random_range(-0.6..0.6) }
        }
        8..18 => Operation::Measure { maker, pick: which, robust: rng.random() },
        18..20 => Operation::Weak { maker, pick: which },
        20..22 => Operation::DropFactor(which),
        22..24 => Operation::DropVariable(which),
        24 => Operation::Replace(which),
        25 => Operation::Move(which),
        26 => Operation::Fail(rng.random()),
        _ if which % 3 == 0 => Operation::Optimize,
        _ => Operation::Relinearize,
    }
}

fn any_sequence(elimination: Elimination, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut looking, mut blind) = (World::new(elimination), World::new(elimination));
    for step in 0..60 {
        let operation = operation(&mut rng);
        looking.run(&operation);
        blind.run(&operation);
        let before = looking.smoother.fingerprint();
        match rng.random_range(0..4_u8) {
            0 => assert!(is_exact(&mut looking.smoother), "seed {seed}, step {step}"),
            1 => {
                let error = largest_error(&mut looking.smoother, 1e-6);
                assert!(error < 1e-4, "seed {seed}, step {step}, {operation:?}: {error}");
            }
            2 => {
                looking.smoother.cached_estimates(1e-3).unwrap();
            }
            _ => {}
        }
        assert_eq!(looking.smoother.fingerprint(), before);
        assert_eq!(before, blind.smoother.fingerprint(), "seed {seed}, step {step}");
    }
}

#[test]
fn any_sequence_with_cholesky() {
    (0..60).for_each(|seed| any_sequence(Elimination::Cholesky, seed));
}

#[test]
fn any_sequence_with_qr() {
    (100..140).for_each(|seed| any_sequence(Elimination::Qr, seed));
}

/// A whole replay, looking at each step.
fn replay(settings: Settings, tolerance: Option<f64>, bound: f64) -> u64 {
    let document = read(&repository().join("data/manhattan3500.g2o"));
    let mut replayer = Replayer::new(&document, &ReplayOptions::default(), settings).unwrap();
    let mut steps = 0;
    while steps < 1500 && replayer.step().unwrap().is_some() {
        steps += 1;
        let Some(tolerance) = tolerance else { continue };
        let smoother = replayer.smoother_mut();
        if steps % 25 == 0 {
            let error = largest_error(smoother, tolerance);
            assert!(error <= bound, "step {steps}: {error}");
        } else {
            smoother.cached_estimates(tolerance).unwrap();
        }
    }
    replayer.smoother().fingerprint()
}

#[test]
fn a_replay_stays_near_the_exact_estimates() {
    let blind = replay(Settings::default(), None, 0.0);
    for (tolerance, bound) in [(0.0, 0.0), (1e-6, 3e-5), (1e-3, 3e-2)] {
        assert_eq!(replay(Settings::default(), Some(tolerance), bound), blind);
    }
}

#[test]
fn a_batch_in_the_background_is_taken_over() {
    let settings = Settings::default().with_relinearization(Relinearization::BACKGROUND);
    let blind = replay(settings, None, 0.0);
    assert_eq!(replay(settings, Some(0.0), 0.0), blind);
}

#[test]
fn keys_are_checked_and_copies_last() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    assert_eq!(smoother.cached_estimates(1e-3).unwrap().iter().count(), 0);
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut change = smoother.change();
    let keys = [0.0, 1.0].map(|x| change.add_variable(&Pose2::new(x, 0.0, 0.0)));
    change.add_factor(Prior::new(keys[0], Pose2::identity(), noise.clone()).unwrap());
    let step = Pose2::new(1.5, 0.0, 0.0);
    change.add_factor(BetweenPose2::new(keys[0], keys[1], step, noise).unwrap());
    smoother.apply(change).unwrap();

    let exact = smoother.estimate(keys[1]).unwrap();
    let kept = smoother.cached_estimates(0.0).unwrap();
    assert_eq!(kept.get(keys[1]).unwrap(), exact);
    let copy = kept.to_values();

    let mut change = smoother.change();
    change.drop_variable_and_factors(smoother.graph(), keys[1].id()).unwrap();
    smoother.apply(change).unwrap();
    let kept = smoother.cached_estimates(0.0).unwrap();
    assert!(kept.get(keys[1]).is_err() && kept.value(keys[1].id()).is_err());
    assert!(kept.get(keys[0]).is_ok());
    assert_eq!(copy.get(keys[1]).unwrap(), exact);
}
