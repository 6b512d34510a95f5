//! The covariance of a target, as a square root.

use nalgebra::DMatrix;

use crate::motion::carried;
use crate::rank_qr::{triangle, upper_inverse};
use crate::target::Target;

/// Pivots below this share of their column's norm make an inverse that has lost half of the digits
/// or more; the information of pairs is then taken from `R_t` itself.
const TRUSTED: f64 = 1e-5;

/// `S` with `Σ = S Sᵀ`, held poses held where they are: the [right inverse](Target::right_inverse) of a target that is
/// regular but for the common motions that nothing sees.
///
/// One inverse serves all pairs: what is known of a pair follows from its rows of S at a cost linear
/// in the blanket, where eliminating all others from `R_t` is cubic.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CovarianceRoot {
    trusted: bool,
}

impl CovarianceRoot {
    /// O(n³) the first time that the target's inverse is asked for.
    pub(crate) fn of(target: &Target) -> Option<Self> {
        let held: usize = target.held().map(|held| target.dim_of(held)).sum();
        let is_regular = target.rank() + held == target.dim();
        is_regular.then(|| Self { trusted: target.is_well_conditioned() })
    }

    /// Itself, if its numbers are good enough to make factors of.
    pub(crate) fn trusted(&self) -> Option<&Self> {
        self.trusted.then_some(self)
    }

    /// The rows of some members under each other.
    pub(crate) fn rows(&self, target: &Target, members: &[usize]) -> DMatrix<f64> {
        let s = target.right_inverse();
        let mut rows = DMatrix::zeros(members.iter().map(|&m| target.dim_of(m)).sum(), s.ncols());
        let mut top = 0;
        for &m in members {
            let own = s.rows_range(target.columns(m));
            rows.rows_mut(top, own.nrows()).copy_from(&own);
            top += own.nrows();
        }
        rows
    }

    /// A root of the covariance of `other` as seen from `pose`: `S_j - A S_i` with A of [`carried`].
    pub(crate) fn seen(&self, target: &Target, pose: usize, other: usize) -> Option<DMatrix<f64>> {
        let motion = carried(&target.members[pose].value, &target.members[other].value)?;
        let mut seen = self.rows(target, &[other]);
        let own = target.right_inverse().rows_range(target.columns(pose));
        seen.gemm(-1.0, &motion, &own, 1.0);
        Some(seen)
    }

    /// `[R_ij R_ii]`, the information of `child` given `parent` (equations 2 to 4 of the GLC paper)
    /// in columns of the parent, then of the child. From the QR of the rows of both, the parent's
    /// first,
    ///
    /// ```text
    /// [U_jj  U_ji]    Σ_jj = U_jjᵀ U_jj,  Σ_ij = U_jiᵀ U_jj,  Σ_i|j = U_iiᵀ U_ii
    /// [ 0    U_ii]
    /// ```
    ///
    /// so `R_ii = U_ii⁻ᵀ` and `R_ij = -R_ii Σ_ij Σ_jj⁻¹ = -U_ii⁻ᵀ U_jiᵀ U_jj⁻ᵀ`.
    pub(crate) fn conditional(&self, target: &Target, child: usize, parent: usize) -> DMatrix<f64> {
        let u = triangle(self.rows(target, &[parent, child]).transpose());
        // The lower rows of U⁻ᵀ are these very blocks.
        let inverse = upper_inverse(&u).transpose();
        let first = target.dim_of(parent);
        inverse.rows(first, inverse.nrows() - first).into_owned()
    }
}

impl Target {
    /// S with `R_t S = I`, zero in the rows of columns that hold no pivot. O(rank³) the first time.
    pub(crate) fn right_inverse(&self) -> &DMatrix<f64> {
        self.inverse.get_or_init(|| {
            let inverse = upper_inverse(&self.root.select_columns(&self.pivots));
            let mut s = DMatrix::zeros(self.dim(), self.rank());
            for (row, &column) in self.pivots.iter().enumerate() {
                s.set_row(column, &inverse.row(row));
            }
            s
        })
    }

    /// True if [`right_inverse`](Self::right_inverse) has half of the digits or more.
    pub(crate) fn is_well_conditioned(&self) -> bool {
        let pivots = self.pivots.iter().enumerate();
        let is_large = |(row, &column): (usize, &usize)| {
            self.root[(row, column)].abs() > TRUSTED * self.scales[column]
        };
        pivots.into_iter().all(is_large)
    }
}

/// The root of the information whose covariance is `B Bᵀ`: `U⁻ᵀ` with `Bᵀ = Q U`.
pub(crate) fn information_root(b: &DMatrix<f64>) -> DMatrix<f64> {
    upper_inverse(&triangle(b.transpose())).transpose()
}
