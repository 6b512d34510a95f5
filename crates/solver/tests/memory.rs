//! Memory follows what is in use, not what once was: in bytes that the smoother counts itself.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{
    Arguments, Factor, FactorId, Key, LieGroup, Linearization, Noise, Point2, Pose2, VariableId,
    VariableType,
};
use evergraph_solver::{Relinearization, Settings, Smoother};

/// A linear measurement of many points, as a removal leaves them behind.
#[derive(Debug)]
struct Dense {
    keys: Vec<VariableId>,
    rows: usize,
}

impl Dense {
    fn coefficient(row: usize, column: usize) -> f64 {
        ((row * 7919 + column * 104_729 + 13) as f64).sin()
    }
}

impl Factor for Dense {
    fn name(&self) -> String {
        "Dense".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.keys
    }
    fn residual_dim(&self) -> usize {
        self.rows
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Point2>()
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        for (row, out) in out.iter_mut().enumerate() {
            let terms = (0..self.keys.len()).flat_map(|k| {
                let p: Point2 = at.get(k);
                [p.x() * Self::coefficient(row, 2 * k), p.y() * Self::coefficient(row, 2 * k + 1)]
            });
            *out = terms.sum();
        }
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
        for k in 0..self.keys.len() {
            let block = out.block_mut(k);
            for (i, x) in block.iter_mut().enumerate() {
                *x = Self::coefficient(i % self.rows, 2 * k + i / self.rows);
            }
        }
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// A window of points; batches of them are replaced by a dense factor of ever another size.
#[test]
fn a_window_of_dense_factors_does_not_grow() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let noise = Noise::isotropic(2, 0.1).unwrap();
    let mut window: Vec<Key<Point2>> = Vec::new();
    let mut dense: Vec<FactorId> = Vec::new();
    let (mut early, mut largest, mut nonzeros) = (0, 0, 0);
    for step in 0..4000_usize {
        let mut change = smoother.change();
        let point = change.add_variable(&Point2::new(0.0, 0.0));
        change.add_factor(Prior::new(point, Point2::new(0.0, 0.0), noise.clone()).unwrap());
        window.push(point);
        if window.len() > 60 {
            for old in window.drain(..10) {
                change.drop_variable_and_factors(smoother.graph(), old).unwrap();
            }
            let taken = |f: &FactorId| change.dropped_factors().contains(f);
            dense.retain(|f| !taken(f));
            if dense.len() > 3 {
                change.drop_factor(dense.remove(0));
            }
            let keys = window[..3 + step % 23].iter().map(|key| key.id()).collect();
            dense.push(change.add_factor(Dense { keys, rows: 1 + step % 37 }));
        }
        smoother.apply(change).unwrap();
        nonzeros = nonzeros.max(smoother.size().nonzeros);
        match step {
            0..1000 => early = early.max(smoother.memory_bytes()),
            _ => largest = largest.max(smoother.memory_bytes()),
        }
    }
    println!("bytes: {early} early, {largest} later, R at most {}", 8 * nonzeros);
    assert!(largest <= early + early / 4, "{largest} bytes after {early}");
    // The pool alone may keep a megabyte.
    assert!(largest <= 3_000_000, "{largest} bytes, R of {}", 8 * nonzeros);
    let clone = smoother.clone();
    println!("a clone: {} bytes", clone.memory_bytes());
    assert!(clone.memory_bytes() <= 1_200_000, "{} bytes", clone.memory_bytes());
    assert_eq!(clone.fingerprint(), smoother.fingerprint());
}

/// A large map of which little is left.
#[test]
fn a_map_that_shrinks_gives_its_memory_back() {
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    let mut smoother = Smoother::new(settings).unwrap();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut change = smoother.change();
    let poses: Vec<Key<Pose2>> =
        (0..6000).map(|k| change.add_variable(&Pose2::new(f64::from(k), 0.0, 0.0))).collect();
    for &pose in &poses {
        change.add_factor(Prior::new(pose, Pose2::identity(), noise.clone()).unwrap());
    }
    for (k, &pose) in poses.iter().enumerate().skip(1) {
        for from in [poses[k - 1], poses[k / 2]] {
            if from != pose && (from == poses[k - 1] || k / 2 != k - 1) {
                let z = Pose2::new(1.0, 0.0, 0.0);
                change.add_factor(BetweenPose2::new(from, pose, z, noise.clone()).unwrap());
            }
        }
    }
    smoother.apply(change).unwrap();
    smoother.relinearize_batch().unwrap();
    let full = smoother.memory_bytes();
    let mut change = smoother.change();
    for &pose in &poses[..5950] {
        change.drop_variable_and_factors(smoother.graph(), pose).unwrap();
    }
    smoother.apply(change).unwrap();
    for _ in 0..3 {
        let mut change = smoother.change();
        let pose = change.add_variable(&Pose2::identity());
        change.add_factor(Prior::new(pose, Pose2::identity(), noise.clone()).unwrap());
        smoother.apply(change).unwrap();
    }
    let left = smoother.memory_bytes();
    println!("bytes: {full} full, {left} left");
    assert!(left < full / 5, "{left} bytes of {full}");
}
