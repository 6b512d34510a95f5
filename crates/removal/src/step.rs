//! One step of a plan: what goes, what comes, and what that does.

use evergraph_model::{Factor, VariableId};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

use crate::condition::{Conditioning, condition};
use crate::covariance::CovarianceRoot;
use crate::error::RemovalError;
use crate::fallback::Fallback;
use crate::member::Member;
use crate::neighborhood::Neighborhood;
use crate::options::{Options, Recovery, Topology};
use crate::overlay::{Overlay, Source};
use crate::recover::composition;
use crate::replacement::{Maker, Replacement};
use crate::target::Target;
use crate::topology::{Tree, Unary};
use crate::whitened::Certificate;

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
    /// The information of a tree relative to that of the removed factors; given when a consistency or a price was asked
    /// for. `None` for other topologies.
    pub certificate: Option<Certificate>,
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

impl Draft {
    /// Plans the removal of a node, or of a connected group.
    pub(crate) fn of(
        overlay: &Overlay<'_>,
        removed: &[VariableId],
        options: &Options,
        certify: bool,
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
        let replacement = match options.recovery {
            _ if target.members.is_empty() => Replacement::nothing(&target, options.topology),
            Recovery::Drop => Replacement::nothing(&target, options.topology),
            Recovery::Composition => {
                let covariance = CovarianceRoot::of(&target);
                let weights = options.mutual_information;
                let tree = Tree::chow_liu(&target, covariance.as_ref(), weights, Unary::OnFirst);
                let factors = composition::factors(overlay, &neighborhood, &tree)?;
                Replacement::composed(&neighborhood, &target, factors)?
            }
            Recovery::Glc | Recovery::Nonlinear => {
                let neighborhood = &neighborhood;
                Maker { overlay, neighborhood, target: &target, options, certify }.replacement()?
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
            certificate: None,
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
        let (merged_root, merged_rhs) = replacement.merged_rows();
        let Replacement { made, rows, rhs, merged, .. } = replacement;
        let absorbed = || neighborhood.factors.iter().chain(&merged);
        let gone = || absorbed().chain(&neighborhood.rejected);
        let removed_dims: usize =
            neighborhood.members[..neighborhood.removed].iter().map(|m| m.value.dim()).sum();
        let gone_rows: usize = gone().map(|read| read.rows.nrows()).sum();
        let new_rows: usize = made.iter().map(|m| m.factor.residual_dim()).sum();
        // c = Σ ρ - ½ η_mᵀ Λ_mm⁻¹ η_m - ½ dᵀ Λ' d: with it, the error of the full graph, the node
        // at its best, is that of the reduced graph plus c at the estimate.
        let constant = gone().map(|read| read.error).sum::<f64>()
            - target.explained
            - 0.5 * rhs.norm_squared()
            + replacement.disagreement;
        let ids = |range: std::ops::Range<usize>| {
            neighborhood.members[range].iter().map(|m| m.id).collect::<Vec<_>>()
        };
        let step = Step {
            removed: ids(0..neighborhood.removed),
            blanket: ids(neighborhood.removed..neighborhood.members.len()),
            absorbed: absorbed().map(|read| read.source).collect(),
            rejected: neighborhood.rejected.iter().map(|read| read.source).collect(),
            first_new: 0,
            added: made.iter().map(|m| NewFactor::of(&*m.factor, m.linear)).collect(),
            topology: replacement.topology,
            fallback: replacement.fallback,
            rank: target.rank(),
            free_directions: target.free,
            price: None,
            certificate: replacement.certificate,
            constant,
            degrees_of_freedom: gone_rows as i64 - removed_dims as i64 - new_rows as i64,
            largest_rotation: replacement.largest_rotation,
            largest_length: replacement.largest_length,
        };
        let gradient = rows.tr_mul(&rhs) - target.gradient() - merged_root.tr_mul(&merged_rhs);
        let rank = target.rank();
        let mut before = target.root.resize_vertically(rank + merged_root.nrows(), 0.0);
        before.rows_mut(rank, merged_root.nrows()).copy_from(&merged_root);
        let factors = made.into_iter().map(|m| m.factor).collect();
        let mut seen = target.members;
        seen.extend(neighborhood.fixed.iter().cloned());
        Self { step, factors, before, after: rows, gradient, seen }
    }
}
