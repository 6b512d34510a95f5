//! Digits lost in one pivot must not hide the next one's zero: graphs with stiff and soft edges, with
//! a weak prior or none.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const POSES: usize = 12;

/// A random tree with closures, two of its edges stiff, all in one change.
fn graph(
    seed: u64,
    stiff: f64,
    elimination: Elimination,
) -> (Smoother, Change, Vec<Key<Pose2>>, Vec<Pose2>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut pose = || {
        let mut within = |limit: f64| rng.random_range(-limit..limit);
        Pose2::new(within(5.0), within(5.0), within(3.0))
    };
    let truth: Vec<Pose2> = (0..POSES).map(|_| pose()).collect();
    let mut edges: Vec<(usize, usize, f64)> = (1..POSES)
        .map(|i| (rng.random_range(0..i), i, if i == 5 || i == 7 { stiff } else { 0.1 }))
        .collect();
    for _ in 0..8 {
        let (i, j) = (rng.random_range(0..POSES), rng.random_range(0..POSES));
        if i != j {
            edges.push((i, j, 0.1));
        }
    }
    let settings = Settings::default()
        .with_elimination(elimination)
        .with_relinearization(Relinearization::NEVER);
    let smoother = Smoother::new(settings).unwrap();
    let mut change = smoother.change();
    let poses: Vec<Key<Pose2>> = truth.iter().map(|pose| change.add_variable(pose)).collect();
    for (k, &(i, j, sigma)) in edges.iter().enumerate() {
        let off = Pose2::new(0.01 * sigma, 0.02 * sigma * k as f64, 0.0);
        let z = truth[i].between(&truth[j]).compose(&off);
        let noise = Noise::isotropic(3, sigma).unwrap();
        change.add_factor(BetweenPose2::new(poses[i], poses[j], z, noise).unwrap());
    }
    (smoother, change, poses, truth)
}

const STIFF: [f64; 6] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10];

#[test]
fn without_a_prior_every_graph_is_refused() {
    for elimination in [Elimination::Cholesky, Elimination::Qr] {
        for stiff in STIFF {
            for seed in 0..100 {
                let (mut smoother, change, ..) = graph(seed, stiff, elimination);
                let result = smoother.apply(change);
                assert!(
                    result.is_err(),
                    "{elimination:?}, sigma {stiff}, seed {seed} was accepted"
                );
            }
        }
    }
}

#[test]
fn a_weak_prior_places_the_graph_or_is_refused() {
    let mut solved = 0;
    for elimination in [Elimination::Cholesky, Elimination::Qr] {
        for stiff in STIFF {
            for seed in 0..100 {
                let (mut smoother, mut change, poses, truth) = graph(seed, stiff, elimination);
                let place = truth[3].compose(&Pose2::new(0.3, 0.2, 0.05));
                change.add_factor(
                    Prior::new(poses[3], place, Noise::isotropic(3, 100.0).unwrap()).unwrap(),
                );
                if smoother.apply(change).is_err() {
                    // Beyond what 64-bit numbers tell apart.
                    assert!(
                        stiff < 1e-7,
                        "{elimination:?}, sigma {stiff}, seed {seed} was refused"
                    );
                    continue;
                }
                solved += 1;
                let estimate = smoother.estimate(poses[3]).unwrap();
                let off = (estimate.x() - place.x()).hypot(estimate.y() - place.y());
                assert!(off < 5e-3, "{elimination:?}, sigma {stiff}, seed {seed}: off by {off} m");
            }
        }
    }
    assert!(solved >= 700, "only {solved} graphs were solved");
}
