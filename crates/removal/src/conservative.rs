//! Information on a given sparsity that claims no more than the target in any direction.
//!
//! In coordinates `z = R_t ξ`, whitened by the square root of the target, the target is the identity. The information of
//! the new factors is linear in unknown weights,
//!
//! ```text
//! M = B Y Bᵀ       Y symmetric, not zero only on a pattern
//! ```
//!
//! and the program
//!
//! ```text
//! minimize  tr M - ln det M   subject to   M ≤ I
//! ```
//!
//! is convex. Half of its value, less half of the rank, is the Kullback-Leibler divergence of the new factors from the
//! old. `M ≤ I` is `Λ' ≤ Λ_t` in the Loewner order.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// The solver stops when the divergence is no further than this from the least, in nats.
const GAP: f64 = 1e-6;

/// Iterations before the solver gives up.
const MOST_ITERATIONS: usize = 50;

/// The convex program.
#[derive(Clone, Debug)]
pub(crate) struct Program {
    /// `B`.
    pub(crate) columns: DMatrix<f64>,
    /// Entries (row, column) of Y that may differ from zero, rows not above columns.
    pub(crate) pattern: Vec<(usize, usize)>,
    /// A Y on the pattern with M positive definite. Its rows and columns are those of the columns of `B`.
    pub(crate) start: DMatrix<f64>,
}

/// Weights of least divergence.
#[derive(Clone, Debug)]
pub(crate) struct Weights {
    /// Y.
    pub(crate) y: DMatrix<f64>,
    /// The most by which the divergence is above the least, in nats.
    pub(crate) gap: f64,
}

type Factored = Cholesky<f64, Dyn>;

/// A point of a primal-dual path, or a step along it.
#[derive(Clone)]
struct Point {
    y: DMatrix<f64>,
    /// M.
    information: DMatrix<f64>,
    /// Multiplier Z of `M ≤ I`.
    multiplier: DMatrix<f64>,
}

/// Cholesky factors at a point.
struct Factors {
    information: Factored,
    /// Of `S = I - M`.
    slack: Factored,
}

impl Program {
    /// Solves the program by a primal-dual interior point method with Mehrotra's predictor and corrector. It begins at the
    /// start divided by twice its `largest` eigenvalue. `None` when rounding ends it before the gap is closed.
    ///
    /// O(iterations · (rank³ + pattern³)).
    pub(crate) fn solve(&self, largest: f64) -> Option<Weights> {
        /// Weight of the barrier at the start.
        const BARRIER: f64 = 0.1;
        let rank = self.columns.nrows();
        let y = &self.start * (0.5 / largest);
        let information = self.sum(&y);
        let slack = (DMatrix::identity(rank, rank) - &information).cholesky()?;
        let mut point = Point { y, information, multiplier: slack.inverse() * BARRIER };
        let mut factors = point.factors()?;
        let gram = self.columns.tr_mul(&self.columns);
        for _ in 0..MOST_ITERATIONS {
            // tr Z S, and half of it in nats.
            let product = point.multiplier.trace() - point.multiplier.dot(&point.information);
            let gap = 0.5 * product;
            let newton = Newton::at(self, &gram, &point, &factors)?;
            // The step without a barrier tells how much of one is needed, and what is missing to second order.
            let (affine, decrement) = newton.step(0.0, None);
            if gap <= GAP && decrement <= GAP {
                return Some(Weights { y: point.y, gap });
            }
            let mu = product / rank as f64 * (1.0 - point.share(&affine)?).powi(3).max(1e-4);
            let (step, _) = newton.step(mu, Some(factors.second_order(&affine)));
            (point, factors) = point.advanced(&step)?;
        }
        None
    }

    /// `B Y Bᵀ`.
    fn sum(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        symmetric(&self.columns * y * self.columns.transpose())
    }
}

/// The linear system of a step:
///
/// ```text
/// P dY P + sym(Q dY W) = P - T - μ W + Bᵀ C B    on the pattern
/// dZ = μ S⁻¹ - Z + sym(Z dM S⁻¹) - C
/// P = Bᵀ M⁻¹ B,  Q = Bᵀ Z B,  W = Bᵀ S⁻¹ B,  T = Bᵀ B
/// ```
///
/// It leads to the point of the central path where `Z S = μ I`; C is what the linear model leaves out of `Z S`.
struct Newton<'a> {
    program: &'a Program,
    gram: &'a DMatrix<f64>,
    point: &'a Point,
    factors: &'a Factors,
    /// P.
    information: DMatrix<f64>,
    /// W.
    slack: DMatrix<f64>,
    /// The factor of the matrix on the left.
    matrix: Factored,
}

