//! Marginal covariances, from the live clique tree.
//!
//! With `JᵀJ = RᵀR`, the covariance of variables B is `Σ_BB = YᵀY`, `RᵀY = E_B`: a forward
//! substitution that starts at the cliques of B and follows their paths to the root. It need not go
//! all the way. Where the paths have met, at a clique C, what is left of the right-hand side is
//! some W on the variables of C, and the cliques above contribute
//!
//! ```text
//! Σ_BB = YᵀY + Wᵀ Σ_CC W
//! ```
//!
//! with the rows of Y below C only. The covariance of a whole clique comes from its parent's, whose
//! variables hold its separator S (F are the frontals, `P = R_FF⁻¹ R_FS`):
//!
//! ```text
//! Σ_FS = −P Σ_SS,    Σ_FF = R_FF⁻¹ R_FF⁻ᵀ − Σ_FS Pᵀ
//! ```
//!
//! so that each is made once, from the root down, and kept for the questions that follow. Nothing is
//! factored again, and no inverse of more than a clique is formed. The recursion is that of M. Kaess
//! and F. Dellaert, "Covariance recovery from a square root information matrix for data
//! association", RAS 2009, by cliques.

use std::collections::BTreeMap;

use evergraph_model::VariableId;
use nalgebra::DMatrix;

use crate::error::SmootherError;
use crate::smoother::Smoother;
use crate::tree::Clique;

/// Answers questions about covariances of one state of a smoother; what it has found out it keeps.
///
/// Covariances are of the tangent vectors at the linearization points (translation first, in the
/// frame of the variable, m and rad), for the noise as it stands in the factors (robust ones with
/// their present weights).
#[derive(Debug)]
pub struct Covariances<'a> {
    smoother: &'a Smoother,
    /// By clique: of its frontals and separator, in their order.
    cliques: BTreeMap<u32, DMatrix<f64>>,
}

impl Smoother {
    /// Covariances of the present state. The first question about a variable costs the cliques
    /// between it and its root; those nearby then cost a few cliques.
    pub fn covariances(&self) -> Covariances<'_> {
        Covariances { smoother: self, cliques: BTreeMap::new() }
    }

    /// The marginal covariance of one variable: see [`Covariances::marginal`].
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is stale or foreign.
    pub fn marginal(&self, variable: VariableId) -> Result<DMatrix<f64>, SmootherError> {
        self.covariances().marginal(variable)
    }

    /// The joint covariance of some variables: see [`Covariances::joint`].
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is stale or foreign.
    pub fn joint(&self, variables: &[VariableId]) -> Result<DMatrix<f64>, SmootherError> {
        self.covariances().joint(variables)
    }
}

