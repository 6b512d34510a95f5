//! Many nodes: which goes when.

use std::collections::{BTreeMap, BTreeSet};

use evergraph_model::VariableId;

use crate::error::RemovalError;
use crate::neighborhood::blanket;
use crate::options::{Recovery, Topology};
use crate::order::{Order, shuffled};
use crate::overlay::Overlay;
use crate::plan::Work;
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
    let mut degrees: BTreeMap<VariableId, usize> =
        nodes.iter().map(|&node| (node, degree(work.overlay, node))).collect();
    let mut queue: BTreeSet<(usize, VariableId)> =
        degrees.iter().map(|(&node, &degree)| (degree, node)).collect();
    while let Some((_, node)) = queue.pop_first() {
        let draft = work.draft(&[node])?;
        let touched = draft.step.blanket.clone();
        work.take(draft)?;
        degrees.remove(&node);
        for neighbor in touched {
            if let Some(known) = degrees.get_mut(&neighbor) {
                queue.remove(&(*known, neighbor));
                *known = degree(work.overlay, neighbor);
                queue.insert((*known, neighbor));
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
    let mut drafts: BTreeMap<VariableId, Draft> = BTreeMap::new();
    for &node in nodes {
        drafts.insert(node, work.draft(&[node])?);
    }
    let price = |draft: &Draft| draft.step.price.unwrap_or(f64::INFINITY);
    while let Some(node) =
        drafts.iter().min_by(|a, b| price(a.1).total_cmp(&price(b.1))).map(|(&node, _)| node)
    {
        let Some(draft) = drafts.remove(&node) else { break };
        // A neighborhood has changed when it shares a variable with this one.
        let touched: BTreeSet<VariableId> =
            draft.step.blanket.iter().chain(&draft.step.removed).copied().collect();
        work.take(draft)?;
        let changed: Vec<VariableId> = drafts
            .iter()
            .filter(|(node, draft)| {
                touched.contains(node) || draft.step.blanket.iter().any(|v| touched.contains(v))
            })
            .map(|(&node, _)| node)
            .collect();
        for node in changed {
            drafts.insert(node, work.draft(&[node])?);
        }
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
