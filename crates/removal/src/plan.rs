//! Plans: a change, and what it costs.

use std::collections::BTreeMap;

use evergraph_model::{Change, FactorId, Graph, GraphError, VariableId};

use crate::error::RemovalError;
use crate::many;
use crate::neighborhood::{Member, check_last_pose};
use crate::options::{Options, Rank, Recovery, Topology};
use crate::order::Order;
use crate::overlay::{Estimates, Overlay};
use crate::price::{Covariance, Ledger};
use crate::step::{Draft, Step};

/// A removal that has been planned by reading only; [`change`](Self::change) does it.
///
/// The change drops the nodes and the factors that are absorbed, and adds the new ones; it moves no
/// linearization point, since that is for the smoother to do, for all that moved together. It requires the
/// versions of all variables that were read, so that it is refused as stale when one of them, or a
/// factor on one of them, has changed since. Estimates that move and points that the smoother
/// relinearizes do not make it stale; [`drift`](Self::drift) tells of them.
#[derive(Clone, Debug)]
pub struct Plan {
    change: Change,
    steps: Vec<Step>,
    /// The blankets as they were seen.
    seen: BTreeMap<VariableId, Member>,
}

impl Plan {
    /// The change to apply.
    pub fn change(&self) -> &Change {
        &self.change
    }

    /// The change to apply, owned.
    pub fn into_change(self) -> Change {
        self.change
    }

    /// What is done, in order.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// All variables that go.
    pub fn removed(&self) -> impl Iterator<Item = VariableId> {
        self.steps.iter().flat_map(|step| step.removed.iter().copied())
    }

    /// Kullback-Leibler divergence in nats of the map after from the map before, over everything
    /// kept: the sum over the steps, `None` unless all were priced.
    ///
    /// Exact for a single step. Of several, each step's is that of the map which the steps before it
    /// near by have left; divergences do not add up exactly.
    pub fn price(&self) -> Option<f64> {
        self.steps.iter().map(|step| step.price).sum()
    }

    /// What the removal changes the error by: the error of the full graph, the removed nodes at
    /// their best, is at the estimate of the others that of the reduced graph plus this.
    pub fn constant(&self) -> f64 {
        self.steps.iter().map(|step| step.constant).sum()
    }

    /// Degrees of freedom that go with the constant: rows less dimensions, before less after.
    pub fn degrees_of_freedom(&self) -> i64 {
        self.steps.iter().map(|step| step.degrees_of_freedom).sum()
    }

    /// How far the estimate of a variable of the blankets has moved since the plan was made: the
    /// largest component of the tangent, in metres or radians. A version does not tell, because
    /// estimates move with measurements far away too.
    ///
    /// # Errors
    /// [`GraphError`] when a variable has no estimate any more.
    pub fn drift(&self, estimates: &dyn Estimates) -> Result<f64, GraphError> {
        let now = estimates.estimates_of(&self.seen.keys().copied().collect::<Vec<_>>())?;
        let mut largest = 0.0_f64;
        for (member, now) in self.seen.values().zip(now) {
            let mut local = vec![0.0; member.value.dim()];
            member.value.kind().local(&member.estimate(), now.storage(), &mut local);
            // `max` would take a NaN for nothing.
            let step = local.iter().map(|x| if x.is_nan() { f64::INFINITY } else { x.abs() });
            largest = step.fold(largest, f64::max);
        }
        Ok(largest)
    }

    /// One change for all that the steps have left in the overlay.
    fn new(work: Work<'_, '_>) -> Result<Self, RemovalError> {
        let Work { overlay, steps, mut seen, .. } = work;
        let graph = overlay.graph;
        let mut change = graph.change();
        let mut removed: Vec<VariableId> =
            steps.iter().flat_map(|step| &step.removed).copied().collect();
        removed.sort_unstable();
        seen.retain(|id, _| removed.binary_search(id).is_err());
        for &variable in removed.iter().chain(seen.keys()) {
            change.require(variable, graph.version(variable)?);
        }
        for factor in overlay.dropped() {
            change.drop_factor(factor);
        }
        for &variable in &removed {
            change.drop_variable(variable);
        }
        for factor in overlay.surviving() {
            change.add_shared_factor(std::sync::Arc::clone(factor));
        }
        Ok(Self { change, steps, seen })
    }
}

