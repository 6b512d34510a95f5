//! Nodes that wait for their removal, in the dynamic orders.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use crate::options::Topology;
use crate::step::Step;

/// [`Order::MinDegree`](crate::Order::MinDegree): the node with the smallest Markov blanket first,
/// ties by the order of nodes.
#[derive(Clone, Debug)]
pub(crate) struct DegreeQueue<N> {
    queue: BTreeSet<(usize, N)>,
    degrees: BTreeMap<N, usize>,
}

impl<N> Default for DegreeQueue<N> {
    fn default() -> Self {
        Self { queue: BTreeSet::new(), degrees: BTreeMap::new() }
    }
}

impl<N: Copy + Ord> DegreeQueue<N> {
    /// Adds a node, or changes its degree. O(log n).
    pub(crate) fn insert(&mut self, node: N, degree: usize) {
        if let Some(known) = self.degrees.insert(node, degree) {
            self.queue.remove(&(known, node));
        }
        self.queue.insert((degree, node));
    }

    /// Whether a node waits.
    pub(crate) fn contains(&self, node: N) -> bool {
        self.degrees.contains_key(&node)
    }

    /// Takes the next node. O(log n).
    pub(crate) fn pop(&mut self) -> Option<N> {
        let (_, node) = self.queue.pop_first()?;
        self.degrees.remove(&node);
        Some(node)
    }
}

/// What the removal of a node would cost.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Loss {
    /// Its price in nats; infinite when it cannot be removed or priced now, so that it goes last.
    pub price: f64,
    /// Whether one dense factor would take the place of a tree ([`Fallback`](crate::Fallback)). That
    /// loses nothing now, but ties all of the neighborhood together: it goes after all trees.
    pub dense: bool,
    /// Size of its Markov blanket.
    pub degree: usize,
}

impl Loss {
    /// Of a step that was priced.
    pub fn of(step: &Step) -> Self {
        Self {
            price: step.price.unwrap_or(f64::INFINITY),
            dense: step.fallback.is_some() && step.topology == Topology::Dense,
            degree: step.blanket.len(),
        }
    }

    /// Of a node that cannot be removed or priced, with `degree` neighbours.
    pub fn unknown(degree: usize) -> Self {
        Self { price: f64::INFINITY, dense: true, degree }
    }

    fn cmp(&self, other: &Self) -> Ordering {
        let class = |loss: &Self| (loss.price.is_infinite(), loss.dense);
        class(self).cmp(&class(other)).then(self.price.total_cmp(&other.price))
    }
}

/// [`Order::MinLoss`](crate::Order::MinLoss): the node whose removal costs least first, ties by the order of nodes.
///
/// A removal changes all other prices a little, and those of its blanket much. So
///
/// - a node is priced again before it goes, and waits if another has become cheaper;
/// - a node is priced again when it was in the blanket of a removed one, since its own neighborhood has
///   changed; prices fall as well as rise (the divergence is not submodular), and one that fell must
///   not wait for its turn. A large neighborhood is first left to change by an eighth: a landmark
///   that hundreds of poses see is next to most removals, and pricing it is cubic in their number.
///
/// Prices of other nodes, also of those that only share neighbours with a removed one, are lower or
/// higher than they say until it is their turn.
#[derive(Clone, Debug)]
pub(crate) struct LossQueue<N> {
    nodes: BTreeMap<N, Waiting>,
    /// How many nodes have gone.
    gone: usize,
}

impl<N> Default for LossQueue<N> {
    fn default() -> Self {
        Self { nodes: BTreeMap::new(), gone: 0 }
    }
}

/// Part of a neighborhood that changes before it is priced again out of turn.
const SHARE: f64 = 0.125;

#[derive(Clone, Copy, Debug)]
struct Waiting {
    loss: Loss,
    /// How many nodes had gone when it was priced.
    priced_at: usize,
    /// Removals since, in the blankets of which it was.
    changes: usize,
}

impl<N: Copy + Ord> LossQueue<N> {
    /// Adds a node with its loss.
    pub(crate) fn insert(&mut self, node: N, loss: Loss) {
        self.nodes.insert(node, Waiting { loss, priced_at: self.gone, changes: 0 });
    }

    /// Takes the node that costs least, with its price as things stand; `price` finds what a removal
    /// would cost. O(n) and mostly one price.
    ///
    /// # Errors
    /// Those of `price`; the queue is then as good as before.
    pub(crate) fn pop<E>(
        &mut self,
        mut price: impl FnMut(N) -> Result<Loss, E>,
    ) -> Result<Option<(N, Loss)>, E> {
        while let Some((&node, waiting)) = self.nodes.iter().min_by(|a, b| a.1.loss.cmp(&b.1.loss))
        {
            if waiting.priced_at == self.gone {
                let loss = waiting.loss;
                self.nodes.remove(&node);
                return Ok(Some((node, loss)));
            }
            let loss = price(node)?;
            self.insert(node, loss);
        }
        Ok(None)
    }

