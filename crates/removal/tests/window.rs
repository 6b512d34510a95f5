//! A window of ten poses, the oldest removed at each step (fixed-lag smoothing), beside exact removal.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{Key, LieGroup, Noise, Pose2};
use evergraph_removal::{Consistency, Options, Removal};
use evergraph_solver::{Relinearization, Settings, Smoother};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const LAG: usize = 10;
const LOOP: usize = 8;

/// Odometry of 1 m and 0.1 rad and a measurement over eight poses at each step, sigma 0.05 m and 0.01 rad; of the first
/// pose 0.1 m and 0.1 rad are known.
struct Window {
    smoother: Smoother,
    options: Options,
    keys: Vec<Key<Pose2>>,
    rng: ChaCha8Rng,
}

impl Window {
    fn new(options: Options) -> Self {
        Self::with(options, Settings::default())
    }

    /// Whose linearization points never move, so that removals see the linear model of the beginning.
    fn linear(options: Options) -> Self {
        let settings = Settings::default().with_relinearization(Relinearization::NEVER);
        Self::with(options.with_linear_within(f64::INFINITY), settings)
    }

    fn with(options: Options, settings: Settings) -> Self {
        let smoother = Smoother::new(settings).unwrap();
        Self { smoother, options, keys: Vec::new(), rng: ChaCha8Rng::seed_from_u64(3) }
    }

    /// Standard normal, by Box and Muller.
    fn normal(&mut self) -> f64 {
        let (u, v) = (self.rng.random_range(1e-12..1.0_f64), self.rng.random_range(0.0..1.0_f64));
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    fn noise(&mut self) -> Pose2 {
        Pose2::new(0.05 * self.normal(), 0.05 * self.normal(), 0.01 * self.normal())
    }

    fn step(&mut self) {
        let sigmas = Noise::from_sigmas(&[0.05, 0.05, 0.01]).unwrap();
        let k = self.keys.len();
        let z = Pose2::new(1.0, 0.0, 0.1).compose(&self.noise());
        let off = self.noise();
        let mut change = self.smoother.change();
        // Where nothing but odometry without noise has it: all windows begin with the same points.
        let estimate = nominal(k);
        let key = change.add_variable(&estimate);
        match self.keys.last() {
            Some(&last) => {
                change.add_factor(BetweenPose2::new(last, key, z, sigmas.clone()).unwrap());
            }
            None => {
                let known = Noise::isotropic(3, 0.1).unwrap();
                change.add_factor(Prior::new(key, estimate, known).unwrap());
            }
        }
        if k >= LOOP {
            let from = self.keys[k - LOOP];
            let z = nominal(k - LOOP).between(&estimate).compose(&off);
            change.add_factor(BetweenPose2::new(from, key, z, sigmas).unwrap());
        }
        self.keys.push(key);
        self.smoother.apply(change).unwrap();
        if k >= LAG {
            let removal = Removal::new(self.smoother.graph(), &self.smoother);
            let plan = removal.with_options(self.options).plan(self.keys[k - LAG]).unwrap();
            self.smoother.apply(plan.into_change()).unwrap();
        }
    }

    /// Of all poses of the window.
    fn covariance(&self) -> DMatrix<f64> {
        let start = self.keys.len().saturating_sub(LAG);
        self.smoother.joint(&self.keys[start..]).unwrap()
    }

    fn heading(&self) -> f64 {
        let covariance = self.smoother.marginal(*self.keys.last().unwrap()).unwrap();
        covariance[(2, 2)].sqrt()
    }
}

/// The pose k without noise.
fn nominal(k: usize) -> Pose2 {
    let turn = 0.1 * k as f64;
    let radius = 1.0 / (2.0 * (0.05_f64).sin());
    Pose2::new(
        radius * ((turn - 0.05).sin() + 0.05_f64.sin()),
        radius * (0.05_f64.cos() - (turn - 0.05).cos()),
        turn,
    )
}

fn tree() -> Options {
    Options::tree()
}

#[test]
fn the_default_is_exact_and_leaves_few_factors() {
    let (mut auto, mut dense) = (Window::new(Options::default()), Window::new(Options::dense()));
    for k in 0..400 {
        auto.step();
        dense.step();
        if k % 20 == 0 {
            let (a, d) = (auto.covariance(), dense.covariance());
            assert!((&a - &d).amax() < 1e-9 * d.amax(), "step {k}");
        }
    }
    assert!(auto.smoother.graph().factor_count() <= 6);
    assert!((auto.heading() - 0.1035).abs() < 5e-4, "{}", auto.heading());
}

/// Of covariances in one linear model, that of dense removal, which is exact, is never above the tree's: in no direction
/// of the window, at no step.
#[test]
fn a_conservative_tree_is_never_too_certain() {
    let options = tree().with_consistency(Consistency::Conservative);
    let (mut bounded, mut dense) = (Window::linear(options), Window::linear(Options::dense()));
    for k in 0..600 {
        bounded.step();
        dense.step();
        let (b, d) = (bounded.covariance(), dense.covariance());
        let l = d.cholesky().unwrap().l();
        let half = l.solve_lower_triangular(&b).unwrap();
        let whitened = l.solve_lower_triangular(&half.transpose()).unwrap();
        let least = whitened.symmetric_eigenvalues().min();
        assert!(least > 1.0 - 1e-6, "step {k}: {least}");
        assert!(bounded.heading() > dense.heading() * (1.0 - 1e-6), "step {k}");
    }
    let ratio = bounded.heading() / dense.heading();
    assert!(ratio < 1.1, "{ratio}");
}

/// Unary factors that are absorbed with each removal nearby make a tree drift; left alone, they do not.
#[test]
fn a_tree_drifts_where_unary_factors_are_absorbed() {
    let options = [Options::dense(), tree(), tree().with_keep_unary(false)];
    let headings = options.map(|options| {
        let mut window = Window::new(options);
        (0..800).for_each(|_| window.step());
        window.heading()
    });
    let [kept, absorbed] = [1, 2].map(|k| headings[k] / headings[0] - 1.0);
    assert!(kept.abs() < 0.02, "{kept}");
    assert!(absorbed.abs() > 0.05, "{absorbed}");
}