/// Plans removals from a graph at an estimate.
///
/// ```
/// # use evergraph_factors::{BetweenPose2, Prior};
/// # use evergraph_model::{Noise, Pose2};
/// # use evergraph_removal::Removal;
/// # use evergraph_solver::{Settings, Smoother};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let mut smoother = Smoother::new(Settings::default())?;
/// # let noise = Noise::from_sigmas(&[0.1, 0.1, 0.02])?;
/// # let mut change = smoother.change();
/// # let mut last = change.add_variable(&Pose2::new(0.0, 0.0, 0.0));
/// # change.add_factor(Prior::new(last, Pose2::new(0.0, 0.0, 0.0), noise.clone())?);
/// # let mut middle = last;
/// # for k in 1..4 {
/// #     let next = change.add_variable(&Pose2::new(f64::from(k), 0.0, 0.0));
/// #     let z = Pose2::new(1.0, 0.0, 0.1);
/// #     change.add_factor(BetweenPose2::new(last, next, z, noise.clone())?);
/// #     if k == 2 { middle = next; }
/// #     last = next;
/// # }
/// # smoother.apply(change)?;
/// let plan = Removal::new(smoother.graph(), &smoother)
///     .priced_by(&mut smoother.covariances())
///     .plan(middle)?;
/// assert_eq!(plan.steps()[0].blanket.len(), 2);
/// assert!(plan.price().is_some_and(|nats| nats < 1e-6));
/// smoother.apply(plan.into_change())?;
/// assert_eq!(smoother.graph().variable_count(), 3);
/// # Ok(())
/// # }
/// ```
pub struct Removal<'a> {
    graph: &'a Graph,
    estimates: &'a dyn Estimates,
    options: Options,
    covariance: Option<&'a mut dyn Covariance>,
    spared: &'a [FactorId],
}

impl std::fmt::Debug for Removal<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let priced = self.covariance.is_some();
        f.debug_struct("Removal").field("options", &self.options).field("priced", &priced).finish()
    }
}

impl<'a> Removal<'a> {
    /// With default [`Options`] and without prices. `estimates` are those of a fully
    /// back-substituted solution.
    pub fn new(graph: &'a Graph, estimates: &'a dyn Estimates) -> Self {
        Self { graph, estimates, options: Options::default(), covariance: None, spared: &[] }
    }

    /// Sets the options.
    #[must_use]
    pub fn with_options(mut self, options: Options) -> Self {
        self.options = options;
        self
    }

    /// Leaves some factors alone as long as all of their variables stay, such as the prior that holds
    /// the gauge: absorbed, it would make what is relative around it absolute, and no longer be told
    /// from what was measured. What is known stays the same either way.
    #[must_use]
    pub fn sparing(mut self, factors: &'a [FactorId]) -> Self {
        self.spared = factors;
        self
    }

    /// Prices every step by joint covariances of the graph as it is.
    #[must_use]
    pub fn priced_by(mut self, covariance: &'a mut dyn Covariance) -> Self {
        self.covariance = Some(covariance);
        self
    }

    /// Plans the removal of one node. O(n³) in the dimension of its neighborhood.
    ///
    /// # Errors
    /// [`RemovalError`].
    pub fn plan(&mut self, node: impl Into<VariableId>) -> Result<Plan, RemovalError> {
        self.plan_many(&[node.into()], Order::Given)
    }

