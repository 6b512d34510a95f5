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

/// Iterations before the solver gives up. A usual run takes about ten.
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
    /// Multiplier of `M ≤ I`.
    multiplier: DMatrix<f64>,
}

/// Cholesky factors at a point.
struct Factors {
    information: Factored,
    /// Of `S = I - M`.
    slack: Factored,
}

impl Program {
    /// Solves the program by a primal-dual interior point method. It begins at the start divided by twice its `largest`
    /// eigenvalue. `None` when rounding ends it before the gap is closed.
    ///
    /// O(iterations · (rank³ + pattern³)).
    pub(crate) fn solve(&self, largest: f64) -> Option<Weights> {
        /// Weight of the barrier at the start.
        const BARRIER: f64 = 0.1;
        let rank = self.columns.nrows();
        let y = &self.start * (0.5 / largest);
        let information = self.sum(&y);
        let identity = DMatrix::identity(rank, rank);
        let multiplier = (&identity - &information).cholesky()?.inverse() * BARRIER;
        let mut point = Point { y, information, multiplier };
        let mut factors = point.factors()?;
        let gram = self.columns.tr_mul(&self.columns);
        for _ in 0..MOST_ITERATIONS {
            // tr Z S, and half of it in nats.
            let product = point.multiplier.trace() - point.multiplier.dot(&point.information);
            let gap = 0.5 * product;
            let terms = self.terms(&point, &factors);
            let newton = terms.newton(self)?;
            // Mehrotra's rule: the step without a barrier says how much of one is needed, and what it leaves out to
            // second order.
            let none = DMatrix::zeros(rank, rank);
            let affine = self.step(&terms, &newton, &gram, &point, &factors, 0.0, &none);
            if gap <= GAP && affine.decrement <= GAP {
                return Some(Weights { y: point.y, gap });
            }
            let share = point.share(&affine.to)?;
            let mu = product / rank as f64 * (1.0 - share).powi(3).max(1e-4);
            let second = factors.second_order(&affine.to);
            let step = self.step(&terms, &newton, &gram, &point, &factors, mu, &second);
            (point, factors) = point.advanced(&step.to)?;
        }
        None
    }

    /// `B Y Bᵀ`.
    fn sum(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        symmetric(&self.columns * y * self.columns.transpose())
    }

    fn terms(&self, point: &Point, factors: &Factors) -> Terms {
        let through = |factor: &Factored| {
            let mut half = self.columns.clone();
            factor.l_dirty().solve_lower_triangular_mut(&mut half);
            half.tr_mul(&half)
        };
        Terms {
            information: through(&factors.information),
            multiplier: self.columns.tr_mul(&(&point.multiplier * &self.columns)),
            slack: through(&factors.slack),
        }
    }

    /// The Newton step towards the point of the central path where `Z S = μ I`, with C what the affine step leaves out:
    ///
    /// ```text
    /// P dY P + sym(Q dY W) = P - T - μ W + Bᵀ C B    on the pattern
    /// dZ = μ S⁻¹ - Z + sym(Z dM S⁻¹) - C_Z
    /// P = Bᵀ M⁻¹ B,  Q = Bᵀ Z B,  W = Bᵀ S⁻¹ B,  T = Bᵀ B
    /// ```
    #[allow(clippy::too_many_arguments)]
    fn step(
        &self,
        terms: &Terms,
        newton: &Factored,
        gram: &DMatrix<f64>,
        point: &Point,
        factors: &Factors,
        mu: f64,
        second: &DMatrix<f64>,
    ) -> Step {
        let corrected = self.columns.tr_mul(&(second * &self.columns));
        let right = DVector::from_iterator(
            self.pattern.len(),
            self.pattern.iter().map(|&at| {
                scale(at)
                    * (terms.information[at] - gram[at] - mu * terms.slack[at] + corrected[at])
            }),
        );
        let solution = newton.solve(&right);
        let decrement = 0.5 * right.dot(&solution);
        let mut y = DMatrix::zeros(self.start.nrows(), self.start.ncols());
        for (&(i, j), entry) in self.pattern.iter().zip(&solution) {
            let entry = entry / scale((i, j));
            y[(i, j)] = entry;
            y[(j, i)] = entry;
        }
        let information = self.sum(&y);
        let product = factors.slack.solve(&(&information * &point.multiplier));
        let inverse = factors.slack.inverse();
        let multiplier = inverse * mu - &point.multiplier + symmetric(product) - second;
        Step { to: Point { y, information, multiplier }, decrement }
    }
}

/// A step along the path.
struct Step {
    to: Point,
    /// Half of the gradient of the Lagrangian times the step: the distance from the optimum of the program without a
    /// bound, in nats.
    decrement: f64,
}

impl Factors {
    /// What a step leaves out of `Z S` to second order: `sym(dZ dS S⁻¹)`, `dS = -dM`.
    fn second_order(&self, step: &Point) -> DMatrix<f64> {
        -symmetric(self.slack.solve(&(&step.information * &step.multiplier)))
    }
}

/// Off-diagonal entries of a symmetric matrix as a vector count √2, so that dot products agree.
fn scale((i, j): (usize, usize)) -> f64 {
    if i == j { 1.0 } else { std::f64::consts::SQRT_2 }
}

fn symmetric(matrix: DMatrix<f64>) -> DMatrix<f64> {
    0.5 * (&matrix + matrix.transpose())
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

/// `P`, `Q` and `W` of [`Program::step`].
struct Terms {
    information: DMatrix<f64>,
    multiplier: DMatrix<f64>,
    slack: DMatrix<f64>,
}

impl Terms {
    /// The factor of the matrix of `dY -> P dY P + sym(Q dY W)` on the pattern.
    fn newton(&self, program: &Program) -> Option<Factored> {
        let (p, q, w) = (&self.information, &self.multiplier, &self.slack);
        let n = program.pattern.len();
        let mut hessian = DMatrix::zeros(n, n);
        for (column, &(k, l)) in program.pattern.iter().enumerate() {
            let columns = |m: &DMatrix<f64>| (m.column(k).into_owned(), m.column(l).into_owned());
            let ((pk, pl), (qk, ql), (wk, wl)) = (columns(p), columns(q), columns(w));
            for (row, &(i, j)) in program.pattern.iter().enumerate().skip(column) {
                let own = pk[i] * pl[j] + pl[i] * pk[j];
                let mixed = qk[i] * wl[j] + ql[i] * wk[j] + wk[i] * ql[j] + wl[i] * qk[j];
                hessian[(row, column)] = scale((k, l)) * scale((i, j)) * (0.5 * own + 0.25 * mixed);
            }
        }
        hessian.cholesky()
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
