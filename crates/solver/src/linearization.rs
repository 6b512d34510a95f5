//! The linear system at the linearization points: one block `[J₁ … Jₖ | r]` per factor, with a
//! Jacobian for each of its unknowns.

use evergraph_model::{FactorIndex, Graph, GraphError};

/// Whitened Jacobians and residuals of all factors, in one array.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blocks {
    data: Vec<f64>,
    /// By factor slot.
    places: Vec<Place>,
    /// Starts of free places, by length.
    free: Vec<(usize, Vec<usize>)>,
    /// Numbers in free places.
    free_len: usize,
}

/// The array is compacted when free places hold more numbers than this ...
const SPARE: usize = 1 << 14;
/// ... and than this many times those in use. A place is used again only for a block of the same
/// length, and dense factors come in ever new lengths.
const SPARE_SHARE: usize = 1;

/// A block in the array: start and length; length 0 for none.
pub(crate) type Place = (usize, usize);

/// Sizes of [`Blocks`] before an insertion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mark {
    data: usize,
    places: usize,
}

/// The reason why a factor has no usable linearization.
#[derive(Clone, Debug)]
pub(crate) enum Flaw {
    /// Its residual or Jacobian holds a NaN, an infinity, or a number beyond [`LARGEST`].
    NotFinite,
    /// Its code panicked.
    Refused(GraphError),
}

impl Blocks {
    /// `[J₁ … Jₖ | r]` of a factor, column-major.
    #[inline]
    pub(crate) fn get(&self, factor: FactorIndex) -> &[f64] {
        self.at(self.places[factor.index()])
    }

    #[inline]
    fn at(&self, (start, len): Place) -> &[f64] {
        &self.data[start..start + len]
    }

    /// Makes room for a new factor and linearizes it.
    ///
    /// # Errors
    /// A [`Flaw`]; the room is then taken all the same.
    pub(crate) fn insert(
        &mut self,
        graph: &Graph,
        factor: FactorIndex,
        points: &[f64],
    ) -> Result<(), Flaw> {
        if self.places.len() <= factor.index() {
            self.places.resize(factor.index() + 1, (0, 0));
        }
        self.places[factor.index()] = self.take(graph.linearization_len(factor));
        self.relinearize(graph, factor, points)
    }

    /// Linearizes a factor again.
    ///
    /// # Errors
    /// A [`Flaw`]; the numbers of the block mean nothing then.
    pub(crate) fn relinearize(
        &mut self,
        graph: &Graph,
        factor: FactorIndex,
        points: &[f64],
    ) -> Result<(), Flaw> {
        self.linearize_at(self.places[factor.index()], graph, factor, points)
    }

    fn linearize_at(
        &mut self,
        (start, len): Place,
        graph: &Graph,
        factor: FactorIndex,
        points: &[f64],
    ) -> Result<(), Flaw> {
        let block = &mut self.data[start..start + len];
        graph.linearize(factor, points, block).map_err(Flaw::Refused)?;
        if block.iter().all(|x| x.abs() < LARGEST) { Ok(()) } else { Err(Flaw::NotFinite) }
    }

    /// Restores a block that was read by [`get`](Self::get) before.
    pub(crate) fn restore(&mut self, factor: FactorIndex, block: &[f64]) {
        let (start, len) = self.places[factor.index()];
        self.data[start..start + len].copy_from_slice(block);
    }

    /// Frees the room of a factor.
    pub(crate) fn remove(&mut self, factor: FactorIndex) {
        let place = std::mem::take(&mut self.places[factor.index()]);
        self.release(place);
    }

    /// The place of a factor's block; none for a factor that has not been inserted.
    pub(crate) fn place(&self, factor: FactorIndex) -> Place {
        self.places.get(factor.index()).copied().unwrap_or_default()
    }

    /// Reverts the newest [`insert`](Self::insert). [`place`](Self::place) and
    /// [`mark`](Self::mark) were read before it.
    pub(crate) fn undo_insert(&mut self, factor: FactorIndex, before: Place, mark: Mark) {
        let place = std::mem::replace(&mut self.places[factor.index()], before);
        if self.data.len() > mark.data {
            self.data.truncate(place.0);
        } else {
            self.release(place);
        }
        self.places.truncate(mark.places);
    }

    /// The sizes that [`undo_insert`](Self::undo_insert) goes back to.
    pub(crate) fn mark(&self) -> Mark {
        Mark { data: self.data.len(), places: self.places.len() }
    }

