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
