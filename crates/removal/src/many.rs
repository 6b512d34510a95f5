//! Many nodes: which goes when.

use std::collections::BTreeSet;

use evergraph_model::VariableId;

use crate::error::RemovalError;
use crate::neighborhood::blanket;
use crate::options::{Recovery, Topology};
use crate::order::{Order, shuffled};
use crate::overlay::Overlay;
use crate::plan::Work;
use crate::queue::{DegreeQueue, Loss, LossQueue};
use crate::step::Draft;

/// Takes all of `nodes` out, each once.
pub(crate) fn run(
    work: &mut Work<'_, '_>,
    nodes: &[VariableId],
    order: Order,
) -> Result<(), RemovalError> {
    let exact = work.options.topology == Topology::Dense
        && matches!(work.options.recovery, Recovery::Glc | Recovery::Nonlinear);
    if exact {
        for group in groups(work.overlay, nodes) {
            let draft = work.draft(&group)?;
            work.take(draft)?;
        }
        return Ok(());
    }
    match order {
        Order::Given => one_by_one(work, nodes),
        Order::Random(seed) => one_by_one(work, &shuffled(nodes, seed)),
        Order::MinDegree => by_degree(work, nodes),
        Order::MinLoss => by_loss(work, nodes),
    }
}

fn one_by_one(work: &mut Work<'_, '_>, nodes: &[VariableId]) -> Result<(), RemovalError> {
    for &node in nodes {
        let draft = work.draft(&[node])?;
        work.take(draft)?;
    }
    Ok(())
}

/// Smallest blanket first. A step changes the blankets of its own blanket only.
fn by_degree(work: &mut Work<'_, '_>, nodes: &[VariableId]) -> Result<(), RemovalError> {
    let degree = |overlay: &Overlay<'_>, node| blanket(overlay, &[node]).len();
    let mut queue = DegreeQueue::default();
    nodes.iter().for_each(|&node| queue.insert(node, degree(work.overlay, node)));
    while let Some(node) = queue.pop() {
        let draft = work.draft(&[node])?;
        let touched = draft.step.blanket.clone();
        work.take(draft)?;
        for neighbor in touched {
            if queue.contains(neighbor) {
                queue.insert(neighbor, degree(work.overlay, neighbor));
            }
        }
    }
    Ok(())
}

/// Lowest price first.
fn by_loss(work: &mut Work<'_, '_>, nodes: &[VariableId]) -> Result<(), RemovalError> {
    if !work.is_priced() {
        return Err(RemovalError::NeedsCovariance);
    }
    let mut queue = LossQueue::default();
    for &node in nodes {
        let loss = Loss::of(&work.draft(&[node])?.step);
        queue.insert(node, loss);
    }
    // The node that goes was often drafted last.
    let mut last: Option<Draft> = None;
    let price = |work: &mut Work<'_, '_>, last: &mut Option<Draft>, node| {
        let draft = last.insert(work.draft(&[node])?);
        Ok::<_, RemovalError>(Loss::of(&draft.step))
    };
    while let Some((node, _)) = queue.pop(|node| price(work, &mut last, node))? {
        let draft = match last.take() {
            Some(draft) if draft.step.removed == [node] => draft,
            _ => work.draft(&[node])?,
        };
        let touched = draft.step.blanket.clone();
        work.take(draft)?;
        queue.removed(&touched, |node| price(work, &mut last, node))?;
    }
    Ok(())
}

/// Nodes that share factors with each other, connected groups of them; in the order in which the
/// first of each was given.
fn groups(overlay: &Overlay<'_>, nodes: &[VariableId]) -> Vec<Vec<VariableId>> {
    let all: BTreeSet<VariableId> = nodes.iter().copied().collect();
    let mut seen = BTreeSet::new();
    let mut groups = Vec::new();
    for &start in nodes {
        if !seen.insert(start) {
            continue;
        }
        let mut group = vec![start];
        let mut next = 0;
        while let Some(&node) = group.get(next) {
            next += 1;
            for (_, factor) in overlay.factors_of(node) {
                for &key in factor.keys() {
                    if all.contains(&key) && seen.insert(key) {
                        group.push(key);
                    }
                }
            }
        }
        groups.push(group);
    }
    groups
}
