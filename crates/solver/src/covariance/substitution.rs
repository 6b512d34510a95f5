//! Forward substitution on the way to the root.

use std::collections::BTreeMap;

use evergraph_model::VariableIndex;
use nalgebra::DMatrix;

use crate::factorization::Factorization;
use crate::tree::Clique;

/// Several right-hand sides U on the variables of some cliques, a row per scalar, and the rows Y that
/// have been solved for.
pub(super) struct RightHandSide {
    columns: usize,
    data: Vec<f64>,
    /// By variable slot: its first row.
    row_of: BTreeMap<VariableIndex, usize>,
    solved: Vec<f64>,
}

impl RightHandSide {
    pub(super) fn new(columns: usize) -> Self {
        Self { columns, data: Vec::new(), row_of: BTreeMap::new(), solved: Vec::new() }
    }

    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// Zeros for variables that have no rows yet.
    pub(super) fn add_rows(
        &mut self,
        factorization: &Factorization,
        variables: impl Iterator<Item = VariableIndex>,
    ) {
        for v in variables {
            let end = self.data.len();
            let columns = self.columns;
            self.row_of.entry(v).or_insert_with(|| end / columns);
            if self.row_of[&v] * columns == end {
                self.data.resize(end + factorization.graph.dim_at(v) * columns, 0.0);
            }
        }
    }

    /// The first row of a variable that has rows.
    pub(super) fn row_of(&self, variable: VariableIndex) -> usize {
        self.row_of[&variable]
    }

    pub(super) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.data[row * self.columns..(row + 1) * self.columns]
    }

    /// `R_FFᵀ Y_F = U_F`, `U_S -= R_FSᵀ Y_F`, of a clique all of whose variables have rows.
    pub(super) fn substitute(&mut self, factorization: &Factorization, clique: &Clique) {
        let rows = self.rows_of(factorization, clique);
        for j in 0..clique.numeric.layout.frontal() {
            let factor = clique.numeric.row(j);
            let start = self.solved.len();
            let own = &self.data[rows[j] * self.columns..(rows[j] + 1) * self.columns];
            self.solved.extend(own.iter().map(|u| u / factor[0]));
            let solved = &self.solved[start..];
            // The entry of the right-hand side of the estimate, the last, has no row.
            for (&row, r) in rows[j + 1..].iter().zip(&factor[1..]) {
                let below = &mut self.data[row * self.columns..(row + 1) * self.columns];
                below.iter_mut().zip(solved).for_each(|(u, y)| *u -= r * y);
            }
        }
    }

    /// `YᵀY` over all that has been solved for.
    pub(super) fn gram(&self) -> DMatrix<f64> {
        let rows = self.solved.len() / self.columns;
        let transposed = DMatrix::from_column_slice(self.columns, rows, &self.solved);
        &transposed * transposed.transpose()
    }

    /// What stands at the variables of a clique, in their order.
    pub(super) fn at(&self, factorization: &Factorization, clique: &Clique) -> DMatrix<f64> {
        let rows = self.rows_of(factorization, clique);
        DMatrix::from_fn(rows.len(), self.columns, |i, j| self.data[rows[i] * self.columns + j])
    }

    fn rows_of(&self, factorization: &Factorization, clique: &Clique) -> Vec<usize> {
        let rows = |v: VariableIndex| {
            let first = self.row_of[&v];
            first..first + factorization.graph.dim_at(v)
        };
        clique.structure.variables().flat_map(rows).collect()
    }
}
