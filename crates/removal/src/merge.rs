//! Merging of terms on one variable.

use nalgebra::{DMatrix, DVector};

use crate::neighborhood::Read;
use crate::potential::Potential;
use crate::rank_qr::{back_substitute, column_norms, echelon};

/// A term on one variable that takes in all factors of its form on that variable, without approximation: otherwise they
/// would pile up on variables that stay for long.
pub(crate) struct Merged {
    pub(crate) term: Potential,
    /// Its minimum, from the estimate on.
    pub(crate) offset: DVector<f64>,
    pub(crate) reads: Vec<Read>,
    /// `½ min ‖[G; J] ξ - [G d; b]‖²`, the error that is left at the common minimum.
    pub(crate) disagreement: f64,
}

impl Merged {
    /// `None` when there is nothing to merge.
    pub(crate) fn of(
        potential: &Potential,
        offset: &DVector<f64>,
        reads: Vec<Read>,
    ) -> Option<Self> {
        if reads.is_empty() {
            return None;
        }
        let n = offset.len();
        let count = potential.rows.nrows() + reads.iter().map(|r| r.rows.nrows()).sum::<usize>();
        let mut stack = DMatrix::zeros(count, n + 1);
        let mut top = potential.rows.nrows();
        stack.view_mut((0, 0), (top, n)).copy_from(&potential.rows);
        stack.view_mut((0, n), (top, 1)).copy_from(&(&potential.rows * offset));
        for read in &reads {
            stack.rows_mut(top, read.rows.nrows()).copy_from(&read.rows);
            top += read.rows.nrows();
        }
        let scales = column_norms(&stack, n);
        let pivots = echelon(&mut stack, n, &scales);
        let rank = pivots.len();
        let rows = stack.view((0, 0), (rank, n)).into_owned();
        let rhs = stack.column(n);
        let offset = back_substitute(&rows, &pivots, rhs.rows(0, rank).into_owned().as_slice());
        let disagreement = 0.5 * rhs.rows(rank, count - rank).norm_squared();
        let term = Potential { rows, ..potential.clone() };
        Some(Self { term, offset, reads, disagreement })
    }
}
