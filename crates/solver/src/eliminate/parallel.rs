//! Elimination of independent subtrees on several threads.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::job::{Eliminated, Failure, Job};
use super::range::Range;
use super::system::System;
use super::workspace::Workspace;
use crate::tree::Numeric;

/// Jobs with less arithmetic than this (multiply-adds) stay on one thread: waking the others, and the
/// fresh memory that they write to, would take longer. A batch on manhattanOlson3500 (5e6) takes 5 to
/// 15 % longer on two threads than on one, one on city10000 (7e7) 4 % less.
const WORTH_SHARING: f64 = 2e7;
/// The tree is cut into subtrees of at most this share of the whole work.
const SHARE: f64 = 1.0 / 16.0;

/// Eliminates disjoint subtrees in parallel; what is above them, or all if sharing does not pay, is
/// left to the caller.
pub(super) fn eliminate_subtrees(
    system: &System<'_>,
    job: &Job,
    pool: &rayon::ThreadPool,
    results: &mut Eliminated,
) -> Result<(), Failure> {
    let mut tasks: Vec<(usize, &mut [Option<Numeric>])> = Vec::new();
    let mut rest: &mut [Option<Numeric>] = &mut results.nodes;
    let mut at = 0;
    for (start, end) in cut(system, job) {
        let (_, tail) = rest.split_at_mut(start - at);
        let (task, tail) = tail.split_at_mut(end - start);
        tasks.push((start, task));
        (rest, at) = (tail, end);
    }
    if tasks.len() < 2 {
        return Ok(());
    }
    let outcomes: Vec<Result<_, Failure>> = pool.install(|| {
        tasks
            .into_par_iter()
            .map_init(Workspace::default, |workspace, (offset, nodes)| {
                let mut kept = BTreeMap::new();
                Range { system, job, offset, nodes, kept: &mut kept }.eliminate(workspace)?;
                Ok(kept)
            })
            .collect()
    });
    for outcome in outcomes {
        results.kept.extend(outcome?);
    }
    Ok(())
}

/// Ranges of nodes that are whole subtrees, disjoint and in order; none if sharing does not pay.
fn cut(system: &System<'_>, job: &Job) -> Vec<(usize, usize)> {
    let mut first: Vec<usize> = (0..job.nodes.len()).collect();
    let mut work: Vec<f64> = Vec::with_capacity(job.nodes.len());
    for node in &job.nodes {
        let structure = system.structure(node);
        let (f, n) = (f64::from(structure.frontal_dim), structure.layout().columns() as f64);
        work.push(f * n * n / 2.0);
    }
    for (i, node) in job.nodes.iter().enumerate() {
        if let Some(parent) = node.parent {
            first[parent.index()] = first[parent.index()].min(first[i]);
            work[parent.index()] += work[i];
        }
    }
    let total: f64 =
        job.nodes.iter().zip(&work).filter(|(node, _)| node.parent.is_none()).map(|(_, w)| w).sum();
    if total < WORTH_SHARING {
        return Vec::new();
    }
    let small = |i: usize| work[i] <= total * SHARE;
    (0..job.nodes.len())
        .filter(|&i| small(i) && job.nodes[i].parent.is_none_or(|p| !small(p.index())))
        .map(|i| (first[i], i + 1))
        .collect()
}
