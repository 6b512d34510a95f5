//! What a factor reads ([`Arguments`]) and writes ([`Linearization`]).

use nalgebra::{SMatrix, SVector};

use crate::manifold::Manifold;

/// The values of a factor's variables, in the order of its keys.
#[derive(Clone, Copy, Debug)]
pub struct Arguments<'a> {
    storages: &'a [&'a [f64]],
}

impl<'a> Arguments<'a> {
    /// Wraps stored values, one slice per key.
    pub fn new(storages: &'a [&'a [f64]]) -> Self {
        Self { storages }
    }

    /// The value of the variable at `position` in the factor's keys. The graph has checked the
    /// type when the factor came in ([`crate::Factor::accepts`]).
    pub fn get<V: Manifold>(&self, position: usize) -> V {
        V::load(self.storages[position])
    }

    /// The stored numbers of the variable at `position`.
    pub fn storage(&self, position: usize) -> &'a [f64] {
        self.storages[position]
    }

    /// How many variables there are.
    pub fn len(&self) -> usize {
        self.storages.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.storages.is_empty()
    }
}

/// Where a factor writes its whitened Jacobian blocks and residual: one column-major matrix
/// `[J₁ … Jₖ | r]` owned by the caller, with `rows` rows. It is zero when the factor gets it.
#[derive(Debug)]
pub struct Linearization<'a> {
    rows: usize,
    /// First column of each block, and of the residual at the end.
    columns: &'a [u32],
    data: &'a mut [f64],
}

impl<'a> Linearization<'a> {
    /// Wraps `data` (`rows` × (Σ dimensions + 1)); `columns` has the first column of each key's
    /// block and then that of the residual.
    pub fn new(rows: usize, columns: &'a [u32], data: &'a mut [f64]) -> Self {
        debug_assert_eq!(data.len(), rows * (*columns.last().unwrap_or(&0) as usize + 1));
        Self { rows, columns, data }
    }

    /// Number of rows, the residual's dimension.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The Jacobian block of the variable at `position`, column-major.
    pub fn block_mut(&mut self, position: usize) -> &mut [f64] {
        let (start, end) = (self.columns[position] as usize, self.columns[position + 1] as usize);
        &mut self.data[start * self.rows..end * self.rows]
    }

    /// The residual.
    pub fn residual_mut(&mut self) -> &mut [f64] {
        let start = self.data.len() - self.rows;
        &mut self.data[start..]
    }

    /// The whole of `[J₁ … Jₖ | r]`, column-major; for wrappers that rescale rows.
    pub fn data_mut(&mut self) -> &mut [f64] {
        self.data
    }

    /// Writes the block of the variable at `position`.
    pub fn set_block<const R: usize, const C: usize>(
        &mut self,
        position: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        self.block_mut(position).copy_from_slice(block.as_slice());
    }

    /// Writes the residual.
    pub fn set_residual<const R: usize>(&mut self, residual: &SVector<f64, R>) {
        self.residual_mut().copy_from_slice(residual.as_slice());
    }
}
