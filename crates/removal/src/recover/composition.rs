//! Compounding and merging of measurements (section V of the laser paper, after Smith and
//! Cheeseman): the baseline.
//!
//! The new edges share the measurements that they are compounded of, so information is counted more
//! than once, and the gradient is not kept. Edges between kept poses are merged into the tree's where
//! they are parallel to them, and dropped where they are not: the tree replaces the clique.

use std::sync::Arc;

use evergraph_factors::Between;
use evergraph_model::{Factor, LieGroup, Noise, Pose2, Pose3};
use nalgebra::{DMatrix, SMatrix, SVector};

use crate::error::{MakeError, RemovalError};
use crate::neighborhood::{Neighborhood, Read};
use crate::overlay::Overlay;
use crate::topology::Tree;

/// Leaves factors between kept variables alone that are no full relative poses.
///
/// # Errors
/// [`RemovalError::NotComposable`] when a factor on the node is none.
pub(crate) fn keep_composable(
    neighborhood: &mut Neighborhood,
    overlay: &Overlay<'_>,
) -> Result<(), RemovalError> {
    let composable = |read: &Read| {
        overlay.factor(read.source).is_some_and(|factor| {
            edge::<Pose2, 3>(factor, read).is_some() || edge::<Pose3, 6>(factor, read).is_some()
        })
    };
    let on_node = |read: &Read| read.members.contains(&0);
    if let Some(read) = neighborhood.factors.iter().find(|r| on_node(r) && !composable(r)) {
        let factor = overlay.factor(read.source);
        return Err(RemovalError::NotComposable {
            removed: neighborhood.members[0].id,
            factor: read.source.to_string(),
            name: factor.map(|f| f.name()).unwrap_or_default(),
            variables: factor.map(|f| f.keys().to_vec()).unwrap_or_default(),
        });
    }
    neighborhood.factors.retain(composable);
    Ok(())
}

/// One edge for each edge of the tree.
pub(crate) fn factors(
    overlay: &Overlay<'_>,
    neighborhood: &Neighborhood,
    tree: &Tree,
) -> Result<Vec<Arc<dyn Factor>>, RemovalError> {
    let made = if neighborhood.members[0].value.kind().is::<Pose2>() {
        edges::<Pose2, 3>(overlay, neighborhood, tree)
    } else {
        edges::<Pose3, 6>(overlay, neighborhood, tree)
    };
    made.map_err(|error| RemovalError::NotRepresentable {
        removed: vec![neighborhood.members[0].id],
        reason: error.to_string(),
    })
}

/// A measured transform `from⁻¹ to` and its information, for right perturbations of it.
#[derive(Clone, Copy)]
struct Edge<G, const N: usize> {
    from: usize,
    to: usize,
    z: G,
    information: SMatrix<f64, N, N>,
}

/// A full relative pose of regular information, as the robust weight leaves it.
fn edge<G: LieGroup<N>, const N: usize>(factor: &dyn Factor, read: &Read) -> Option<Edge<G, N>> {
    let (between, _) = factor.downcast::<Between<G, N>>()?;
    // One end is fixed otherwise.
    let &[from, to] = &read.members[..] else { return None };
    let root = between.noise().fixed::<N>()?;
    let information = read.weight * root.tr_mul(&root);
    information.cholesky()?;
    Some(Edge { from, to, z: *between.measurement(), information })
}

impl<G: LieGroup<N>, const N: usize> Edge<G, N> {
    /// The same edge seen from its other end: `(z Exp(ε))⁻¹ = z⁻¹ Exp(-Ad(z) ε)`.
    fn reversed(&self) -> Self {
        let z = self.z.inverse();
        let back = z.adjoint();
        let information = back.tr_mul(&(self.information * back));
        Self { from: self.to, to: self.from, z, information }
    }

    fn towards(&self, from: usize) -> Self {
        if self.from == from { *self } else { self.reversed() }
    }

    /// Compounding: this edge, then `next`. `z₁ Exp(ε₁) z₂ Exp(ε₂) = z₁z₂ Exp(Ad(z₂⁻¹) ε₁ + ε₂)`.
    fn then(&self, next: &Self) -> Option<Self> {
        let transport = next.z.inverse().adjoint();
        let (first, second) = (self.information.try_inverse()?, next.information.try_inverse()?);
        let covariance = transport * first * transport.transpose() + second;
        Some(Self {
            from: self.from,
            to: next.to,
            z: self.z.compose(&next.z),
            information: covariance.try_inverse()?,
        })
    }

    /// Merging of parallel edges: the z of least `Σ ‖Log(z_k⁻¹ z)‖²` by Gauss-Newton, and the
    /// information there.
    fn merged(edges: &[Self]) -> Option<Self> {
        let mut merged = *edges.first()?;
        for _ in 0..20 {
            let (mut information, mut gradient) = (SMatrix::zeros(), SVector::zeros());
            for edge in edges {
                let error = edge.z.between(&merged.z).log();
                let jacobian = G::right_jacobian_inverse(&error);
                let weighted = jacobian.transpose() * edge.information;
                information += weighted * jacobian;
                gradient -= weighted * error;
            }
            let step: SVector<f64, N> = information.cholesky()?.solve(&gradient);
            merged.z = merged.z.compose(&G::exp(&step));
            merged.information = information;
            if step.norm() < 1e-14 {
                break;
            }
        }
        Some(merged)
    }
}

fn edges<G: LieGroup<N>, const N: usize>(
    overlay: &Overlay<'_>,
    neighborhood: &Neighborhood,
    tree: &Tree,
) -> Result<Vec<Arc<dyn Factor>>, MakeError> {
    let all: Vec<Edge<G, N>> = neighborhood
        .factors
        .iter()
        .filter_map(|read| edge(overlay.factor(read.source)?, read))
        .collect();
    let between = |a: usize, b: usize| -> Vec<Edge<G, N>> {
        let joins = |e: &&Edge<G, N>| (e.from, e.to) == (a, b) || (e.from, e.to) == (b, a);
        all.iter().filter(joins).map(|e| e.towards(a)).collect()
    };
    let singular = || MakeError::NotFinite("a composed covariance");
    let mut factors: Vec<Arc<dyn Factor>> = Vec::new();
    for &(child, parent) in &tree.edges {
        // Members: the node is 0, the blanket comes after it.
        let (child, parent) = (child + 1, parent + 1);
        let mut parallel = between(parent, child);
        let (to_node, from_node) = (between(parent, 0), between(0, child));
        if !to_node.is_empty() && !from_node.is_empty() {
            let through_node = Edge::merged(&to_node)
                .and_then(|to_node| to_node.then(&Edge::merged(&from_node)?))
                .ok_or_else(singular)?;
            parallel.push(through_node);
        }
        if parallel.is_empty() {
            // All that joined one of them to the node was too light to be absorbed. Such a variable
            // is a leaf of the tree, or its root with one child: whatever is known is joined first.
            continue;
        }
        let edge = Edge::merged(&parallel).ok_or_else(singular)?;
        let information = DMatrix::from_column_slice(N, N, edge.information.as_slice());
        let key = |m: usize| overlay.graph.key::<G>(neighborhood.members[m].id);
        let noise = Noise::from_information(&(0.5 * (&information + information.transpose())))?;
        factors.push(Arc::new(Between::<G, N>::new(key(parent)?, key(child)?, edge.z, noise)?));
    }
    Ok(factors)
}