impl<'a> Newton<'a> {
    fn at(
        program: &'a Program,
        gram: &'a DMatrix<f64>,
        point: &'a Point,
        factors: &'a Factors,
    ) -> Option<Self> {
        let through = |factor: &Factored| {
            let mut half = program.columns.clone();
            factor.l_dirty().solve_lower_triangular_mut(&mut half);
            half.tr_mul(&half)
        };
        let (information, slack) = (through(&factors.information), through(&factors.slack));
        let multiplier = program.columns.tr_mul(&(&point.multiplier * &program.columns));
        let matrix = matrix(&program.pattern, &information, &multiplier, &slack).cholesky()?;
        Some(Self { program, gram, point, factors, information, slack, matrix })
    }

    /// The step, and the Newton decrement: half of the gradient of the Lagrangian times the step, in nats.
    fn step(&self, mu: f64, second: Option<DMatrix<f64>>) -> (Point, f64) {
        let Program { columns, pattern, start } = self.program;
        let second = second.unwrap_or_else(|| self.point.multiplier.map(|_| 0.0));
        let corrected = columns.tr_mul(&(&second * columns));
        let entry = |at| self.information[at] - self.gram[at] - mu * self.slack[at] + corrected[at];
        let right = pattern.iter().map(|&at| scale(at) * entry(at));
        let right = DVector::from_iterator(pattern.len(), right);
        let solution = self.matrix.solve(&right);
        let mut y = DMatrix::zeros(start.nrows(), start.ncols());
        for (&(i, j), entry) in pattern.iter().zip(&solution) {
            let entry = entry / scale((i, j));
            y[(i, j)] = entry;
            y[(j, i)] = entry;
        }
        let information = self.program.sum(&y);
        let slack = &self.factors.slack;
        let product = symmetric(slack.solve(&(&information * &self.point.multiplier)));
        let multiplier = slack.inverse() * mu - &self.point.multiplier + product - second;
        (Point { y, information, multiplier }, 0.5 * right.dot(&solution))
    }
}

/// The matrix of `dY -> P dY P + sym(Q dY W)` on a pattern; its lower triangle.
fn matrix(
    pattern: &[(usize, usize)],
    p: &DMatrix<f64>,
    q: &DMatrix<f64>,
    w: &DMatrix<f64>,
) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(pattern.len(), pattern.len());
    for (column, &(k, l)) in pattern.iter().enumerate() {
        let columns = |m: &DMatrix<f64>| (m.column(k).into_owned(), m.column(l).into_owned());
        let ((pk, pl), (qk, ql), (wk, wl)) = (columns(p), columns(q), columns(w));
        for (row, &(i, j)) in pattern.iter().enumerate().skip(column) {
            let own = pk[i] * pl[j] + pl[i] * pk[j];
            let mixed = qk[i] * wl[j] + ql[i] * wk[j] + wk[i] * ql[j] + wl[i] * qk[j];
            matrix[(row, column)] = scale((k, l)) * scale((i, j)) * (0.5 * own + 0.25 * mixed);
        }
    }
    matrix
}

/// Off-diagonal entries of a symmetric matrix as a vector count √2, so that dot products agree.
fn scale((i, j): (usize, usize)) -> f64 {
    if i == j { 1.0 } else { std::f64::consts::SQRT_2 }
}

fn symmetric(matrix: DMatrix<f64>) -> DMatrix<f64> {
    0.5 * (&matrix + matrix.transpose())
}

impl Factors {
    /// The terms of second order that a step leaves out of `Z S`: `sym(dZ dS S⁻¹)`, `dS = -dM`.
    fn second_order(&self, step: &Point) -> DMatrix<f64> {
        -symmetric(self.slack.solve(&(&step.information * &step.multiplier)))
    }
}

