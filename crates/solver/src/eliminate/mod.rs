//! Elimination of a set of cliques, bottom-up: batch and incremental are this code on a larger or
//! smaller part of the tree.
//!
//! A [`Job`] lists the cliques to eliminate in postorder, each with the children that hand it
//! their contributions: other cliques of the job, or kept ones of the tree. Nothing is altered;
//! the caller installs the results, or drops them if anything fails.

mod assembly;
mod front;
mod job;
mod parallel;
mod range;
mod rows;
mod slice;
mod system;
mod workspace;

pub(crate) use job::{Child, Eliminated, Failure, Job, Node, NodeStructure};
pub(crate) use slice::eliminate_pending;
pub(crate) use system::System;
pub(crate) use workspace::Workspace;

use range::Range;

/// Eliminates all nodes of a job, on several threads where that pays. The arithmetic of a node
/// depends on the node alone, so the bits do not depend on the threads. `buffer` are old results.
pub(crate) fn eliminate(
    system: &System<'_>,
    job: &Job,
    buffer: Eliminated,
    workspace: &mut Workspace,
    threads: Option<&rayon::ThreadPool>,
) -> Result<Eliminated, Failure> {
    let mut results = buffer;
    results.start(job, &mut workspace.pool);
    // What fails first is only certain in sequence, so a failure is found again below.
    if threads
        .is_some_and(|pool| parallel::eliminate_subtrees(system, job, pool, &mut results).is_err())
    {
        results.start(job, &mut workspace.pool);
    }
    let Eliminated { nodes, kept } = &mut results;
    let range = Range { system, job, offset: 0, nodes, kept };
    match range.eliminate(workspace) {
        Ok(()) => Ok(results),
        Err(failure) => {
            results.recycle(&mut workspace.pool);
            Err(failure)
        }
    }
}
