//! Exact minimum degree on rows of bits.
//!
//! The eliminated graph is kept explicitly, one bit set per variable, so a step is a handful of
//! word operations per neighbour, degrees are exact (approximate ones cost fill), and the symbolic
//! structure falls out of the same pass.

use super::elimination::Elimination;
use super::groups::Groups;

const NONE: u32 = u32::MAX;

/// Buffers of the ordering.
#[derive(Debug, Default)]
pub(super) struct MinimumDegree {
    rows: Vec<u64>,
    pivot_row: Vec<u64>,
    buckets: Buckets,
}

impl MinimumDegree {
    /// Orders `n` variables by minimum degree, `last` (if given) after all others. Ties go to the
    /// variable whose degree has not changed for longest, at the start to the one numbered first:
    /// eliminations spread over the graph and the tree stays shallow (a chain of n variables, which
    /// the opposite rule would eliminate from one end to the other, has depth O(log n)).
    pub(super) fn order(
        &mut self,
        n: usize,
        groups: &Groups,
        last: Option<u32>,
        elimination: &mut Elimination,
    ) {
        let words = n.div_ceil(64);
        let Self { rows, pivot_row, buckets } = self;
        rows.clear();
        rows.resize(n * words, 0);
        for group in groups.iter() {
            for &a in group {
                let row = &mut rows[a as usize * words..][..words];
                for &b in group {
                    row[b as usize / 64] |= 1 << (b % 64);
                }
                row[a as usize / 64] &= !(1 << (a % 64));
            }
        }
        buckets.start(n);
        for v in (0..n as u32).filter(|&v| Some(v) != last) {
            buckets.insert(v, count(&rows[v as usize * words..][..words]));
        }
        elimination.start(n);
        while let Some(v) = buckets.pop_smallest() {
            pivot_row.clear();
            pivot_row.extend_from_slice(&rows[v as usize * words..][..words]);
            let first = elimination.members.len();
            elimination.push(v, bits(pivot_row));
            for i in first..elimination.members.len() {
                let u = elimination.members[i];
                let row = &mut rows[u as usize * words..][..words];
                let mut degree = 0;
                for (w, p) in row.iter_mut().zip(&*pivot_row) {
                    *w |= p;
                    degree += w.count_ones();
                }
                for gone in [u, v] {
                    let word = &mut row[gone as usize / 64];
                    degree -= (*word >> (gone % 64) & 1) as u32;
                    *word &= !(1 << (gone % 64));
                }
                if Some(u) != last {
                    buckets.move_to(u, degree);
                }
            }
        }
        if let Some(last) = last {
            elimination.push(last, []);
        }
    }
}

fn count(row: &[u64]) -> u32 {
    row.iter().map(|w| w.count_ones()).sum()
}

fn bits(row: &[u64]) -> impl Iterator<Item = u32> {
    row.iter().enumerate().flat_map(|(i, &word)| {
        std::iter::successors(Some(word), |w| Some(w & w.wrapping_sub(1)))
            .take_while(|w| *w != 0)
            .map(move |w| i as u32 * 64 + w.trailing_zeros())
    })
}

/// Variables in doubly linked lists by degree; they come in at the tail and leave at the head.
#[derive(Debug, Default)]
struct Buckets {
    head: Vec<u32>,
    tail: Vec<u32>,
    next: Vec<u32>,
    previous: Vec<u32>,
    degree: Vec<u32>,
    smallest: usize,
}

impl Buckets {
    /// Empties the lists, for `n` variables.
    fn start(&mut self, n: usize) {
        self.head.clear();
        self.head.resize(n + 1, NONE);
        self.tail.clear();
        self.tail.resize(n + 1, NONE);
        for list in [&mut self.next, &mut self.previous, &mut self.degree] {
            list.resize(n, NONE);
        }
        self.smallest = 0;
    }

    fn insert(&mut self, v: u32, degree: u32) {
        let d = degree as usize;
        let tail = std::mem::replace(&mut self.tail[d], v);
        match tail {
            NONE => self.head[d] = v,
            tail => self.next[tail as usize] = v,
        }
        self.previous[v as usize] = tail;
        self.next[v as usize] = NONE;
        self.degree[v as usize] = degree;
        self.smallest = self.smallest.min(d);
    }

    fn remove(&mut self, v: u32) {
        let d = self.degree[v as usize] as usize;
        let (next, previous) = (self.next[v as usize], self.previous[v as usize]);
        match next {
            NONE => self.tail[d] = previous,
            next => self.previous[next as usize] = previous,
        }
        match previous {
            NONE => self.head[d] = next,
            previous => self.next[previous as usize] = next,
        }
    }

    fn move_to(&mut self, v: u32, degree: u32) {
        self.remove(v);
        self.insert(v, degree);
    }

    fn pop_smallest(&mut self) -> Option<u32> {
        while self.smallest < self.head.len() {
            let v = self.head[self.smallest];
            if v != NONE {
                self.remove(v);
                return Some(v);
            }
            self.smallest += 1;
        }
        None
    }
}