impl Point {
    /// `None` when a matrix is not positive definite.
    fn factors(&self) -> Option<Factors> {
        let n = self.information.nrows();
        let slack = (DMatrix::identity(n, n) - &self.information).cholesky()?;
        let information = self.information.clone().cholesky()?;
        self.multiplier.clone().cholesky()?;
        Some(Factors { information, slack })
    }

    /// The share of a step, at most 1, to where a matrix is no longer positive definite.
    fn share(&self, step: &Point) -> Option<f64> {
        const SHORTER: f64 = 0.9;
        let mut share = 1.0;
        while share > 1e-6 {
            if self.along(step, share).factors().is_some() {
                return Some(share);
            }
            share *= SHORTER;
        }
        None
    }

    /// The point most of the way to there.
    fn advanced(&self, step: &Point) -> Option<(Self, Factors)> {
        const INSIDE: f64 = 0.95;
        let next = self.along(step, INSIDE * self.share(step)?);
        let factors = next.factors()?;
        Some((next, factors))
    }

    fn along(&self, step: &Point, share: f64) -> Self {
        Self {
            y: &self.y + &step.y * share,
            information: &self.information + &step.information * share,
            multiplier: &self.multiplier + &step.multiplier * share,
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Blocks of `k` columns, orthonormal within a block, as a tree's terms are.
    fn program(terms: usize, k: usize, rng: &mut ChaCha8Rng) -> Program {
        let n = terms * k;
        let mut columns = DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
        for t in 0..terms {
            let q = columns.columns(t * k, k).into_owned().qr().q();
            columns.columns_mut(t * k, k).copy_from(&q);
        }
        let block =
            |t: usize| (t * k..(t + 1) * k).flat_map(move |i| (t * k..=i).map(move |j| (i, j)));
        Program {
            columns,
            pattern: (0..terms).flat_map(block).collect(),
            start: DMatrix::identity(n, n),
        }
    }

    fn largest(m: &DMatrix<f64>) -> f64 {
        m.clone().symmetric_eigenvalues().max()
    }

    /// Half of `tr M - n - ln det M`.
    fn divergence(m: &DMatrix<f64>) -> f64 {
        0.5 * (m.trace() - m.nrows() as f64 - m.determinant().ln())
    }

    /// No step on the pattern that stays below the bound gains more than the gap, and the bound holds strictly.
    #[test]
    fn weights_are_the_best_on_their_pattern() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for (terms, k) in [(2, 1), (3, 3), (9, 3), (2, 6), (5, 6)] {
            let program = program(terms, k, &mut rng);
            let tree = program.sum(&program.start);
            let weights = program.solve(largest(&tree)).unwrap();
            let best = program.sum(&weights.y);
            assert!(largest(&best) < 1.0 && weights.gap <= GAP);
            let found = divergence(&best);
            let scaled = divergence(&(&tree / largest(&tree)));
            assert!(divergence(&tree) < found && found < scaled + GAP, "{terms} {k}");
            for _ in 0..200 {
                let mut step = DMatrix::zeros(terms * k, terms * k);
                for &(i, j) in &program.pattern {
                    step[(i, j)] = rng.random_range(-1.0..1.0);
                    step[(j, i)] = step[(i, j)];
                }
                for size in [1e-1, 1e-3, 1e-5] {
                    let other = program.sum(&(&weights.y + &step * size));
                    let is_allowed = largest(&other) <= 1.0 && other.clone().cholesky().is_some();
                    assert!(!is_allowed || divergence(&other) > found - GAP, "{terms} {k} {size}");
                }
            }
        }
    }

    /// Two directions a with `B = [1 a; 0 b]`: `Y = diag(y₁, y₂)` has its best in closed form when `y₁ = y₂`.
    #[test]
    fn two_scalars_have_the_answer_by_hand() {
        let (a, b) = (0.6, 0.8);
        let program = Program {
            columns: DMatrix::from_row_slice(2, 2, &[1.0, a, 0.0, b]),
            pattern: vec![(0, 0), (1, 1)],
            start: DMatrix::identity(2, 2),
        };
        let weights = program.solve(largest(&program.sum(&program.start))).unwrap();
        // By symmetry the weights are equal; the eigenvalues of M are y (1 ± a).
        for k in 0..2 {
            assert!((weights.y[(k, k)] - 1.0 / (1.0 + a)).abs() < 1e-3, "{}", weights.y);
        }
    }
}