impl Covariances<'_> {
    /// Whose covariances these are.
    pub fn smoother(&self) -> &Smoother {
        self.smoother
    }

    /// The marginal covariance of one variable, `dim × dim` in the order of its tangent.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is stale or foreign.
    pub fn marginal(&mut self, variable: VariableId) -> Result<DMatrix<f64>, SmootherError> {
        self.joint(&[variable])
    }

    /// The joint marginal covariance of some variables, in the order given, each in the order of
    /// its tangent. Variables of different components do not correlate.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is stale or foreign.
    pub fn joint(&mut self, variables: &[VariableId]) -> Result<DMatrix<f64>, SmootherError> {
        let Smoother { graph, tree, .. } = self.smoother;
        for &variable in variables {
            graph.check_variable(variable)?;
        }
        let slots = || variables.iter().map(|id| id.index());
        let paths: BTreeMap<u32, Vec<u32>> = slots()
            .map(|v| tree.clique_of(v as u32))
            .map(|clique| (clique, tree.path_to(clique)))
            .collect();
        let met = meeting_place(paths.values());
        // The cliques below it, children before parents.
        let mut below: Vec<(usize, u32)> = paths
            .values()
            .flat_map(|path| path.iter().copied().enumerate().skip(met.map_or(0, |(at, _)| at + 1)))
            .collect();
        below.sort_unstable_by(|x, y| y.cmp(x));
        below.dedup();

        let columns = slots().map(|v| graph.dim_at(v)).sum();
        if columns == 0 {
            return Ok(DMatrix::zeros(0, 0));
        }
        let mut rhs = RightHandSide::new(columns);
        for &(_, clique) in &below {
            rhs.add_rows(self.smoother, &tree.clique(clique).structure.frontals);
        }
        if let Some((_, clique)) = met {
            let structure = &tree.clique(clique).structure;
            rhs.add_rows(self.smoother, &structure.frontals);
            rhs.add_rows(self.smoother, &structure.separator);
        }
        let mut column = 0;
        for v in slots() {
            let row = rhs.row_of[&(v as u32)];
            for i in 0..graph.dim_at(v) {
                rhs.row_mut(row + i)[column] = 1.0;
                column += 1;
            }
        }
        for &(_, clique) in &below {
            rhs.substitute(self.smoother, tree.clique(clique));
        }
        let mut sum = rhs.gram_above(below.iter().map(|&(_, c)| frontal_dim(tree.clique(c))).sum());
        if let Some((_, clique)) = met {
            let left = rhs.rest();
            sum += left.tr_mul(&(self.of_clique(clique) * &left));
        }
        Ok(sum)
    }

    /// The covariance of a clique's frontals and separator.
    fn of_clique(&mut self, clique: u32) -> &DMatrix<f64> {
        let tree = &self.smoother.tree;
        // From the last that is known down.
        let mut unknown = Vec::new();
        let mut next = Some(clique);
        while let Some(current) = next.filter(|current| !self.cliques.contains_key(current)) {
            unknown.push(current);
            next = tree.parent_of(current);
        }
        for current in unknown.into_iter().rev() {
            let above = tree.parent_of(current).map(|parent| {
                let known = &self.cliques[&parent];
                separator_block(self.smoother, current, parent, known)
            });
            let covariance = from_separator(tree.clique(current), above);
            self.cliques.insert(current, covariance);
        }
        &self.cliques[&clique]
    }
}

fn frontal_dim(clique: &Clique) -> usize {
    clique.numeric.layout.frontal()
}

/// The last clique that all paths from the root have in common, and its place on them.
fn meeting_place<'a>(mut paths: impl Iterator<Item = &'a Vec<u32>>) -> Option<(usize, u32)> {
    let mut common = paths.next()?.clone();
    for path in paths {
        let len = common.iter().zip(path).take_while(|(x, y)| x == y).count();
        common.truncate(len);
    }
    Some((common.len().checked_sub(1)?, *common.last()?))
}

/// Several right-hand sides on the variables of some cliques, a row per scalar.
struct RightHandSide {
    columns: usize,
    data: Vec<f64>,
    /// By variable slot: its first row.
    row_of: BTreeMap<u32, usize>,
}

impl RightHandSide {
    fn new(columns: usize) -> Self {
        Self { columns, data: Vec::new(), row_of: BTreeMap::new() }
    }

    fn rows(&self) -> usize {
        self.data.len() / self.columns
    }

    /// Zeros for more variables.
    fn add_rows(&mut self, smoother: &Smoother, variables: &[u32]) {
        for &v in variables {
            let rows = self.rows();
            self.row_of.insert(v, rows);
            let dim = smoother.graph.dim_at(v as usize);
            self.data.resize((rows + dim) * self.columns, 0.0);
        }
    }

    fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.data[row * self.columns..(row + 1) * self.columns]
    }

    /// `R_FFᵀ Y_F = U_F`, `U_S -= R_FSᵀ Y_F`, in place.
    fn substitute(&mut self, smoother: &Smoother, clique: &Clique) {
        let rows: Vec<usize> = clique
            .structure
            .variables()
            .flat_map(|v| {
                let first = self.row_of[&v];
                first..first + smoother.graph.dim_at(v as usize)
            })
            .collect();
        for j in 0..frontal_dim(clique) {
            let factor = clique.numeric.row(j);
            let solved: Vec<f64> = self.row_mut(rows[j]).iter().map(|x| x / factor[0]).collect();
            self.row_mut(rows[j]).copy_from_slice(&solved);
            // The entry of the right-hand side, the last, has no row.
            for (&row, r) in rows[j + 1..].iter().zip(&factor[1..]) {
                for (u, y) in self.row_mut(row).iter_mut().zip(&solved) {
                    *u -= r * y;
                }
            }
        }
    }

    /// `YᵀY` over the first `rows` rows; they are dropped.
    fn gram_above(&mut self, rows: usize) -> DMatrix<f64> {
        let rest = self.data.split_off(rows * self.columns);
        let y = DMatrix::from_row_slice(rows, self.columns, &self.data);
        self.data = rest;
        y.tr_mul(&y)
    }

    fn rest(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.rows(), self.columns, &self.data)
    }
}

/// `Σ_SS` of a clique, out of the covariance of its parent.
fn separator_block(
    smoother: &Smoother,
    clique: u32,
    parent: u32,
    known: &DMatrix<f64>,
) -> DMatrix<f64> {
    let Smoother { graph, tree, .. } = smoother;
    let mut place = BTreeMap::new();
    let mut at = 0;
    for v in tree.clique(parent).structure.variables() {
        place.insert(v, at);
        at += graph.dim_at(v as usize);
    }
    let scalars: Vec<usize> = tree
        .clique(clique)
        .structure
        .separator
        .iter()
        .flat_map(|v| place[v]..place[v] + graph.dim_at(*v as usize))
        .collect();
    DMatrix::from_fn(scalars.len(), scalars.len(), |i, j| known[(scalars[i], scalars[j])])
}

/// The covariance of a clique, given that of its separator (none for a root).
fn from_separator(clique: &Clique, above: Option<DMatrix<f64>>) -> DMatrix<f64> {
    let layout = clique.numeric.layout;
    let (f, n) = (layout.frontal(), layout.columns() - 1);
    let above = above.unwrap_or_default();
    // [R_FF⁻¹ P], by back-substitution on [I R_FS].
    let mut solved = DMatrix::zeros(f, n);
    for j in 0..f {
        solved[(j, j)] = 1.0;
        for (s, r) in (f..n).zip(&clique.numeric.row(j)[f - j..]) {
            solved[(j, s)] = *r;
        }
    }
    for j in (0..f).rev() {
        let row = clique.numeric.row(j);
        for column in 0..n {
            let known: f64 = (j + 1..f).map(|k| row[k - j] * solved[(k, column)]).sum();
            solved[(j, column)] = (solved[(j, column)] - known) / row[0];
        }
    }
    let (inverse, p) = (solved.columns(0, f), solved.columns(f, n - f));
    let cross = -(p * &above);
    let own = inverse * inverse.transpose() - &cross * p.transpose();
    let mut all = DMatrix::zeros(n, n);
    all.view_mut((0, 0), (f, f)).copy_from(&own);
    all.view_mut((0, f), (f, n - f)).copy_from(&cross);
    all.view_mut((f, 0), (n - f, f)).copy_from(&cross.transpose());
    all.view_mut((f, f), (n - f, n - f)).copy_from(&above);
    all
}

#[cfg(test)]
mod tests {
    use evergraph_factors::{BetweenPose2, Prior};
    use evergraph_model::{LieGroup, Noise, Pose2};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::{Elimination, Settings};

