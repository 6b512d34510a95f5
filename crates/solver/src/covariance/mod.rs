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
//! with the rows of Y below C only, if `Σ_CC` is known; else the substitution goes on through C. The
//! covariance of a whole clique comes from its parent's, whose
//! variables hold its separator S (F are the frontals, `P = R_FF⁻¹ R_FS`):
//!
//! ```text
//! Σ_FS = −P Σ_SS,    Σ_FF = R_FF⁻¹ R_FF⁻ᵀ − Σ_FS Pᵀ
//! ```
//!
//! so that each is made once, from the root down, and kept for the questions that follow; made when
//! enough have gone through the clique to have paid for it. Nothing is factored again, and no inverse of more than a clique is formed. The recursion is that of M. Kaess
//! and F. Dellaert, "Covariance recovery from a square root information matrix for data
//! association", RAS 2009, by cliques.

mod clique;
mod product;
mod substitution;

use std::collections::BTreeMap;

use evergraph_model::{VariableId, VariableIndex};
use nalgebra::DMatrix;

use self::clique::{cost_to_make, cost_to_pass, from_separator, separator_block};
use self::substitution::RightHandSide;
use crate::error::SmootherError;
use crate::factorization::Factorization;
use crate::index::CliqueIndex;
use crate::smoother::Smoother;

/// Answers questions about covariances of one state of a smoother; what it has found out it keeps.
///
/// Covariances are of the tangent vectors at the linearization points (translation first, in the
/// frame of the variable, m and rad), for the noise as it stands in the factors (robust ones with
/// their present weights).
#[derive(Debug)]
pub struct Covariances<'a> {
    smoother: &'a Smoother,
    /// By clique: of its frontals and separator, in their order.
    cliques: BTreeMap<CliqueIndex, DMatrix<f64>>,
    /// By clique: what questions have spent on going through it.
    spent: BTreeMap<CliqueIndex, f64>,
}

impl Smoother {
    /// Covariances of the present state. A question costs the cliques between its variables and their
    /// root; after many, those up to a clique whose covariance they have paid for.
    pub fn covariances(&self) -> Covariances<'_> {
        Covariances { smoother: self, cliques: BTreeMap::new(), spent: BTreeMap::new() }
    }

    /// The marginal covariance of one variable: see [`Covariances::marginal`].
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn marginal(&self, variable: impl Into<VariableId>) -> Result<DMatrix<f64>, SmootherError> {
        self.covariances().marginal(variable)
    }

    /// The joint covariance of some variables: see [`Covariances::joint`].
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn joint(
        &self,
        variables: &[impl Into<VariableId> + Copy],
    ) -> Result<DMatrix<f64>, SmootherError> {
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
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn marginal(
        &mut self,
        variable: impl Into<VariableId>,
    ) -> Result<DMatrix<f64>, SmootherError> {
        self.joint(&[variable.into()])
    }

    /// The joint marginal covariance of some variables, in the order given, each in the order of
    /// its tangent. Variables of different components do not correlate. Fixed variables are certain:
    /// their rows and columns are zero.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn joint(
        &mut self,
        variables: &[impl Into<VariableId> + Copy],
    ) -> Result<DMatrix<f64>, SmootherError> {
        let variables = self.smoother.indices(variables)?;
        let graph = &self.smoother.factorization.graph;
        let unknown = |v: &VariableIndex| !graph.is_fixed_at(*v);
        if variables.iter().all(unknown) {
            return Ok(self.joint_of_unknowns(&variables));
        }
        let unknowns: Vec<VariableIndex> = variables.iter().copied().filter(unknown).collect();
        let small = self.joint_of_unknowns(&unknowns);
        // The row in the small matrix of each row that is not zero.
        let mut next = 0;
        let rows: Vec<Option<usize>> = variables
            .iter()
            .flat_map(|&v| std::iter::repeat_n(!graph.is_fixed_at(v), graph.dim_at(v)))
            .map(|is_unknown| is_unknown.then(|| (next, next += 1).0))
            .collect();
        Ok(DMatrix::from_fn(rows.len(), rows.len(), |i, j| match (rows[i], rows[j]) {
            (Some(i), Some(j)) => small[(i, j)],
            _ => 0.0,
        }))
    }

    /// [`joint`](Self::joint) of variables that are not fixed.
    fn joint_of_unknowns(&mut self, variables: &[VariableIndex]) -> DMatrix<f64> {
        let Factorization { graph, tree, .. } = &self.smoother.factorization;
        let slots = || variables.iter().copied();
        let paths: BTreeMap<CliqueIndex, Vec<CliqueIndex>> = slots()
            .map(|v| tree.clique_of(v))
            .map(|clique| (clique, tree.path_to(clique)))
            .collect();
        let met = meeting_place(paths.values());
        // The cliques below it, children before parents.
        let mut below: Vec<(usize, CliqueIndex)> = paths
            .values()
            .flat_map(|path| path.iter().copied().enumerate().skip(met.map_or(0, |(at, _)| at + 1)))
            .collect();
        below.sort_unstable_by(|x, y| y.cmp(x));
        below.dedup();

        let columns = slots().map(|v| graph.dim_at(v)).sum();
        if columns == 0 {
            return DMatrix::zeros(0, 0);
        }
        let mut rhs = RightHandSide::new(columns);
        for &(_, clique) in &below {
            rhs.add_rows(
                &self.smoother.factorization,
                tree.clique(clique).structure.frontals.iter().copied(),
            );
        }
        if let Some((_, clique)) = met {
            rhs.add_rows(&self.smoother.factorization, tree.clique(clique).structure.variables());
        }
        let mut column = 0;
        for v in slots() {
            let row = rhs.row_of(v);
            for i in 0..graph.dim_at(v) {
                rhs.row_mut(row + i)[column] = 1.0;
                column += 1;
            }
        }
        for &(_, clique) in &below {
            rhs.substitute(&self.smoother.factorization, tree.clique(clique));
        }
        let above = met.map(|(_, clique)| self.climb(clique, &mut rhs));
        let mut sum = rhs.gram();
        if let Some(above) = above.flatten() {
            sum += above;
        }
        sum
    }

    /// From `clique` up to one whose covariance is known, or past the root. What the known one
    /// contributes.
    fn climb(&mut self, clique: CliqueIndex, rhs: &mut RightHandSide) -> Option<DMatrix<f64>> {
        self.learn(clique, rhs.columns());
        let tree = &self.smoother.factorization.tree;
        let mut next = Some(clique);
        while let Some(current) = next {
            let passed = tree.clique(current);
            rhs.add_rows(&self.smoother.factorization, passed.structure.variables());
            if let Some(known) = self.cliques.get(&current) {
                let left = rhs.at(&self.smoother.factorization, passed);
                return Some(left.tr_mul(&(known * &left)));
            }
            rhs.substitute(&self.smoother.factorization, passed);
            next = tree.parent_of(current);
        }
        None
    }

    /// Makes the covariances of cliques from `clique` to the root that so many right-hand sides have
    /// gone through that making them would have cost no more; from the root down.
    ///
    /// So a single small question does not pay for the covariance of a large clique, of which it needs
    /// a few combinations, and many do not go through it again and again. A clique that has been paid
    /// for waits until its parent has.
    fn learn(&mut self, clique: CliqueIndex, columns: usize) {
        let tree = &self.smoother.factorization.tree;
        let mut parent: Option<CliqueIndex> = None;
        let mut is_known = true;
        for current in tree.path_to(clique) {
            if !self.cliques.contains_key(&current) {
                let passed = tree.clique(current);
                let spent = self.spent.entry(current).or_insert(0.0);
                *spent += cost_to_pass(passed, columns);
                is_known &= *spent >= cost_to_make(passed);
                if is_known {
                    let above = parent.map(|parent| {
                        separator_block(
                            &self.smoother.factorization,
                            current,
                            parent,
                            &self.cliques[&parent],
                        )
                    });
                    self.cliques.insert(current, from_separator(passed, above));
                }
            }
            parent = Some(current);
        }
    }
}

