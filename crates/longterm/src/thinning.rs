//! Nodes removed from a live smoother, one by one.

use std::collections::BTreeSet;
use std::time::Duration;

use evergraph_model::{Graph, VariableId};
use evergraph_removal::{Certificate, Fallback, RemovalError, Topology};
#[cfg(doc)]
use evergraph_removal::{Options, Order};
#[cfg(doc)]
use evergraph_solver::Smoother;

use crate::needed::Needed;
#[cfg(doc)]
use crate::rules::Rules;

/// A node that was removed.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Thinned {
    /// The node.
    pub variable: VariableId,
    /// Size of its Markov blanket.
    pub blanket: usize,
    /// Time to plan, estimates of the blanket included, without the price.
    pub plan: Duration,
    /// Time to apply.
    pub apply: Duration,
    /// Price in nats, in the map as the removals before left it. `None` when neither [`Rules::prices`]
    /// nor [`Order::MinLoss`] asks for it, when it is not finite, or when rounding left no covariance.
    pub price: Option<f64>,
    /// See [`Plan::constant`](evergraph_removal::Plan::constant).
    pub constant: f64,
    /// See [`Plan::degrees_of_freedom`](evergraph_removal::Plan::degrees_of_freedom).
    pub degrees_of_freedom: i64,
    /// The topology of the new factors.
    pub topology: Topology,
    /// The reason where it did not take the form that was asked for.
    pub fallback: Option<Fallback>,
    /// See [`Step::certificate`](evergraph_removal::Step::certificate).
    pub certificate: Option<Certificate>,
}

/// The outcome of removals.
#[derive(Debug, Default)]
#[non_exhaustive]
pub struct Thinning {
    /// The nodes that were removed, in order.
    pub removed: Vec<Thinned>,
    /// The nodes that had to stay, in the order in which that was found.
    pub kept: Vec<(VariableId, Needed)>,
}

impl Thinning {
    /// The sum of the prices; `None` unless all are known.
    pub fn price(&self) -> Option<f64> {
        // The sum of no terms is -0.
        self.removed.iter().map(|it| it.price).sum::<Option<f64>>().map(|sum| sum + 0.0)
    }
}

/// Refuses lists that make no sense.
pub(crate) fn check(graph: &Graph, nodes: &[VariableId]) -> Result<(), RemovalError> {
    let mut seen = BTreeSet::new();
    for &node in nodes {
        graph.check_variable(node)?;
        if !seen.insert(node) {
            return Err(RemovalError::Twice { variable: node });
        }
    }
    if nodes.is_empty() { Err(RemovalError::Nothing) } else { Ok(()) }
}
