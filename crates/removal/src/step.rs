//! One step of a plan: what goes, what comes, and what that does.

use evergraph_model::{Factor, VariableId};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

use crate::condition::{Conditioning, condition};
use crate::covariance::CovarianceRoot;
use crate::error::{MakeError, RemovalError};
use crate::member::Member;
use crate::minimum::Minimum;
use crate::neighborhood::{Neighborhood, Read};
use crate::options::{Guard, Offset, Options, Recovery, Topology};
use crate::overlay::{Overlay, Source};
use crate::potential::{Potential, Sum};
use crate::recover::{self, Made, composition};
use crate::target::Target;
use crate::topology::Tree;

/// Why a step did not take the form that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Fallback {
    /// Relative factors on the tree would have left a direction free that the removed factors
    /// hold; generic linear constraints on the same tree do not.
    LinearTreeForRank,
    /// No tree holds all directions that the removed factors hold; one factor on the whole blanket
    /// does.
    DenseForRank,
    /// The tree's minimum lies further from the estimate than [`Guard`](crate::Guard) allows; one
    /// factor on the whole blanket reproduces the removed factors without approximation.
    DenseForOffset,
    /// The same on a blanket that is larger than
    /// [`Guard::largest_dense`](crate::Guard::largest_dense): the tree stays and its minimum is moved towards
    /// the estimate. A part of the gradient is lost, so that other variables move.
    ShortenedOffset,
}

/// A factor that a step adds.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct NewFactor {
    /// [`Factor::name`].
    pub name: String,
    /// Its variables.
    pub variables: Vec<VariableId>,
    /// Rows of its residual.
    pub rows: usize,
    /// Whether it is a generic linear constraint.
    pub linear: bool,
}

impl NewFactor {
    fn of(factor: &dyn Factor, linear: bool) -> Self {
        let (name, variables) = (factor.name(), factor.keys().to_vec());
        Self { name, variables, rows: factor.residual_dim(), linear }
    }
}

/// What one removal does. Later steps of a plan may absorb the factors of earlier ones.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Step {
    /// The node, or a connected group of them.
    pub removed: Vec<VariableId>,
    /// The Markov blanket, by slot. Fixed variables are given and not part of it.
    pub blanket: Vec<VariableId>,
    /// The factors that are replaced (`Z_m`).
    pub absorbed: Vec<Source>,
    /// Factors on the node whose robust weight was too low to be absorbed: dropped, not replaced.
    pub rejected: Vec<Source>,
    /// The number of the first new factor in [`Source::Planned`].
    pub first_new: usize,
    /// What is added.
    pub added: Vec<NewFactor>,
    /// The topology that was used.
    pub topology: Topology,
    /// Why it, or the kind of factors, is not what was asked for.
    pub fallback: Option<Fallback>,
    /// Rank of the target information; 0 for a fixed node, whose factors stay with its value put in.
    pub rank: usize,
    /// Directions of the removed nodes that no factor determined.
    pub free_directions: usize,
    /// Kullback-Leibler divergence in nats, if a covariance was given: see
    /// [`Plan::price`](crate::Plan::price).
    pub price: Option<f64>,
    /// See [`Plan::constant`](crate::Plan::constant).
    pub constant: f64,
    /// Residual rows less dimensions of variables: what goes less what comes.
    pub degrees_of_freedom: i64,
    /// Largest rotation of a new factor's offset, radians.
    pub largest_rotation: f64,
    /// Longest whitened residual of a new factor at the estimate.
    pub largest_length: f64,
}

/// A step with all that it takes to apply and to price it.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) step: Step,
    pub(crate) factors: Vec<Arc<dyn Factor>>,
    /// `R_t` in the columns of the blanket. Without columns where nothing changes for the blanket.
    pub(crate) before: DMatrix<f64>,
    /// The new factors' rows, likewise.
    pub(crate) after: DMatrix<f64>,
    /// What the gradient `-Σ Jᵀ r` changes by.
    pub(crate) gradient: DVector<f64>,
    /// The blanket and the fixed variables as they were read.
    pub(crate) seen: Vec<Member>,
}

/// New factors, and what they add up to.
struct Replacement {
    made: Vec<Made>,
    topology: Topology,
    fallback: Option<Fallback>,
    rows: DMatrix<f64>,
    /// The whitened residual at the estimate, negated: `G d`.
    rhs: DVector<f64>,
    largest_rotation: f64,
    /// As [`Guard::rotation`](crate::Guard) counts, of trees.
    known_rotation: f64,
    largest_length: f64,
}

