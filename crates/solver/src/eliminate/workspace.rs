//! What eliminations on one thread share.

use super::system::System;
use crate::dense::FrontLayout;
use crate::pool::Pool;
use crate::profile::Clock;
use crate::tree::Structure;

/// Where a variable stands in the current front.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Place {
    /// First scalar row.
    pub(super) start: u32,
    pub(super) dim: u32,
}

/// Scalars that are contiguous in a child's separator and in the front.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    /// First scalar in the child.
    pub(super) from: usize,
    /// First scalar in the front.
    pub(super) to: usize,
    pub(super) len: usize,
}

/// Buffers, never part of any result.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    pub(crate) pool: Pool,
    pub(crate) clock: Clock,
    /// By variable slot. Entries of other fronts are left in place and never read.
    pub(super) place: Vec<Place>,
    /// By column of the front: what a row's number is added to, to find the entry.
    pub(super) base: Vec<usize>,
    /// Diagonal of JᵀJ for the scalars of the current front.
    pub(super) diagonal: Vec<f64>,
    /// Errors that stand for rounding in the columns of those scalars, in units of ε; for QR.
    pub(super) rounding: Vec<f64>,
    pub(super) runs: Vec<Run>,
    /// A dense matrix: of rows for QR, of a large front.
    pub(super) square: Vec<f64>,
}

/// The dense matrix is freed when it holds more numbers than this ...
const FEW_NUMBERS: usize = 1 << 17;
/// ... and than this many times those of all cliques.
const NUMBER_SHARE: usize = 4;

impl Workspace {
    /// Frees a dense matrix that is far larger than one which a tree of so many numbers needs.
    pub(crate) fn trim(&mut self, numbers: usize) {
        if self.square.capacity() > FEW_NUMBERS + NUMBER_SHARE * numbers {
            self.square = Vec::new();
        }
    }

    /// Bytes of the pool and the dense matrix.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.pool.memory_bytes() + 8 * self.square.capacity()
    }

    /// Numbers the scalars of a front.
    #[inline(always)]
    pub(super) fn place(&mut self, system: &System<'_>, structure: &Structure) {
        if self.place.len() < system.graph.variable_slots() {
            self.place.resize(system.graph.variable_slots(), Place::default());
        }
        let mut start = 0;
        for v in structure.variables() {
            let dim = system.graph.dim_at(v) as u32;
            self.place[v.index()] = Place { start, dim };
            start += dim;
        }
        self.diagonal.clear();
        self.diagonal.resize(start as usize, 0.0);
    }

    /// Locates the columns of a front whose triangle begins at `triangle`; where that is 0 there
    /// are no frontal columns.
    #[inline(always)]
    pub(super) fn locate_columns(&mut self, layout: FrontLayout, triangle: usize) {
        let (frontal, rows) = (layout.frontal(), layout.rows());
        self.base.clear();
        self.base.extend((0..frontal).map(|column| column * rows));
        // May be less than zero; the row brings it back.
        let columns = (frontal..layout.columns()).zip(layout.diagonals());
        self.base.extend(columns.map(|(column, at)| (triangle + at).wrapping_sub(column)));
    }

    /// Maps the separator of a child to the current front, in runs; the right-hand side is the
    /// last.
    #[inline(always)]
    pub(super) fn map_child(&mut self, child: &Structure, columns: usize) {
        self.runs.clear();
        let mut from = 0;
        let variables = child.separator.iter().map(|&v| {
            let place = self.place[v.index()];
            (place.start as usize, place.dim as usize)
        });
        for (to, len) in variables.chain(std::iter::once((columns - 1, 1))) {
            match self.runs.last_mut() {
                Some(run) if run.to + run.len == to => run.len += len,
                _ => self.runs.push(Run { from, to, len }),
            }
            from += len;
        }
    }
}
