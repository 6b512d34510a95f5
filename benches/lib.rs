//! What the benchmarks share: worlds to replay, without any file.

use evergraph::Replayer;
use evergraph::factors::{Between, LocalJacobian};
use evergraph::formats::Document;
use evergraph::prelude::*;
use evergraph::replay::ReplayOptions;
use evergraph::simulate::{Grid, Surface};

/// A 2D world with many revisits.
///
/// # Panics
/// Never: the presets are valid.
pub fn city(poses: u32) -> Document {
    Grid::city(poses, 1).generate().expect("presets of the simulator are valid").document
}

/// A 3D world, a spiral over a sphere.
///
/// # Panics
/// Never: the presets are valid.
pub fn sphere(poses: u32) -> Document {
    Surface::sphere(poses, 1).generate().expect("presets of the simulator are valid").document
}

/// A replay of `document` after `steps` steps; all of them if there are fewer.
///
/// # Panics
/// When a step fails, which it does not for simulated worlds.
pub fn replayed(document: &Document, settings: Settings, steps: usize) -> Replayer {
    let mut replayer = Replayer::new(document, &ReplayOptions::default(), settings)
        .expect("simulated worlds are graphs");
    for _ in 0..steps {
        if replayer.step().expect("simulated worlds are well determined").is_none() {
            break;
        }
    }
    replayer
}

/// Poses at the same place, all of them measured from each other: a map that is a single clique.
///
/// # Panics
/// Never: the measurements are valid and determine every pose.
pub fn complete_graph<P, const N: usize>(poses: usize) -> (Smoother, Vec<Key<P>>)
where
    P: LieGroup<N> + LocalJacobian,
{
    let noise = Noise::isotropic(N, 1.0).expect("a positive sigma");
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    let mut smoother = Smoother::new(settings).expect("valid settings");
    let mut change = smoother.change();
    let keys: Vec<Key<P>> = (0..poses).map(|_| change.add_variable(&P::identity())).collect();
    let prior = Prior::new(keys[0], P::identity(), noise.clone());
    change.add_factor(prior.expect("a valid measurement"));
    for (i, &a) in keys.iter().enumerate() {
        for &b in &keys[i + 1..] {
            let between = Between::new(a, b, P::identity(), noise.clone());
            change.add_factor(between.expect("a valid measurement"));
        }
    }
    smoother.apply(change).expect("a prior and edges determine all poses");
    (smoother, keys)
}
