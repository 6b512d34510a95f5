//! The distance of a term's minimum from the estimate.

use nalgebra::{DMatrix, DVector};

use crate::motion::{carried, rotation_part};
use crate::potential::Potential;
use crate::rank_qr::triangle;
use crate::target::Target;

/// The minimum of a term, in coordinates relative to its first member where others move with it.
pub(crate) struct Minimum {
    /// First entry and rotation part of each member.
    parts: Vec<(usize, usize, usize)>,
    rows: DMatrix<f64>,
    offset: DVector<f64>,
}

impl Minimum {
    pub(crate) fn of(target: &Target, potential: &Potential, offset: &DVector<f64>) -> Self {
        let value = |k: usize| &target.members[potential.members[k]].value;
        let (mut rows, mut offset) = (potential.rows.clone(), offset.clone());
        let root = offset.rows(0, value(0).dim()).into_owned();
        let mut parts = Vec::with_capacity(potential.members.len());
        let mut start = 0;
        for k in 0..potential.members.len() {
            let dim = value(k).dim();
            let motion = carried(value(0), value(k)).filter(|_| k > 0);
            if let Some(motion) = &motion {
                let mut own = offset.rows_mut(start, dim);
                own -= motion * &root;
                let carried = rows.columns(start, dim) * motion;
                let mut first = rows.columns_mut(0, root.len());
                first += carried;
            }
            if k > 0 {
                parts.push((start, dim, rotation_part(value(k).kind())));
            }
            start += dim;
        }
        if potential.relative {
            rows.columns_mut(0, root.len()).fill(0.0);
        }
        Self { parts, rows, offset }
    }

    /// The largest turn of a member relative to the first. A turn that all have in common only says how hard a linear
    /// factor pulls, as its length does: it bends with the motion of its variables, not with its offset.
    pub(crate) fn rotation(&self) -> f64 {
        let turn =
            |&(start, dim, turn): &(_, usize, _)| self.offset.rows(start + dim - turn, turn).norm();
        self.parts.iter().map(turn).fold(0.0, f64::max)
    }

    /// Where the minimum would be beside a prior of 1 m and 1 rad at the estimate, the `d'` of least
    /// `‖G d' - G d‖² + ‖d'‖²`: what is hardly known stays there.
    pub(crate) fn known(mut self) -> Self {
        let (rows, n) = self.rows.shape();
        let mut stack = DMatrix::zeros(rows + n, n + 1);
        stack.view_mut((0, 0), (rows, n)).copy_from(&self.rows);
        stack.view_mut((0, n), (rows, 1)).copy_from(&(&self.rows * &self.offset));
        stack.view_mut((rows, 0), (n, n)).fill_with_identity();
        let u = triangle(stack);
        let solution = u.view((0, 0), (n, n)).solve_upper_triangular(&u.view((0, n), (n, 1)));
        match solution.filter(|known| known.iter().all(|x| x.is_finite())) {
            Some(known) => self.offset = known.column(0).into_owned(),
            // Numbers that left the range of `f64` are not to be trusted.
            None => self.offset.fill(f64::INFINITY),
        }
        self
    }
}
