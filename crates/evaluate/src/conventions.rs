//! What a map costs, and in whose convention.
//!
//! This library measures the error of an edge as `e = Log(z⁻¹ xᵢ⁻¹ xⱼ)`, with the full logarithm of
//! SE(2) and SE(3). g2o takes, of the same product, translation and angle in 2D, translation and the
//! vector part of the quaternion in 3D. Both vanish together, but the sums differ away from zero, in
//! 3D by the unit of the rotation (half an angle) as well: compare numbers of one convention only.

use evergraph_factors::{BetweenPose2, BetweenPose3};
use evergraph_formats::G2oRotation;
use evergraph_model::{
    FactorIndex, Graph, GraphError, LieGroup, Manifold, Noise, Pose2, Pose3, VariableIndex,
};

/// g2o's chi2 of all factors at `points`, without kernels. `points` are laid out as
/// [`Graph::value_range`] says. `rotation` says how the file's 3D matrices were read, so that they count as
/// they stand in the file.
///
/// # Errors
/// [`GraphError::FactorPanicked`].
pub fn g2o_chi2(graph: &Graph, points: &[f64], rotation: G2oRotation) -> Result<f64, GraphError> {
    graph.factor_indices().map(|f| g2o_squared(graph, f, points, rotation)).sum()
}

fn g2o_squared(
    graph: &Graph,
    f: FactorIndex,
    points: &[f64],
    rotation: G2oRotation,
) -> Result<f64, GraphError> {
    let factor = graph.factor_at(f);
    if let Some((between, _)) = factor.downcast::<BetweenPose2>()
        && let Some([from, to]) = ends::<Pose2>(graph, f, points)
    {
        let d = between.measurement().between(&from.between(&to));
        return Ok(whitened(between.noise(), &mut [d.x(), d.y(), d.theta()]));
    }
    if let Some((between, _)) = factor.downcast::<BetweenPose3>()
        && let Some([from, to]) = ends::<Pose3>(graph, f, points)
    {
        let d = between.measurement().between(&from.between(&to));
        let [qx, qy, qz, qw] = d.rotation().quaternion();
        // q and -q are the same rotation; g2o takes the one with w >= 0.
        let sign = if qw < 0.0 { -1.0 } else { 1.0 };
        // Matrices that were taken from half angles to angles go with twice the vector part.
        let unit = sign * if rotation == G2oRotation::Quaternion { 2.0 } else { 1.0 };
        return Ok(whitened(
            between.noise(),
            &mut [d.x(), d.y(), d.z(), unit * qx, unit * qy, unit * qz],
        ));
    }
    // Anything else: the same in both conventions.
    let mut residual = vec![0.0; graph.rows_at(f)];
    graph.residual(f, points, &mut residual)?;
    Ok(squared_norm(&residual))
}

/// The values of a factor's two variables.
fn ends<V: Manifold>(graph: &Graph, f: FactorIndex, points: &[f64]) -> Option<[V; 2]> {
    let &[from, to] = graph.variables_at(f) else { return None };
    let at = |v: VariableIndex| graph.value_ref(v, &points[graph.value_range(v)]).get::<V>();
    Some([at(from)?, at(to)?])
}

fn whitened(noise: &Noise, residual: &mut [f64]) -> f64 {
    noise.whiten_columns(residual);
    squared_norm(residual)
}

fn squared_norm(residual: &[f64]) -> f64 {
    residual.iter().map(|r| r * r).sum()
}

#[cfg(test)]
mod tests {
    use evergraph_formats::{Document, ReadOptions};
    use evergraph_replay::Initial;

    use super::*;
    use crate::Start;

    fn start(text: &str) -> Start {
        let document = Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap();
        Start::of(&document, Initial::FromFile).unwrap()
    }

    #[test]
    fn in_the_plane_g2o_takes_translation_and_angle() {
        let start =
            start("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 2 0.5\nEDGE_SE2 0 1 0 0 0 1 0 0 1 0 4\n");
        assert!(
            (start.g2o_chi2(G2oRotation::Angle).unwrap() - (1.0 + 4.0 + 4.0 * 0.25)).abs() < 1e-12
        );
        // The logarithm's translation is longer than the chord by (θ/2)/sin(θ/2).
        let stretch = (0.25 / 0.25_f64.sin()).powi(2);
        let objective = start.objective().unwrap();
        assert!((objective.chi2 - (5.0 * stretch + 1.0)).abs() < 1e-12);
        assert_eq!(objective.error, 0.5 * objective.chi2);
    }

    #[test]
    fn in_space_g2o_takes_the_quaternion_vector_part() {
        let (sin, cos) = 0.3_f64.sin_cos();
        let identity6 = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
        let text = format!(
            "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 {} {}\n\
             EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 {identity6}\n",
            -sin, -cos
        );
        let g2o = start(&text).g2o_chi2(G2oRotation::Angle).unwrap();
        assert!((g2o - sin * sin).abs() < 1e-12, "{g2o}");
        assert!((start(&text).objective().unwrap().chi2 - 0.36).abs() < 1e-12);
    }
}
