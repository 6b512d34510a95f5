//! The linear system at the linearization points: one block `[J₁ … Jₖ | r]` per factor.

use evergraph_model::Graph;

/// Whitened Jacobians and residuals of all factors, in one array.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blocks {
    data: Vec<f64>,
    /// By factor slot.
    places: Vec<Place>,
    /// Starts of free places, by length.
    free: Vec<(usize, Vec<usize>)>,
}

/// Where a block stands: start and length; length 0 for none.
type Place = (usize, usize);

impl Blocks {
    /// `[J₁ … Jₖ | r]` of a factor, column-major.
    #[inline]
    pub(crate) fn get(&self, factor: usize) -> &[f64] {
        self.at(self.places[factor])
    }

    #[inline]
    fn at(&self, (start, len): Place) -> &[f64] {
        &self.data[start..start + len]
    }

    /// Makes room for a new factor and linearizes it. Returns whether all numbers are finite.
    pub(crate) fn insert(&mut self, graph: &Graph, factor: usize, points: &[f64]) -> bool {
        if self.places.len() <= factor {
            self.places.resize(factor + 1, (0, 0));
        }
        self.places[factor] = self.take(graph.linearization_len(factor));
        self.relinearize(graph, factor, points)
    }

    /// Linearizes a factor again. Returns whether all numbers are finite.
    pub(crate) fn relinearize(&mut self, graph: &Graph, factor: usize, points: &[f64]) -> bool {
        self.linearize_at(self.places[factor], graph, factor, points)
    }

    fn linearize_at(
        &mut self,
        (start, len): Place,
        graph: &Graph,
        factor: usize,
        points: &[f64],
    ) -> bool {
        let block = &mut self.data[start..start + len];
        graph.linearize(factor, points, block);
        block.iter().all(|x| x.is_finite())
    }

    /// Puts a block back that was read by [`get`](Self::get) before.
    pub(crate) fn restore(&mut self, factor: usize, block: &[f64]) {
        let (start, len) = self.places[factor];
        self.data[start..start + len].copy_from_slice(block);
    }

    pub(crate) fn remove(&mut self, factor: usize) {
        let place = std::mem::take(&mut self.places[factor]);
        self.give(place);
    }

    /// Takes back the newest [`insert`](Self::insert): [`mark`](Self::mark) was called before it.
    pub(crate) fn undo_insert(&mut self, factor: usize, mark: (usize, usize)) {
        let place = std::mem::take(&mut self.places[factor]);
        if self.data.len() > mark.0 {
            self.data.truncate(place.0);
        } else {
            self.give(place);
        }
        self.places.truncate(mark.1);
    }

    /// The sizes that [`undo_insert`](Self::undo_insert) goes back to.
    pub(crate) fn mark(&self) -> (usize, usize) {
        (self.data.len(), self.places.len())
    }

    fn take(&mut self, len: usize) -> Place {
        let free = self.free.iter_mut().find(|(l, _)| *l == len);
        let start = free.and_then(|(_, starts)| starts.pop()).unwrap_or_else(|| {
            let end = self.data.len();
            self.data.resize(end + len, 0.0);
            end
        });
        (start, len)
    }

    fn give(&mut self, (start, len): Place) {
        match self.free.iter_mut().find(|(l, _)| *l == len) {
            _ if len == 0 => {}
            Some((_, starts)) => starts.push(start),
            None => self.free.push((len, vec![start])),
        }
    }
}

/// Blocks of some factors at other linearization points. They stand in the array of the [`Blocks`],
/// so that exchanging them for the factors' own copies nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Overlay {
    /// In the order of [`insert`](Self::insert); none until it is linearized.
    places: Vec<Place>,
    /// By factor slot: position in `places`; `u32::MAX` for none.
    positions: Vec<u32>,
}

impl Overlay {
    /// Takes a factor in; whether it was not.
    pub(crate) fn insert(&mut self, graph: &Graph, factor: usize) -> bool {
        if self.positions.len() < graph.factor_slots() {
            self.positions.resize(graph.factor_slots(), u32::MAX);
        }
        let is_new = self.positions[factor] == u32::MAX;
        if is_new {
            self.positions[factor] = self.places.len() as u32;
            self.places.push((0, 0));
        }
        is_new
    }

    /// Where in `places` a factor that was taken in is.
    #[inline]
    pub(crate) fn position(&self, factor: usize) -> Option<usize> {
        self.positions.get(factor).filter(|at| **at != u32::MAX).map(|at| *at as usize)
    }

    /// The block of a factor.
    #[inline]
    pub(crate) fn get<'a>(&self, blocks: &'a Blocks, factor: usize) -> Option<&'a [f64]> {
        Some(blocks.at(self.places[self.position(factor)?]))
    }

    /// Linearizes a factor that was taken in. Returns whether all numbers are finite.
    pub(crate) fn linearize(
        &mut self,
        blocks: &mut Blocks,
        graph: &Graph,
        factor: usize,
        points: &[f64],
    ) -> bool {
        let Some(position) = self.position(factor) else { return false };
        let place = blocks.take(graph.linearization_len(factor));
        self.places[position] = place;
        blocks.linearize_at(place, graph, factor, points)
    }

    /// Exchanges the block at a position with the factor's own.
    pub(crate) fn swap(&mut self, blocks: &mut Blocks, factor: usize, position: usize) {
        std::mem::swap(&mut blocks.places[factor], &mut self.places[position]);
    }

    pub(crate) fn forget(&mut self, factor: usize) {
        self.positions[factor] = u32::MAX;
    }

    /// Frees the room; the factors have been forgotten.
    pub(crate) fn clear(&mut self, blocks: &mut Blocks) {
        // The first is taken first again.
        self.places.drain(..).rev().for_each(|place| blocks.give(place));
    }
}
