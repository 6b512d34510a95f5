//! What it takes to go back to before a change was linearized.

use evergraph_model::Graph;

use crate::linearization::Blocks;

/// Linearization points and Jacobian blocks that were overwritten, in flat arrays that are used
/// again.
#[derive(Debug, Default)]
pub(crate) struct Undo {
    points_len: usize,
    points: Vec<u32>,
    point_data: Vec<f64>,
    blocks: Vec<u32>,
    block_data: Vec<f64>,
    inserted: Vec<(u32, (usize, usize))>,
}

impl Undo {
    /// Forgets everything; `points_len` is the length of the points now.
    pub(crate) fn start(&mut self, points_len: usize) {
        self.points_len = points_len;
        self.points.clear();
        self.point_data.clear();
        self.blocks.clear();
        self.block_data.clear();
        self.inserted.clear();
    }

    /// A variable's point is about to move.
    pub(crate) fn save_point(&mut self, graph: &Graph, points: &[f64], variable: u32) {
        self.points.push(variable);
        self.point_data.extend_from_slice(&points[graph.value_range(variable as usize)]);
    }

    /// A factor is about to be linearized again.
    pub(crate) fn save_block(&mut self, blocks: &Blocks, factor: u32) {
        self.blocks.push(factor);
        self.block_data.extend_from_slice(blocks.get(factor as usize));
    }

    /// A factor is about to be linearized for the first time.
    pub(crate) fn save_insertion(&mut self, blocks: &Blocks, factor: u32) {
        self.inserted.push((factor, blocks.mark()));
    }

    /// Puts everything back.
    pub(crate) fn take_back(&mut self, graph: &Graph, points: &mut Vec<f64>, blocks: &mut Blocks) {
        let mut end = self.block_data.len();
        for &factor in self.blocks.iter().rev() {
            let start = end - blocks.get(factor as usize).len();
            blocks.restore(factor as usize, &self.block_data[start..end]);
            end = start;
        }
        for &(factor, mark) in self.inserted.iter().rev() {
            blocks.undo_insert(factor as usize, mark);
        }
        let mut end = self.point_data.len();
        for &variable in self.points.iter().rev() {
            let range = graph.value_range(variable as usize);
            let start = end - range.len();
            points[range].copy_from_slice(&self.point_data[start..end]);
            end = start;
        }
        points.truncate(self.points_len);
        self.start(self.points_len);
    }
}
