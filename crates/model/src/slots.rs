//! Dense slots for objects with ids: arrays that follow the number of living objects.

use std::hash::{Hash, Hasher};

use rustc_hash::FxHashMap;

/// Objects in slots. A freed slot is used again, the latest first.
///
/// `I` is the id of an object. Ids are looked up at the door, by [`index_of`](Self::index_of);
/// everything behind it works with slots.
#[derive(Clone, Debug)]
pub(crate) struct Slots<I, T> {
    entries: Vec<Option<(I, T)>>,
    free: Vec<u32>,
    /// Looked up only, never walked through: its order depends on ids, which are no part of results.
    places: FxHashMap<I, u32>,
}

impl<I, T> Default for Slots<I, T> {
    fn default() -> Self {
        Self { entries: Vec::new(), free: Vec::new(), places: FxHashMap::default() }
    }
}

impl<I: Copy + Eq + Hash, T> Slots<I, T> {
    /// Puts an object into a free slot, or a new one; which it is, and whether it is new. `None`
    /// when all 2³² - 1 slots are in use.
    pub(crate) fn insert(&mut self, id: I, object: T) -> Option<(u32, bool)> {
        let (index, fresh) = match self.free.pop() {
            Some(index) => (index, false),
            None => (u32::try_from(self.entries.len()).ok().filter(|&i| i < u32::MAX)?, true),
        };
        if fresh {
            self.entries.push(Some((id, object)));
        } else {
            self.entries[index as usize] = Some((id, object));
        }
        self.places.insert(id, index);
        Some((index, fresh))
    }

    /// Takes back the newest insertion; `fresh` says whether it had made the slot.
    pub(crate) fn undo_insert(&mut self, index: u32, fresh: bool) -> Option<T> {
        let (id, object) = if fresh {
            debug_assert_eq!(index as usize + 1, self.entries.len());
            self.entries.pop().flatten()?
        } else {
            self.free.push(index);
            self.entries[index as usize].take()?
        };
        self.places.remove(&id);
        Some(object)
    }

    pub(crate) fn remove(&mut self, index: usize) -> Option<T> {
        let (id, object) = self.entries[index].take()?;
        self.free.push(index as u32);
        self.places.remove(&id);
        Some(object)
    }

    /// The slot of a living object.
    pub(crate) fn index_of(&self, id: I) -> Option<usize> {
        self.places.get(&id).map(|&index| index as usize)
    }

    pub(crate) fn at(&self, index: usize) -> Option<&T> {
        self.entries.get(index)?.as_ref().map(|(_, object)| object)
    }

    pub(crate) fn at_mut(&mut self, index: usize) -> Option<&mut T> {
        self.entries.get_mut(index)?.as_mut().map(|(_, object)| object)
    }

    /// The id of the living object in a slot.
    pub(crate) fn id_at(&self, index: usize) -> Option<I> {
        self.entries.get(index)?.as_ref().map(|(id, _)| *id)
    }

    /// How many objects there are.
    pub(crate) fn len(&self) -> usize {
        self.entries.len() - self.free.len()
    }

    /// Length of the slot array, living or not.
    pub(crate) fn capacity(&self) -> usize {
        self.entries.len()
    }

    /// Free slots, the next to be used last.
    pub(crate) fn free(&self) -> &[u32] {
        &self.free
    }

    /// Slots with their objects; `None` when an id stands twice, or `free` is not the list of the
    /// free slots.
    pub(crate) fn from_parts(entries: Vec<Option<(I, T)>>, free: Vec<u32>) -> Option<Self> {
        let mut places = FxHashMap::default();
        for (index, entry) in entries.iter().enumerate() {
            if let Some((id, _)) = entry
                && places.insert(*id, u32::try_from(index).ok()?).is_some()
            {
                return None;
            }
        }
        let mut sorted = free.clone();
        sorted.sort_unstable();
        let vacant = entries.iter().enumerate().filter(|(_, entry)| entry.is_none());
        let matches = vacant.map(|(index, _)| index).eq(sorted.iter().map(|&f| f as usize));
        matches.then_some(Self { entries, free, places })
    }

    /// Feeds the occupation of the slots, which decides the slots to come, to a hash. Ids are left
    /// out: no result depends on their numbers.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        self.free.hash(hash);
        self.entries.iter().for_each(|entry| entry.is_some().hash(hash));
    }

    /// Indices of living objects, ascending.
    pub(crate) fn indices(&self) -> impl Iterator<Item = usize> {
        self.entries.iter().enumerate().filter(|(_, e)| e.is_some()).map(|(i, _)| i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_follows_the_living() {
        let mut slots = Slots::default();
        for id in 0..100_000_u32 {
            let (index, _) = slots.insert(id, id).unwrap();
            assert_eq!(slots.at(index as usize), Some(&id));
            assert_eq!((slots.index_of(id), slots.id_at(index as usize)), (Some(0), Some(id)));
            slots.remove(index as usize);
            assert_eq!(slots.index_of(id), None);
        }
        assert_eq!((slots.capacity(), slots.len()), (1, 0));
    }

    #[test]
    fn undo_restores_the_slots_to_come() {
        let mut slots = Slots::default();
        for i in 0..10_u32 {
            slots.insert(i, i).unwrap();
        }
        for i in [3, 7, 5] {
            slots.remove(i);
        }
        let before = (slots.free().to_vec(), slots.capacity());
        let inserted: Vec<_> = (20..25_u32).map(|id| slots.insert(id, id).unwrap()).collect();
        assert_eq!(inserted[0], (5, false));
        assert_eq!(inserted[4], (11, true));
        for (index, fresh) in inserted.into_iter().rev() {
            slots.undo_insert(index, fresh).unwrap();
        }
        assert_eq!((slots.free().to_vec(), slots.capacity()), before);
        assert_eq!(slots.index_of(20), None);
    }

    #[test]
    fn parts_that_do_not_fit_are_refused() {
        assert!(Slots::from_parts(vec![Some((1, ())), None], vec![1]).is_some());
        for (entries, free) in [
            (vec![Some((1, ())), Some((1, ()))], vec![]),
            (vec![Some((1, ())), None], vec![]),
            (vec![Some((1, ())), None], vec![0]),
            (vec![None, None], vec![1, 1]),
            (vec![Some((1, ()))], vec![4]),
        ] {
            assert!(Slots::from_parts(entries, free).is_none());
        }
    }
}
