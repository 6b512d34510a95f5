//! The Chow-Liu tree: which variables the new factors join.

use std::cmp::Ordering;

use evergraph_model::VariableType;
use nalgebra::DMatrix;

use crate::covariance::{CovarianceRoot, information_root};
use crate::motion::{pose_of, rotation_part};
use crate::options::MutualInformation;
use crate::rank_qr::{half_log_det, triangle, upper_inverse};
use crate::target::Target;

/// A spanning tree of the blanket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Tree {
    pub(crate) root: usize,
    /// (child, parent), parents before their children.
    pub(crate) edges: Vec<(usize, usize)>,
}

/// The variable that the unary factor of a tree is on, of those of highest marginal rank.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unary {
    /// The variable that was added last. Where the oldest variables are removed first it is removed last, and until then
    /// nothing approximates the unary factor again.
    OnNewest,
    /// The first by slot.
    OnFirst,
}

/// Mutual information of a pair under a vanishing prior ε: `-½ nullity ln ε + finite`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Weight {
    /// `n_i + n_j - n_ij`, with n_S the nullity of the marginal of S.
    nullity: i64,
    /// Nats.
    finite: f64,
}

impl Weight {
    const NONE: Self = Self { nullity: i64::MIN, finite: f64::NEG_INFINITY };

    fn cmp(&self, other: &Self) -> Ordering {
        self.nullity.cmp(&other.nullity).then(self.finite.total_cmp(&other.finite))
    }
}

impl Tree {
    /// The spanning tree of maximum weight, the mutual information or what stands for it, over the target (equation 1 of the GLC paper,
    /// 16 of the laser paper), rooted where the target knows most of a single variable.
    pub(crate) fn chow_liu(
        target: &Target,
        covariance: Option<&CovarianceRoot>,
        weights: MutualInformation,
        unary: Unary,
    ) -> Self {
        let n = target.members.len();
        let root = root(target, unary);
        let weight = weights_of(target, covariance, weights);
        // Prim: grow from the root by the heaviest edge that leaves the tree.
        let mut best: Vec<(Weight, usize)> = (0..n).map(|k| (weight(k, root), root)).collect();
        let mut inside = vec![false; n];
        inside[root] = true;
        let mut edges = Vec::with_capacity(n - 1);
        for _ in 1..n {
            let outside = (0..n).filter(|&k| !inside[k]);
            // `rev`, so that ties go to the first.
            let next = outside.rev().max_by(|&a, &b| best[a].0.cmp(&best[b].0));
            let Some(next) = next else { break };
            inside[next] = true;
            edges.push((next, best[next].1));
            for k in (0..n).filter(|&k| !inside[k]) {
                let candidate = weight(k, next);
                if candidate.cmp(&best[k].0) == Ordering::Greater {
                    best[k] = (candidate, next);
                }
            }
        }
        Self { root, edges }
    }
}

/// The held pose if all is relative, else a variable of highest marginal rank.
fn root(target: &Target, unary: Unary) -> usize {
    let all = 0..target.members.len();
    if all.clone().all(|k| target.is_relative(k))
        && let Some(held) = target.held().next()
    {
        return held;
    }
    let ranks: Vec<usize> = match target.is_regular() {
        true => all.clone().map(|k| target.dim_of(k)).collect(),
        false => {
            let single: Vec<[usize; 1]> = all.clone().map(|k| [k]).collect();
            let marginals = target.marginals(&single).into_iter().enumerate();
            marginals.map(|(k, rows)| target.reduced(k, rows).nrows()).collect()
        }
    };
    match unary {
        Unary::OnNewest => all.max_by_key(|&k| (ranks[k], target.members[k].id)),
        Unary::OnFirst => all.rev().max_by_key(|&k| ranks[k]),
    }
    .unwrap_or(0)
}

type WeightOf<'a> = Box<dyn Fn(usize, usize) -> Weight + 'a>;

/// What is added to every direction, as a share of the mean over directions of its unit. With 1e-3
/// nine tenths of sphere2500, by least degree, lose sixteen times as much as without.
const DAMPING: f64 = 1e-4;

