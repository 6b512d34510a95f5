//! What a removal costs.

use evergraph_model::VariableId;
use evergraph_model::belief::{BeliefError, Covariance, checked_joint};
use nalgebra::{DMatrix, DVector};

use crate::rank_qr::triangle;

/// The Kullback-Leibler divergence, in nats, of the map after the replacement from the map before.
///
/// With Σ the joint covariance of the blanket in the full graph, `Σ = L Lᵀ`, and the square roots
/// R_t of what goes and G of what comes, the blanket's information changes from `Σ⁻¹` to
/// `Σ⁻¹ - R_tᵀR_t + GᵀG`. With μ the eigenvalues of
///
/// ```text
/// M = I + (G L)ᵀ(G L) - (R_t L)ᵀ(R_t L)
/// D(before ‖ after) = ½ Σ (μ - 1 - ln μ) + ½ δηᵀ L M⁻¹ Lᵀ δη
/// ```
///
/// `δη` is what the gradient changes by, zero when it is kept. It is the divergence of the whole
/// graph's marginals over everything kept, because given the blanket the distribution of the rest is
/// the same before and after. Infinite when a direction of the blanket would become free.
///
/// `None` when Σ is not positive definite, or its product with the information overflows. O(n³).
pub(crate) fn divergence(
    sigma: &DMatrix<f64>,
    target: &DMatrix<f64>,
    new: &DMatrix<f64>,
    gradient: &DVector<f64>,
) -> Option<f64> {
    let symmetric = 0.5 * (sigma + sigma.transpose());
    let l = symmetric.cholesky()?.l();
    let (before, after) = (target * &l, new * &l);
    let (gone, come) = (before.tr_mul(&before), after.tr_mul(&after));
    let pull = l.tr_mul(gradient);
    // Numbers that left the range of `f64`; an eigenvalue iteration would not end on them.
    if gone.iter().chain(come.iter()).chain(pull.iter()).any(|x| !x.is_finite()) {
        return None;
    }
    let n = l.nrows();
    let change = &come - &gone;
    // Σ (μ - 1 - ln μ) is tr(M - I) - ln det M; never below zero but for rounding.
    let (excess, mean) = match (DMatrix::identity(n, n) + &change).cholesky() {
        Some(m) => (change.trace() - log_det(m.l_dirty()), m.solve(&pull).dot(&pull)),
        None => {
            let root = root_of_sum(gone, &after);
            let Some(y) = root.tr_solve_upper_triangular(&pull) else { return Some(f64::INFINITY) };
            (root.norm_squared() - n as f64 - log_det(&root), y.norm_squared())
        }
    };
    // Not `max`, which would take a NaN for nothing.
    let price = 0.5 * (if excess < 0.0 { 0.0 } else { excess } + mean);
    (!price.is_nan()).then_some(price)
}

/// `ln det AᵀA` of a triangle.
fn log_det(triangle: &DMatrix<f64>) -> f64 {
    triangle.diagonal().iter().map(|x| 2.0 * x.abs().ln()).sum()
}

/// U upper triangular with `UᵀU = (I - AᵀA) + BᵀB`, where nearly all that was known of a direction goes
/// and little comes, so that their difference is lost in rounding. `I - AᵀA`, what the rest of the map
/// knows, is never negative; what rounding makes negative counts as nothing, so that M is a sum of
/// squares again, good to 1e-16.
fn root_of_sum(gone: DMatrix<f64>, after: &DMatrix<f64>) -> DMatrix<f64> {
    let n = gone.ncols();
    let eigen = gone.symmetric_eigen();
    let mut stack = DMatrix::zeros(n + after.nrows(), n);
    for (k, gone) in eigen.eigenvalues.iter().enumerate() {
        let row = (1.0 - gone).max(0.0).sqrt() * eigen.eigenvectors.column(k).transpose();
        stack.set_row(k, &row);
    }
    stack.rows_mut(n, after.nrows()).copy_from(after);
    triangle(stack)
}

/// What earlier steps of a plan have changed in the blankets they touched.
#[derive(Debug, Default)]
pub(crate) struct Ledger {
    changes: Vec<Changed>,
}

#[derive(Debug)]
struct Changed {
    variables: Vec<VariableId>,
    dims: Vec<usize>,
    before: DMatrix<f64>,
    after: DMatrix<f64>,
}