    /// Plans the removal of many nodes as one change.
    ///
    /// Trees go node by node in the given order: the neighborhood of a later node is that which the
    /// steps before it leave. Dense removals take connected groups of nodes at once, one factor for
    /// each group, because the result does not depend on the order and what is never added need not
    /// be absorbed again: one by one, removing most of a graph makes blankets of hundreds of poses
    /// on the way.
    ///
    /// # Errors
    /// [`RemovalError`]; the plan stands or falls as a whole.
    pub fn plan_many(&mut self, nodes: &[VariableId], order: Order) -> Result<Plan, RemovalError> {
        check(&self.options)?;
        let mut overlay = Overlay::new(self.graph, self.estimates, self.spared);
        let mut sorted = nodes.to_vec();
        sorted.sort_unstable();
        for &node in nodes {
            overlay.check(node)?;
        }
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(RemovalError::Twice { variable: pair[0] });
        }
        if nodes.is_empty() {
            return Err(RemovalError::Nothing);
        }
        let covariance = self.covariance.as_mut().map(|c| &mut **c as &mut dyn Covariance);
        let mut work = Work {
            overlay: &mut overlay,
            options: &self.options,
            covariance,
            ledger: Ledger::default(),
            steps: Vec::new(),
            seen: BTreeMap::new(),
        };
        many::run(&mut work, nodes, order)?;
        Plan::new(work)
    }
}

/// A plan in the making.
pub(crate) struct Work<'w, 'a> {
    pub(crate) overlay: &'w mut Overlay<'a>,
    pub(crate) options: &'w Options,
    covariance: Option<&'w mut dyn Covariance>,
    ledger: Ledger,
    steps: Vec<Step>,
    seen: BTreeMap<VariableId, Member>,
}

impl Work<'_, '_> {
    /// Plans a step on what the steps before it have left, and prices it if that can be done.
    pub(crate) fn draft(&mut self, removed: &[VariableId]) -> Result<Draft, RemovalError> {
        let mut draft = Draft::of(self.overlay, removed, self.options)?;
        if draft.step.blanket.is_empty() {
            // Nothing that is kept depends on it.
            draft.step.price = self.covariance.as_ref().map(|_| 0.0);
        } else if let Some(covariance) = self.covariance.as_deref_mut() {
            let blanket = &draft.step.blanket;
            let dims: Vec<usize> =
                blanket.iter().map(|id| self.overlay.graph.dim_at(id.index())).collect();
            let sigma = self.ledger.covariance(covariance, blanket, &dims)?;
            let price =
                crate::price::divergence(&sigma, &draft.before, &draft.after, &draft.gradient);
            draft.step.price = Some(price.ok_or_else(|| RemovalError::Covariance {
                variables: blanket.clone(),
                reason: "it is not positive definite, or too large".into(),
            })?);
        }
        Ok(draft)
    }

    /// Makes a step part of the plan.
    pub(crate) fn take(&mut self, draft: Draft) -> Result<(), RemovalError> {
        // It may have been drafted when there were others.
        check_last_pose(self.overlay, &draft.step.removed)?;
        let Draft { mut step, factors, before, after, seen, .. } = draft;
        self.seen.extend(seen.into_iter().map(|member| (member.id, member)));
        let dropped = step.absorbed.iter().chain(&step.rejected).copied();
        step.first_new = self.overlay.apply(&step.removed, dropped, &factors);
        if self.covariance.is_some() {
            let dims =
                step.blanket.iter().map(|id| self.overlay.graph.dim_at(id.index())).collect();
            self.ledger.note(step.blanket.clone(), dims, before, after);
        }
        self.steps.push(step);
        Ok(())
    }

    pub(crate) fn is_priced(&self) -> bool {
        self.covariance.is_some()
    }
}

fn check(options: &Options) -> Result<(), RemovalError> {
    let refuse = |option, value, expected| Err(RemovalError::Option { option, value, expected });
    if !(0.0..=1.0).contains(&options.least_weight) {
        return refuse("least_weight", options.least_weight, "from 0 to 1");
    }
    if (options.topology, options.recovery) == (Topology::Dense, Recovery::Composition) {
        return Err(RemovalError::DenseComposition);
    }
    if options.linear_within.is_nan() || options.linear_within < 0.0 {
        return refuse("linear_within", options.linear_within, "not negative");
    }
    let guard = &options.guard;
    for (option, value) in
        [("guard.rotation", guard.rotation), ("guard.mahalanobis", guard.mahalanobis)]
    {
        if value.is_nan() || value <= 0.0 {
            return refuse(option, value, "positive; infinity switches it off");
        }
    }
    match options.rank {
        Rank::Absolute(tolerance) if !(tolerance >= 0.0 && tolerance.is_finite()) => {
            refuse("rank", tolerance, "finite and not negative")
        }
        _ => Ok(()),
    }
}
