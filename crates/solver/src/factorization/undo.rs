//! A record of what an update overwrites, to revert it.

use evergraph_model::{FactorIndex, Graph, VariableIndex};

use crate::linearization::{Blocks, Mark, Place};

/// Linearization points and Jacobian blocks that were overwritten, in flat arrays that are used
/// again.
#[derive(Debug, Default)]
pub(crate) struct Undo {
    points_len: usize,
    points: Vec<VariableIndex>,
    point_data: Vec<f64>,
    blocks: Vec<FactorIndex>,
    block_data: Vec<f64>,
    /// New blocks, with the place of the one before: factors whose unknowns change have one.
    inserted: Vec<(FactorIndex, Place, Mark)>,
    /// Whether pending points and blocks took the place of the smoother's own.
    has_swapped: bool,
}

impl Undo {
    /// Forgets everything; `points_len` is the length of the points now.
    pub(super) fn start(&mut self, points_len: usize) {
        self.points_len = points_len;
        self.points.clear();
        self.point_data.clear();
        self.blocks.clear();
        self.block_data.clear();
        self.inserted.clear();
        self.has_swapped = false;
    }

    /// Saves a variable's point, which is about to move.
    pub(super) fn save_point(&mut self, graph: &Graph, points: &[f64], variable: VariableIndex) {
        self.points.push(variable);
        self.point_data.extend_from_slice(&points[graph.value_range(variable)]);
    }

    /// The variables whose points were saved.
    pub(super) fn moved(&self) -> &[VariableIndex] {
        &self.points
    }

    /// Saves the block of a factor that is about to be linearized again.
    pub(super) fn save_block(&mut self, blocks: &Blocks, factor: FactorIndex) {
        self.blocks.push(factor);
        self.block_data.extend_from_slice(blocks.get(factor));
    }

    /// Remembers that a factor is about to get a new block.
    pub(super) fn save_insertion(&mut self, blocks: &Blocks, factor: FactorIndex) {
        self.inserted.push((factor, blocks.place(factor), blocks.mark()));
    }

    /// Remembers that pending points and blocks are about to be swapped in.
    pub(super) fn save_swap(&mut self) {
        self.has_swapped = true;
    }

    pub(super) fn has_swapped(&self) -> bool {
        self.has_swapped
    }

    /// Restores points and blocks. Swapped ones are exchanged back by the caller, afterwards.
    pub(super) fn revert(&self, graph: &Graph, points: &mut Vec<f64>, blocks: &mut Blocks) {
        let mut end = self.block_data.len();
        for &factor in self.blocks.iter().rev() {
            let start = end - blocks.get(factor).len();
            blocks.restore(factor, &self.block_data[start..end]);
            end = start;
        }
        for &(factor, before, mark) in self.inserted.iter().rev() {
            blocks.undo_insert(factor, before, mark);
        }
        let mut end = self.point_data.len();
        for &variable in self.points.iter().rev() {
            let range = graph.value_range(variable);
            let start = end - range.len();
            points[range].copy_from_slice(&self.point_data[start..end]);
            end = start;
        }
        points.truncate(self.points_len);
    }

    /// Frees the blocks that new ones have replaced: there is no way back from then on.
    pub(super) fn finish(&self, blocks: &mut Blocks) {
        self.inserted.iter().for_each(|&(_, before, _)| blocks.release(before));
    }
}
