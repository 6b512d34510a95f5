//! Nodes taken out of a live smoother, one by one: planned, then applied, as a robot does it between
//! updates.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use evergraph_model::{FactorId, Graph, GraphError, VariableId};
use evergraph_removal::{
    Fallback, Loss, Options, Order, Removal, RemovalError, Remover, remove_in_order,
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
    /// then is ([`remove_in_order`]). A node that is needed stays and is listed. `done` is
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
        done: impl FnMut(),
    ) -> Result<Self, ThinningError> {
        check(smoother.graph(), nodes)?;
        let before = smoother.clone();
        let mut live = Live { smoother, rules, thinning: Self::default(), done };
        match remove_in_order(&mut live, nodes, rules.order, rules.at_most) {
            Ok(()) => Ok(live.thinning),
            Err(error) => {
                *live.smoother = before;
                Err(error)
            }
        }
    }

    /// The sum of the prices; `None` unless all are known.
    pub fn price(&self) -> Option<f64> {
        // The sum of no terms is -0.
        self.removed.iter().map(|it| it.price).sum::<Option<f64>>().map(|sum| sum + 0.0)
    }
}

/// A smoother that nodes are removed from, and what has become of them.
struct Live<'a, D> {
    smoother: &'a mut Smoother,
    rules: &'a Rules<'a>,
    thinning: Thinning,
    done: D,
}

impl<D: FnMut()> Remover for Live<'_, D> {
    type Error = ThinningError;

    fn slot(&self, node: VariableId) -> Result<usize, ThinningError> {
        Ok(node.index())
    }

    fn degree(&self, node: VariableId) -> Result<usize, ThinningError> {
        Ok(degree(self.smoother.graph(), node).map_err(RemovalError::from)?)
    }

    fn prices(&mut self) -> impl FnMut(VariableId) -> Result<Loss, ThinningError> {
        let (smoother, rules) = (&*self.smoother, self.rules);
        let mut covariances = smoother.covariances();
        move |node| Ok(loss(smoother, &mut covariances, node, rules)?)
    }

    fn remove(
        &mut self,
        node: VariableId,
        loss: Option<Loss>,
    ) -> Result<Option<Vec<VariableId>>, ThinningError> {
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
    ) -> Result<Option<Vec<VariableId>>, ThinningError> {
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

/// How many others share a factor with a variable.
fn degree(graph: &Graph, node: VariableId) -> Result<usize, GraphError> {
    let mut found = BTreeSet::new();
    for factor in graph.factors_of(node)? {
        found.extend(graph.factor(factor)?.keys().iter().copied());
    }
    Ok(found.len().saturating_sub(1))
}
