//! The terms that the target is split into, and the point where they agree with its gradient.

use std::cell::LazyCell;

use nalgebra::{DMatrix, DVector};
use smallvec::{SmallVec, smallvec};

use crate::covariance::{CovarianceRoot, information_root};
use crate::motion::{carried, pose_of};
use crate::options::Recovery;
use crate::rank_qr::{back_substitute, echelon, forward_substitute};
use crate::target::Target;
use crate::topology::Tree;

/// A quadratic term `½ ‖G ξ - w‖²` on some of the blanket.
#[derive(Clone, Debug)]
pub(crate) struct Potential {
    /// Places in the blanket; a pose that others are seen from comes first.
    pub(crate) members: SmallVec<[usize; 2]>,
    /// `G`, columns of the members in that order, in their tangents.
    pub(crate) rows: DMatrix<f64>,
    /// It only tells where the others stand as seen from the first, a pose: `G_1 = -Σ G_k A_k` with
    /// A of [`carried`].
    pub(crate) relative: bool,
}

impl Potential {
    /// One term for everything: exact.
    pub(crate) fn dense(target: &Target) -> Vec<Self> {
        // The first pose is the root of a root shift; a held one, whose column then vanishes, is
        // that already.
        let root = target.held().next().or_else(|| {
            let is_pose = |m: &crate::member::Member| pose_of(m.value.kind()).is_some();
            target.members.iter().position(is_pose)
        });
        let others = (0..target.members.len()).filter(|&k| Some(k) != root);
        let members: SmallVec<[usize; 2]> = root.into_iter().chain(others).collect();
        let columns: Vec<usize> = members.iter().flat_map(|&m| target.columns(m)).collect();
        let rows = target.root.select_columns(&columns);
        let relative = root.is_some_and(|root| target.is_relative(root));
        keep([Self { members, rows, relative }])
    }

    /// The terms of a tree: a unary one at the root and one for each edge. Where the target's
    /// covariance can be trusted they are taken from that, which costs less than the marginals of
    /// pairs. O(n³) either way.
    pub(crate) fn of_tree(
        target: &Target,
        covariance: Option<&CovarianceRoot>,
        tree: &Tree,
        recovery: Recovery,
    ) -> Vec<Self> {
        let covariance = covariance.and_then(CovarianceRoot::trusted);
        let regular = covariance.filter(|_| target.is_regular());
        let root = Self {
            members: smallvec![tree.root],
            rows: match target.is_relative(tree.root) {
                true => DMatrix::zeros(0, target.dim_of(tree.root)),
                false => regular.map_or_else(
                    || target.reduced(tree.root, target.marginal(&[tree.root])),
                    |covariance| information_root(&covariance.rows(target, &[tree.root])),
                ),
            },
            relative: false,
        };
        // Columns of the child, then of the parent.
        let pairs = LazyCell::new(|| {
            let sets: Vec<[usize; 2]> = tree.edges.iter().map(|&(c, p)| [c, p]).collect();
            target.marginals(&sets)
        });
        let edges = tree.edges.iter().enumerate().map(|(edge, &(child, parent))| {
            if let Some(pose) = target.holdable(child, parent) {
                let seen = if pose == parent { child } else { parent };
                let rows = covariance
                    .and_then(|covariance| covariance.seen(target, pose, seen))
                    .map(|b| information_root(&b));
                // The pose is held where it is: its columns are left out.
                let rows = rows.unwrap_or_else(|| {
                    let (first, dim) = (target.dim_of(child), target.dim_of(seen));
                    let start = if seen == child { 0 } else { first };
                    target.reduced(seen, pairs[edge].columns(start, dim).into_owned())
                });
                Self::seen_from(target, pose, seen, rows)
            } else if recovery == Recovery::Nonlinear
                && let Some(relative) = Self::relative_part(target, &pairs[edge], child, parent)
            {
                relative
            } else {
                let conditional = match regular {
                    Some(covariance) => Self {
                        members: smallvec![parent, child],
                        rows: covariance.conditional(target, child, parent),
                        relative: false,
                    },
                    None => Self::conditional(target, pairs[edge].clone(), child, parent),
                };
                conditional.pose_first(target)
            }
        });
        keep(std::iter::once(root).chain(edges))
    }

