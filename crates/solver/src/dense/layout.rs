//! How the lower triangle of a front is stored: no square, no copies.
//!
//! ```text
//!   frontal columns: rectangular,    other columns: groups of `group` columns that start at the
//!   column-major, `rows` rows        same row, each group column-major
//!   | L        |                     | .              |
//!   | L L      |                     | S              |
//!   | P P      |                     | S S | S        |
//!   | P P      |                     | S S | S S      |
//!   | pad pad  |                     | pad | pad      |
//! ```
//!
//! `rows` is the number of columns rounded up to a multiple of `group`, the padding is zero, and
//! groups start at rows that are multiples of `group`: the kernels then run on whole vectors, with
//! neither masks nor remainders. What stands above the diagonal means nothing. The frontal columns
//! do not depend on how many of them there are, so that a clique can be split without a copy.

/// Fronts with more columns than this are grouped by eight (a vector of AVX-512), smaller ones by
/// four (a vector of AVX2), which wastes less.
const NARROW: usize = 64;

/// Shape of a front: `frontal` columns to eliminate and `order` others, the right-hand side the
/// last of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct FrontLayout {
    frontal: u32,
    order: u32,
}

impl FrontLayout {
    pub(crate) fn new(frontal: usize, order: usize) -> Self {
        Self { frontal: frontal as u32, order: order as u32 }
    }

    /// Columns to eliminate.
    #[inline(always)]
    pub(crate) fn frontal(self) -> usize {
        self.frontal as usize
    }

    /// Columns that stay, the right-hand side included.
    #[inline(always)]
    pub(crate) fn order(self) -> usize {
        self.order as usize
    }

    /// All columns.
    #[inline(always)]
    pub(crate) fn columns(self) -> usize {
        self.frontal() + self.order()
    }

    /// Whether the widest vectors pay.
    #[inline(always)]
    pub(crate) fn is_wide(self) -> bool {
        self.columns() > NARROW
    }

    /// Columns of the triangle that start at the same row.
    #[inline(always)]
    pub(crate) fn group(self) -> usize {
        if self.is_wide() { 8 } else { 4 }
    }

    /// Rows of a frontal column, padding included.
    #[inline(always)]
    pub(crate) fn rows(self) -> usize {
        self.columns().next_multiple_of(self.group())
    }

    /// Numbers in the frontal columns.
    #[inline(always)]
    pub(crate) fn panel_len(self) -> usize {
        self.frontal() * self.rows()
    }

    /// Numbers in the other columns.
    #[inline(always)]
    pub(crate) fn triangle_len(self) -> usize {
        self.column_at(self.columns())
    }

    /// Where column `column` (of the front, at least `frontal`) begins in the triangle; its first
    /// entry is row `column` rounded down to a multiple of `group`.
    #[inline(always)]
    fn column_at(self, column: usize) -> usize {
        let (group, rows, frontal) = (self.group(), self.rows(), self.frontal());
        let (own, first) = (column / group, frontal / group);
        if own == first {
            return (column - frontal) * (rows - group * first);
        }
        let partial = ((first + 1) * group - frontal) * (rows - group * first);
        // Whole groups in between: group · Σ (rows − group · b).
        let between = own - 1 - first;
        let sum = (own * (own - 1) - first * (first + 1)) / 2;
        let whole = group * (between * rows - group * sum);
        partial + whole + (column - group * own) * (rows - group * own)
    }

    /// Where the diagonal entry of column `column` of the front stands in the triangle; the
    /// entries below it follow.
    #[inline(always)]
    pub(crate) fn diagonal_at(self, column: usize) -> usize {
        self.column_at(column) + column % self.group()
    }

    /// [`diagonal_at`](Self::diagonal_at) of all columns of the triangle in turn.
    #[inline(always)]
    pub(crate) fn diagonals(self) -> impl Iterator<Item = usize> {
        let (group, rows) = (self.group(), self.rows());
        let mut start = 0;
        (self.frontal()..self.columns()).map(move |column| {
            let within = column & (group - 1);
            let at = start + within;
            start += rows - (column - within);
            at
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_one_behind_the_other() {
        for order in 0..140 {
            for frontal in 1..18 {
                let layout = FrontLayout::new(frontal, order);
                let (group, rows) = (layout.group(), layout.rows());
                assert!(rows >= layout.columns() && rows.is_multiple_of(group));
                let mut end = 0;
                let diagonals: Vec<usize> = layout.diagonals().collect();
                for column in frontal..frontal + order {
                    let first_row = column / group * group;
                    assert_eq!(layout.diagonal_at(column), end + column - first_row);
                    assert_eq!(layout.diagonal_at(column), diagonals[column - frontal]);
                    end += rows - first_row;
                }
                assert_eq!(layout.triangle_len(), end, "{frontal}, {order}");
            }
        }
    }
}
