//! Large fronts: faer's blocked kernels on a square copy.

use faer::linalg::cholesky::llt::factor::{
    LltError, LltParams, LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, Par, Spec};

use super::cholesky::{BadPivot, PartialCholesky};
use super::layout::FrontLayout;

/// As [`PartialCholesky`], always on one thread: parallelism comes from the tree. `square` is
/// scratch.
pub(super) fn partial_cholesky(
    front: PartialCholesky<'_>,
    square: &mut Vec<f64>,
) -> Result<f64, BadPivot> {
    let PartialCholesky { layout, panel, triangle, diagonal, bound } = front;
    let (n, frontal) = (layout.columns(), layout.frontal());
    square.resize(n * n, 0.0);
    for_each_column(layout, |column, from_triangle, start| {
        let source = if from_triangle { &triangle[start..] } else { &panel[start..] };
        square[column * n + column..(column + 1) * n].copy_from_slice(&source[..n - column]);
    });
    let matrix = MatMut::from_column_major_slice_mut(&mut square[..n * n], n, n);
    let (mut a, _, mut b, c) = matrix.split_at_mut(frontal, frontal);
    let params = Spec::<LltParams, f64>::default();
    let scratch = cholesky_in_place_scratch::<f64>(frontal, Par::Seq, params);
    let mut memory = faer::dyn_stack::MemBuffer::new(scratch);
    let stack = faer::dyn_stack::MemStack::new(&mut memory);
    if let Err(error) =
        cholesky_in_place(a.as_mut(), LltRegularization::default(), Par::Seq, stack, params)
    {
        let LltError::NonPositivePivot { index } = error;
        return Err(BadPivot { column: index.min(frontal - 1) });
    }
    let mut smallest = f64::INFINITY;
    for (column, scale) in diagonal[..frontal].iter().enumerate() {
        let pivot = a[(column, column)] * a[(column, column)];
        if !bound.allows(pivot, *scale, smallest) {
            return Err(BadPivot { column });
        }
        smallest = smallest.min(pivot / scale);
    }
    // P = B L⁻ᵀ, solved as L Pᵀ = Bᵀ.
    solve_lower_triangular_in_place(a.as_ref(), b.as_mut().transpose_mut(), Par::Seq);
    matmul(
        c,
        BlockStructure::TriangularLower,
        Accum::Add,
        b.as_ref(),
        BlockStructure::Rectangular,
        b.as_ref().transpose(),
        BlockStructure::Rectangular,
        -1.0,
        Par::Seq,
    );
    for_each_column(layout, |column, from_triangle, start| {
        let target = if from_triangle { &mut triangle[start..] } else { &mut panel[start..] };
        target[..n - column].copy_from_slice(&square[column * n + column..(column + 1) * n]);
    });
    Ok(smallest)
}

/// Calls `visit` with each column of a front, whether it stands in the triangle, and where its
/// diagonal entry is there or in the panel.
fn for_each_column(layout: FrontLayout, mut visit: impl FnMut(usize, bool, usize)) {
    let (frontal, rows) = (layout.frontal(), layout.rows());
    for column in 0..frontal {
        visit(column, false, column * rows + column);
    }
    for column in frontal..layout.columns() {
        visit(column, true, layout.diagonal_at(column));
    }
}