    /// `p_t(x_i | x_j)`, equations 2 to 4 of the GLC paper. With the square root `rows` of the pair's
    /// marginal brought into echelon form, x_i first,
    ///
    /// ```text
    /// [R_ii  R_ij]      Λ_ii = R_iiᵀ R_ii,   Λ_ij = R_iiᵀ R_ij
    /// [ 0    R_jj]
    /// ```
    ///
    /// the information `Eᵀ Λ_ii E`, `E = [I  Λ_ii⁻¹ Λ_ij]`, that the constraint adds is that of the
    /// upper rows: `R_ii E = [R_ii R_ij]`. No inverse is needed, so any rank will do; the lower row is
    /// the marginal of x_j, which belongs to the next term towards the root.
    fn conditional(target: &Target, mut rows: DMatrix<f64>, child: usize, parent: usize) -> Self {
        let dim = target.dim_of(child);
        let rank = echelon(&mut rows, dim, &target.scales[target.columns(child)]).len();
        let rows = rows.rows(0, rank).into_owned();
        // A root shift sees the child from the parent, if that is a pose.
        Self { members: smallvec![parent, child], rows: swapped(&rows, dim), relative: false }
    }

    /// Of a pair, the pose comes first where the other is none, to be the root of a root shift.
    fn pose_first(mut self, target: &Target) -> Self {
        let is_pose = |m: usize| pose_of(target.members[m].value.kind()).is_some();
        if !is_pose(self.members[0]) && is_pose(self.members[1]) {
            self.rows = swapped(&self.rows, target.dim_of(self.members[0]));
            self.members.swap(0, 1);
        }
        self
    }

    /// What `rows` say of `seen` with `pose` held, for any place of the pose: `[-G A  G]`.
    fn seen_from(target: &Target, pose: usize, seen: usize, rows: DMatrix<f64>) -> Self {
        let (from, to) = (&target.members[pose].value, &target.members[seen].value);
        let dim = target.dim_of(pose);
        let mut both = DMatrix::zeros(rows.nrows(), dim + rows.ncols());
        if let Some(motion) = carried(from, to) {
            both.columns_mut(0, dim).copy_from(&-(&rows * motion));
        }
        both.columns_mut(dim, rows.ncols()).copy_from(&rows);
        Self { members: smallvec![pose, seen], rows: both, relative: true }
    }

    /// What a pair knows of its relative position, when it knows more: in the coordinates
    /// `(x_1, x_1⁻¹ x_2)` the square root is `[R_1 + R_2 A  R_2]`, and eliminating the first
    /// coordinate leaves the marginal of the second. On a tree these marginals and the root's are
    /// the information matrices of least divergence (Mazuran, Burgard and Tipaldi 2016, closed form).
    fn relative_part(
        target: &Target,
        pair: &DMatrix<f64>,
        child: usize,
        parent: usize,
    ) -> Option<Self> {
        let is_pose = |m: usize| pose_of(target.members[m].value.kind()).is_some();
        let (pose, seen) = if is_pose(parent) { (parent, child) } else { (child, parent) };
        let motion = carried(&target.members[pose].value, &target.members[seen].value)?;
        let dim = target.dim_of(pose);
        let mut rows = pair.clone();
        if pose == parent {
            rows = swapped(&rows, target.dim_of(child));
        }
        let step = rows.columns(dim, rows.ncols() - dim) * motion;
        let mut first = rows.columns_mut(0, dim);
        first += step;
        let scales: Vec<f64> =
            [pose, seen].iter().flat_map(|&m| target.scales[target.columns(m)].to_vec()).collect();
        let top = echelon(&mut rows, dim, &scales).len();
        let (height, width) = (rows.nrows() - top, rows.ncols() - dim);
        let mut rows = rows.view((top, dim), (height, width)).into_owned();
        let rank = echelon(&mut rows, width, &scales[dim..]).len();
        let rows = rows.rows(0, rank).into_owned();
        Some(Self::seen_from(target, pose, seen, rows))
    }

