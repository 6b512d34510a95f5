//! Who is near: points in a hash map of square cells.

use std::collections::HashMap;

/// At most so many points of a cell are looked at, evenly spread over the time in which they came.
/// It bounds the work at a place that is visited all the time, and so keeps a world linear.
const LOOKED_AT: usize = 64;

/// Indices of points by the cell that they fall into.
///
/// The map is only ever asked for a key, so its order reaches no result.
#[derive(Clone, Debug)]
pub(crate) struct Cells<const D: usize> {
    size: f64,
    cells: HashMap<[i64; D], Vec<u32>>,
}

impl<const D: usize> Cells<D> {
    /// Cells with sides of `size` meters: the largest radius of a query.
    pub(crate) fn new(size: f64) -> Self {
        Self { size, cells: HashMap::new() }
    }

    /// Adds a point; indices must come in increasing order.
    pub(crate) fn insert(&mut self, at: &[f64; D], index: u32) {
        let cell = self.cell(at);
        self.cells.entry(cell).or_default().push(index);
    }

    /// Calls `visit` with indices below `before` of all cells that touch the cell of `at`, in an
    /// order that depends on the points only.
    pub(crate) fn near(&self, at: &[f64; D], before: u32, mut visit: impl FnMut(u32)) {
        let center = self.cell(at);
        for neighbor in 0..3_i64.pow(D as u32) {
            let mut rest = neighbor;
            // Far out, where cells saturate, wrapping keeps the neighbours distinct.
            let cell = center.map(|coordinate| {
                let step = rest % 3 - 1;
                rest /= 3;
                coordinate.wrapping_add(step)
            });
            let Some(points) = self.cells.get(&cell) else { continue };
            let earlier = points.partition_point(|&index| index < before);
            let looked_at = earlier.min(LOOKED_AT);
            for i in 0..looked_at {
                visit(points[i * earlier / looked_at]);
            }
        }
    }

    fn cell(&self, at: &[f64; D]) -> [i64; D] {
        at.map(|coordinate| (coordinate / self.size).floor() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found<const D: usize>(cells: &Cells<D>, at: [f64; D], before: u32) -> Vec<u32> {
        let mut all = Vec::new();
        cells.near(&at, before, |index| all.push(index));
        all.sort_unstable();
        all
    }

    #[test]
    fn all_points_within_the_size_are_found_across_the_origin() {
        let mut cells = Cells::new(2.0);
        for (index, x) in [-5.0, -1.9, -0.1, 0.1, 1.9, 5.0].into_iter().enumerate() {
            cells.insert(&[x, 0.0], index as u32);
        }
        assert_eq!(found(&cells, [0.0, 0.0], 6), [1, 2, 3, 4]);
        assert_eq!(found(&cells, [0.0, 0.0], 3), [1, 2]);
        assert_eq!(found(&cells, [0.0, 9.0], 6), [0_u32; 0]);
    }

    #[test]
    fn a_crowded_cell_is_sampled_without_repetition() {
        let mut cells = Cells::new(1.0);
        for index in 0..1000 {
            cells.insert(&[0.5, 0.5, 0.5], index);
        }
        let seen = found(&cells, [0.5, 0.5, 0.5], 900);
        assert_eq!(seen.len(), LOOKED_AT);
        assert!(seen.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(seen[0] < 100 && seen[LOOKED_AT - 1] >= 800 && seen[LOOKED_AT - 1] < 900);
    }

    #[test]
    fn a_tiny_size_saturates_without_repetition() {
        let mut cells = Cells::new(1e-300);
        cells.insert(&[1.0, -1.0], 0);
        assert_eq!(found(&cells, [1.0, -1.0], 1), [0]);
    }
}
