//! A whole graph as one dense Jacobian.

use evergraph::model::{Graph, Value, VariableId};
use nalgebra::{DMatrix, DVector};

/// Tangent dimension of a variable.
///
/// # Panics
/// When it is not in the graph.
pub fn dim_of(graph: &Graph, id: VariableId) -> usize {
    graph.dim_at(graph.variable_index(id).expect("a variable of the graph"))
}

/// `[J | r]` of all factors, whitened, at the `values`; columns of all variables in `order`, which
/// are the unknowns of the graph.
///
/// # Panics
/// When a factor panics, or `order` names a variable that is not in the graph.
pub fn stack(
    graph: &Graph,
    order: &[VariableId],
    values: impl Fn(VariableId) -> Value,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut points = vec![0.0; graph.value_len()];
    let mut first = vec![0; graph.variable_slots()];
    let mut width = 0;
    for &id in order {
        let index = graph.variable_index(id).expect("a variable of the graph");
        points[graph.value_range(index)].copy_from_slice(values(id).storage());
        first[index.index()] = width;
        width += graph.dim_at(index);
    }
    let count = graph.factor_indices().map(|f| graph.rows_at(f)).sum();
    let (mut jacobian, mut residual) = (DMatrix::zeros(count, width), DVector::zeros(count));
    let mut top = 0;
    for f in graph.factor_indices() {
        let mut block = vec![0.0; graph.linearization_len(f)];
        graph.linearize(f, &points, &mut block).expect("a factor that does not panic");
        let (rows, columns) = (graph.rows_at(f), graph.columns_at(f));
        let block = DMatrix::from_vec(rows, block.len() / rows, block);
        for (k, &v) in graph.unknowns_at(f).iter().enumerate() {
            let (start, end) = (columns[k] as usize, columns[k + 1] as usize);
            jacobian
                .view_mut((top, first[v.index()]), (rows, end - start))
                .copy_from(&block.columns(start, end - start));
        }
        residual.rows_mut(top, rows).copy_from(&block.column(block.ncols() - 1));
        top += rows;
    }
    (jacobian, residual)
}
