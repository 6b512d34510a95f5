//! The full graph held at the same poses as the reduced one, so that the two can be compared.

use std::collections::BTreeMap;

use evergraph_factors::Prior;
use evergraph_formats::spell_id;
use evergraph_model::{Change, FactorId, Graph, Noise, Pose2, Pose3, Value, VariableId};
use evergraph_replay::{GaugePrior, Overview, Replayer};
use evergraph_solver::optimize_to_the_end;

use crate::reduced::ReducedError;

/// The gauge priors of a component of the full graph, in both graphs.
#[derive(Default)]
struct Anchors<'a> {
    are: Vec<&'a GaugePrior>,
    should_be: Vec<&'a GaugePrior>,
}

/// Puts the gauge priors of each component of the full graph where the reduced graph has its own, optimizes
/// the full graph again where that moved one, and returns the priors. At the optimum of relative
/// measurements nothing else moves. `overview` is that of the full graph's document.
///
/// A component of which nothing is kept is not compared. Its prior stays, so that the full graph is
/// determined.
///
/// # Errors
/// [`ReducedError::NotReduced`] where the reduced graph is held otherwise than the full one,
/// [`ReducedError::Full`] when the full graph cannot be solved with the other priors.
pub fn anchor_alike(
    full: &mut Replayer,
    reduced: &Replayer,
    overview: &Overview,
) -> Result<Vec<FactorId>, ReducedError> {
    let mut components: BTreeMap<Option<usize>, Anchors<'_>> = BTreeMap::new();
    let component = |prior: &GaugePrior| overview.component_of(prior.id, true);
    for prior in full.replay().gauge_priors() {
        components.entry(component(prior)).or_default().are.push(prior);
    }
    for prior in reduced.replay().gauge_priors() {
        components.entry(component(prior)).or_default().should_be.push(prior);
    }
    let not_reduced = |problem: String| ReducedError::NotReduced {
        full: full.name().into(),
        reduced: reduced.name().into(),
        problem,
    };
    let mut change = full.smoother().change();
    let (mut factors, mut moves) = (Vec::new(), false);
    for Anchors { are, should_be } in components.values() {
        if stay(are, should_be) {
            factors.extend(are.iter().map(|prior| prior.factor));
            continue;
        }
        if are.len() != should_be.len() {
            return Err(not_reduced(fallen_apart(are, should_be)));
        }
        moves = true;
        for prior in are {
            change.drop_factor(prior.factor);
        }
        for prior in should_be {
            let moved = full.replay().pose(prior.id).and_then(|variable| {
                let value = full.smoother().estimate_value(variable).ok()?;
                add_prior(full.graph(), &mut change, variable, &value, prior)
            });
            factors.push(moved.ok_or_else(|| {
                let (id, count) = (spell_id(prior.id), prior.directions);
                not_reduced(format!(
                    "its gauge is held at pose {id}, in {count} directions, where that of the full \
                     graph is not"
                ))
            })?);
        }
    }
    if moves {
        let applied = full.smoother_mut().apply(change).map(drop);
        let optimized = applied.and_then(|()| optimize_to_the_end(full.smoother_mut()).map(drop));
        optimized.map_err(|source| ReducedError::Full(Box::new(source)))?;
    }
    Ok(factors)
}

/// Whether the full graph's priors do for both graphs. The reduced graph may have fewer: it holds what
/// they say in its own factors, or nothing of the component.
fn stay(are: &[&GaugePrior], should_be: &[&GaugePrior]) -> bool {
    let place = |prior: &GaugePrior| (prior.id, prior.directions);
    should_be.iter().all(|prior| are.iter().any(|it| place(it) == place(prior)))
}

/// Why the priors of a component cannot be moved.
fn fallen_apart(are: &[&GaugePrior], should_be: &[&GaugePrior]) -> String {
    let ids: Vec<String> = should_be.iter().map(|prior| spell_id(prior.id)).collect();
    if are.is_empty() {
        return format!(
            "nothing in it tells where the part of pose {} lies, which the full graph's own \
             measurements do",
            ids.join(" and that of pose ")
        );
    }
    if should_be.len() < are.len() {
        return format!(
            "it is held in its place at pose {}, and the full graph at {} poses, which says more than one \
             place can; FIX or prior the same poses in both",
            ids.join(", "),
            are.len()
        );
    }
    format!(
        "it falls into {} parts whose place nothing tells (those of poses {}) where the full graph has \
         {}, and what was known between them is lost",
        should_be.len(),
        ids.join(", "),
        are.len()
    )
}

/// A prior on all of a pose, at `value`.
fn add_prior(
    graph: &Graph,
    change: &mut Change,
    variable: VariableId,
    value: &Value,
    like: &GaugePrior,
) -> Option<FactorId> {
    if like.directions != value.dim() {
        return None;
    }
    let noise = Noise::isotropic(value.dim(), like.sigma).ok()?;
    if let Some(pose) = value.get::<Pose2>() {
        let key = graph.key::<Pose2>(variable).ok()?;
        return Some(change.add_factor(Prior::new(key, pose, noise).ok()?));
    }
    let key = graph.key::<Pose3>(variable).ok()?;
    Some(change.add_factor(Prior::new(key, value.get::<Pose3>()?, noise).ok()?))
}