/// The way to weigh pairs that fits the target.
fn weights_of<'a>(
    target: &'a Target,
    covariance: Option<&'a CovarianceRoot>,
    weights: MutualInformation,
) -> WeightOf<'a> {
    if weights == MutualInformation::LogDetPlusIdentity {
        return isam(target);
    }
    let all_move = || (0..target.members.len()).all(|k| target.is_relative(k));
    let worlds = target.held().count();
    match covariance {
        Some(covariance) if worlds == 0 => {
            let pairs = regular(target, |members| covariance.rows(target, members));
            Box::new(move |i, j| Weight { nullity: 0, finite: pairs(i, j) })
        }
        Some(covariance) if worlds == 1 && all_move() => {
            let damping = (weights == MutualInformation::Damped).then_some(DAMPING);
            relative(target, covariance, damping)
        }
        _ => vanishing_prior(target),
    }
}

/// Equation 17 of the laser paper, in nats,
///
/// ```text
/// I(x_i; x_j) = ½ ln |Σ_ii| + ½ ln |Σ_jj| - ½ ln |Σ_(ij)(ij)|
/// ```
///
/// from the rows of a square root `Σ = S Sᵀ`, `S = R⁻¹`.
fn regular<'a>(
    target: &'a Target,
    rows: impl Fn(&[usize]) -> DMatrix<f64> + 'a,
) -> impl Fn(usize, usize) -> f64 + 'a {
    let single: Vec<f64> = (0..target.members.len()).map(|k| half_log_det(&rows(&[k]))).collect();
    move |i, j| single[i] + single[j] - half_log_det(&rows(&[i, j]))
}

/// When the target is relative and otherwise regular, the limit in closed form. A prior on one
/// variable alone, of any weight, leaves
///
/// ```text
/// I(x_i; x_j) = ½ ln |Σ_jj| - ½ ln |Σ_rel(i, j)|
/// ```
///
/// with `Σ_rel` the covariance of x_j as seen from the pose x_i, which does not depend on that
/// prior; and `½ ln |Σ_jj|` grows with its vanishing at the same rate for all variables of a kind,
/// faster for poses than for points. So poses are joined with each other first, then each point with
/// a pose.
///
/// Damped, `-½ ln |Σ_rel| = ½ ln |Λ_rel|` becomes `½ ln |Λ_rel + damping D|` ([`damped`]), for which
/// it matters who is seen: of two poses the first, as in iSAM's rule.
fn relative<'a>(
    target: &'a Target,
    covariance: &'a CovarianceRoot,
    damping: Option<f64>,
) -> WeightOf<'a> {
    Box::new(move |i, j| {
        let kind = |k: usize| target.members[k].value.kind();
        let is_pose = |&k: &usize| pose_of(kind(k)).is_some();
        let Some(pose) = [i.max(j), i.min(j)].into_iter().find(is_pose) else {
            return Weight::NONE;
        };
        let other = if pose == i { j } else { i };
        let Some(seen) = covariance.seen(target, pose, other) else { return Weight::NONE };
        let finite = match damping {
            Some(damping) => {
                let lengths = lengths(kind(other), seen.nrows());
                half_log_det(&damped(&information_root(&seen), damping, lengths))
            }
            None => -half_log_det(&seen),
        };
        Weight { nullity: target.dim_of(other) as i64, finite }
    })
}

/// How many numbers of a tangent are lengths: those of a pose come before its rotation; all else has
/// one unit.
fn lengths(kind: &VariableType, dim: usize) -> usize {
    if pose_of(kind).is_some() { dim.saturating_sub(rotation_part(kind)) } else { dim }
}

/// `[Rᵀ √(damping D)]`, whose square is `Λ + damping D`: D is diagonal, over lengths and over the rest
/// the mean of the diagonal of `Λ = RᵀR`, which stays as it is when the axes are turned.
fn damped(root: &DMatrix<f64>, damping: f64, lengths: usize) -> DMatrix<f64> {
    let (rows, n) = root.shape();
    let mut wide = root.transpose().resize_horizontally(rows + n, 0.0);
    for unit in [0..lengths, lengths..n] {
        let sum = root.columns_range(unit.clone()).norm_squared();
        for k in unit.clone() {
            wide[(k, rows + k)] = (damping * sum / unit.len() as f64).sqrt();
        }
    }
    wide
}