impl Draft {
    /// Plans the removal of a node, or of a connected group.
    pub(crate) fn of(
        overlay: &Overlay<'_>,
        removed: &[VariableId],
        options: &Options,
    ) -> Result<Self, RemovalError> {
        if let &[node] = removed
            && overlay.is_fixed(node)
        {
            return Ok(Self::conditioned(node, condition(overlay, node)?, options));
        }
        // What is lost on purpose, or composed, is what is on the node.
        let intra_clique = options.intra_clique && options.recovery != Recovery::Drop;
        let mut neighborhood = Neighborhood::of(overlay, removed, options, intra_clique)?;
        if options.recovery == Recovery::Composition {
            composition::keep_composable(&mut neighborhood, overlay)?;
        }
        let target = Target::of(&neighborhood);
        let made = |error: MakeError| RemovalError::NotRepresentable {
            removed: removed.to_vec(),
            reason: error.to_string(),
        };
        let replacement = match options.recovery {
            _ if target.members.is_empty() => Replacement::nothing(&target, options.topology),
            Recovery::Drop => Replacement::nothing(&target, options.topology),
            Recovery::Composition => {
                let covariance = CovarianceRoot::of(&target);
                let tree = Tree::chow_liu(&target, covariance.as_ref(), options.mutual_information);
                let factors = composition::factors(overlay, &neighborhood, &tree)?;
                Replacement::composed(&neighborhood, &target, factors)?
            }
            Recovery::Glc | Recovery::Nonlinear => {
                Replacement::exact_or_tree(overlay, &target, options).map_err(made)?
            }
        };
        Ok(Self::assemble(&neighborhood, target, replacement))
    }

    /// The removal of a fixed node: exact, whatever the options.
    fn conditioned(node: VariableId, conditioning: Conditioning, options: &Options) -> Self {
        let Conditioning { blanket, absorbed, factors, constant, constant_rows } = conditioning;
        let step = Step {
            removed: vec![node],
            blanket,
            absorbed,
            rejected: Vec::new(),
            first_new: 0,
            added: factors.iter().map(|factor| NewFactor::of(&**factor, false)).collect(),
            topology: options.topology,
            fallback: None,
            rank: 0,
            free_directions: 0,
            price: None,
            constant,
            degrees_of_freedom: constant_rows as i64,
            largest_rotation: 0.0,
            largest_length: 0.0,
        };
        Self {
            step,
            factors,
            before: DMatrix::zeros(0, 0),
            after: DMatrix::zeros(0, 0),
            gradient: DVector::zeros(0),
            seen: Vec::new(),
        }
    }

    fn assemble(neighborhood: &Neighborhood, target: Target, replacement: Replacement) -> Self {
        let Replacement { made, rows, rhs, .. } = replacement;
        let sources = |reads: &[Read]| reads.iter().map(|read| read.source).collect::<Vec<_>>();
        let gone = || neighborhood.factors.iter().chain(&neighborhood.rejected);
        let removed_dims: usize =
            neighborhood.members[..neighborhood.removed].iter().map(|m| m.value.dim()).sum();
        let gone_rows: usize = gone().map(|read| read.rows.nrows()).sum();
        let new_rows: usize = made.iter().map(|m| m.factor.residual_dim()).sum();
        // c = Σ ρ - ½ η_mᵀ Λ_mm⁻¹ η_m - ½ dᵀ Λ' d: with it, the error of the full graph, the node
        // at its best, is that of the reduced graph plus c at the estimate.
        let constant = gone().map(|read| read.error).sum::<f64>()
            - target.explained
            - 0.5 * rhs.norm_squared();
        let ids = |range: std::ops::Range<usize>| {
            neighborhood.members[range].iter().map(|m| m.id).collect::<Vec<_>>()
        };
        let step = Step {
            removed: ids(0..neighborhood.removed),
            blanket: ids(neighborhood.removed..neighborhood.members.len()),
            absorbed: sources(&neighborhood.factors),
            rejected: sources(&neighborhood.rejected),
            first_new: 0,
            added: made.iter().map(|m| NewFactor::of(&*m.factor, m.linear)).collect(),
            topology: replacement.topology,
            fallback: replacement.fallback,
            rank: target.rank(),
            free_directions: target.free,
            price: None,
            constant,
            degrees_of_freedom: gone_rows as i64 - removed_dims as i64 - new_rows as i64,
            largest_rotation: replacement.largest_rotation,
            largest_length: replacement.largest_length,
        };
        let gradient = rows.tr_mul(&rhs) - target.gradient();
        let factors = made.into_iter().map(|m| m.factor).collect();
        let mut seen = target.members;
        seen.extend(neighborhood.fixed.iter().cloned());
        Self { step, factors, before: target.root, after: rows, gradient, seen }
    }
}

impl Replacement {
    fn nothing(target: &Target, topology: Topology) -> Self {
        Self {
            made: Vec::new(),
            topology,
            fallback: None,
            rows: DMatrix::zeros(0, target.dim()),
            rhs: DVector::zeros(0),
            largest_rotation: 0.0,
            known_rotation: 0.0,
            largest_length: 0.0,
        }
    }

