//! Numbers of twice the precision, as sums of two `f64`, and the little dense algebra that
//! references need: with a unit roundoff of about 1e-31 they are exact beside anything in `f64`.
//!
//! The error-free sums and products are those of T. Dekker, "A floating-point technique for
//! extending the available precision", Numerische Mathematik 18 (1971), without fused
//! multiply-adds, which are slow where the processor's are not compiled in.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// `high + low`, `|low| ≤ ½ ulp(high)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Double {
    high: f64,
    low: f64,
}

impl Double {
    /// Rounded to `f64`.
    pub fn value(self) -> f64 {
        self.high
    }

    /// The square root, by one step of Newton's method from that in `f64`.
    pub fn sqrt(self) -> Self {
        if self.high <= 0.0 {
            return Self::from(self.high.sqrt());
        }
        let root = Self::from(self.high.sqrt());
        root + (self - root * root) / (root + root)
    }

    /// The sum of two numbers of which the first is the larger.
    fn fast_sum(a: f64, b: f64) -> Self {
        let high = a + b;
        Self { high, low: b - (high - a) }
    }

    fn sum(a: f64, b: f64) -> Self {
        let high = a + b;
        let part = high - a;
        Self { high, low: (a - (high - part)) + (b - part) }
    }

    fn product(a: f64, b: f64) -> Self {
        let split = |x: f64| {
            let c = 134_217_729.0 * x;
            let high = c - (c - x);
            (high, x - high)
        };
        let ((a1, a2), (b1, b2)) = (split(a), split(b));
        let high = a * b;
        Self { high, low: ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2 }
    }
}

impl From<f64> for Double {
    fn from(high: f64) -> Self {
        Self { high, low: 0.0 }
    }
}

impl Neg for Double {
    type Output = Self;
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Add for Double {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (high, low) = (Self::sum(self.high, other.high), Self::sum(self.low, other.low));
        let sum = Self::fast_sum(high.high, high.low + low.high);
        Self::fast_sum(sum.high, sum.low + low.low)
    }
}

impl Sub for Double {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Double {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = Self::product(self.high, other.high);
        let cross = self.high * other.low + self.low * other.high;
        Self::fast_sum(product.high, product.low + cross)
    }
}

impl Div for Double {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = Self::from(self.high / other.high);
        let rest = self - first * other;
        let second = Self::from(rest.high / other.high);
        let rest = rest - second * other;
        first + second + Self::from(rest.high / other.high)
    }
}

/// A symmetric positive definite matrix with a vector: `(Λ, η)`.
#[derive(Clone, Debug)]
pub struct Normal {
    /// Its size.
    pub dim: usize,
    /// Λ, row by row.
    pub information: Vec<Double>,
    /// η.
    pub gradient: Vec<Double>,
}

impl Normal {
    /// Zeros.
    pub fn zeros(dim: usize) -> Self {
        let zero = Double::default();
        Self { dim, information: vec![zero; dim * dim], gradient: vec![zero; dim] }
    }

    /// Adds `JᵀJ` and `-Jᵀr` of one row `[J | r]`, given as the columns that are not zero.
    pub fn add_row(&mut self, row: &[(usize, f64)], residual: f64) {
        for &(i, a) in row {
            for &(j, b) in row {
                let entry = &mut self.information[i * self.dim + j];
                *entry = *entry + Double::product(a, b);
            }
            self.gradient[i] = self.gradient[i] - Double::product(a, residual);
        }
    }

    /// Λ, rounded.
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        self.information[i * self.dim + j].value()
    }

    /// `Λ⁻¹` (row by row) and `Λ⁻¹ η`, by Cholesky. `None` when Λ is not positive definite.
    pub fn inverse(&self) -> Option<(Vec<Double>, Vec<Double>)> {
        let n = self.dim;
        // L with Λ = L Lᵀ, in rows.
        let mut l = self.information.clone();
        for i in 0..n {
            for j in 0..=i {
                let dot = dot(&l[i * n..i * n + j], &l[j * n..j * n + j]);
                let rest = l[i * n + j] - dot;
                l[i * n + j] = if i > j {
                    rest / l[j * n + j]
                } else if rest.value() > 0.0 {
                    rest.sqrt()
                } else {
                    return None;
                };
            }
        }
        // Columns of L⁻¹, as rows of `w`: entries from the diagonal on.
        let mut w = vec![Double::default(); n * n];
        for j in 0..n {
            w[j * n + j] = Double::from(1.0) / l[j * n + j];
            for i in j + 1..n {
                let dot = dot(&l[i * n + j..i * n + i], &w[j * n + j..j * n + i]);
                w[j * n + i] = -dot / l[i * n + i];
            }
        }
        let mut inverse = vec![Double::default(); n * n];
        for i in 0..n {
            for j in 0..=i {
                let entry = dot(&w[i * n + i..(i + 1) * n], &w[j * n + i..(j + 1) * n]);
                inverse[i * n + j] = entry;
                inverse[j * n + i] = entry;
            }
        }
        let solution = inverse.chunks_exact(n).map(|row| dot(row, &self.gradient)).collect();
        Some((inverse, solution))
    }
}

fn dot(a: &[Double], b: &[Double]) -> Double {
    a.iter().zip(b).fold(Double::default(), |sum, (&a, &b)| sum + a * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_has_twice_the_digits() {
        let third = Double::from(1.0) / Double::from(3.0);
        let one = third + third + third;
        assert!((one - Double::from(1.0)).value().abs() < 1e-31);
        let two = Double::from(2.0).sqrt();
        assert!((two * two - Double::from(2.0)).value().abs() < 1e-31);
        let (a, b) = (Double::from(1.0 + f64::EPSILON), Double::from(1.0 - f64::EPSILON));
        assert_eq!((a * b - Double::from(1.0)).value(), -f64::EPSILON * f64::EPSILON);
    }

    /// The inverse of a Hilbert matrix has whole numbers, and a condition number of 1e16.
    #[test]
    fn inverses_are_right_where_f64_has_no_digit_left() {
        let n = 12;
        let mut hilbert = Normal::zeros(n);
        for i in 0..n {
            for j in 0..n {
                let fraction = Double::from(1.0) / Double::from((i + j + 1) as f64);
                hilbert.information[i * n + j] = fraction;
            }
            hilbert.gradient[i] = hilbert.information[i * n];
        }
        let (inverse, solution) = hilbert.inverse().expect("positive definite");
        assert!((inverse[0].value() - 144.0).abs() < 1e-9);
        assert!((inverse[1].value() + 10296.0).abs() < 1e-7);
        // η is the first column.
        for (k, x) in solution.iter().enumerate() {
            assert!((x.value() - f64::from(u8::from(k == 0))).abs() < 1e-6, "{k}: {x:?}");
        }
    }
}
