//! Consistency of a reduced graph: it is not to claim more than the full one.
//!
//! A reduced graph is conservative when its information Λ on the kept variables is at most the full graph's marginal
//! Λ_t in every direction, `Λ ≤ Λ_t` in the Loewner order; covariances are then never too small. The largest eigenvalue
//! λ of Λ with respect to Λ_t says by how much it is not: in one direction, over all kept variables together, the
//! reduced graph claims a standard deviation of `1/√λ` of the right one.
//!
//! The eigenvalue is found by Lanczos iterations on `P Λ`, `P = Λ_t⁻¹`, which is symmetric in the inner product
//! `xᵀΛy`. `P` times a vector is a solution with the factorization of the full graph, so that nothing dense is formed.

use std::collections::BTreeMap;

use evergraph_model::{Graph, GraphError, VariableId};
use nalgebra::{DMatrix, DMatrixView, DVector};
use serde::Serialize;

use crate::comparison::Comparison;
use crate::factorized::Factorized;
use crate::pairs::Pairs;
use crate::solved::DivergenceError;

/// The information of a reduced graph relative to the full one's, both at the full graph's optimum.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Consistency {
    /// Largest eigenvalue of the reduced information with respect to the full graph's marginal. At most 1, but for
    /// rounding, when the reduced graph is conservative.
    pub largest_eigenvalue: f64,
    /// Bound on its error: an eigenvalue lies within this distance.
    pub residual: f64,
    /// Kept variables.
    pub variables: usize,
    /// Those whose marginal covariance is too small in some direction, by more than 1e-6 of it.
    pub overconfident: usize,
    /// The variable whose marginal covariance is too small by the largest share; the least too large one when all
    /// are large enough.
    pub worst: WorstMarginal,
}

/// The direction in which the marginal covariance of a variable is too small.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct WorstMarginal {
    /// The variable, in the full graph.
    #[serde(skip)]
    pub variable: VariableId,
    /// Its tangent direction, of length 1: translation before rotation, in its own frame.
    pub direction: Vec<f64>,
    /// Standard deviation along that direction in the reduced graph over that in the full graph.
    pub deviation_ratio: f64,
}

/// Lanczos iterations.
const ITERATIONS: usize = 100;

/// A marginal covariance counts as too small when it is so by this share.
const ROUNDING: f64 = 1e-6;

impl Comparison<'_> {
    /// Compares what the reduced graph claims to know with what the full one knows. Fixed variables are certain in both.
    ///
    /// Costs a hundred solutions with the factorization of the full graph, and the marginal covariances of all variables.
    ///
    /// # Errors
    /// [`DivergenceError`].
    pub fn consistency(&self) -> Result<Consistency, DivergenceError> {
        let Self { pairs, all, here, .. } = self;
        let (largest_eigenvalue, residual) = largest_eigenvalue(pairs, all)?;
        if !largest_eigenvalue.is_finite() {
            return Err(DivergenceError::NotFinite { quantity: "largest eigenvalue" });
        }
        let (overconfident, worst) = marginals(pairs, all, here)?;
        let variables = pairs.count();
        Ok(Consistency { largest_eigenvalue, residual, variables, overconfident, worst })
    }
}

impl Consistency {
    /// True if the reduced graph claims no more than the full one in any direction, but for rounding.
    pub fn is_conservative(&self) -> bool {
        self.largest_eigenvalue <= 1.0 + ROUNDING
    }
}

/// The linear model of a graph: `Λ x = Σ Jᵀ (J x)`.
struct Model {
    factors: Vec<(Vec<std::ops::Range<usize>>, DMatrix<f64>)>,
}

impl Model {
    fn of(graph: &Graph, points: &[f64]) -> Result<Self, GraphError> {
        let mut factors = Vec::new();
        for f in graph.factor_indices() {
            let mut block = vec![0.0; graph.linearization_len(f)];
            graph.linearize(f, points, &mut block)?;
            let rows = graph.rows_at(f);
            let jacobian = &block[..block.len() - rows];
            let jacobian = DMatrixView::from_slice(jacobian, rows, jacobian.len() / rows.max(1));
            let ranges = graph.unknowns_at(f).iter().map(|&index| graph.tangent_range(index));
            factors.push((ranges.collect(), jacobian.into_owned()));
        }
        Ok(Self { factors })
    }

    fn times(&self, x: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; x.len()];
        for (ranges, jacobian) in &self.factors {
            let own: Vec<f64> =
                ranges.iter().flat_map(|range| x[range.clone()].iter().copied()).collect();
            let gradient = jacobian.tr_mul(&(jacobian * DVector::from_vec(own)));
            let entries = ranges.iter().cloned().flatten();
            entries.zip(&gradient).for_each(|(k, g)| product[k] += g);
        }
        product
    }
}