    /// A term on one variable.
    pub(crate) fn on_one(member: usize, rows: DMatrix<f64>) -> Self {
        Self { members: smallvec![member], rows, relative: false }
    }

    /// A term on an edge of a tree, columns of the parent first.
    pub(crate) fn on_edge(
        target: &Target,
        parent: usize,
        child: usize,
        rows: DMatrix<f64>,
    ) -> Self {
        Self { members: smallvec![parent, child], rows, relative: false }.pose_first(target)
    }

    /// `G` in the columns of the whole blanket.
    fn spread(&self, target: &Target) -> DMatrix<f64> {
        let mut rows = DMatrix::zeros(self.rows.nrows(), target.dim());
        let mut source = 0;
        for &m in &self.members {
            let columns = target.columns(m);
            let dim = columns.len();
            rows.columns_range_mut(columns).copy_from(&self.rows.columns(source, dim));
            source += dim;
        }
        rows
    }

    /// The rows of some terms under each other, in the columns of the whole blanket.
    pub(crate) fn stack(target: &Target, potentials: &[Self]) -> DMatrix<f64> {
        let count = potentials.iter().map(|p| p.rows.nrows()).sum();
        let mut rows = DMatrix::zeros(count, target.dim());
        let mut top = 0;
        for potential in potentials {
            let own = potential.spread(target);
            rows.rows_mut(top, own.nrows()).copy_from(&own);
            top += own.nrows();
        }
        rows
    }

    /// The part of a vector over the blanket that belongs to the members.
    pub(crate) fn part(&self, target: &Target, whole: &DVector<f64>) -> DVector<f64> {
        let entries: Vec<f64> = self
            .members
            .iter()
            .flat_map(|&m| whole.as_slice()[target.columns(m)].iter().copied())
            .collect();
        DVector::from_vec(entries)
    }
}

/// The first `dim` columns behind the others.
fn swapped(rows: &DMatrix<f64>, dim: usize) -> DMatrix<f64> {
    let columns: Vec<usize> = (dim..rows.ncols()).chain(0..dim).collect();
    rows.select_columns(&columns)
}

/// Terms that say something.
fn keep(potentials: impl IntoIterator<Item = Potential>) -> Vec<Potential> {
    potentials.into_iter().filter(|p| p.rows.nrows() > 0).collect()
}

/// All terms together: `Λ' = Rᵀ R`, and the point ξ = d where their sum is least.
#[derive(Clone, Debug)]
pub(crate) struct Sum {
    /// The terms' rows under each other, in the columns of the blanket.
    pub(crate) rows: DMatrix<f64>,
    /// Rank of `Λ'`.
    pub(crate) rank: usize,
    /// `d` with `Λ' d = η_t`: with it the gradient at ξ = 0 is that of what is replaced. Held
    /// poses do not move.
    pub(crate) minimum: DVector<f64>,
}

impl Sum {
    /// O((rows) n²).
    pub(crate) fn of(target: &Target, potentials: &[Potential]) -> Self {
        let rows = Potential::stack(target, potentials);
        // Every vector of null(Λ_t) is in the null space of each marginal, so null(Λ') contains it;
        // the two are equal when the ranks are. Columns of held poses depend on the others.
        let mut root = rows.clone();
        for held in target.held() {
            root.columns_range_mut(target.columns(held)).fill(0.0);
        }
        let pivots = echelon(&mut root, target.dim(), &target.scales);
        let y = forward_substitute(&root, &pivots, &target.gradient());
        let minimum = back_substitute(&root, &pivots, &y);
        Self { rows, rank: pivots.len(), minimum }
    }
}
