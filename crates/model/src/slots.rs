//! Generational slots whose next ids can be planned by reading only.

use std::hash::{Hash, Hasher};

use smallvec::SmallVec;

/// Places for objects. A freed place is used again under the next generation, so memory follows
/// the number of living objects and an id is never given twice.
#[derive(Clone, Debug)]
pub(crate) struct Slots<T> {
    entries: Vec<Entry<T>>,
    free: Vec<u32>,
}

#[derive(Clone, Debug)]
struct Entry<T> {
    generation: u32,
    object: Option<T>,
}

/// How many freed slots one change can take up again; what it needs beyond that it gets from the
/// end. A share of what is free, so that the array settles at a few times the need whatever the
/// size of the changes, and bounded, so that planning stays cheap.
fn reusable(free: usize) -> usize {
    (free / 4).clamp(FEW, 4096)
}

const FEW: usize = 16;

/// The ids that the next insertions will get, so that a change can name what it is about to add.
#[derive(Clone, Debug)]
pub(crate) struct SlotPlan {
    reused: SmallVec<[(u32, u32); FEW]>,
    fresh: u32,
    taken: u32,
}

impl SlotPlan {
    /// The next planned (index, generation); `None` when 2³² slots are in use.
    pub(crate) fn take(&mut self) -> Option<(u32, u32)> {
        let k = self.taken as usize;
        let id = match self.reused.get(k) {
            Some(&slot) => slot,
            None => (self.fresh.checked_add((k - self.reused.len()) as u32)?, 0),
        };
        self.taken += 1;
        Some(id)
    }
}

impl<T> Default for Slots<T> {
    fn default() -> Self {
        Self { entries: Vec::new(), free: Vec::new() }
    }
}

impl<T> Slots<T> {
    pub(crate) fn plan(&self) -> SlotPlan {
        let reused = self.free.iter().rev().take(reusable(self.free.len()));
        SlotPlan {
            reused: reused.map(|&i| (i, self.entries[i as usize].generation)).collect(),
            fresh: self.entries.len() as u32,
            taken: 0,
        }
    }

    /// Whether every id that `plan` has handed out is still the one the next insertions will get.
    pub(crate) fn is_current(&self, plan: &SlotPlan) -> bool {
        let taken = plan.taken as usize;
        let reused = plan.reused.len().min(taken);
        let reused_ok = self.free.len() >= reused
            && plan.reused[..reused].iter().zip(self.free.iter().rev()).all(
                |(&(index, generation), &next)| {
                    index == next && self.entries[next as usize].generation == generation
                },
            );
        let fresh_ok = taken <= plan.reused.len() || plan.fresh as usize == self.entries.len();
        reused_ok && fresh_ok
    }

    /// Puts an object into the slot that a current plan named for it.
    pub(crate) fn insert_planned(&mut self, index: u32, object: T) {
        if index as usize == self.entries.len() {
            self.entries.push(Entry { generation: 0, object: Some(object) });
        } else {
            let next = self.free.pop();
            debug_assert_eq!(next, Some(index), "the plan was checked by is_current");
            self.entries[index as usize].object = Some(object);
        }
    }

    /// Takes back the newest insertion; `was_fresh` says whether it had made the slot.
    pub(crate) fn undo_insert(&mut self, index: u32, was_fresh: bool) -> Option<T> {
        if was_fresh {
            debug_assert_eq!(index as usize + 1, self.entries.len());
            self.entries.pop().and_then(|entry| entry.object)
        } else {
            self.free.push(index);
            self.entries[index as usize].object.take()
        }
    }

    pub(crate) fn remove(&mut self, index: u32) -> Option<T> {
        let entry = &mut self.entries[index as usize];
        let object = entry.object.take()?;
        // A slot that has used up its generations is retired rather than reused.
        if let Some(next) = entry.generation.checked_add(1) {
            entry.generation = next;
            self.free.push(index);
        }
        Some(object)
    }

    pub(crate) fn get(&self, index: u32, generation: u32) -> Option<&T> {
        let entry = self.entries.get(index as usize)?;
        if entry.generation == generation { entry.object.as_ref() } else { None }
    }

    pub(crate) fn at(&self, index: usize) -> Option<&T> {
        self.entries.get(index)?.object.as_ref()
    }

    pub(crate) fn at_mut(&mut self, index: usize) -> Option<&mut T> {
        self.entries.get_mut(index)?.object.as_mut()
    }

    pub(crate) fn generation(&self, index: usize) -> u32 {
        self.entries[index].generation
    }

    /// Length of the slot array, living or not.
    pub(crate) fn capacity(&self) -> usize {
        self.entries.len()
    }

    /// Feeds generations and free slots, which decide the ids to come, to a hash.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        self.free.hash(hash);
        for entry in &self.entries {
            (entry.generation, entry.object.is_some()).hash(hash);
        }
    }

    /// Indices of living objects, ascending.
    pub(crate) fn indices(&self) -> impl Iterator<Item = usize> {
        self.entries.iter().enumerate().filter(|(_, e)| e.object.is_some()).map(|(i, _)| i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_is_never_given_twice() {
        let mut slots = Slots::default();
        let mut seen = std::collections::HashSet::new();
        for cycle in 0..100_000_u32 {
            let mut plan = slots.plan();
            let (index, generation) = plan.take().unwrap();
            assert!(slots.is_current(&plan));
            assert!(seen.insert((index, generation)), "cycle {cycle}");
            slots.insert_planned(index, cycle);
            assert_eq!(slots.get(index, generation), Some(&cycle));
            slots.remove(index);
            assert_eq!(slots.get(index, generation), None);
        }
        assert_eq!(slots.capacity(), 1, "memory follows the living, not the time");
    }

    #[test]
    fn a_plan_goes_stale_when_its_slots_are_taken() {
        let mut slots = Slots::default();
        let (mut first, mut second) = (slots.plan(), slots.plan());
        let (index, _) = first.take().unwrap();
        second.take().unwrap();
        slots.insert_planned(index, ());
        assert!(!slots.is_current(&second));
    }

    #[test]
    fn undo_restores_plans() {
        let mut slots = Slots::default();
        for i in 0..40 {
            slots.insert_planned(i, i);
        }
        for i in [3, 17, 5] {
            slots.remove(i);
        }
        let mut before = slots.plan();
        let ids: Vec<_> = (0..5).map(|_| before.take().unwrap()).collect();
        assert_eq!(ids, [(5, 1), (17, 1), (3, 1), (40, 0), (41, 0)]);
        for &(index, _) in &ids {
            slots.insert_planned(index, 0);
        }
        for &(index, generation) in ids.iter().rev() {
            slots.undo_insert(index, index >= 40 && generation == 0);
        }
        assert!(slots.is_current(&before));
        assert_eq!(slots.capacity(), 40);
    }
}
