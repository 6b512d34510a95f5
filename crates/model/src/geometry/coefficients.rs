//! Scalar coefficients of the exponential, its Jacobians and their inverses.
//!
//! Each is a smooth even function of the angle θ and is given as a function of x = θ². The closed
//! forms subtract nearly equal numbers when θ is small: at θ = 0.01 the derivative of the last one
//! would keep six digits. Below θ = 1 the power series is used instead; there the closed forms
//! still have 13 digits, so nothing jumps at the switch. The arc tangent, of which the logarithms
//! are made, has its own.

/// Below this θ² the series are used.
const SERIES_BELOW: f64 = 1.0;

/// Terms kept. At θ = 1 the first one left out is below 1e-16 of the sum in every series.
const TERMS: usize = 11;

/// (-1)ᵏ / (2k + first)!
const fn alternating(first: usize) -> [f64; TERMS] {
    let mut table = [0.0; TERMS];
    let mut factorial = 1.0;
    let mut n = 0;
    while n < first {
        n += 1;
        factorial *= n as f64;
    }
    let mut k = 0;
    while k < TERMS {
        table[k] = if k % 2 == 0 { 1.0 / factorial } else { -1.0 / factorial };
        factorial *= ((n + 1) * (n + 2)) as f64;
        n += 2;
        k += 1;
    }
    table
}

/// The series of 2 df/dx = f'(θ)/θ from that of f(x).
const fn derivative(series: &[f64; TERMS]) -> [f64; TERMS] {
    let mut table = [0.0; TERMS];
    let mut k = 1;
    while k < TERMS {
        table[k - 1] = 2.0 * k as f64 * series[k];
        k += 1;
    }
    table
}

const B: [f64; TERMS] = alternating(2);
const B_PRIME: [f64; TERMS] = derivative(&B);
const C: [f64; TERMS] = alternating(3);
const C_PRIME: [f64; TERMS] = derivative(&C);
/// |B₂ₖ| / (2k)! for k = 1, 2, … with the Bernoulli numbers B₂ₖ.
const GAMMA: [f64; TERMS] = [
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30_240.0,
    1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    691.0 / 1_307_674_368_000.0,
    1.0 / 74_724_249_600.0,
    3_617.0 / 10_670_622_842_880_000.0,
    43_867.0 / 5_109_094_217_170_944_000.0,
    174_611.0 / 802_857_662_698_291_200_000.0,
    77_683.0 / 14_101_100_039_391_805_440_000.0,
];
const GAMMA_PRIME: [f64; TERMS] = derivative(&GAMMA);

/// (-1)ᵏ / (2k + 1), of `atan(t)/t` in t².
const ARCTANGENT: [f64; TERMS] = {
    let mut table = [0.0; TERMS];
    let mut k = 0;
    while k < TERMS {
        table[k] = if k % 2 == 0 { 1.0 } else { -1.0 } / (2 * k + 1) as f64;
        k += 1;
    }
    table
};

/// Below this squared tangent, an angle of 0.2, that series is used; the first term left out is
/// 2e-17 there.
const ARCTANGENT_BELOW: f64 = 0.04;

/// Even and odd powers apart: in one chain every step would wait for the one before.
#[inline]
fn sum(series: &[f64; TERMS], x: f64) -> f64 {
    let (mut even, mut odd) = (series[TERMS - 1], 0.0);
    for pair in series[..TERMS - 1].as_chunks::<2>().0.iter().rev() {
        even = even * (x * x) + pair[0];
        odd = odd * (x * x) + pair[1];
    }
    even + x * odd
}

/// `atan(t)/t` for `x = t²` where `t` is small, as it is in residuals; the series is several times
/// faster than `atan2`.
#[inline]
pub(super) fn small_arctangent(x: f64) -> Option<f64> {
    (x < ARCTANGENT_BELOW).then(|| sum(&ARCTANGENT, x))
}

/// `sin(t) / t`.
#[inline]
pub(super) fn sinc(t: f64) -> f64 {
    if t == 0.0 { 1.0 } else { t.sin() / t }
}

/// Coefficients of `Jl = I + b [φ] + c [φ]²`: `b = (1 - cos θ)/θ²`, `c = (θ - sin θ)/θ³`.
#[inline]
pub(super) fn jacobian(x: f64) -> (f64, f64) {
    if x < SERIES_BELOW {
        return (sum(&B, x), sum(&C, x));
    }
    let theta = x.sqrt();
    let half = sinc(0.5 * theta);
    (0.5 * half * half, (theta - theta.sin()) / (x * theta))
}

/// `b'/θ` and `c'/θ` of [`jacobian`]'s coefficients.
#[inline]
pub(super) fn jacobian_prime(x: f64) -> (f64, f64) {
    if x < SERIES_BELOW {
        return (sum(&B_PRIME, x), sum(&C_PRIME, x));
    }
    let (b, c) = jacobian(x);
    ((sinc(x.sqrt()) - 2.0 * b) / x, (b - 3.0 * c) / x)
}

/// The coefficient of `Jl⁻¹ = I - ½ [φ] + γ [φ]²`: `γ = (1 - h cot h)/θ²` with `h = θ/2`.
///
/// `h cot h` is taken as `h cos h / sin h`, which is exact at half a turn, where the usual
/// `(1 + cos θ)/sin θ` is 0/0.
#[inline]
pub(super) fn inverse_jacobian(x: f64) -> f64 {
    if x < SERIES_BELOW {
        return sum(&GAMMA, x);
    }
    let half = 0.5 * x.sqrt();
    let (sin, cos) = half.sin_cos();
    (1.0 - half * cos / sin) / x
}

/// `γ` and `γ'/θ` of [`inverse_jacobian`].
#[inline]
pub(super) fn inverse_jacobian_with_prime(x: f64) -> (f64, f64) {
    if x < SERIES_BELOW {
        return (sum(&GAMMA, x), sum(&GAMMA_PRIME, x));
    }
    let half = 0.5 * x.sqrt();
    let (sin, cos) = half.sin_cos();
    let h_cot_h = half * cos / sin;
    let gamma = (1.0 - h_cot_h) / x;
    // d(h cot h)/dθ = (cot h - h/sin² h)/2
    let minus_slope = 0.25 / (sin * sin) - h_cot_h / x;
    (gamma, (minus_slope - 2.0 * gamma) / x)
}