    /// Two trajectories with closures that never meet, grown step by step.
    fn grow(elimination: Elimination, rng: &mut ChaCha8Rng) -> (Smoother, Vec<VariableId>) {
        let settings = Settings { elimination, ..Settings::default() };
        let mut smoother = Smoother::new(settings).unwrap();
        let mut poses: Vec<VariableId> = Vec::new();
        for k in 0..90_usize {
            let mut change = smoother.change();
            let pose = change.add_variable(&Pose2::new(k as f64, 0.0, 0.0));
            let noise = Noise::from_sigmas(&[0.1, 0.3, 0.05]).unwrap();
            if k % 45 == 0 {
                let prior = Prior::new(pose, Pose2::identity(), noise).unwrap();
                change.add_factor(prior);
            } else {
                let mut from = vec![k - 1];
                if k % 5 == 4 {
                    from.push(rng.random_range(k / 45 * 45..k));
                }
                for from in from {
                    let key = smoother.graph().key::<Pose2>(poses[from]).unwrap();
                    let wiggle = rng.random_range(-0.1..0.1);
                    let measured = Pose2::new((k - from) as f64, wiggle, wiggle);
                    change
                        .add_factor(BetweenPose2::new(key, pose, measured, noise.clone()).unwrap());
                }
            }
            smoother.apply(change).unwrap();
            poses.push(pose.id());
        }
        (smoother, poses)
    }

    /// `(JᵀJ)⁻¹` of everything, by a dense QR of J; scalars by tangent range.
    fn dense(smoother: &Smoother) -> DMatrix<f64> {
        let graph = &smoother.graph;
        let rows = graph.factor_indices().map(|f| graph.rows_at(f)).sum();
        let mut jacobian = DMatrix::zeros(rows, graph.tangent_len());
        let mut row = 0;
        for f in graph.factor_indices() {
            let block = smoother.blocks.get(f).chunks_exact(graph.rows_at(f));
            let scalars =
                graph.variables_at(f).iter().flat_map(|&v| graph.tangent_range(v as usize));
            for (scalar, column) in scalars.zip(block) {
                jacobian.view_mut((row, scalar), (column.len(), 1)).copy_from_slice(column);
            }
            row += graph.rows_at(f);
        }
        let inverse = jacobian.qr().r().try_inverse().unwrap();
        &inverse * inverse.transpose()
    }

    #[test]
    fn covariances_are_blocks_of_the_inverse() {
        let mut rng = ChaCha8Rng::seed_from_u64(17);
        for elimination in [Elimination::Cholesky, Elimination::Qr] {
            let (smoother, poses) = grow(elimination, &mut rng);
            let expected = dense(&smoother);
            let mut kept = smoother.covariances();
            for count in [1, 1, 2, 3, 5, 8, 20, 90] {
                for _ in 0..8 {
                    let some: Vec<VariableId> =
                        (0..count).map(|_| poses[rng.random_range(0..poses.len())]).collect();
                    let scalars: Vec<usize> = some
                        .iter()
                        .flat_map(|id| smoother.graph.tangent_range(id.index()))
                        .collect();
                    for found in [smoother.joint(&some).unwrap(), kept.joint(&some).unwrap()] {
                        assert_eq!(found.shape(), (scalars.len(), scalars.len()));
                        for (i, &row) in scalars.iter().enumerate() {
                            for (j, &column) in scalars.iter().enumerate() {
                                let scale =
                                    (expected[(row, row)] * expected[(column, column)]).sqrt();
                                let off = (found[(i, j)] - expected[(row, column)]).abs();
                                assert!(off < 1e-9 * scale, "({i}, {j}): off by {off}");
                            }
                        }
                    }
                }
            }
            assert_eq!(smoother.joint(&[]).unwrap().len(), 0);
        }
    }

    #[test]
    fn unknown_variables_are_errors() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (smoother, poses) = grow(Elimination::Cholesky, &mut rng);
        let (other, _) = grow(Elimination::Cholesky, &mut rng);
        assert!(matches!(other.joint(&poses[..2]), Err(SmootherError::Graph(_))));
        assert!(smoother.marginal(poses[0]).is_ok());
    }
}
