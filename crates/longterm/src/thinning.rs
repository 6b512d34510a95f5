//! Nodes taken out of a live smoother, one by one: planned, then applied, as a robot does it between
//! updates.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use evergraph_model::{FactorId, Graph, GraphError, VariableId};
use evergraph_removal::{
    DegreeQueue, Fallback, Loss, LossQueue, Options, Order, Removal, RemovalError, shuffled,
};
use evergraph_solver::{Covariances, Smoother, SmootherError};
use thiserror::Error;

/// How nodes are removed one by one.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// Who goes first.
    pub order: Order,
    /// After so many removals the rest of the nodes stays. With fewer than there are nodes, the order
    /// decides who goes, not only when.
    pub at_most: usize,
    /// What comes in the place of a node.
    pub options: Options,
    /// Factors that are left alone while their variables stay ([`Removal::sparing`]), such as gauge
    /// priors.
    pub spared: &'a [FactorId],
    /// Whether each removal is priced.
    pub prices: bool,
}

/// Why nodes could not be removed; the smoother is as it was.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ThinningError {
    /// The removal makes no sense for this graph.
    #[error(transparent)]
    Removal(#[from] RemovalError),
    /// The smoother refused one, and not because a direction would have become free.
    #[error("removing {variable} was refused: {source}")]
    Smoother {
        /// The node.
        variable: VariableId,
        /// Why; boxed, so that results are small where all goes well.
        source: Box<SmootherError>,
    },
}

/// A node that is gone.
#[derive(Clone, Debug, PartialEq)]
pub struct Thinned {
    /// The node.
    pub variable: VariableId,
    /// Size of its Markov blanket.
    pub blanket: usize,
    /// Time to plan, estimates of the blanket included, without the price.
    pub plan: Duration,
    /// Time to apply.
    pub apply: Duration,
    /// What it cost, in nats, of the map as the removals before left it; `None` when that was not asked
    /// for (by [`Rules::prices`] or [`Order::MinLoss`]), is not finite, or rounding left no covariance
    /// to price it by.
    pub price: Option<f64>,
    /// See [`Plan::constant`](evergraph_removal::Plan::constant).
    pub constant: f64,
    /// See [`Plan::degrees_of_freedom`](evergraph_removal::Plan::degrees_of_freedom).
    pub degrees_of_freedom: i64,
    /// Why it did not take the form that was asked for.
    pub fallback: Option<Fallback>,
}

/// Why a node had to stay.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Needed {
    /// There is nothing that could carry what is known of it, or of where the map is; or its blanket
    /// is too large to plan for.
    #[error(transparent)]
    Planned(RemovalError),
    /// Without it a direction would be free.
    #[error(transparent)]
    Applied(SmootherError),
}

/// What became of the nodes.
#[derive(Debug, Default)]
pub struct Thinning {
    /// Those that are gone, in order.
    pub removed: Vec<Thinned>,
    /// Those that had to stay, in the order in which that was found.
    pub kept: Vec<(VariableId, Needed)>,
}

impl Thinning {
    /// Removes `nodes` one by one, [`Rules::at_most`] of them. Dynamic orders look at the graph as it
    /// then is ([`DegreeQueue`], [`LossQueue`]). A node that is needed stays and is listed. `done` is
    /// called after each node.
    ///
    /// Prices are exact where the neighborhood is in the linear model ([`Options::linear_within`]), as after
    /// [`Smoother::optimize`]. With [`Rules::prices`] each node costs one more plan, with its joint
    /// covariance; with [`Order::MinLoss`] each does at the start and before it goes, and those next to a
    /// removed one again.
    ///
    /// # Errors
    /// [`ThinningError`]; the smoother is then as it was before the first.
    pub fn run(
        smoother: &mut Smoother,
        nodes: &[VariableId],
        rules: &Rules<'_>,
        mut done: impl FnMut(),
    ) -> Result<Self, ThinningError> {
        check(smoother.graph(), nodes)?;
        let before = smoother.clone();
        let mut thinning = Self::default();
        match thinning.all(smoother, nodes, rules, &mut done) {
            Ok(()) => Ok(thinning),
            Err(error) => {
                *smoother = before;
                Err(error)
            }
        }
    }

    fn all(
        &mut self,
        smoother: &mut Smoother,
        nodes: &[VariableId],
        rules: &Rules<'_>,
        done: &mut impl FnMut(),
    ) -> Result<(), ThinningError> {
        let mut queue = Queue::new(smoother, nodes, rules)?;
        while self.removed.len() < rules.at_most
            && let Some((node, loss)) = queue.pop(smoother, rules)?
        {
            if let Some(touched) = self.take(smoother, node, loss, rules)? {
                queue.look_again(smoother, &touched, rules)?;
            }
            done();
        }
        Ok(())
    }

    /// The sum of the prices; `None` unless all are known.
    pub fn price(&self) -> Option<f64> {
        // The sum of no terms is -0.
        self.removed.iter().map(|it| it.price).sum::<Option<f64>>().map(|sum| sum + 0.0)
    }

