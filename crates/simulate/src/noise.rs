//! Random streams and Gaussian noise with the same bits on every platform.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream of random numbers is for; each purpose has its own, so that changing one leaves
/// the others as they are.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    Walk = 0,
    Odometry = 1,
    Closures = 2,
    LandmarkPlaces = 3,
    LandmarkSightings = 4,
}

/// The stream of one purpose in the world of one seed.
#[derive(Clone, Debug)]
pub(crate) struct Stream(ChaCha8Rng);

impl Stream {
    pub(crate) fn new(seed: u64, purpose: Purpose) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(purpose as u64);
        Self(rng)
    }

    /// Uniform in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0.random()
    }

    /// Uniform integer.
    pub(crate) fn integer(&mut self) -> u32 {
        self.0.random()
    }

    /// True with the given probability.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// Independent normal numbers with the given standard deviations.
    pub(crate) fn normals<const N: usize>(&mut self, sigmas: &[f64; N]) -> [f64; N] {
        sigmas.map(|sigma| sigma * self.standard_normal())
    }

    /// Ratio of uniforms with Leva's quadratic bounds around the region of acceptance.
    ///
    /// The result is a quotient, and the logarithm decides in one of eighty draws only. The
    /// ziggurat of `rand_distr` returns logarithms in its tails, from whichever mathematics library
    /// the features of other crates select.
    fn standard_normal(&mut self) -> f64 {
        loop {
            let u = 1.0 - self.uniform(); // in (0, 1]
            let v = 1.7156 * (self.uniform() - 0.5);
            let x = u - 0.449871;
            let y = v.abs() + 0.386595;
            let q = x * x + y * (0.19600 * y - 0.25472 * x);
            if q < 0.27597 || (q <= 0.27846 && v * v <= -4.0 * u * u * libm::log(u)) {
                return v / u;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments and tails of the standard normal, each within five standard errors.
    #[test]
    fn standard_normal_has_its_moments_and_tails() {
        let mut stream = Stream::new(1, Purpose::Odometry);
        let count = 1_000_000;
        let (mut moments, mut beyond) = ([0.0; 4], [0_u32; 3]);
        for _ in 0..count {
            let x = stream.standard_normal();
            for (power, sum) in moments.iter_mut().enumerate() {
                *sum += x.powi(power as i32 + 1) / f64::from(count);
            }
            for (sigma, hits) in beyond.iter_mut().enumerate() {
                *hits += u32::from(x.abs() > sigma as f64 + 1.0);
            }
        }
        // E x^k = 0, 1, 0, 3 with variances 1, 2, 15, 96.
        let expected = [(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0_f64)];
        for (moment, (mean, variance)) in moments.iter().zip(expected) {
            assert!((moment - mean).abs() < 5.0 * (variance / f64::from(count)).sqrt());
        }
        for (hits, p) in beyond.iter().zip([0.317_310_5, 0.045_500_3, 0.002_699_8_f64]) {
            let error = f64::from(*hits) / f64::from(count) - p;
            assert!(error.abs() < 5.0 * (p * (1.0 - p) / f64::from(count)).sqrt());
        }
    }

    #[test]
    fn purposes_have_different_streams_and_a_seed_repeats() {
        let first = |seed, purpose| Stream::new(seed, purpose).integer();
        assert_eq!(first(3, Purpose::Walk), first(3, Purpose::Walk));
        assert_ne!(first(3, Purpose::Walk), first(3, Purpose::Closures));
        assert_ne!(first(3, Purpose::Walk), first(4, Purpose::Walk));
    }
}
