//! In which order many nodes are removed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// The order in which trees are put in the place of many nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Order {
    /// As given.
    Given,
    /// At random, as the GLC paper's experiments do; the same on every machine for one seed.
    Random(u64),
    /// The node with the smallest Markov blanket first, counted as nodes go; ties by slot. A node is counted again when
    /// one of its neighbours has been removed.
    MinDegree,
    /// The node whose removal costs least first ([`Step::price`](crate::Step::price)); ties by slot.
    ///
    /// A removal changes all other prices a little, and those of its blanket much:
    ///
    /// - A node is priced again before it is removed, and waits if another has become cheaper.
    /// - A node in the blanket of a removed one is priced again, because its own neighborhood has changed. Prices fall as
    ///   well as rise (the divergence is not submodular). A large neighborhood first changes by an eighth: a landmark
    ///   that hundreds of poses see is next to most removals, and pricing it is cubic in their number.
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