impl Ledger {
    /// The covariance of `variables` with the earlier steps applied whose blankets share a variable
    /// with them: on the union U of those blankets the information has changed by
    /// `Σ (G_kᵀG_k - R_kᵀR_k)`. Steps further away are left out, so that the cost stays that of a few
    /// blankets; what they change here is of the order of their own price.
    pub(crate) fn covariance(
        &self,
        covariance: &mut dyn Covariance,
        variables: &[VariableId],
        dims: &[usize],
    ) -> Result<DMatrix<f64>, BeliefError> {
        let near: Vec<&Changed> = self
            .changes
            .iter()
            .filter(|c| c.variables.iter().any(|v| variables.contains(v)))
            .collect();
        let (mut all, mut all_dims) = (variables.to_vec(), dims.to_vec());
        for change in &near {
            for (&v, &dim) in change.variables.iter().zip(&change.dims) {
                if !all.contains(&v) {
                    all.push(v);
                    all_dims.push(dim);
                }
            }
        }
        let starts: Vec<usize> = std::iter::once(0)
            .chain(all_dims.iter().scan(0, |end, dim| {
                *end += dim;
                Some(*end)
            }))
            .collect();
        let n = starts[all.len()];
        let sigma = checked_joint(covariance, &all, n)?;
        let dim: usize = dims.iter().sum();
        let own = || sigma.view((0, 0), (dim, dim)).into_owned();
        if near.is_empty() {
            return Ok(sigma);
        }
        let Some(l) = (0.5 * (&sigma + sigma.transpose())).cholesky().map(|c| c.l()) else {
            return Ok(own());
        };
        let mut m = DMatrix::identity(n, n);
        for change in near {
            for (rows, sign) in [(&change.after, 1.0), (&change.before, -1.0)] {
                let mut spread = DMatrix::zeros(rows.nrows(), n);
                let mut source = 0;
                for (v, &dim) in change.variables.iter().zip(&change.dims) {
                    if let Some(place) = all.iter().position(|other| other == v) {
                        spread
                            .columns_mut(starts[place], dim)
                            .copy_from(&rows.columns(source, dim));
                    }
                    source += dim;
                }
                let product = spread * &l;
                m += sign * product.tr_mul(&product);
            }
        }
        // Σ_now = L M⁻¹ Lᵀ, of which the first rows are wanted.
        let top = l.rows(0, dim).into_owned();
        Ok(m.cholesky().map_or_else(own, |m| &top * m.solve(&top.transpose())))
    }

    pub(crate) fn note(
        &mut self,
        variables: Vec<VariableId>,
        dims: Vec<usize>,
        before: DMatrix<f64>,
        after: DMatrix<f64>,
    ) {
        self.changes.push(Changed { variables, dims, before, after });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagonal(entries: &[f64]) -> DMatrix<f64> {
        DMatrix::from_diagonal(&DVector::from_column_slice(entries))
    }

    /// All but nothing of a direction is left: `½ (μ - 1 - ln μ)` while μ can be told, and much but
    /// finite beyond that.
    #[test]
    fn a_price_is_finite_while_a_direction_is_held() {
        let turn = DMatrix::from_row_slice(2, 2, &[0.6, 0.8, -0.8, 0.6]);
        let sigma = &turn * diagonal(&[4.0, 9.0]) * turn.transpose();
        let root = |share: f64| diagonal(&[0.5 * share, 1.0 / 3.0]) * turn.transpose();
        for share in [1e-3_f64, 1e-5, 1e-7, 1e-9, 1e-12] {
            let price = divergence(&sigma, &root(1.0), &root(share), &DVector::zeros(2)).unwrap();
            let mu = share * share;
            let expected = 0.5 * (mu - 1.0 - mu.ln());
            if mu > 1e-13 {
                assert!((price - expected).abs() < 1e-2, "{share}: {price} {expected}");
            } else {
                assert!(price.is_finite() && price > 14.0, "{share}: {price}");
            }
        }
        let [sigma, target] = [diagonal(&[4.0, 9.0]), diagonal(&[0.5, 1.0 / 3.0])];
        let nothing = diagonal(&[0.0, 1.0 / 3.0]);
        let price = divergence(&sigma, &target, &nothing, &DVector::zeros(2));
        assert_eq!(price, Some(f64::INFINITY));
    }

    /// A covariance of other points can know less than what goes: the rest of the map then counts as
    /// knowing nothing, and the price is that of what goes and comes.
    #[test]
    fn a_covariance_that_does_not_fit_makes_nothing_free() {
        let [sigma, target, new] = [1.0, 1.6_f64.sqrt(), 0.5_f64.sqrt()].map(|x| diagonal(&[x]));
        let price = divergence(&sigma, &target, &new, &DVector::zeros(1)).unwrap();
        assert!((price - 0.5 * (0.5 - 1.0 - 0.5_f64.ln())).abs() < 1e-12, "{price}");
    }

    #[test]
    fn a_gradient_that_is_lost_costs_its_step() {
        // Nothing else changes, so the mean moves by Σ δη.
        let sigma = DMatrix::from_row_slice(2, 2, &[2.0, 0.5, 0.5, 1.0]);
        let root = diagonal(&[0.3, 0.2]);
        let lost = DVector::from_vec(vec![0.4, -0.1]);
        let price = divergence(&sigma, &root, &root, &lost).unwrap();
        assert!((price - 0.5 * lost.dot(&(&sigma * &lost))).abs() < 1e-15);
    }
}
