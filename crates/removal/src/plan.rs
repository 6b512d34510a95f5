//! Plans: a change, and what it costs.

use std::sync::Arc;

use evergraph_model::belief::Estimates;
use evergraph_model::{Change, Factor, FactorId, GraphError, VariableId};

use crate::error::RemovalError;
use crate::member::Member;
use crate::overlay::{Overlay, Source};
use crate::step::Step;
use crate::work::Done;

/// A removal that has been planned by reading only; applying [`change`](Self::change) does it.
///
/// The change drops the nodes and the factors that are absorbed, and adds the new ones. It moves no linearization point:
/// points have to be moved together with all others that moved, which is the smoother's task.
///
/// The change requires the versions of all variables that were read. It is refused as stale when one of them, or a factor
/// on one of them, has changed since. Estimates that move and points that the smoother relinearizes do not make it stale;
/// [`drift`](Self::drift) measures them.
#[derive(Clone, Debug)]
#[must_use = "a plan alters nothing until its change is applied"]
pub struct Plan {
    change: Change,
    steps: Vec<Step>,
    /// The kept members of the blankets as they were read, by slot.
    seen: Vec<Member>,
    dropped: Vec<(FactorId, Arc<dyn Factor>)>,
    planned: Vec<PlannedFactor>,
}

/// A factor that a step of a plan makes.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PlannedFactor {
    /// The factor.
    pub factor: Arc<dyn Factor>,
    /// Its id in the plan's change; `None` when a later step of the plan absorbs it.
    pub id: Option<FactorId>,
}

impl Plan {
    /// The change to apply.
    pub fn change(&self) -> &Change {
        &self.change
    }

    /// The change to apply, owned.
    #[must_use = "the change does nothing until it is applied"]
    pub fn into_change(self) -> Change {
        self.change
    }

    /// The steps, in the order in which they are done.
    #[must_use]
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// All variables that are removed.
    pub fn removed(&self) -> impl Iterator<Item = VariableId> {
        self.steps.iter().flat_map(|step| step.removed.iter().copied())
    }

    /// Kullback-Leibler divergence in nats of the map after from the map before, over everything
    /// kept: the sum over the steps, `None` unless all were priced.
    ///
    /// Exact for a single step. Of several, each step's is that of the map which the steps before it
    /// near by have left; divergences do not add up exactly.
    #[must_use]
    pub fn price(&self) -> Option<f64> {
        self.steps.iter().map(|step| step.price).sum()
    }

    /// What the removal changes the error by: the error of the full graph, the removed nodes at
    /// their best, is at the estimate of the others that of the reduced graph plus this.
    #[must_use]
    pub fn constant(&self) -> f64 {
        self.steps.iter().map(|step| step.constant).sum()
    }

    /// Degrees of freedom that go with the constant: rows less dimensions, before less after.
    #[must_use]
    pub fn degrees_of_freedom(&self) -> i64 {
        self.steps.iter().map(|step| step.degrees_of_freedom).sum()
    }

    /// The factors of the graph that the change drops, by slot: those absorbed and those rejected.
    #[must_use]
    pub fn dropped(&self) -> &[(FactorId, Arc<dyn Factor>)] {
        &self.dropped
    }

    /// All factors that the steps make, also those that a later step absorbs. Places are the numbers in
    /// [`Source::Planned`].
    #[must_use]
    pub fn planned(&self) -> &[PlannedFactor] {
        &self.planned
    }

    /// The factor behind an entry of [`Step::absorbed`] or [`Step::rejected`]; `None` for a source of another plan.
    #[must_use]
    pub fn factor(&self, source: Source) -> Option<&Arc<dyn Factor>> {
        match source {
            Source::Graph(id) => {
                self.dropped.iter().find(|(dropped, _)| *dropped == id).map(|(_, factor)| factor)
            }
            Source::Planned(number) => self.planned.get(number).map(|planned| &planned.factor),
        }
    }

    /// The largest distance between the estimate of a variable of the blankets now and when the plan was made: the
    /// largest component of the tangent, in metres or radians. Versions do not show it, because estimates move with
    /// measurements far away too.
    ///
    /// # Errors
    /// [`GraphError`] when a variable has no estimate any more.
    pub fn drift(&self, estimates: &dyn Estimates) -> Result<f64, GraphError> {
        let variables: Vec<VariableId> = self.seen.iter().map(|member| member.id).collect();
        let now = estimates.estimates_of(&variables)?;
        let mut largest = 0.0_f64;
        for (member, now) in self.seen.iter().zip(now) {
            let (kind, dim) = (member.value.kind(), member.value.dim());
            if kind != now.kind() || dim != now.dim() {
                return Ok(f64::INFINITY);
            }
            let mut local = vec![0.0; dim];
            kind.local(&member.estimate(), now.storage(), &mut local);
            // `max` would ignore a NaN.
            let step = local.iter().map(|x| if x.is_nan() { f64::INFINITY } else { x.abs() });
            largest = step.fold(largest, f64::max);
        }
        Ok(largest)
    }

    /// One change for all that the steps have left in the overlay.
    pub(crate) fn new(overlay: Overlay<'_>, done: Done) -> Result<Self, RemovalError> {
        let Done { steps, mut seen } = done;
        let graph = overlay.graph;
        let mut change = graph.change();
        let mut removed: Vec<VariableId> =
            steps.iter().flat_map(|step| &step.removed).copied().collect();
        removed.sort_unstable_by_key(|&id| overlay.slot(id));
        removed.iter().for_each(|id| drop(seen.remove(id)));
        let mut seen: Vec<Member> = seen.into_values().collect();
        seen.sort_unstable_by_key(|member| overlay.slot(member.id));
        for variable in removed.iter().copied().chain(seen.iter().map(|member| member.id)) {
            change.require(variable, graph.version(variable)?);
        }
        let mut dropped = Vec::new();
        for id in overlay.dropped() {
            dropped.push((id, Arc::clone(graph.factor(id)?)));
            change.drop_factor(id);
        }
        for &variable in &removed {
            change.drop_variable(variable);
        }
        let mut planned = Vec::new();
        for added in overlay.into_added() {
            let id =
                (!added.is_absorbed).then(|| change.add_shared_factor(Arc::clone(&added.factor)));
            planned.push(PlannedFactor { factor: added.factor, id });
        }
        Ok(Self { change, steps, seen, dropped, planned })
    }
}
