//! The driver of removals on a live smoother.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use evergraph_model::{Graph, GraphError, VariableId};
use evergraph_removal::{Loss, Removal, RemovalError, Remover, remove_in_order};
#[cfg(doc)]
use evergraph_removal::{Options, Order};
use evergraph_solver::{Covariances, Smoother, SmootherError};

use crate::error::{ThinningError, ThinningFailure};
use crate::needed::{Needed, is_needed};
use crate::rules::Rules;
use crate::thinning::{Thinned, Thinning, check};

impl Thinning {
    /// Removes `nodes` one by one, [`Rules::limit`] of them: each is planned, then applied, as a robot
    /// does it between updates. Dynamic orders look at the graph as the removals before left it
    /// ([`remove_in_order`]). A node without which something would be undetermined stays and is listed.
    /// `done` is called after each node.
    ///
    /// The work of a call is that of its removals: the smoother is not copied. To keep the state from
    /// before, clone it.
    ///
    /// Prices are exact where the neighborhood is in the linear model ([`Options::linear_within`]), as
    /// after [`Smoother::optimize`]. With [`Rules::prices`] each node costs one more plan, with its joint
    /// covariance. With [`Order::MinLoss`] each node does at the start and before it goes, and the nodes
    /// next to a removed one do again.
    ///
    /// # Errors
    /// [`ThinningError`] at the first removal that fails. The removals before it stay done and are in the
    /// error; the failed one has changed nothing. A list that is empty, names a node twice or names one
    /// that is not in the graph is refused before anything is removed.
    pub fn run(
        smoother: &mut Smoother,
        nodes: &[VariableId],
        rules: &Rules<'_>,
        done: impl FnMut(),
    ) -> Result<Self, ThinningError> {
        let alone = nodes.iter().copied().filter(|&node| is_alone(smoother.graph(), node));
        let alone = alone.collect();
        let mut live = Live { smoother, rules, thinning: Self::default(), alone, done };
        let outcome = check(live.smoother.graph(), nodes)
            .map_err(ThinningFailure::from)
            .and_then(|()| remove_in_order(&mut live, nodes, rules.order, rules.limit));
        match outcome {
            Ok(()) => Ok(live.thinning),
            Err(failure) => Err(ThinningError { failure, done: Box::new(live.thinning) }),
        }
    }
}

/// A smoother from which nodes are removed, and the outcome so far.
struct Live<'a, D> {
    smoother: &'a mut Smoother,
    rules: &'a Rules<'a>,
    thinning: Thinning,
    /// Nodes that shared no factor with others from the beginning. Any other node that does not is the
    /// last of its component, which keeps one.
    alone: BTreeSet<VariableId>,
    done: D,
}

impl<D: FnMut()> Remover for Live<'_, D> {
    type Error = ThinningFailure;

    fn slot(&self, node: VariableId) -> Result<usize, ThinningFailure> {
        Ok(self.smoother.graph().variable_index(node).map_err(RemovalError::from)?.index())
    }

    fn degree(&self, node: VariableId) -> Result<usize, ThinningFailure> {
        Ok(degree(self.smoother.graph(), node).map_err(RemovalError::from)?)
    }

    fn prices(&mut self) -> impl FnMut(VariableId) -> Result<Loss, ThinningFailure> {
        let (smoother, rules) = (&*self.smoother, self.rules);
        let mut covariances = smoother.covariances();
        move |node| Ok(loss(smoother, &mut covariances, node, rules)?)
    }

    fn remove(
        &mut self,
        node: VariableId,
        loss: Option<Loss>,
    ) -> Result<Option<Vec<VariableId>>, ThinningFailure> {
        let touched = self.take(node, loss)?;
        (self.done)();
        Ok(touched)
    }
}

impl<D> Live<'_, D> {
    /// Removes a node, whose price may be known, or notes why it stays. Says whose neighborhood has
    /// changed; `None` when nothing has.
    fn take(
        &mut self,
        node: VariableId,
        loss: Option<Loss>,
    ) -> Result<Option<Vec<VariableId>>, ThinningFailure> {
        let loss = match loss {
            None if self.rules.prices => {
                let mut covariances = self.smoother.covariances();
                Some(self::loss(self.smoother, &mut covariances, node, self.rules)?)
            }
            known => known,
        };
        let price = loss.map(|loss| loss.price).filter(|price| price.is_finite());
        let begun = Instant::now();
        let planned = removal(self.smoother, self.rules).plan(node);
        let planning = begun.elapsed();
        let plan = match planned {
            Ok(plan) => plan,
            Err(error) if is_needed(&error) => {
                self.thinning.kept.push((node, Needed::Planned(error)));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        let step = plan.steps().first();
        let touched = step.map_or_else(Vec::new, |step| step.blanket.clone());
        let is_last = touched.is_empty() && is_alone(self.smoother.graph(), node);
        if is_last && !self.alone.contains(&node) {
            let last = RemovalError::NoBlanket { variable: node };
            self.thinning.kept.push((node, Needed::Planned(last)));
            return Ok(None);
        }
        let thinned = Thinned {
            variable: node,
            blanket: touched.len(),
            plan: planning,
            apply: Duration::ZERO,
            price,
            constant: plan.constant(),
            degrees_of_freedom: plan.degrees_of_freedom(),
            fallback: step.and_then(|step| step.fallback),
        };
        let begun = Instant::now();
        match self.smoother.apply(plan.into_change()) {
            Ok(_) => {
                self.thinning.removed.push(Thinned { apply: begun.elapsed(), ..thinned });
                Ok(Some(touched))
            }
            Err(error @ SmootherError::Singular(_)) => {
                self.thinning.kept.push((node, Needed::Applied(error)));
                Ok(None)
            }
            Err(source) => {
                Err(ThinningFailure::Smoother { variable: node, source: Box::new(source) })
            }
        }
    }
}

fn removal<'a>(smoother: &'a Smoother, rules: &Rules<'a>) -> Removal<'a> {
    Removal::new(smoother.graph(), smoother).with_options(rules.options).sparing(rules.spared)
}

/// The loss that a removal would be.
fn loss(
    smoother: &Smoother,
    covariances: &mut Covariances<'_>,
    node: VariableId,
    rules: &Rules<'_>,
) -> Result<Loss, RemovalError> {
    let unknown = || Ok(Loss::unknown(degree(smoother.graph(), node)?));
    match removal(smoother, rules).priced_by(covariances).plan(node) {
        Ok(plan) => plan.steps().first().map_or_else(unknown, |step| Ok(Loss::of(step))),
        Err(RemovalError::Covariance { .. }) => unknown(),
        Err(error) if is_needed(&error) => unknown(),
        Err(error) => Err(error),
    }
}

/// True if a node of the graph shares no factor with others.
fn is_alone(graph: &Graph, node: VariableId) -> bool {
    degree(graph, node).is_ok_and(|degree| degree == 0)
}

/// The number of other variables that share a factor with a variable.
fn degree(graph: &Graph, node: VariableId) -> Result<usize, GraphError> {
    let mut found = BTreeSet::new();
    for factor in graph.factors_of(node)? {
        found.extend(graph.factor(factor)?.keys().iter().copied());
    }
    Ok(found.len().saturating_sub(1))
}
