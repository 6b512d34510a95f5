//! Least squares on a few unknowns, of factors at values that no graph holds.

use evergraph_model::LinearizedFactor;
use nalgebra::{DMatrix, DVector};

/// `½ Σ‖r‖²` to second order: `JᵀJ`, `Jᵀr` and the error.
#[derive(Clone, Debug)]
pub(crate) struct Quadratic {
    pub information: DMatrix<f64>,
    pub gradient: DVector<f64>,
    pub error: f64,
}

impl Quadratic {
    pub fn zeros(dim: usize) -> Self {
        Self { information: DMatrix::zeros(dim, dim), gradient: DVector::zeros(dim), error: 0.0 }
    }

    /// Adds a factor whose derivative by the unknowns is `jacobian`.
    pub fn add(&mut self, jacobian: &DMatrix<f64>, linearized: &LinearizedFactor) {
        self.information.gemm_tr(1.0, jacobian, jacobian, 1.0);
        self.gradient.gemv_tr(1.0, jacobian, &linearized.residual(), 1.0);
        self.error += linearized.error();
    }

    /// Notes a factor that cannot be evaluated: no point is an optimum then.
    pub fn spoil(&mut self) {
        self.error = f64::NAN;
    }

    /// The damped step, `(JᵀJ + λ D) d = -Jᵀr` with `D` the diagonal, of which each entry is at
    /// least that of `least`. Along those the damping does not vanish: what is free is not to go
    /// where rounding sends it.
    fn step(&self, lambda: f64, least: &[f64]) -> Option<DVector<f64>> {
        const AT_LEAST: f64 = 0.01;
        let mut damped = self.information.clone();
        for (i, least) in least.iter().enumerate() {
            damped[(i, i)] += lambda * damped[(i, i)] + lambda.max(AT_LEAST) * least;
        }
        let step = damped.cholesky()?.solve(&-&self.gradient);
        step.iter().all(|x| x.is_finite()).then_some(step)
    }
}

/// Levenberg-Marquardt on a few unknowns, from `start`: where it ends, and the quadratic there.
/// `quadratic` evaluates, `moved` moves a point by a step; `least` is the least curvature that the
/// damping reckons with, `1/σ²` of what is as good as free. `None` where numbers overflow.
pub(crate) fn minimize<X: Clone>(
    start: X,
    least: &[f64],
    mut quadratic: impl FnMut(&X) -> Quadratic,
    moved: impl Fn(&X, &DVector<f64>) -> Option<X>,
) -> Option<(X, Quadratic)> {
    const ITERATIONS: usize = 60;
    const ENOUGH: f64 = 1e-12;
    let mut at = start;
    let mut here = quadratic(&at);
    let mut lambda = 1e-6;
    for _ in 0..ITERATIONS {
        if !here.error.is_finite() {
            return None;
        }
        let Some(step) = here.step(lambda, least) else {
            if lambda > 1e12 {
                break;
            }
            lambda *= 10.0;
            continue;
        };
        let next = moved(&at, &step)?;
        let there = quadratic(&next);
        if there.error <= here.error {
            let gain = here.error - there.error;
            (at, here) = (next, there);
            lambda = (0.1 * lambda).max(1e-12);
            if gain <= ENOUGH * here.error + f64::MIN_POSITIVE {
                break;
            }
        } else if lambda > 1e12 {
            break;
        } else {
            lambda *= 10.0;
        }
    }
    Some((at, here))
}
