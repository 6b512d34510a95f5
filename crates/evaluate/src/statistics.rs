//! Numbers that stand for many.

use serde::Serialize;

use crate::EvaluateError;

/// What there is to say about a list of errors `eₖ`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Statistics {
    /// How many there are, at least one.
    pub count: usize,
    /// Root mean square, `√(sse / count)`.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// The middle one of the sorted errors, or the mean of the middle two.
    pub median: f64,
    /// Standard deviation of the population, `√(Σ (eₖ - mean)² / count)`.
    pub std: f64,
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// Sum of squares.
    pub sse: f64,
}

impl Statistics {
    /// Summarizes errors; `None` when there are none.
    ///
    /// # Errors
    /// [`EvaluateError::Overflow`] when their squares are not finite.
    pub fn of(errors: &[f64]) -> Result<Option<Self>, EvaluateError> {
        let mut sorted = errors.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else { return Ok(None) };
        let count = sorted.len();
        let mean_of = |sum: f64| sum / count as f64;
        let sse: f64 = sorted.iter().map(|e| e * e).sum();
        if !sse.is_finite() {
            return Err(EvaluateError::Overflow);
        }
        let mean = mean_of(sorted.iter().sum());
        let variance = mean_of(sorted.iter().map(|e| (e - mean).powi(2)).sum());
        let median = 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]);
        let rmse = mean_of(sse).sqrt();
        Ok(Some(Self { count, rmse, mean, median, std: variance.sqrt(), min, max, sse }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_by_hand() {
        let s = Statistics::of(&[4.0, 1.0, 2.0, 1.0]).unwrap().unwrap();
        assert_eq!((s.count, s.sse, s.mean, s.median, s.min, s.max), (4, 22.0, 2.0, 1.5, 1.0, 4.0));
        assert_eq!((s.rmse, s.std), (5.5_f64.sqrt(), 1.5_f64.sqrt()));
        assert_eq!(Statistics::of(&[7.0]).unwrap().unwrap().median, 7.0);
    }

    #[test]
    fn nothing_and_too_much() {
        assert_eq!(Statistics::of(&[]).unwrap(), None);
        for bad in [1e200, f64::INFINITY, f64::NAN] {
            assert!(matches!(Statistics::of(&[1.0, bad]), Err(EvaluateError::Overflow)));
        }
    }
}
