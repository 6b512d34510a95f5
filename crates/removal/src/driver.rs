//! The driver of removal orders.

use std::collections::BTreeMap;

use evergraph_model::VariableId;

use crate::order::{Order, shuffled};
use crate::queue::{DegreeQueue, Loss, LossQueue};

/// A graph that nodes are removed from one at a time: a plan in the making, or a live smoother.
///
/// [`remove_in_order`] decides which node is next and asks the remover for degrees, prices and the removal itself.
pub trait Remover {
    /// Failures that end the run.
    type Error;

    /// The slot of a node, which breaks ties between equal degrees and equal prices. Slots of nodes do not change
    /// while others are removed.
    ///
    /// # Errors
    /// An id that is not in the graph.
    fn slot(&self, node: VariableId) -> Result<usize, Self::Error>;

    /// Size of the Markov blanket of a node, in variables, as the graph is now.
    ///
    /// # Errors
    /// An id that is not in the graph.
    fn degree(&self, node: VariableId) -> Result<usize, Self::Error>;

    /// A function that prices the removal of a node from the graph as it is now. It is used for several nodes before
    /// the next removal, so that they can share covariances.
    ///
    /// A node that cannot be removed or priced has the price [`Loss::unknown`]; it is no error.
    fn prices(&mut self) -> impl FnMut(VariableId) -> Result<Loss, Self::Error>;

    /// Removes a node, whose loss is given if the order has asked for it. The result is its Markov blanket, or `None`
    /// for a node that has to stay.
    ///
    /// # Errors
    /// Failures that end the run; a node that has to stay is none.
    fn remove(
        &mut self,
        node: VariableId,
        loss: Option<Loss>,
    ) -> Result<Option<Vec<VariableId>>, Self::Error>;
}

/// Removes `nodes` from a graph, each named once, until `at_most` of them are gone. With fewer than there are nodes
/// the order decides which nodes go, not only when.
///
/// Dynamic orders read the graph as the removals before have left it: [`Order::MinDegree`] and [`Order::MinLoss`] say
/// when a node is looked at again. A node that has to stay is not tried again.
///
/// # Errors
/// Those of the remover, at the first; the removals before it have been done.
///
/// # Examples
/// A remover that only notes the order in which nodes go:
///
/// ```
/// use evergraph_model::{Graph, Point2, VariableId};
/// use evergraph_removal::{Loss, Order, Remover, remove_in_order};
///
/// struct Noted(Vec<VariableId>);
///
/// impl Remover for Noted {
///     type Error = std::convert::Infallible;
///     fn slot(&self, _: VariableId) -> Result<usize, Self::Error> {
///         Ok(0)
///     }
///     fn degree(&self, _: VariableId) -> Result<usize, Self::Error> {
///         Ok(1)
///     }
///     fn prices(&mut self) -> impl FnMut(VariableId) -> Result<Loss, Self::Error> {
///         |_| Ok(Loss::unknown(1))
///     }
///     fn remove(
///         &mut self,
///         node: VariableId,
///         _: Option<Loss>,
///     ) -> Result<Option<Vec<VariableId>>, Self::Error> {
///         self.0.push(node);
///         Ok(Some(Vec::new()))
///     }
/// }
///
/// let mut change = Graph::new().change();
/// let nodes = [0.0, 1.0, 2.0].map(|x| change.add_variable(&Point2::new(x, 0.0)).id());
/// let mut noted = Noted(Vec::new());
/// remove_in_order(&mut noted, &nodes, Order::Given, 2)?;
/// assert_eq!(noted.0, nodes[..2]);
/// # Ok::<(), std::convert::Infallible>(())
/// ```
pub fn remove_in_order<R: Remover>(
    remover: &mut R,
    nodes: &[VariableId],
    order: Order,
    at_most: usize,
) -> Result<(), R::Error> {
    match order {
        Order::Given => one_by_one(remover, nodes, at_most),
        Order::Random(seed) => one_by_one(remover, &shuffled(nodes, seed), at_most),
        Order::MinDegree => by_degree(remover, &Nodes::new(remover, nodes)?, at_most),
        Order::MinLoss => by_loss(remover, &Nodes::new(remover, nodes)?, at_most),
    }
}

/// A node with its slot before it, so that ties go to the lower slot.
type Waiting = (usize, VariableId);

/// The nodes as given, and by id.
struct Nodes {
    given: Vec<Waiting>,
    by_id: BTreeMap<VariableId, Waiting>,
}

impl Nodes {
    fn new<R: Remover>(remover: &R, nodes: &[VariableId]) -> Result<Self, R::Error> {
        let slot = |&node| Ok((remover.slot(node)?, node));
        let given = nodes.iter().map(slot).collect::<Result<Vec<Waiting>, R::Error>>()?;
        let by_id = given.iter().map(|&waiting| (waiting.1, waiting)).collect();
        Ok(Self { given, by_id })
    }

    /// Those of some variables that are nodes.
    fn among(&self, variables: &[VariableId]) -> Vec<Waiting> {
        variables.iter().filter_map(|variable| self.by_id.get(variable)).copied().collect()
    }
}

fn one_by_one<R: Remover>(
    remover: &mut R,
    nodes: &[VariableId],
    at_most: usize,
) -> Result<(), R::Error> {
    let mut gone = 0;
    for &node in nodes {
        if gone == at_most {
            break;
        }
        gone += usize::from(remover.remove(node, None)?.is_some());
    }
    Ok(())
}

/// Smallest blanket first. A removal changes the blankets of its own blanket only.
fn by_degree<R: Remover>(remover: &mut R, nodes: &Nodes, at_most: usize) -> Result<(), R::Error> {
    let mut queue = DegreeQueue::default();
    for &waiting in &nodes.given {
        queue.insert(waiting, remover.degree(waiting.1)?);
    }
    let mut gone = 0;
    while gone < at_most
        && let Some((_, node)) = queue.pop()
    {
        let Some(touched) = remover.remove(node, None)? else { continue };
        gone += 1;
        for waiting in nodes.among(&touched) {
            if queue.contains(waiting) {
                queue.insert(waiting, remover.degree(waiting.1)?);
            }
        }
    }
    Ok(())
}

/// Lowest price first.
fn by_loss<R: Remover>(remover: &mut R, nodes: &Nodes, at_most: usize) -> Result<(), R::Error> {
    let mut queue = LossQueue::default();
    {
        let mut price = remover.prices();
        for &waiting in &nodes.given {
            queue.insert(waiting, price(waiting.1)?);
        }
    }
    let mut gone = 0;
    while gone < at_most {
        let next = {
            let mut price = remover.prices();
            queue.pop(|(_, node)| price(node))?
        };
        let Some(((_, node), loss)) = next else { break };
        let Some(touched) = remover.remove(node, Some(loss))? else { continue };
        gone += 1;
        let mut price = remover.prices();
        queue.removed(&nodes.among(&touched), |(_, node)| price(node))?;
    }
    Ok(())
}