/// Any other singular target: the mutual information under two priors `ε I` in column-scaled
/// coordinates. Both are far below what is known and far above what counts as nothing, so that
/// between them `-½ nullity ln ε` shows as the slope, a whole number, and the finite part is what
/// remains.
fn vanishing_prior(target: &Target) -> WeightOf<'_> {
    const ROOTS: [f64; 2] = [1e-5, 1e-7];
    let n = target.dim();
    let under = |prior: f64| {
        let mut stack = DMatrix::zeros(target.rank() + n, n);
        stack.rows_mut(0, target.rank()).copy_from(&target.root);
        for (k, &scale) in target.scales.iter().enumerate() {
            if scale > 0.0 {
                stack.column_mut(k).unscale_mut(scale);
            }
            stack[(target.rank() + k, k)] = prior;
        }
        let s = upper_inverse(&triangle(stack));
        regular(target, move |members| {
            s.select_rows(&members.iter().flat_map(|&m| target.columns(m)).collect::<Vec<_>>())
        })
    };
    let (weak, weaker) = (under(ROOTS[0]), under(ROOTS[1]));
    Box::new(move |i, j| {
        let (first, second) = (weak(i, j), weaker(i, j));
        let slope = (second - first) / (ROOTS[0].ln() - ROOTS[1].ln());
        let nullity = slope.round();
        Weight { nullity: nullity as i64, finite: second + nullity * ROOTS[1].ln() }
    })
}

/// iSAM 1.7: `½ (ln |Λ_i|j + I| - ln |Λ_i + I|)`, with `Λ_i|j` the block of x_i in the marginal of the
/// pair, for the member that comes first.
fn isam(target: &Target) -> WeightOf<'_> {
    let log_det = |rows: DMatrix<f64>| {
        let n = rows.ncols();
        let plus = rows.tr_mul(&rows) + DMatrix::identity(n, n);
        plus.cholesky()
            .map_or(f64::NEG_INFINITY, |c| 2.0 * c.l_dirty().diagonal().map(f64::ln).sum())
    };
    let single: Vec<f64> =
        (0..target.members.len()).map(|k| log_det(target.marginal(&[k]))).collect();
    Box::new(move |i, j| {
        let (i, j) = (i.min(j), i.max(j));
        let pair = target.marginal(&[i, j]);
        let given = pair.columns(0, target.dim_of(i)).into_owned();
        Weight { nullity: 0, finite: 0.5 * (log_det(given) - single[i]) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Of a pose in space.
    fn weight(root: &DMatrix<f64>) -> f64 {
        half_log_det(&damped(root, DAMPING, 3))
    }

    fn regular(numbers: Vec<f64>) -> DMatrix<f64> {
        DMatrix::from_vec(6, 6, numbers) + DMatrix::<f64>::identity(6, 6) * 4.0
    }

    proptest! {
        #[test]
        fn damping_knows_no_units_and_no_axes(
            numbers in proptest::collection::vec(-1.0..1.0f64, 36),
            unit in 1e-3..1e3f64,
            angles in proptest::array::uniform3(-3.0..3.0f64),
        ) {
            let root = regular(numbers);
            let mut other = root.clone();
            other.columns_mut(0, 3).apply(|x| *x *= unit);
            // The same for all pairs: no tree depends on it.
            let difference = weight(&other) - weight(&root);
            prop_assert!((difference - 3.0 * unit.ln()).abs() < 1e-9, "{difference}");
            let turn = nalgebra::Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
            let mut turned = root.clone();
            turned.columns_mut(0, 3).copy_from(&(root.columns(0, 3) * turn.matrix()));
            prop_assert!((weight(&turned) - weight(&root)).abs() < 1e-9);
        }

        #[test]
        fn damping_is_the_determinant_by_hand(
            numbers in proptest::collection::vec(-1.0..1.0f64, 36),
        ) {
            let root = regular(numbers);
            let mut information = root.tr_mul(&root);
            let diagonal = information.diagonal();
            for k in 0..6 {
                information[(k, k)] += DAMPING * diagonal.rows(k / 3 * 3, 3).mean();
            }
            prop_assert!((weight(&root) - 0.5 * information.determinant().ln()).abs() < 1e-9);
        }
    }
}