    /// Removes a node, whose price may be known, or notes why it stays. Says whose neighborhood has
    /// changed; `None` when nothing has.
    fn take(
        &mut self,
        smoother: &mut Smoother,
        node: VariableId,
        loss: Option<Loss>,
        rules: &Rules<'_>,
    ) -> Result<Option<Vec<VariableId>>, ThinningError> {
        let loss = match loss {
            None if rules.prices => {
                Some(self::loss(smoother, &mut smoother.covariances(), node, rules)?)
            }
            known => known,
        };
        let price = loss.map(|loss| loss.price).filter(|price| price.is_finite());
        let begun = Instant::now();
        let planned = removal(smoother, rules).plan(node);
        let planning = begun.elapsed();
        let plan = match planned {
            Ok(plan) => plan,
            Err(error) if is_needed(&error) => {
                self.kept.push((node, Needed::Planned(error)));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        let step = plan.steps().first();
        let touched = step.map_or_else(Vec::new, |step| step.blanket.clone());
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
        match smoother.apply(plan.into_change()) {
            Ok(_) => {
                self.removed.push(Thinned { apply: begun.elapsed(), ..thinned });
                Ok(Some(touched))
            }
            Err(error @ SmootherError::Singular(_)) => {
                self.kept.push((node, Needed::Applied(error)));
                Ok(None)
            }
            Err(source) => {
                Err(ThinningError::Smoother { variable: node, source: Box::new(source) })
            }
        }
    }
}

fn check(graph: &Graph, nodes: &[VariableId]) -> Result<(), RemovalError> {
    let mut seen = BTreeSet::new();
    for &node in nodes {
        graph.check_variable(node)?;
        if !seen.insert(node) {
            return Err(RemovalError::Twice { variable: node });
        }
    }
    if nodes.is_empty() { Err(RemovalError::Nothing) } else { Ok(()) }
}

/// Whether the node stays, where another error says that the call makes no sense.
fn is_needed(error: &RemovalError) -> bool {
    matches!(
        error,
        RemovalError::NoBlanket { .. }
            | RemovalError::LargeBlanket { .. }
            | RemovalError::LastPose { .. }
            | RemovalError::NotRepresentable { .. }
    )
}

fn removal<'a>(smoother: &'a Smoother, rules: &Rules<'a>) -> Removal<'a> {
    Removal::new(smoother.graph(), smoother).with_options(rules.options).sparing(rules.spared)
}

/// What a removal would cost.
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

/// Nodes that wait, and which is next.
enum Queue {
    /// The next is last.
    Fixed(Vec<VariableId>),
    Degree(DegreeQueue),
    Loss(LossQueue),
}

impl Queue {
    fn new(
        smoother: &Smoother,
        nodes: &[VariableId],
        rules: &Rules<'_>,
    ) -> Result<Self, RemovalError> {
        Ok(match rules.order {
            Order::Given => Self::Fixed(nodes.iter().rev().copied().collect()),
            Order::Random(seed) => Self::Fixed(shuffled(nodes, seed).into_iter().rev().collect()),
            Order::MinDegree => {
                let mut queue = DegreeQueue::default();
                for &node in nodes {
                    queue.insert(node, degree(smoother.graph(), node)?);
                }
                Self::Degree(queue)
            }
            Order::MinLoss => {
                let mut covariances = smoother.covariances();
                let mut queue = LossQueue::default();
                for &node in nodes {
                    queue.insert(node, loss(smoother, &mut covariances, node, rules)?);
                }
                Self::Loss(queue)
            }
        })
    }

    /// The next node, and what it costs if that is known.
    fn pop(
        &mut self,
        smoother: &Smoother,
        rules: &Rules<'_>,
    ) -> Result<Option<(VariableId, Option<Loss>)>, RemovalError> {
        Ok(match self {
            Self::Fixed(nodes) => nodes.pop().map(|node| (node, None)),
            Self::Degree(queue) => queue.pop().map(|node| (node, None)),
            Self::Loss(queue) => {
                let mut covariances = smoother.covariances();
                let next = queue.pop(|node| loss(smoother, &mut covariances, node, rules))?;
                next.map(|(node, loss)| (node, Some(loss)))
            }
        })
    }

    /// After a removal whose blanket was `touched`.
    fn look_again(
        &mut self,
        smoother: &Smoother,
        touched: &[VariableId],
        rules: &Rules<'_>,
    ) -> Result<(), RemovalError> {
        match self {
            Self::Fixed(_) => Ok(()),
            Self::Degree(queue) => {
                for &node in touched {
                    if queue.contains(node) {
                        queue.insert(node, degree(smoother.graph(), node)?);
                    }
                }
                Ok(())
            }
            Self::Loss(queue) => {
                let mut covariances = smoother.covariances();
                queue.removed(touched, |node| loss(smoother, &mut covariances, node, rules))
            }
        }
    }
}

/// How many others share a factor with a variable.
fn degree(graph: &Graph, node: VariableId) -> Result<usize, GraphError> {
    let mut found = BTreeSet::new();
    for factor in graph.factors_of(node)? {
        found.extend(graph.factor(factor)?.keys().iter().copied());
    }
    Ok(found.len().saturating_sub(1))
}
