//! In which order many nodes are removed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// The order in which trees are put in the place of many nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// As given.
    Given,
    /// At random, as the GLC paper's experiments do; the same on every machine for one seed.
    Random(u64),
    /// The node with the smallest Markov blanket first, counted as nodes go; ties by id.
    MinDegree,
    /// The node whose removal costs least first ([`Step::price`](crate::Step::price)), as priced
    /// right before it goes; [`LossQueue`](crate::LossQueue) says when others are priced again.
    MinLoss,
}

/// `nodes` in a random order, the same on every machine for one seed: that of [`Order::Random`], and
/// its beginning a fair choice of some.
pub fn shuffled<T: Clone>(nodes: &[T], seed: u64) -> Vec<T> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut nodes = nodes.to_vec();
    for last in (1..nodes.len()).rev() {
        nodes.swap(last, rng.random_range(0..=last));
    }
    nodes
}