    /// What was composed adds up to what its factors say at the estimate.
    fn composed(
        neighborhood: &Neighborhood,
        target: &Target,
        factors: Vec<Arc<dyn Factor>>,
    ) -> Result<Self, RemovalError> {
        let mut new = Self::nothing(target, Topology::ChowLiu);
        for factor in factors {
            let read = neighborhood.read_new(&*factor)?;
            let (top, width) = (new.rows.nrows(), read.rows.ncols() - 1);
            let count = read.rows.nrows();
            new.rows = new.rows.resize_vertically(top + count, 0.0);
            new.rhs = new.rhs.resize_vertically(top + count, 0.0);
            let mut source = 0;
            for &m in &read.members {
                let columns = target.columns(m - neighborhood.removed);
                let mut block = new.rows.view_mut((top, columns.start), (count, columns.len()));
                block.copy_from(&read.rows.columns(source, columns.len()));
                source += columns.len();
            }
            let rhs = read.rows.column(width);
            new.rhs.rows_mut(top, count).copy_from(&rhs);
            new.largest_length = new.largest_length.max(rhs.norm());
            new.made.push(Made { factor, linear: false });
        }
        Ok(new)
    }

    /// The topology that was asked for, if it holds what the target holds and can be trusted, else
    /// the next closer one.
    fn exact_or_tree(
        overlay: &Overlay<'_>,
        target: &Target,
        options: &Options,
    ) -> Result<Self, MakeError> {
        let mut fallback = None;
        if options.topology == Topology::ChowLiu {
            let covariance = CovarianceRoot::of(target);
            let tree = Tree::chow_liu(target, covariance.as_ref(), options.mutual_information);
            let kinds: &[Recovery] = match options.recovery {
                Recovery::Nonlinear => &[Recovery::Nonlinear, Recovery::Glc],
                _ => &[Recovery::Glc],
            };
            for &recovery in kinds {
                let potentials = Potential::of_tree(target, covariance.as_ref(), &tree, recovery);
                let sum = Sum::of(target, &potentials);
                if sum.rank < target.rank() {
                    fallback = Some(match recovery {
                        Recovery::Nonlinear => Fallback::LinearTreeForRank,
                        _ => Fallback::DenseForRank,
                    });
                    continue;
                }
                let own = Options { recovery, ..*options };
                let new = Self::make(overlay, target, &potentials, sum.rows, &sum.minimum, &own)?;
                let guard = &options.guard;
                // Between two, a tree is what one factor would be, unless recovery splits it further.
                let is_exact = target.members.len() <= 2
                    && (recovery == Recovery::Glc || potentials.iter().all(|p| p.relative));
                let is_near =
                    new.known_rotation <= guard.rotation && new.largest_length <= guard.mahalanobis;
                if is_exact || is_near {
                    return Ok(Self { fallback, ..new });
                }
                if target.members.len() > guard.largest_dense {
                    let share = new.allowed_share(guard);
                    let minimum = &sum.minimum * share;
                    let new = Self::make(overlay, target, &potentials, new.rows, &minimum, &own)?;
                    return Ok(Self { fallback: Some(Fallback::ShortenedOffset), ..new });
                }
                fallback = Some(Fallback::DenseForOffset);
                break;
            }
        }
        let potentials = Potential::dense(target);
        let root = target.root.clone();
        let new = Self::make(overlay, target, &potentials, root, &target.minimum(), options)?;
        Ok(Self { topology: Topology::Dense, fallback, ..new })
    }

    /// The share of the offset that is within the limits of a guard.
    fn allowed_share(&self, guard: &Guard) -> f64 {
        let share = |limit: f64, actual: f64| if actual > limit { limit / actual } else { 1.0 };
        let rotation = share(guard.rotation, self.known_rotation);
        rotation.min(share(guard.mahalanobis, self.largest_length))
    }

    fn make(
        overlay: &Overlay<'_>,
        target: &Target,
        potentials: &[Potential],
        rows: DMatrix<f64>,
        minimum: &DVector<f64>,
        options: &Options,
    ) -> Result<Self, MakeError> {
        let minimum = match options.offset {
            Offset::KeepGradient => minimum.clone(),
            Offset::Zero => DVector::zeros(target.dim()),
        };
        let mut new = Self::nothing(target, Topology::ChowLiu);
        for potential in potentials {
            let offset = potential.part(target, &minimum);
            let term = Minimum::of(target, potential, &offset);
            let rotation = term.rotation();
            new.largest_rotation = new.largest_rotation.max(rotation);
            // Most terms are near enough as they are; of dense ones nobody asks.
            let is_near = rotation <= options.guard.rotation || potential.members.len() > 2;
            let known = if is_near { rotation } else { term.known().rotation() };
            new.known_rotation = new.known_rotation.max(known);
            new.largest_length = new.largest_length.max((&potential.rows * &offset).norm());
            // Counted from where the members are seen.
            let delta = potential.members.iter().flat_map(|&m| target.members[m].delta.iter());
            let offset = DVector::from_iterator(
                offset.len(),
                offset.iter().zip(delta).map(|(offset, delta)| offset + delta),
            );
            new.made.extend(recover::make(overlay.graph, target, potential, &offset, options)?);
        }
        new.rhs = &rows * &minimum;
        Ok(Self { rows, ..new })
    }
}
