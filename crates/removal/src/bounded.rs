//! Terms of a tree whose information is below the target's.

use std::ops::Range;

use nalgebra::DMatrix;

use crate::conservative::Program;
use crate::covariance::{CovarianceRoot, information_root};
use crate::fallback::Fallback;
use crate::options::Consistency;
use crate::potential::Potential;
use crate::target::Target;
use crate::topology::Tree;
use crate::whitened::{Certificate, Whitened, largest_eigenvalue};

/// Terms whose information is below the target's.
pub(crate) struct Bounded {
    pub(crate) potentials: Vec<Potential>,
    pub(crate) certificate: Certificate,
    pub(crate) fallback: Option<Fallback>,
}

/// Eigenvalues of a tree that is exact are this close to 1.
const ROUNDING: f64 = 1e-12;

/// A program with more unknowns than this is solved over the rows of the tree's terms only.
const MOST_UNKNOWNS: usize = 400;

/// Bounds the information of a tree by the target's. `None` when the tree claims no more as it is.
pub(crate) fn bounded(
    target: &Target,
    tree: &Tree,
    potentials: &[Potential],
    consistency: Consistency,
) -> Option<Bounded> {
    let whitened = Whitened::of(target, potentials);
    let largest = largest_eigenvalue(whitened.information());
    if largest <= 1.0 + ROUNDING {
        return None;
    }
    let conservative = match consistency {
        Consistency::Conservative => least_divergence(target, tree, potentials, &whitened, largest),
        _ => None,
    };
    let (potentials, gap) = conservative.map_or_else(
        || (scaled(potentials, largest), None),
        |(potentials, gap)| (potentials, Some(gap)),
    );
    let fallback = (gap.is_none() && consistency == Consistency::Conservative)
        .then_some(Fallback::ScaledForConsistency);
    let (potentials, certificate) = certified(target, potentials, gap);
    Some(Bounded { potentials, certificate, fallback })
}

/// The terms with their certificate. Rounding on the way from weights to terms may leave them above the bound; they are
/// scaled below it.
fn certified(
    target: &Target,
    potentials: Vec<Potential>,
    gap: Option<f64>,
) -> (Vec<Potential>, Certificate) {
    let certificate = Whitened::of(target, &potentials).certificate(gap);
    if certificate.largest_eigenvalue <= 1.0 {
        return (potentials, certificate);
    }
    let potentials = scaled(&potentials, certificate.largest_eigenvalue);
    let certificate = Whitened::of(target, &potentials).certificate(gap);
    (potentials, certificate)
}

/// The tree's information times the largest factor that bounds it.
fn scaled(potentials: &[Potential], largest: f64) -> Vec<Potential> {
    let scale = ((1.0 - ROUNDING) / largest).sqrt();
    potentials.iter().map(|p| Potential { rows: &p.rows * scale, ..p.clone() }).collect()
}

/// The terms of least divergence, and the gap to it in nats: of all information with the sparsity of the tree where the
/// target is regular, else of weights on the rows of the tree's terms, so that directions that no term sees stay unseen.
fn least_divergence(
    target: &Target,
    tree: &Tree,
    potentials: &[Potential],
    whitened: &Whitened,
    largest: f64,
) -> Option<(Vec<Potential>, f64)> {
    let on_tree = || {
        let spaces = target.is_regular().then(|| Spaces::of_tree(target, tree, potentials))??;
        let (y, gap) = spaces.solve(target, largest)?;
        Some((conditionals(target, tree, spaces.information(target, &y))?, gap))
    };
    let on_terms = || {
        let spaces = Spaces::of_terms(potentials, whitened);
        let (y, gap) = spaces.solve(target, largest)?;
        let bounded = potentials.iter().zip(whitened.starts.windows(2)).map(|(term, w)| {
            let n = w[1] - w[0];
            let root = y.view((w[0], w[0]), (n, n)).into_owned().cholesky()?.l().transpose();
            Some(Potential { rows: root * &term.rows, ..term.clone() })
        });
        Some((bounded.collect::<Option<_>>()?, gap))
    };
    on_tree().or_else(on_terms)
}

/// Rows that weights are on.
struct Spaces {
    terms: Vec<Potential>,
    pattern: Vec<(usize, usize)>,
    /// Number of the rows that belong to the tree itself.
    own: usize,
}

