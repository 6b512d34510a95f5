//! The batch step on another thread.
//!
//! From a snapshot of graph and estimate the thread orders, linearizes and solves to convergence,
//! while `apply` goes on. A fixed number of changes later the result takes the place of the live
//! factorization, after the changes since have been applied to it. When the thread is late, that
//! step waits: what comes out does not depend on timing.

use std::fmt;
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use evergraph_model::Change;

use crate::batch::{BatchReport, BatchSettings};
use crate::error::SmootherError;
use crate::report::Report;
use crate::settings::{Relinearization, Settings};
use crate::smoother::Smoother;

/// What the thread found.
type Outcome = Result<(Smoother, BatchReport), SmootherError>;

/// A batch step under way.
#[derive(Clone)]
pub(crate) struct Background {
    result: Arc<(Mutex<Option<Outcome>>, Condvar)>,
    /// What has been applied since.
    changes: Vec<Change>,
    /// The step that takes it over.
    due: u64,
}

impl fmt::Debug for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Background")
            .field("changes", &self.changes.len())
            .field("due", &self.due)
            .finish_non_exhaustive()
    }
}

impl Background {
    /// Starts a batch step from the smoother's estimate, to be taken over at step `due`.
    ///
    /// # Errors
    /// The system does not give us a thread.
    fn start(smoother: &Smoother, due: u64) -> std::io::Result<Self> {
        let settings =
            Settings { relinearization: Relinearization::NEVER, threads: 1, ..smoother.settings };
        let (graph, points) = (smoother.graph.clone(), smoother.estimate_points());
        let (newest, instructions) = (smoother.newest, smoother.scratch.instructions);
        let result = Arc::new((Mutex::new(None), Condvar::new()));
        let ours = Arc::clone(&result);
        std::thread::Builder::new().name("evergraph-batch".into()).spawn(move || {
            // Whoever waits is told of a panic too.
            let outcome = std::panic::catch_unwind(AssertUnwindSafe(|| {
                let mut smoother =
                    Smoother::from_graph(settings, graph, points, newest, instructions)?;
                let report = smoother.optimize(&BatchSettings::periodic())?;
                Ok((smoother, report))
            }));
            let outcome = outcome.unwrap_or(Err(SmootherError::Background));
            let (slot, arrived) = &*ours;
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
            arrived.notify_all();
        })?;
        Ok(Self { result, changes: Vec::new(), due })
    }

    /// Waits for the result.
    fn finish(self) -> (Outcome, Vec<Change>) {
        let (slot, arrived) = &*self.result;
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        while slot.is_none() {
            slot = arrived.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
        // A clone of the smoother waits for the same result.
        let shared = Arc::strong_count(&self.result) > 1;
        let outcome = if shared { slot.clone() } else { slot.take() };
        (outcome.expect("it has arrived"), self.changes)
    }
}

impl Smoother {
    /// Notes a change that was applied, for a batch step that is under way, and takes its result
    /// over when that is due; or starts one. Whether it has done any of that.
    pub(crate) fn batch_in_background(&mut self, change: Change, report: &mut Report) -> bool {
        let policy = self.settings.relinearization;
        let (Some(every), Some(after)) = (policy.batch, policy.background) else { return false };
        if let Some(background) = &mut self.background {
            background.changes.push(change);
            if self.steps < background.due {
                return false;
            }
            if let Some(background) = self.background.take() {
                self.take_over(background, report);
            }
            return true;
        }
        let starts = self.steps.is_multiple_of(u64::from(every.get()));
        if starts && self.graph.variable_count() > 0 {
            // Without a thread there is no batch step; the next one may have more luck.
            self.background = Background::start(self, self.steps + u64::from(after.get())).ok();
        }
        starts
    }

    /// Takes over what a batch step found, with the changes since.
    fn take_over(&mut self, background: Background, report: &mut Report) {
        let (outcome, changes) = background.finish();
        let caught_up = outcome.and_then(|(mut fresh, batch)| {
            for change in changes {
                fresh.apply(change)?;
            }
            Ok((fresh, batch))
        });
        match caught_up {
            Ok((fresh, batch)) => {
                self.ahead.clear(&mut self.blocks, &mut self.scratch.workspace.pool);
                let Smoother { graph, points, blocks, tree, solution, newest, at_optimum, .. } =
                    fresh;
                (self.graph, self.points, self.blocks, self.tree) = (graph, points, blocks, tree);
                (self.solution, self.newest, self.at_optimum) = (solution, newest, at_optimum);
                self.scratch.due.clear();
                report.variables_relinearized += self.graph.variable_count();
                report.batch = Some(batch);
            }
            Err(error) => report.relinearization_refused = Some(error),
        }
    }
}
