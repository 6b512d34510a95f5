//! A smoother with as little in it as a test can do with.

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{Key, LieGroup, Noise, Pose2};
use evergraph_solver::{Settings, Smoother};

/// Of a pose in the plane.
pub fn sigma() -> Noise {
    Noise::isotropic(3, 0.1).unwrap()
}

/// A prior and a chain of poses.
pub fn chain(count: usize) -> (Smoother, Vec<Key<Pose2>>) {
    let mut smoother = Smoother::new(Settings::default().with_threads(1)).unwrap();
    let mut change = smoother.change();
    let keys: Vec<_> = (0..count)
        .map(|k| change.add_variable(&Pose2::new(k as f64, 0.0, 0.1 * k as f64)))
        .collect();
    change.add_factor(Prior::new(keys[0], Pose2::identity(), sigma()).unwrap());
    for pair in keys.windows(2) {
        let z = Pose2::new(1.0, 0.1, 0.1);
        change.add_factor(BetweenPose2::new(pair[0], pair[1], z, sigma()).unwrap());
    }
    smoother.apply(change).unwrap();
    (smoother, keys)
}
