//! The linear system at the linearization points: one block `[J₁ … Jₖ | r]` per factor.

use evergraph_model::Graph;

/// Whitened Jacobians and residuals of all factors, in one array.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blocks {
    data: Vec<f64>,
    /// By factor slot: start and length; length 0 for none.
    ranges: Vec<(usize, usize)>,
    /// Starts of freed ranges, by length.
    free: Vec<(usize, Vec<usize>)>,
}

impl Blocks {
    /// `[J₁ … Jₖ | r]` of a factor, column-major.
    pub(crate) fn get(&self, factor: usize) -> &[f64] {
        let (start, len) = self.ranges[factor];
        &self.data[start..start + len]
    }

    /// Makes room for a new factor and linearizes it. Returns whether all numbers are finite.
    pub(crate) fn insert(&mut self, graph: &Graph, factor: usize, points: &[f64]) -> bool {
        let len = graph.linearization_len(factor);
        let reused =
            self.free.iter_mut().find(|(l, _)| *l == len).and_then(|(_, starts)| starts.pop());
        let start = reused.unwrap_or_else(|| {
            let end = self.data.len();
            self.data.resize(end + len, 0.0);
            end
        });
        if self.ranges.len() <= factor {
            self.ranges.resize(factor + 1, (0, 0));
        }
        self.ranges[factor] = (start, len);
        self.relinearize(graph, factor, points)
    }

    /// Linearizes a factor again. Returns whether all numbers are finite.
    pub(crate) fn relinearize(&mut self, graph: &Graph, factor: usize, points: &[f64]) -> bool {
        let (start, len) = self.ranges[factor];
        let block = &mut self.data[start..start + len];
        graph.linearize(factor, points, block);
        block.iter().all(|x| x.is_finite())
    }

    /// Puts a block back that was read by [`get`](Self::get) before.
    pub(crate) fn restore(&mut self, factor: usize, block: &[f64]) {
        let (start, len) = self.ranges[factor];
        self.data[start..start + len].copy_from_slice(block);
    }

    /// Exchanges a block with another.
    pub(crate) fn swap(&mut self, factor: usize, block: &mut [f64]) {
        let (start, len) = self.ranges[factor];
        self.data[start..start + len].swap_with_slice(block);
    }

    pub(crate) fn remove(&mut self, factor: usize) {
        let (start, len) = std::mem::take(&mut self.ranges[factor]);
        match self.free.iter_mut().find(|(l, _)| *l == len) {
            Some((_, starts)) => starts.push(start),
            None => self.free.push((len, vec![start])),
        }
    }

    /// Takes back the newest [`insert`](Self::insert): [`mark`](Self::mark) was called before it.
    pub(crate) fn undo_insert(&mut self, factor: usize, mark: (usize, usize)) {
        let (start, len) = std::mem::take(&mut self.ranges[factor]);
        if self.data.len() > mark.0 {
            self.data.truncate(start);
        } else if let Some((_, starts)) = self.free.iter_mut().find(|(l, _)| *l == len) {
            starts.push(start);
        }
        self.ranges.truncate(mark.1);
    }

    /// The sizes that [`undo_insert`](Self::undo_insert) goes back to.
    pub(crate) fn mark(&self) -> (usize, usize) {
        (self.data.len(), self.ranges.len())
    }
}

/// Blocks of some factors at other linearization points.
#[derive(Clone, Debug, Default)]
pub(crate) struct Overlay {
    data: Vec<f64>,
    /// By place: start and length; length 0 until it is linearized.
    ranges: Vec<(usize, u32)>,
    /// By factor slot; `u32::MAX` for none.
    places: Vec<u32>,
}

impl Overlay {
    /// Gives a factor a place; whether it had none.
    pub(crate) fn insert(&mut self, graph: &Graph, factor: usize) -> bool {
        if self.places.len() < graph.factor_slots() {
            self.places.resize(graph.factor_slots(), u32::MAX);
        }
        let is_new = self.places[factor] == u32::MAX;
        if is_new {
            self.places[factor] = self.ranges.len() as u32;
            self.ranges.push((0, 0));
        }
        is_new
    }

    /// The place of a factor's block.
    #[inline]
    pub(crate) fn place(&self, factor: usize) -> Option<usize> {
        self.places.get(factor).filter(|place| **place != u32::MAX).map(|place| *place as usize)
    }

    /// The block of a factor.
    #[inline]
    pub(crate) fn get(&self, factor: usize) -> Option<&[f64]> {
        let (start, len) = self.ranges[self.place(factor)?];
        Some(&self.data[start..start + len as usize])
    }

    /// The block at a place.
    pub(crate) fn at_mut(&mut self, place: usize) -> &mut [f64] {
        let (start, len) = self.ranges[place];
        &mut self.data[start..start + len as usize]
    }

    /// Linearizes a factor that has a place. Returns whether all numbers are finite.
    pub(crate) fn linearize(&mut self, graph: &Graph, factor: usize, points: &[f64]) -> bool {
        let Some(place) = self.place(factor) else { return false };
        let (start, len) = (self.data.len(), graph.linearization_len(factor));
        self.ranges[place] = (start, len as u32);
        self.data.resize(start + len, 0.0);
        let block = &mut self.data[start..];
        graph.linearize(factor, points, block);
        block.iter().all(|x| x.is_finite())
    }

    pub(crate) fn forget(&mut self, factor: usize) {
        self.places[factor] = u32::MAX;
    }

    /// Frees the room; the factors have been forgotten.
    pub(crate) fn clear(&mut self) {
        self.data.clear();
        self.ranges.clear();
    }
}
