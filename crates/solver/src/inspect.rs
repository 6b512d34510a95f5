//! The linear system and its factor as plain sparse triplets, for oracles and for reading.

use evergraph_model::VariableIndex;

use crate::factorization::Factorization;
use crate::smoother::Smoother;
use crate::solve;

/// `‖Jδ + r‖²`, its factor R, and the solution, over scalars in the order of elimination.
#[derive(Clone, Debug)]
pub struct LinearSystem {
    rows: usize,
    columns: usize,
    jacobian: Vec<(usize, usize, f64)>,
    residual: Vec<f64>,
    factor: Vec<(usize, usize, f64)>,
    rhs: Vec<f64>,
    delta: Vec<f64>,
}

impl LinearSystem {
    /// Rows of J.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns of J and R: scalars of the variables that are not fixed.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Entries of J: row, column, value.
    pub fn jacobian(&self) -> &[(usize, usize, f64)] {
        &self.jacobian
    }

    /// r.
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }

    /// Entries of R in its upper triangle: row, column, value.
    pub fn factor(&self) -> &[(usize, usize, f64)] {
        &self.factor
    }

    /// d, with `Rᵀd = Jᵀr`.
    pub fn rhs(&self) -> &[f64] {
        &self.rhs
    }

    /// δ by back-substitution.
    pub fn delta(&self) -> &[f64] {
        &self.delta
    }
}

impl Smoother {
    /// Copies the linear system out. O(entries); for tests and study.
    pub fn linear_system(&self) -> LinearSystem {
        let Factorization { graph, blocks, tree, .. } = &self.factorization;
        // Scalars in the order of elimination: children before parents.
        let mut column_of = vec![usize::MAX; graph.tangent_len()];
        let mut cliques = tree.top_down();
        cliques.reverse();
        let mut columns = 0;
        for &c in &cliques {
            for &v in &tree.clique(c).structure.frontals {
                for scalar in graph.tangent_range(v) {
                    column_of[scalar] = columns;
                    columns += 1;
                }
            }
        }
        let scalars_of = |variables: &[VariableIndex]| {
            variables.iter().flat_map(|&v| graph.tangent_range(v)).collect::<Vec<_>>()
        };
        let mut system = LinearSystem {
            rows: 0,
            columns,
            jacobian: Vec::new(),
            residual: Vec::new(),
            factor: Vec::new(),
            rhs: vec![0.0; columns],
            delta: vec![0.0; columns],
        };
        for f in graph.factor_indices() {
            let rows = graph.rows_at(f);
            let block = blocks.get(f);
            for (scalar, column) in
                scalars_of(graph.unknowns_at(f)).into_iter().zip(block.chunks_exact(rows))
            {
                for (i, &x) in column.iter().enumerate() {
                    system.jacobian.push((system.rows + i, column_of[scalar], x));
                }
            }
            system.residual.extend_from_slice(&block[block.len() - rows..]);
            system.rows += rows;
        }
        for &c in &cliques {
            let clique = tree.clique(c);
            let scalars = scalars_of(&clique.structure.variables().collect::<Vec<_>>());
            for j in 0..clique.numeric.layout.frontal() {
                let column = column_of[scalars[j]];
                let row = clique.numeric.row(j);
                let rhs = row.len() - 1; // a row ends with the right-hand side
                for (&scalar, &x) in scalars[j..].iter().zip(&row[..rhs]) {
                    system.factor.push((column, column_of[scalar], x));
                }
                system.rhs[column] = row[rhs];
            }
        }
        let delta = solve::all(self.engine.instructions, graph, tree);
        for (scalar, &column) in column_of.iter().enumerate() {
            if column != usize::MAX {
                system.delta[column] = delta[scalar];
            }
        }
        system
    }
}
