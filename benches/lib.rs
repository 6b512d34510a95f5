//! What the benchmarks share: worlds to replay, without any file.

use evergraph::Replayer;
use evergraph::formats::{Document, ReplayOptions};
use evergraph::prelude::*;
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
