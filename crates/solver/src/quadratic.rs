//! The quadratic model `½ ‖Jδ + r‖²` of the objective, and what steps are made of.

use evergraph_model::{Graph, GraphError};

use crate::linearization::Blocks;

/// `x ⊕ δ` for all variables; fixed ones stay.
///
/// # Errors
/// A manifold panics or gives a value that is not finite.
pub(crate) fn retract_all(
    graph: &Graph,
    points: &[f64],
    delta: &[f64],
) -> Result<Vec<f64>, GraphError> {
    let mut out = vec![0.0; points.len()];
    for v in graph.variable_indices() {
        let range = graph.value_range(v);
        if graph.is_fixed_at(v) {
            out[range.clone()].copy_from_slice(&points[range]);
        } else {
            let delta = &delta[graph.tangent_range(v)];
            graph.retract(v, &points[range.clone()], delta, &mut out[range])?;
        }
    }
    Ok(out)
}

/// Calls `visit` with each factor's columns: the scalar that each belongs to, the column, and the
/// residual.
fn for_each_column(graph: &Graph, blocks: &Blocks, mut visit: impl FnMut(usize, &[f64], &[f64])) {
    for f in graph.factor_indices() {
        let rows = graph.rows_at(f);
        let block = blocks.get(f);
        let residual = &block[block.len() - rows..];
        let scalars = graph.unknowns_at(f).iter().flat_map(|&v| graph.tangent_range(v));
        for (scalar, column) in scalars.zip(block.chunks_exact(rows)) {
            visit(scalar, column, residual);
        }
    }
}

/// `diag(JᵀJ)`.
pub(crate) fn diagonal(graph: &Graph, blocks: &Blocks) -> Vec<f64> {
    let mut out = vec![0.0; graph.tangent_len()];
    for_each_column(graph, blocks, |scalar, column, _| {
        out[scalar] += column.iter().map(|x| x * x).sum::<f64>();
    });
    out
}

/// `Jᵀr`.
pub(crate) fn gradient(graph: &Graph, blocks: &Blocks) -> Vec<f64> {
    let mut out = vec![0.0; graph.tangent_len()];
    for_each_column(graph, blocks, |scalar, column, residual| {
        out[scalar] += column.iter().zip(residual).map(|(x, r)| x * r).sum::<f64>();
    });
    out
}

/// `Σ ‖Jδ‖²` and `Σ rᵀJδ`.
fn products(graph: &Graph, blocks: &Blocks, delta: &[f64]) -> (f64, f64) {
    let (mut squared, mut mixed) = (0.0, 0.0);
    let mut product = Vec::new();
    for f in graph.factor_indices() {
        let rows = graph.rows_at(f);
        let block = blocks.get(f);
        product.clear();
        product.resize(rows, 0.0);
        let scalars = graph.unknowns_at(f).iter().flat_map(|&v| graph.tangent_range(v));
        for (scalar, column) in scalars.zip(block.chunks_exact(rows)) {
            for (p, x) in product.iter_mut().zip(column) {
                *p += x * delta[scalar];
            }
        }
        let residual = &block[block.len() - rows..];
        squared += product.iter().map(|p| p * p).sum::<f64>();
        mixed += product.iter().zip(residual).map(|(p, r)| p * r).sum::<f64>();
    }
    (squared, mixed)
}

/// `½ ‖r‖² − ½ ‖Jδ + r‖²`, without subtracting large numbers.
pub(crate) fn decrease_of_model(graph: &Graph, blocks: &Blocks, delta: &[f64]) -> f64 {
    let (squared, mixed) = products(graph, blocks, delta);
    -mixed - 0.5 * squared
}

/// The amount by which the error at `points` may be off: the numbers of the points are rounded, far from
/// the origin by much, and so are residuals and their squares.
pub(crate) fn rounding_of_error(graph: &Graph, blocks: &Blocks, points: &[f64], error: f64) -> f64 {
    let mut squares = error * error;
    for f in graph.factor_indices() {
        let rows = graph.rows_at(f);
        let block = blocks.get(f);
        let residual = &block[block.len() - rows..];
        let mut columns = block.chunks_exact(rows);
        let mut of_factor = 0.0;
        for &v in graph.unknowns_at(f) {
            let size = points[graph.value_range(v)].iter().fold(1.0, |m: f64, x| m.max(x.abs()));
            for column in columns.by_ref().take(graph.dim_at(v)) {
                let products = column.iter().zip(residual).map(|(x, r)| (x * r).abs());
                of_factor += size * products.sum::<f64>();
            }
        }
        squares += of_factor * of_factor;
    }
    f64::EPSILON * squares.sqrt()
}

/// The minimizer of the model along `−D⁻¹ Jᵀr`.
pub(crate) fn steepest_descent(
    graph: &Graph,
    blocks: &Blocks,
    gradient: &[f64],
    scale: &[f64],
) -> Vec<f64> {
    let mut direction: Vec<f64> =
        gradient.iter().zip(scale).map(|(g, s)| if *s > 0.0 { -g / s } else { 0.0 }).collect();
    let slope: f64 = direction.iter().zip(gradient).map(|(d, g)| d * g).sum();
    let (squared, _) = products(graph, blocks, &direction);
    let length = if squared > 0.0 { -slope / squared } else { 0.0 };
    direction.iter_mut().for_each(|d| *d *= length);
    direction
}

pub(crate) fn scaled_norm(delta: &[f64], scale: &[f64]) -> f64 {
    delta.iter().zip(scale).map(|(d, s)| s * d * d).sum::<f64>().sqrt()
}

/// The point of the dogleg path 0 → steepest descent → Gauss-Newton at distance `radius`.
pub(crate) fn within_radius(
    newton: &[f64],
    steepest: &[f64],
    scale: &[f64],
    radius: f64,
) -> Vec<f64> {
    if scaled_norm(newton, scale) <= radius {
        return newton.to_vec();
    }
    let first = scaled_norm(steepest, scale);
    if first >= radius {
        return steepest.iter().map(|d| d * (radius / first)).collect();
    }
    // ‖s + t (n − s)‖ = radius, solved for t in (0, 1) in the form that does not cancel.
    let difference: Vec<f64> = newton.iter().zip(steepest).map(|(n, s)| n - s).collect();
    let a = scaled_norm(&difference, scale).powi(2);
    let b: f64 = steepest.iter().zip(&difference).zip(scale).map(|((s, d), w)| w * s * d).sum();
    let c = (radius - first) * (radius + first);
    let root = (b * b + a * c).sqrt();
    let t = if b > 0.0 { c / (b + root) } else { (root - b) / a };
    steepest.iter().zip(&difference).map(|(s, d)| s + t * d).collect()
}
