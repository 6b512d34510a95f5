//! The source of ids: numbers that are never given twice.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::key::{FactorId, VariableId};

/// Mints the ids of one graph, and of its clones, on any thread.
///
/// A producer of measurements keeps a copy and makes changes with it, without access to the graph:
///
/// ```
/// use evergraph_model::{Graph, Pose2};
///
/// let mut graph = Graph::new();
/// let ids = graph.ids();
/// let prepared = std::thread::spawn(move || {
///     let mut change = ids.change();
///     change.add_variable(&Pose2::new(1.0, 0.0, 0.0));
///     change
/// });
/// let staged = graph.stage(&prepared.join().unwrap()).unwrap();
/// graph.commit(staged);
/// assert_eq!(graph.variable_count(), 1);
/// ```
#[derive(Clone, Debug)]
pub struct Ids {
    lineage: u64,
    source: Arc<Source>,
}

/// Counters shared by a graph, its clones and all changes made for them.
#[derive(Debug)]
struct Source {
    origin: u64,
    variables: AtomicU64,
    factors: AtomicU64,
}

impl Ids {
    /// The ids of a new graph.
    pub(crate) fn new() -> Self {
        Self::of_lineage(fresh_origin())
    }

    /// New ids for a graph that was saved: its identity stays, and what it mints from now on
    /// differs from what any other copy of it mints.
    pub(crate) fn of_lineage(lineage: u64) -> Self {
        let (variables, factors) = (AtomicU64::new(0), AtomicU64::new(0));
        let source = Source { origin: fresh_origin(), variables, factors };
        Self { lineage, source: Arc::new(source) }
    }

    /// The identity of the graph, which its clones and its saved copies share.
    pub(crate) fn lineage(&self) -> u64 {
        self.lineage
    }

    /// The first half of every id that is minted here.
    pub(crate) fn origin(&self) -> u64 {
        self.source.origin
    }

    pub(crate) fn variable(&self) -> VariableId {
        // No order among threads is asked for, only that no two get the same number.
        let number = self.source.variables.fetch_add(1, Ordering::Relaxed);
        VariableId { number, origin: self.source.origin }
    }

    pub(crate) fn factor(&self) -> FactorId {
        let number = self.source.factors.fetch_add(1, Ordering::Relaxed);
        FactorId { number, origin: self.source.origin }
    }
}

/// 64 bits that no other graph has, in this process or another.
fn fresh_origin() -> u64 {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    // `RandomState` takes its keys from the operating system; no result depends on them.
    RandomState::new().hash_one(COUNT.fetch_add(1, Ordering::Relaxed))
}

/// The numbers of one source that were used, as intervals: contiguous but for refused changes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct UsedNumbers {
    /// From the first number of an interval to the number after its last.
    ends: BTreeMap<u64, u64>,
}

/// More intervals than this are not kept: changes as old as the oldest gap are refused then.
const MOST_INTERVALS: usize = 4096;

impl UsedNumbers {
    pub(crate) fn contains(&self, number: u64) -> bool {
        self.ends.range(..=number).next_back().is_some_and(|(_, &end)| number < end)
    }

    /// Adds a number; `false` when it was there.
    pub(crate) fn insert(&mut self, number: u64) -> bool {
        let mut before = self.ends.range_mut(..=number);
        let joined = match before.next_back() {
            Some((_, &mut end)) if number < end => return false,
            Some((&start, end)) if *end == number => {
                *end = number + 1;
                Some(start)
            }
            _ => None,
        };
        let start = joined.unwrap_or(number);
        match self.ends.remove(&(number + 1)) {
            Some(end) => _ = self.ends.insert(start, end),
            None if joined.is_none() => _ = self.ends.insert(number, number + 1),
            None => (),
        }
        true
    }

    /// Takes a number out again.
    pub(crate) fn remove(&mut self, number: u64) {
        let Some((&start, &end)) = self.ends.range(..=number).next_back() else { return };
        if number >= end {
            return;
        }
        if start == number {
            self.ends.remove(&start);
        } else {
            self.ends.insert(start, number);
        }
        if number + 1 < end {
            self.ends.insert(number + 1, end);
        }
    }

    /// Bounds the memory: the oldest gaps count as used.
    pub(crate) fn compact(&mut self) {
        while self.ends.len() > MOST_INTERVALS {
            let (Some((start, _)), Some((_, end))) = (self.ends.pop_first(), self.ends.pop_first())
            else {
                return;
            };
            self.ends.insert(start, end);
        }
    }

    pub(crate) fn intervals(&self) -> impl Iterator<Item = (u64, u64)> {
        self.ends.iter().map(|(&start, &end)| (start, end))
    }

    /// From intervals in ascending order that do not touch; `None` for others.
    pub(crate) fn from_intervals(intervals: &[(u64, u64)]) -> Option<Self> {
        let ascending = intervals.windows(2).all(|pair| pair[0].1 < pair[1].0);
        let proper = intervals.iter().all(|(start, end)| start < end);
        (ascending && proper).then(|| Self { ends: intervals.iter().copied().collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn intervals_are_a_set(operations in prop::collection::vec((any::<bool>(), 0_u64..40), 0..200)) {
            let (mut numbers, mut reference) = (UsedNumbers::default(), BTreeSet::new());
            for (insert, number) in operations {
                if insert {
                    prop_assert_eq!(numbers.insert(number), reference.insert(number));
                } else {
                    numbers.remove(number);
                    reference.remove(&number);
                }
                let found: BTreeSet<u64> = (0..40).filter(|&n| numbers.contains(n)).collect();
                prop_assert_eq!(&found, &reference);
                let intervals: Vec<_> = numbers.intervals().collect();
                prop_assert_eq!(UsedNumbers::from_intervals(&intervals), Some(numbers.clone()));
            }
        }
    }

    #[test]
    fn memory_is_bounded_and_what_was_used_stays_used() {
        let mut numbers = UsedNumbers::default();
        for number in 0..100_000 {
            numbers.insert(3 * number);
            numbers.compact();
        }
        assert!(numbers.intervals().count() <= MOST_INTERVALS);
        assert!((0..100_000).all(|number| numbers.contains(3 * number)));
        assert!(!numbers.contains(299_996));
    }

    #[test]
    fn saved_intervals_that_make_no_sense_are_refused() {
        for bad in [&[(3, 3)][..], &[(0, 2), (2, 4)], &[(5, 6), (1, 2)], &[(4, 1)]] {
            assert_eq!(UsedNumbers::from_intervals(bad), None, "{bad:?}");
        }
    }
}