    fn take(&mut self, len: usize) -> Place {
        let free = self.free.iter_mut().find(|(l, _)| *l == len);
        match free.and_then(|(_, starts)| starts.pop()) {
            Some(start) => {
                self.free_len -= len;
                (start, len)
            }
            None => {
                let end = self.data.len();
                self.data.resize(end + len, 0.0);
                (end, len)
            }
        }
    }

    /// Frees a place that no factor refers to.
    pub(crate) fn release(&mut self, (start, len): Place) {
        self.free_len += len;
        match self.free.iter_mut().find(|(l, _)| *l == len) {
            _ if len == 0 => {}
            Some((_, starts)) => starts.push(start),
            None => self.free.push((len, vec![start])),
        }
    }

    /// Moves all blocks, those of an overlay too, to the front of the array when it is mostly free.
    /// Copies every number, and leaves nothing free: over many steps it costs a copy for each
    /// number that was released.
    pub(crate) fn compact(&mut self, overlay: &mut Overlay) {
        let used = self.data.len() - self.free_len;
        if self.free_len <= SPARE + SPARE_SHARE * used {
            return;
        }
        let mut data = Vec::with_capacity(used);
        for place in self.places.iter_mut().chain(&mut overlay.places) {
            let start = data.len();
            data.extend_from_slice(&self.data[place.0..place.0 + place.1]);
            place.0 = start;
        }
        self.data = data;
        self.free = Vec::new();
        self.free_len = 0;
    }

    /// Bytes of the arrays.
    pub(crate) fn memory_bytes(&self) -> usize {
        let free: usize = self.free.iter().map(|(_, starts)| 8 * starts.capacity()).sum();
        8 * self.data.capacity() + size_of::<Place>() * self.places.capacity() + free
    }
}

/// From here on products of two squares, such as `‖Jᵀr‖²`, overflow.
const LARGEST: f64 = 1e77;

/// Blocks of some factors at other linearization points. They stand in the array of the [`Blocks`],
/// so that exchanging them for the factors' own copies nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Overlay {
    /// In the order of [`insert`](Self::insert); none until it is linearized.
    places: Vec<Place>,
    /// By factor slot: position in `places`; [`NO_POSITION`] for none.
    positions: Vec<u32>,
}

const NO_POSITION: u32 = u32::MAX;

/// What [`Overlay::insert`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Inserted {
    New,
    Known,
}

impl Overlay {
    /// Takes a factor in.
    pub(crate) fn insert(&mut self, graph: &Graph, factor: FactorIndex) -> Inserted {
        if self.positions.len() < graph.factor_slots() {
            self.positions.resize(graph.factor_slots(), NO_POSITION);
        }
        if self.positions[factor.index()] != NO_POSITION {
            return Inserted::Known;
        }
        self.positions[factor.index()] = self.places.len() as u32;
        self.places.push((0, 0));
        Inserted::New
    }

    /// The position in `places` of a factor that was taken in.
    #[inline]
    pub(crate) fn position(&self, factor: FactorIndex) -> Option<usize> {
        self.positions.get(factor.index()).filter(|at| **at != NO_POSITION).map(|at| *at as usize)
    }

    /// The block at a position; empty until it is linearized.
    pub(crate) fn at<'a>(&self, blocks: &'a Blocks, position: usize) -> &'a [f64] {
        blocks.at(self.places[position])
    }

    /// The block of a factor.
    #[inline]
    pub(crate) fn get<'a>(&self, blocks: &'a Blocks, factor: FactorIndex) -> Option<&'a [f64]> {
        Some(blocks.at(self.places[self.position(factor)?]))
    }

    /// Linearizes the factor at a position.
    ///
    /// # Errors
    /// A [`Flaw`]; the room is then taken all the same.
    pub(crate) fn linearize(
        &mut self,
        blocks: &mut Blocks,
        graph: &Graph,
        (factor, position): (FactorIndex, usize),
        points: &[f64],
    ) -> Result<(), Flaw> {
        let place = blocks.take(graph.linearization_len(factor));
        self.places[position] = place;
        blocks.linearize_at(place, graph, factor, points)
    }

    /// Exchanges the block at a position with the factor's own.
    pub(crate) fn swap(&mut self, blocks: &mut Blocks, factor: FactorIndex, position: usize) {
        std::mem::swap(&mut blocks.places[factor.index()], &mut self.places[position]);
    }

    pub(crate) fn forget(&mut self, factor: FactorIndex) {
        self.positions[factor.index()] = NO_POSITION;
    }

    /// Frees the room; the factors have been forgotten.
    pub(crate) fn clear(&mut self, blocks: &mut Blocks) {
        // The first is taken first again.
        self.places.drain(..).rev().for_each(|place| blocks.release(place));
    }
}