/// The largest eigenvalue of `P Λ`, and a bound on its error.
fn largest_eigenvalue(pairs: &Pairs<'_>, all: &Factorized) -> Result<(f64, f64), DivergenceError> {
    let graph = pairs.reduced.graph;
    let model = Model::of(graph, &pairs.points)?;
    let covariances = all.smoother.covariances();
    let inner = all.smoother.graph();
    // The place of each scalar of the reduced graph in the factorization of the full one.
    let mut places = vec![None; graph.tangent_len()];
    for index in graph.unknown_indices() {
        let variable = graph.variable_id(index);
        let in_full = pairs.to_full.get(&variable).and_then(|id| all.variable(*id));
        let in_full = in_full.ok_or(DivergenceError::Unpaired { variable })?;
        let range = inner.tangent_range(inner.variable_index(in_full)?);
        graph.tangent_range(index).zip(range).for_each(|(k, place)| places[k] = Some(place));
    }
    let covariance_times = |x: &[f64]| -> Vec<f64> {
        let mut wide = vec![0.0; inner.tangent_len()];
        for (place, &x) in places.iter().zip(x) {
            place.iter().for_each(|&place| wide[place] = x);
        }
        let product = covariances.times(&wide).unwrap_or_default();
        places.iter().map(|place| place.map_or(0.0, |place| product[place])).collect()
    };
    Ok(lanczos(start(&places), |x| model.times(x), covariance_times))
}

/// Numbers without a pattern, the same each time; zero where there is no unknown.
fn start(places: &[Option<usize>]) -> Vec<f64> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    places.iter().map(|place| place.map_or(0.0, |_| next())).collect()
}

/// Lanczos iterations with full orthogonalization in the inner product `xᵀ Λ y`.
fn lanczos(
    start: Vec<f64>,
    information: impl Fn(&[f64]) -> Vec<f64>,
    covariance: impl Fn(&[f64]) -> Vec<f64>,
) -> (f64, f64) {
    let mut basis: Vec<(DVector<f64>, DVector<f64>)> = Vec::new();
    let (mut diagonal, mut beside) = (Vec::new(), Vec::new());
    let mut next = DVector::from_vec(start);
    for _ in 0..ITERATIONS {
        let mut weighted = DVector::from_vec(information(next.as_slice()));
        let norm = next.dot(&weighted).max(0.0).sqrt();
        // Rounding is all that is left of a space that has been searched.
        if norm.is_nan() || norm <= 1e-14 {
            break;
        }
        if !basis.is_empty() {
            beside.push(norm);
        }
        next /= norm;
        weighted /= norm;
        let mut step = DVector::from_vec(covariance(weighted.as_slice()));
        diagonal.push(step.dot(&weighted));
        basis.push((next, weighted));
        // Twice is enough.
        for _ in 0..2 {
            for (x, weighted) in &basis {
                let share = step.dot(weighted);
                step.axpy(-share, x, 1.0);
            }
        }
        next = step;
    }
    let count = diagonal.len();
    let tridiagonal = DMatrix::from_fn(count, count, |i, j| match i.abs_diff(j) {
        0 => diagonal[i],
        1 => beside[i.min(j)],
        _ => 0.0,
    });
    if count == 0 || tridiagonal.iter().any(|x: &f64| !x.is_finite()) {
        return (f64::NAN, f64::NAN);
    }
    let eigen = tridiagonal.symmetric_eigen();
    let (largest, &value) = eigen
        .eigenvalues
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(b.1))
        .unwrap_or((0, &f64::NAN));
    let weighted = DVector::from_vec(information(next.as_slice()));
    let left = next.dot(&weighted).max(0.0).sqrt();
    (value, left * eigen.eigenvectors[(count - 1, largest)].abs())
}

/// The variables whose marginal covariance is too small, and the worst of all.
fn marginals(
    pairs: &Pairs<'_>,
    all: &Factorized,
    here: &Factorized,
) -> Result<(usize, WorstMarginal), DivergenceError> {
    let (mut full, mut reduced) = (all.smoother.covariances(), here.smoother.covariances());
    let (mut overconfident, mut worst) = (0, None::<(f64, VariableId, Vec<f64>)>);
    let ordered: BTreeMap<VariableId, VariableId> =
        pairs.to_full.iter().map(|(&in_reduced, &in_full)| (in_full, in_reduced)).collect();
    for (in_full, in_reduced) in ordered {
        let (Some(a), Some(b)) = (all.variable(in_full), here.variable(in_reduced)) else {
            continue;
        };
        let right = full.marginal(a).map_err(DivergenceError::Full)?;
        let claimed = reduced.marginal(b).map_err(DivergenceError::Reduced)?;
        let Some((ratio, direction)) = least_ratio(&right, &claimed) else {
            return Err(DivergenceError::NotFinite { quantity: "covariance of a variable" });
        };
        overconfident += usize::from(ratio < 1.0 - ROUNDING);
        if worst.as_ref().is_none_or(|(least, ..)| ratio < *least) {
            worst = Some((ratio, in_full, direction));
        }
    }
    let (ratio, variable, direction) = worst.ok_or(DivergenceError::NothingKept)?;
    Ok((overconfident, WorstMarginal { variable, direction, deviation_ratio: ratio.sqrt() }))
}

/// The least ratio of variances `dᵀ claimed d / dᵀ right d`, and its direction d.
fn least_ratio(right: &DMatrix<f64>, claimed: &DMatrix<f64>) -> Option<(f64, Vec<f64>)> {
    let root = (0.5 * (right + right.transpose())).cholesky()?.l();
    let half = root.solve_lower_triangular(claimed)?;
    let whitened = root.solve_lower_triangular(&half.transpose())?;
    if whitened.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let eigen = whitened.symmetric_eigen();
    let (k, &ratio) = eigen.eigenvalues.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
    let direction = root.tr_solve_lower_triangular(&eigen.eigenvectors.column(k).into_owned())?;
    let direction = direction.normalize();
    Some((ratio.max(0.0), direction.iter().copied().collect()))
}
