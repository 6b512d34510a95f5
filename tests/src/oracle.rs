//! The one judge of every incremental scenario: the clique tree against a fresh batch solution of
//! the same linear system by an independent solver.

use evergraph::Smoother;
use evergraph::solver::LinearSystem;
use faer::prelude::SolveLstsq;
use faer::sparse::{SparseColMat, Triplet};

/// Below this, numbers have too few bits to be right relative to anything.
const NOTHING: f64 = 1e-290;

/// Systems of up to so many columns are solved densely.
const DENSE: usize = 300;

/// Checks that the tree is the factorization of the linearized problem and its solution right.
///
/// With `H = JᵀJ`, and `J` from the smoother's linearization points:
///
/// - `|RᵀR − H|ᵢⱼ ≤ 1e-10 √(Hᵢᵢ Hⱼⱼ)`,
/// - `|Jᵀ(Jδ + r)|∞ ≤ 1e-10 (|H| |δ| + |Jᵀr|)∞`, or what an orthogonal factorization rounds away,
///   `10 ε maxⱼ‖Jⱼ‖ ‖r‖` (it is stable by norms, not by entries),
/// - δ agrees with faer's QR of `J`, dense for small systems and sparse for large ones, within `max(1e-9, 10 ε cond)` relative, or, where δ is
///   next to nothing beside the residual that it comes from, within `10 ε cond ‖r‖`. Components are
///   measured in units of `1/√Hᵢᵢ`, and `cond` is the condition number of H so scaled.
///
/// # Panics
/// When one of them does not hold; `at` says where that was.
pub fn check_against_batch(smoother: &Smoother, at: &str) {
    let system = smoother.linear_system();
    if system.columns() == 0 {
        return;
    }
    let jacobian = Sparse::new(system.rows(), system.columns(), system.jacobian());
    let factor = Sparse::new(system.columns(), system.columns(), system.factor());
    check_factor(&jacobian, &factor, at);
    check_gradient(&jacobian, &system, at);
    check_solution(&jacobian, &factor, &system, at);
}

fn check_factor(jacobian: &Sparse, factor: &Sparse, at: &str) {
    let diagonal = jacobian.column_norms_squared();
    for (j, (h, rr)) in jacobian.gram().iter().zip(factor.gram()).enumerate() {
        let bound = |i: usize| 1e-10 * (diagonal[i] * diagonal[j]).sqrt();
        let value = |list: &[(usize, f64)], i| {
            list.binary_search_by_key(&i, |entry| entry.0).map_or(0.0, |place| list[place].1)
        };
        for &(i, _) in h.iter().chain(&rr) {
            let (a, b) = (value(h, i), value(&rr, i));
            assert!(
                (a - b).abs() <= bound(i),
                "{at}: (RᵀR)[{i}, {j}] is {b}, (JᵀJ)[{i}, {j}] is {a}"
            );
        }
    }
}

fn check_gradient(jacobian: &Sparse, system: &LinearSystem, at: &str) {
    let mut residual = jacobian.times(system.delta());
    for (out, r) in residual.iter_mut().zip(system.residual()) {
        *out += r;
    }
    let left = max(&jacobian.transpose_times(&residual));
    let mut scale = vec![0.0; system.columns()];
    for (j, column) in jacobian.gram().iter().enumerate() {
        for &(i, x) in column {
            scale[i] += x.abs() * system.delta()[j].abs();
            if i != j {
                scale[j] += x.abs() * system.delta()[i].abs();
            }
        }
    }
    for (s, g) in scale.iter_mut().zip(jacobian.transpose_times(system.residual())) {
        *s += g.abs();
    }
    let rounding = 10.0
        * f64::EPSILON
        * max(&jacobian.column_norms_squared()).sqrt()
        * norm(system.residual());
    let bound = (1e-10 * max(&scale)).max(rounding).max(NOTHING);
    assert!(left <= bound, "{at}: gradient {left} at the solution, allowed {bound}");
}

fn check_solution(jacobian: &Sparse, factor: &Sparse, system: &LinearSystem, at: &str) {
    let rhs = faer::Col::from_fn(system.rows(), |i| -system.residual()[i]);
    let fresh = if system.columns() <= DENSE && system.rows() <= 10 * DENSE {
        let mut dense = faer::Mat::<f64>::zeros(system.rows(), system.columns());
        system.jacobian().iter().for_each(|&(i, j, x)| dense[(i, j)] += x);
        dense.qr().solve_lstsq(&rhs)
    } else {
        let entries = system.jacobian().iter().map(|&(i, j, x)| Triplet::new(i, j, x));
        let entries: Vec<_> = entries.collect();
        let sparse = SparseColMat::<usize, f64>::try_new_from_triplets(
            system.rows(),
            system.columns(),
            &entries,
        );
        let sparse = sparse.expect("entries of J lie inside it");
        sparse.sp_qr().expect("memory for the reference solution").solve_lstsq(&rhs)
    };
    let (mut off, mut size) = (0.0_f64, 0.0_f64);
    for (i, h) in jacobian.column_norms_squared().into_iter().enumerate() {
        off = off.max(h.sqrt() * (system.delta()[i] - fresh[i]).abs());
        size = size.max(h.sqrt() * fresh[i].abs());
    }
    let rounding = 10.0 * f64::EPSILON * condition(jacobian, factor);
    let residual = norm(system.residual());
    assert!(
        off <= rounding.max(1e-9) * size || off <= (rounding * residual).max(NOTHING),
        "{at}: δ is off by {off} of {size}, residual {residual}, rounding {rounding}"
    );
}

