//! Covariances of whole cliques.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use crate::factorization::Factorization;
use crate::index::CliqueIndex;
use crate::tree::Clique;

/// The cost of going through a clique with so many right-hand sides, in products.
pub(super) fn cost_to_pass(clique: &Clique, columns: usize) -> f64 {
    let (f, n) = (clique.numeric.layout.frontal() as f64, clique.numeric.layout.columns() as f64);
    f * n * columns as f64
}

/// The cost of computing its covariance, in products.
pub(super) fn cost_to_make(clique: &Clique) -> f64 {
    let (f, n) = (clique.numeric.layout.frontal() as f64, clique.numeric.layout.columns() as f64);
    f * n * (n + f)
}

/// `Σ_SS` of a clique, out of the covariance of its parent.
pub(super) fn separator_block(
    factorization: &Factorization,
    clique: CliqueIndex,
    parent: CliqueIndex,
    known: &DMatrix<f64>,
) -> DMatrix<f64> {
    let Factorization { graph, tree, .. } = factorization;
    let mut place = BTreeMap::new();
    let mut at = 0;
    for v in tree.clique(parent).structure.variables() {
        place.insert(v, at);
        at += graph.dim_at(v);
    }
    let scalars: Vec<usize> = tree
        .clique(clique)
        .structure
        .separator
        .iter()
        .flat_map(|v| place[v]..place[v] + graph.dim_at(*v))
        .collect();
    DMatrix::from_fn(scalars.len(), scalars.len(), |i, j| known[(scalars[i], scalars[j])])
}

/// The covariance of a clique's frontals and separator, given that of its separator (none for a
/// root).
pub(super) fn from_separator(clique: &Clique, above: Option<DMatrix<f64>>) -> DMatrix<f64> {
    let layout = clique.numeric.layout;
    let (f, n) = (layout.frontal(), layout.columns() - 1);
    let above = above.unwrap_or_default();
    // `[R_FF⁻¹ P]ᵀ` by back-substitution on `[I R_FS]`, a row of that after the other.
    let mut solved = DMatrix::zeros(n, f);
    let data = solved.as_mut_slice();
    for j in (0..f).rev() {
        let row = clique.numeric.row(j);
        let (own, below) = data[j * n..].split_at_mut(n);
        own[j] = 1.0;
        own[f..].copy_from_slice(&row[f - j..n - j]);
        for (r, known) in row[1..f - j].iter().zip(below.chunks_exact(n)) {
            // Rows further down begin with zeros, up to their diagonal.
            own.iter_mut().zip(known).skip(j + 1).for_each(|(x, k)| *x -= r * k);
        }
        own.iter_mut().for_each(|x| *x /= row[0]);
    }
    let (inverse, p) = (solved.rows(0, f), solved.rows(f, n - f));
    // Σ_SF and Σ_FF.
    let cross = -(&above * p);
    let own = inverse.tr_mul(&inverse) - p.tr_mul(&cross);
    let mut all = DMatrix::zeros(n, n);
    all.view_mut((0, 0), (f, f)).copy_from(&own);
    all.view_mut((0, f), (f, n - f)).copy_from(&cross.transpose());
    all.view_mut((f, 0), (n - f, f)).copy_from(&cross);
    all.view_mut((f, f), (n - f, n - f)).copy_from(&above);
    all
}
