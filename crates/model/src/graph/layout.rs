//! Where the numbers of each variable stand in flat arrays.

use serde::{Deserialize, Serialize};

/// Ranges of a growing array; freed ones are used again for objects of exactly the same size.
#[derive(Clone, Debug, Default, PartialEq, Hash, Serialize, Deserialize)]
pub(super) struct Layout {
    pub(super) len: u32,
    /// Starts of freed ranges, by size.
    free: Vec<(u32, Vec<u32>)>,
}

impl Layout {
    /// The start and size of a range. The caller has checked that the array stays below 2³².
    pub(super) fn allocate(&mut self, size: u32) -> (u32, u32) {
        // An empty range takes nothing, so there is nothing to give back or undo either.
        if size == 0 {
            return (0, 0);
        }
        if let Some((_, starts)) = self.free.iter_mut().find(|(s, _)| *s == size)
            && let Some(start) = starts.pop()
        {
            return (start, size);
        }
        let start = self.len;
        self.len += size;
        (start, size)
    }

    pub(super) fn release(&mut self, (start, size): (u32, u32)) {
        if size == 0 {
            return;
        }
        match self.free.iter_mut().find(|(s, _)| *s == size) {
            Some((_, starts)) => starts.push(start),
            None => self.free.push((size, vec![start])),
        }
    }

    /// Takes back the newest `allocate`, given the length before it.
    pub(super) fn undo_allocate(&mut self, range: (u32, u32), len_before: u32) {
        if self.len > len_before {
            self.len = len_before;
        } else {
            self.release(range);
        }
    }

    /// Whether these ranges and the freed ones cover the array exactly, each place once.
    pub(super) fn is_covered_by(&self, ranges: impl Iterator<Item = (u32, u32)>) -> bool {
        let freed =
            self.free.iter().flat_map(|(size, starts)| starts.iter().map(|&start| (start, *size)));
        let mut all: Vec<(u32, u32)> = ranges.chain(freed).filter(|range| range.1 > 0).collect();
        all.sort_unstable();
        let end = all.iter().try_fold(
            0,
            |end: u32, &(start, size)| {
                if start == end { end.checked_add(size) } else { None }
            },
        );
        end == Some(self.len)
    }
}