/// Condition number of H with its diagonal scaled to 1, by power and inverse iteration.
fn condition(jacobian: &Sparse, factor: &Sparse) -> f64 {
    let scale: Vec<f64> = jacobian.column_norms_squared().iter().map(|x| x.sqrt()).collect();
    let start: Vec<f64> = (0..scale.len()).map(|i| ((i * 7919 + 13) as f64).sin()).collect();
    let largest_eigenvalue = |apply: &dyn Fn(&[f64]) -> Vec<f64>| {
        let (mut x, mut value) = (start.clone(), 0.0);
        for _ in 0..15 {
            let length = norm(&x);
            x.iter_mut().for_each(|x| *x /= length);
            x = apply(&x);
            value = norm(&x);
        }
        value
    };
    let divided = |x: &[f64]| -> Vec<f64> { x.iter().zip(&scale).map(|(x, s)| x / s).collect() };
    let multiplied = |x: &[f64]| -> Vec<f64> { x.iter().zip(&scale).map(|(x, s)| x * s).collect() };
    let largest =
        largest_eigenvalue(&|x| divided(&jacobian.transpose_times(&jacobian.times(&divided(x)))));
    let inverse = largest_eigenvalue(&|x| {
        multiplied(&factor.solve(&factor.solve_transposed(&multiplied(x))))
    });
    largest * inverse
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn max(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m, x| m.max(x.abs()))
}

/// Compressed rows.
struct Sparse {
    columns: usize,
    rows: Vec<Vec<(usize, f64)>>,
}

impl Sparse {
    fn new(rows: usize, columns: usize, entries: &[(usize, usize, f64)]) -> Self {
        let mut lists = vec![Vec::new(); rows];
        for &(i, j, x) in entries {
            lists[i].push((j, x));
        }
        lists.iter_mut().for_each(|list| list.sort_unstable_by_key(|entry| entry.0));
        Self { columns, rows: lists }
    }

    fn times(&self, x: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|row| row.iter().map(|&(j, a)| a * x[j]).sum()).collect()
    }

    fn transpose_times(&self, y: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.columns];
        for (row, y) in self.rows.iter().zip(y) {
            for &(j, a) in row {
                out[j] += a * y;
            }
        }
        out
    }

    fn column_norms_squared(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.columns];
        for &(j, a) in self.rows.iter().flatten() {
            out[j] += a * a;
        }
        out
    }

    /// The upper triangle of the product of the transpose with itself, by columns.
    fn gram(&self) -> Vec<Vec<(usize, f64)>> {
        let mut column_entries = vec![Vec::new(); self.columns];
        for (k, row) in self.rows.iter().enumerate() {
            for &(j, x) in row {
                column_entries[j].push((k, x));
            }
        }
        let mut sums = vec![0.0; self.columns];
        let mut seen = vec![usize::MAX; self.columns];
        let mut columns = Vec::with_capacity(self.columns);
        for (j, entries) in column_entries.iter().enumerate() {
            let mut pattern = Vec::new();
            for &(k, x) in entries {
                for &(i, y) in self.rows[k].iter().take_while(|entry| entry.0 <= j) {
                    if seen[i] != j {
                        seen[i] = j;
                        sums[i] = 0.0;
                        pattern.push(i);
                    }
                    sums[i] += x * y;
                }
            }
            pattern.sort_unstable();
            columns.push(pattern.into_iter().map(|i| (i, sums[i])).collect());
        }
        columns
    }

    /// For an upper triangular matrix R: `R x = y`.
    fn solve(&self, y: &[f64]) -> Vec<f64> {
        let mut x = y.to_vec();
        for i in (0..self.rows.len()).rev() {
            let row = &self.rows[i];
            let sum: f64 = row[1..].iter().map(|&(j, a)| a * x[j]).sum();
            x[i] = (x[i] - sum) / row[0].1;
        }
        x
    }

    /// For an upper triangular matrix R: `Rᵀ x = y`.
    fn solve_transposed(&self, y: &[f64]) -> Vec<f64> {
        let mut x = y.to_vec();
        for (i, row) in self.rows.iter().enumerate() {
            x[i] /= row[0].1;
            for &(j, a) in &row[1..] {
                x[j] -= a * x[i];
            }
        }
        x
    }
}