/// The last clique that all paths from the root have in common, and its place on them.
fn meeting_place<'a>(
    mut paths: impl Iterator<Item = &'a Vec<CliqueIndex>>,
) -> Option<(usize, CliqueIndex)> {
    let mut common = paths.next()?.clone();
    for path in paths {
        let len = common.iter().zip(path).take_while(|(x, y)| x == y).count();
        common.truncate(len);
    }
    Some((common.len().checked_sub(1)?, *common.last()?))
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
        let Factorization { graph, blocks, .. } = &smoother.factorization;
        let rows = graph.factor_indices().map(|f| graph.rows_at(f)).sum();
        let mut jacobian = DMatrix::zeros(rows, graph.tangent_len());
        let mut row = 0;
        for f in graph.factor_indices() {
            let block = blocks.get(f).chunks_exact(graph.rows_at(f));
            let scalars = graph.unknowns_at(f).iter().flat_map(|&v| graph.tangent_range(v));
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
                        .flat_map(|id| {
                            smoother
                                .graph()
                                .tangent_range(smoother.graph().variable_index(*id).unwrap())
                        })
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
            assert_eq!(smoother.joint(&[] as &[VariableId]).unwrap().len(), 0);
        }
    }

    /// One question goes through the cliques; many make their covariances, from the root down, and get
    /// the same answers.
    #[test]
    fn cliques_that_are_asked_for_often_are_known() {
        let mut rng = ChaCha8Rng::seed_from_u64(23);
        let (smoother, poses) = grow(Elimination::Cholesky, &mut rng);
        let mut kept = smoother.covariances();
        kept.marginal(poses[3]).unwrap();
        assert!(kept.cliques.is_empty(), "{:?}", kept.spent);
        for _ in 0..60 {
            for &pose in &poses {
                kept.marginal(pose).unwrap();
            }
        }
        let tree = &smoother.factorization.tree;
        assert!(tree.roots.iter().all(|root| kept.cliques.contains_key(root)));
        let is_closed = |clique: &CliqueIndex| {
            tree.parent_of(*clique).is_none_or(|parent| kept.cliques.contains_key(&parent))
        };
        assert!(kept.cliques.keys().all(is_closed));
        for &pose in &poses {
            let (known, fresh) = (kept.marginal(pose).unwrap(), smoother.marginal(pose).unwrap());
            assert!((&known - &fresh).amax() < 1e-10 * fresh.amax(), "{known} {fresh}");
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
