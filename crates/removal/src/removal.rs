//! The planner of removals.

use evergraph_model::belief::{Covariance, Estimates};
use evergraph_model::{FactorId, Graph, VariableId};

use crate::error::RemovalError;
use crate::options::Options;
use crate::order::Order;
use crate::overlay::Overlay;
use crate::plan::Plan;
use crate::work::remove_all;

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
#[must_use = "a planner does nothing until it plans"]
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
    /// With default options and without prices.
    pub fn new(graph: &'a Graph, estimates: &'a dyn Estimates) -> Self {
        Self { graph, estimates, options: Options::default(), covariance: None, spared: &[] }
    }

    /// Sets the options.
    pub fn with_options(mut self, options: Options) -> Self {
        self.options = options;
        self
    }

    /// Factors that are not absorbed while all of their variables stay, such as the prior that fixes the gauge. Absorbed,
    /// that prior would make the relative information around it absolute. No information is lost either way.
    pub fn sparing(mut self, factors: &'a [FactorId]) -> Self {
        self.spared = factors;
        self
    }

    /// Prices every step by joint covariances of the graph as it is.
    ///
    /// A smoother's covariances are taken at its linearization points. Prices are exact for removals in the linear model
    /// around these ([`Options::linear_within`](crate::Options::linear_within)), as right after a batch step; else they
    /// are off by the motion of variables relative to each other since. A motion that all poses have in common changes no
    /// price, because their tangents move along; covariances are therefore not transported by the derivative of `Local`.
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
    /// each group, because the result does not depend on the order and a factor that is never added need not
    /// be absorbed again: one by one, removing most of a graph makes blankets of hundreds of poses
    /// on the way.
    ///
    /// # Errors
    /// [`RemovalError`]; the plan stands or falls as a whole.
    pub fn plan_many(
        &mut self,
        nodes: &[impl Into<VariableId> + Copy],
        order: Order,
    ) -> Result<Plan, RemovalError> {
        self.options.check()?;
        let nodes: Vec<VariableId> = nodes.iter().map(|&node| node.into()).collect();
        let mut overlay = Overlay::new(self.graph, self.estimates, self.spared);
        for &node in &nodes {
            overlay.check(node)?;
        }
        let mut sorted = nodes.clone();
        sorted.sort_unstable_by_key(|&node| overlay.slot(node));
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(RemovalError::Twice { variable: pair[0] });
        }
        if nodes.is_empty() {
            return Err(RemovalError::Nothing);
        }
        let covariance = self.covariance.as_mut().map(|c| &mut **c as &mut dyn Covariance);
        let done = remove_all(&mut overlay, &nodes, order, &self.options, covariance)?;
        Plan::new(overlay, done)
    }
}