    /// Notes that a node has gone whose blanket was `touched`.
    ///
    /// # Errors
    /// Those of `price`; what was not priced is left as it was.
    pub(crate) fn removed<E>(
        &mut self,
        touched: &[N],
        mut price: impl FnMut(N) -> Result<Loss, E>,
    ) -> Result<(), E> {
        self.gone += 1;
        for &node in touched {
            let Some(waiting) = self.nodes.get_mut(&node) else { continue };
            waiting.changes += 1;
            if waiting.changes as f64 > SHARE * waiting.loss.degree as f64 {
                let loss = price(node)?;
                self.insert(node, loss);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn nodes(count: usize) -> Vec<usize> {
        (0..count).collect()
    }

    fn loss(price: f64) -> Loss {
        Loss { price, dense: false, degree: 2 }
    }

    #[test]
    fn the_smallest_degree_goes_first() {
        let all = nodes(3);
        let mut queue = DegreeQueue::default();
        all.iter().zip([3, 1, 2]).for_each(|(&node, degree)| queue.insert(node, degree));
        assert_eq!(queue.pop(), Some(all[1]));
        assert!(!queue.contains(all[1]) && queue.contains(all[0]));
        queue.insert(all[0], 2);
        assert_eq!([queue.pop(), queue.pop(), queue.pop()], [Some(all[0]), Some(all[2]), None]);
    }

    /// The second has become dearer far from what it was priced by, the third cheaper beside it.
    #[test]
    fn prices_are_those_of_the_moment() {
        let all = nodes(4);
        let mut queue = LossQueue::default();
        let mut now = [0.0, 1.0, 3.0, 2.0];
        all.iter().zip(now).for_each(|(&node, price)| queue.insert(node, loss(price)));
        let mut asked = Vec::new();
        let mut price = |node: usize, now: &[f64; 4]| {
            asked.push(node);
            Ok::<_, Infallible>(loss(now[node]))
        };
        assert_eq!(queue.pop(|v| price(v, &now)), Ok(Some((all[0], loss(0.0)))));
        now = [0.0, 5.0, 0.5, 2.0];
        queue.removed(&all[2..3], |v| price(v, &now)).unwrap();
        assert_eq!(queue.pop(|v| price(v, &now)), Ok(Some((all[2], loss(0.5)))));
        queue.removed(&[], |v| price(v, &now)).unwrap();
        assert_eq!(queue.pop(|v| price(v, &now)), Ok(Some((all[3], loss(2.0)))));
        queue.removed(&[], |v| price(v, &now)).unwrap();
        assert_eq!(queue.pop(|v| price(v, &now)), Ok(Some((all[1], loss(5.0)))));
        assert_eq!(queue.pop(|v| price(v, &now)), Ok(None));
        // The third beside the first; then each before it went, but for the third.
        assert_eq!(asked, [2, 1, 3, 1]);
    }

    /// A landmark that sixteen see is priced again at the third change.
    #[test]
    fn large_neighborhoods_change_first() {
        let all = nodes(2);
        let mut queue = LossQueue::default();
        queue.insert(all[0], Loss { price: 1.0, dense: false, degree: 16 });
        let mut asked = 0;
        for expected in [0, 0, 1, 1, 1, 2] {
            let touched = queue.removed(&all[..1], |_| {
                asked += 1;
                Ok::<_, Infallible>(Loss { price: 1.0, dense: false, degree: 16 })
            });
            touched.unwrap();
            assert_eq!(asked, expected);
        }
    }

    /// And what cannot be priced for both, whatever it would become.
    #[test]
    fn dense_factors_wait_for_trees() {
        let all = nodes(4);
        let mut queue = LossQueue::default();
        queue.insert(all[0], loss(f64::INFINITY));
        queue.insert(all[1], Loss::unknown(2));
        queue.insert(all[2], Loss { dense: true, ..loss(0.0) });
        queue.insert(all[3], loss(1.0));
        let mut next = || queue.pop(|_| Err(())).unwrap().map(|(node, _)| node);
        assert_eq!([next(), next(), next()], [Some(all[3]), Some(all[2]), Some(all[0])]);
    }

    #[test]
    fn an_error_loses_no_node() {
        let all = nodes(1);
        let mut queue = LossQueue::default();
        queue.insert(all[0], loss(1.0));
        assert_eq!(queue.removed(&all, |_| Err("no")), Err("no"));
        assert_eq!(queue.pop(|_| Err("no")), Err("no"));
        assert_eq!(queue.pop(|_| Ok::<_, ()>(loss(1.0))), Ok(Some((all[0], loss(1.0)))));
    }
}
