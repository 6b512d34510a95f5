//! The batch step on another thread.
//!
//! From a snapshot of graph and estimate the thread orders, linearizes and solves to convergence,
//! while `apply` goes on. A fixed number of changes later the result takes the place of the live
//! factorization, after the changes since have been applied to it. When the thread is late, that
//! step waits: results do not depend on timing.

use std::fmt;
use std::hash::{Hash, Hasher};
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use evergraph_model::{Change, Graph, VariableIndex};

use crate::batch::{BatchReport, BatchSettings};
use crate::error::SmootherError;
use crate::factorization::{Engine, Factorization};

/// The result of the thread.
type Outcome = Result<(Factorization, BatchReport), SmootherError>;

/// What the batch step starts from.
#[derive(Debug)]
pub(crate) struct Snapshot {
    pub(crate) graph: Graph,
    /// The estimate.
    pub(crate) points: Vec<f64>,
    pub(crate) newest: Option<VariableIndex>,
    /// For one thread.
    pub(crate) engine: Engine,
}

/// A batch step under way.
#[derive(Clone)]
pub(crate) struct Background {
    result: Arc<(Mutex<Option<Outcome>>, Condvar)>,
    /// The changes applied since.
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
    /// Starts a batch step, to be taken over at step `due`.
    ///
    /// # Errors
    /// The system does not give us a thread.
    pub(crate) fn start(snapshot: Snapshot, due: u64) -> std::io::Result<Self> {
        let result = Arc::new((Mutex::new(None), Condvar::new()));
        let ours = Arc::clone(&result);
        std::thread::Builder::new().name("evergraph-batch".into()).spawn(move || {
            // The waiting step is told of a panic too.
            let outcome = std::panic::catch_unwind(AssertUnwindSafe(|| optimize(snapshot)));
            let outcome = outcome.unwrap_or(Err(SmootherError::Background));
            let (slot, arrived) = &*ours;
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
            arrived.notify_all();
        })?;
        Ok(Self { result, changes: Vec::new(), due })
    }

    /// Records a change that was applied in the meantime.
    pub(crate) fn record(&mut self, change: Change) {
        self.changes.push(change);
    }

    /// Whether the result is taken over at `step`.
    pub(crate) fn is_due(&self, step: u64) -> bool {
        step >= self.due
    }

    /// Waits for the result, and applies the recorded changes to it.
    pub(crate) fn finish(self, engine: &mut Engine) -> Outcome {
        let (mut factorization, report) = self.wait()?;
        for change in &self.changes {
            factorization.apply(change, engine)?;
        }
        Ok((factorization, report))
    }

    fn wait(&self) -> Outcome {
        let (slot, arrived) = &*self.result;
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            match &*slot {
                // A clone of the smoother may wait for the same result.
                Some(outcome) if Arc::strong_count(&self.result) > 1 => return outcome.clone(),
                Some(_) => return slot.take().expect("it was there a moment ago"),
                None => slot = arrived.wait(slot).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }

    /// Feeds the step that takes it over, and the number of recorded changes, to a hash. The result
    /// follows from the state at the start, and so does when it was started.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        let Self { result: _, changes, due } = self;
        (due, changes.len()).hash(hash);
    }
}

fn optimize(snapshot: Snapshot) -> Outcome {
    let Snapshot { graph, points, newest, mut engine } = snapshot;
    let mut factorization = Factorization::from_graph(graph, points, newest, &mut engine)?;
    let report = factorization.optimize(&BatchSettings::periodic(), &mut engine)?;
    Ok((factorization, report))
}