impl Spaces {
    fn of_terms(potentials: &[Potential], whitened: &Whitened) -> Self {
        let pattern = whitened.starts.windows(2).flat_map(|w| square(w[0]..w[1])).collect();
        Self { terms: potentials.to_vec(), pattern, own: whitened.all.ncols() }
    }

    /// For a child with rows u given its parent ξ, products `u uᵀ` and `u ξᵀ`; with those of the root, they make up all
    /// information on the variables of each edge. `None` when there are too many unknowns.
    fn of_tree(target: &Target, tree: &Tree, potentials: &[Potential]) -> Option<Self> {
        let covariance = CovarianceRoot::of(target)?;
        // The root's term, then one for each edge, whose rows are as many as the child has dimensions.
        let mut end = 0;
        let owners = std::iter::once(tree.root).chain(tree.edges.iter().map(|edge| edge.0));
        let starts: Vec<Range<usize>> = owners
            .map(|member| {
                let start = end;
                end += target.dim_of(member);
                start..end
            })
            .collect();
        let is_whole = |(term, rows): (&Potential, &Range<usize>)| term.rows.nrows() == rows.len();
        if potentials.len() != starts.len() || !potentials.iter().zip(&starts).all(is_whole) {
            return None;
        }
        let mut terms = potentials.to_vec();
        let mut pattern: Vec<(usize, usize)> = starts.iter().cloned().flat_map(square).collect();
        let mut alone = vec![None; target.members.len()];
        alone[tree.root] = Some(starts[0].clone());
        for (&(_, parent), rows) in tree.edges.iter().zip(&starts[1..]) {
            let parent_rows = alone[parent].get_or_insert_with(|| {
                let rows = information_root(&covariance.rows(target, &[parent]));
                let start = end;
                end += rows.nrows();
                terms.push(Potential::on_one(parent, rows));
                start..end
            });
            for i in rows.clone() {
                pattern.extend(parent_rows.clone().map(|j| (i.max(j), i.min(j))));
            }
        }
        let own = potentials.iter().map(|p| p.rows.nrows()).sum();
        (pattern.len() <= MOST_UNKNOWNS).then_some(Self { terms, pattern, own })
    }

    /// Weights, and the gap in nats.
    fn solve(&self, target: &Target, largest: f64) -> Option<(DMatrix<f64>, f64)> {
        let columns = Whitened::of(target, &self.terms).all;
        let count = columns.ncols();
        let mut start = DMatrix::zeros(count, count);
        start.view_mut((0, 0), (self.own, self.own)).fill_with_identity();
        let program = Program { columns, pattern: self.pattern.clone(), start };
        let weights = program.solve(largest)?;
        Some((weights.y, weights.gap))
    }

    /// `Σ G_iᵀ Y_ij G_j` in the columns of the blanket.
    fn information(&self, target: &Target, y: &DMatrix<f64>) -> DMatrix<f64> {
        let rows = Potential::stack(target, &self.terms);
        rows.tr_mul(&(y * &rows))
    }
}

/// Entries of a diagonal block, not above the diagonal.
fn square(rows: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
    let start = rows.start;
    rows.flat_map(move |i| (start..=i).map(move |j| (i, j)))
}

/// The terms of information with the sparsity of a tree: eliminated from the leaves to the root it fills nothing in, so
/// that each variable leaves rows on itself and its parent, and the root rows on itself.
fn conditionals(target: &Target, tree: &Tree, information: DMatrix<f64>) -> Option<Vec<Potential>> {
    let mut left = information;
    let mut potentials = Vec::with_capacity(target.members.len());
    for &(child, parent) in tree.edges.iter().rev() {
        let (own, other) = (target.columns(child), target.columns(parent));
        let corner = left.view_range(own.clone(), own.clone()).into_owned().cholesky()?;
        let cross = left.view_range(own.clone(), other.clone()).into_owned();
        let above = corner.l().solve_lower_triangular(&cross)?;
        let mut block = left.view_range_mut(other.clone(), other.clone());
        block.gemm_tr(-1.0, &above, &above, 1.0);
        let mut rows = DMatrix::zeros(own.len(), other.len() + own.len());
        rows.columns_mut(0, other.len()).copy_from(&above);
        rows.columns_mut(other.len(), own.len()).copy_from(&corner.l().transpose());
        potentials.push(Potential::on_edge(target, parent, child, rows));
    }
    let own = target.columns(tree.root);
    let root = left.view_range(own.clone(), own).into_owned().cholesky()?.l().transpose();
    potentials.push(Potential::on_one(tree.root, root));
    potentials.reverse();
    Some(potentials)
}
