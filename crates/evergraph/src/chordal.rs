//! Start values for batch optimization without a start value: chordal initialization.

use std::collections::{HashMap, HashSet};

use evergraph_factors::{BetweenPose2, BetweenPose3, RelativePosition2, RelativePosition3};
use evergraph_formats::{Document, Initial, Record};
use evergraph_model::{
    Factor, LieGroup, Manifold, Noise, Pose2, Pose3, Rot2, Rot3, Value, VariableId,
};
use evergraph_solver::{Settings, SmootherError};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::chordal_linear::{Relation, solve};
use crate::conventions::unwrapped;
use crate::overview::Start;
use crate::replayer::ReplayerError;

/// Values for the poses and landmarks of a document from its measurements alone, near enough to the
/// optimum that a batch optimization from them mostly finds it; by ids in the file.
///
/// With the rotations relaxed to any matrices, `R_j = R_i Z_ij` is linear, row by row the same
/// system. Its least-squares solution, weighted by the mean rotation information, is projected to
/// rotations; with those held, translations are linear too. Landmarks follow from their first
/// sighting. Poses that FIX names, and the first of each connected part that has none, keep their
/// vertices (without one, where a replay would start them). Every other measurement is left out:
/// priors, ranges, bearings, and what else says only a part of a pose; variables that only those tie
/// to the rest keep their vertices, too.
///
/// Of the settings, elimination and threads are used.
///
/// L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM: a survey
/// on rotation estimation and its use in pose graph optimization", ICRA 2015, section III.
///
/// # Errors
/// [`ReplayerError::Format`] when the document is no graph, [`ReplayerError::Smoother`] when the
/// settings cannot be, [`ReplayerError::Chordal`] when weights differ so much that the linear
/// systems cannot be solved.
///
/// ```
/// use evergraph::prelude::*;
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let text = "EDGE_SE2 0 1 1 0 1.5 4 0 0 4 0 9\nEDGE_SE2 1 2 2 0 1.5 4 0 0 4 0 9\n";
/// let document = Document::parse("chain", text.as_bytes(), &ReadOptions::default())?;
/// let start = evergraph::chordal(&document, &Settings::default())?;
/// let last: Pose2 = start[2].1.get().ok_or("a pose")?;
/// assert!((last.theta() - 3.0).abs() < 1e-9 && (last.y() - 2.0 * 1.5_f64.sin()).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
pub fn chordal(
    document: &Document,
    settings: &Settings,
) -> Result<Vec<(u64, Value)>, ReplayerError> {
    settings.check().map_err(SmootherError::from)?;
    let start = Start::of(document, Initial::FromFile)?;
    let fixed: HashSet<u64> = document
        .records()
        .filter_map(|record| match record {
            Record::Fix { id } => Some(*id),
            _ => None,
        })
        .collect();
    let failed =
        |source| ReplayerError::Chordal { file: document.name().into(), source: Box::new(source) };
    let mut values: HashMap<VariableId, Value> = HashMap::new();
    place_poses::<Pose2, 2>(&start, &fixed, settings, &mut values).map_err(failed)?;
    place_poses::<Pose3, 3>(&start, &fixed, settings, &mut values).map_err(failed)?;
    place_landmarks(&start, &mut values);
    let value = |variable| values.get(&variable).cloned().unwrap_or_else(|| start.value(variable));
    Ok(start.ids().iter().map(|&(id, variable)| (id, value(variable))).collect())
}

/// A pose as a rotation matrix and a translation.
trait Rigid<const D: usize>: Manifold {
    fn parts(&self) -> (SMatrix<f64, D, D>, SVector<f64, D>);

    /// The rotation closest to a matrix in the sense of Frobenius, as a pose at the origin; `None`
    /// for a matrix that is near none.
    fn nearest_rotation(matrix: &SMatrix<f64, D, D>) -> Option<Self>;

    #[must_use]
    fn at(&self, translation: SVector<f64, D>) -> Self;

    /// Ends, measurement and noise of a factor that measures one such pose from another.
    fn between(factor: &dyn Factor) -> Option<([VariableId; 2], Self, &Noise)>;
}

impl Rigid<2> for Pose2 {
    fn parts(&self) -> (Matrix2<f64>, Vector2<f64>) {
        (self.rotation().matrix(), Vector2::new(self.x(), self.y()))
    }

    fn nearest_rotation(m: &Matrix2<f64>) -> Option<Self> {
        let rotation = Rot2::from_direction(m[(0, 0)] + m[(1, 1)], m[(1, 0)] - m[(0, 1)]).ok()?;
        Some(Self::new(0.0, 0.0, rotation.angle()))
    }

    fn at(&self, t: Vector2<f64>) -> Self {
        Self::new(t.x, t.y, self.theta())
    }

    fn between(factor: &dyn Factor) -> Option<([VariableId; 2], Self, &Noise)> {
        let it = unwrapped::<BetweenPose2>(factor)?;
        Some(([it.from(), it.to()], *it.measurement(), it.noise()))
    }
}

impl Rigid<3> for Pose3 {
    fn parts(&self) -> (Matrix3<f64>, Vector3<f64>) {
        (self.rotation().matrix(), Vector3::new(self.x(), self.y(), self.z()))
    }

    fn nearest_rotation(m: &Matrix3<f64>) -> Option<Self> {
        let svd = m.try_svd(true, true, f64::EPSILON, 100)?;
        let (mut u, v_t) = (svd.u?, svd.v_t?);
        if (u * v_t).determinant() < 0.0 {
            // Singular values descend: the last direction is turned at the least cost.
            u.column_mut(2).neg_mut();
        }
        Some(Self::new(Rot3::from_matrix(&(u * v_t)).ok()?, Vector3::zeros()))
    }

    fn at(&self, t: Vector3<f64>) -> Self {
        Self::new(self.rotation(), t)
    }

    fn between(factor: &dyn Factor) -> Option<([VariableId; 2], Self, &Noise)> {
        let it = unwrapped::<BetweenPose3>(factor)?;
        Some(([it.from(), it.to()], *it.measurement(), it.noise()))
    }
}

/// A measurement between two poses, by their places among the poses.
struct Edge<const D: usize> {
    ends: [usize; 2],
    rotation: SMatrix<f64, D, D>,
    translation: SVector<f64, D>,
    rotation_weight: f64,
    translation_weight: f64,
}

/// Gives the poses of one kind their values.
fn place_poses<P: Rigid<D>, const D: usize>(
    start: &Start,
    fixed: &HashSet<u64>,
    settings: &Settings,
    values: &mut HashMap<VariableId, Value>,
) -> Result<(), SmootherError> {
    let mut variables: Vec<VariableId> = Vec::new();
    let mut poses: Vec<P> = Vec::new();
    let mut is_fixed: Vec<bool> = Vec::new();
    for &(id, variable) in start.ids() {
        if let Some(pose) = start.value(variable).get::<P>() {
            variables.push(variable);
            poses.push(pose);
            is_fixed.push(fixed.contains(&id));
        }
    }
    let places: HashMap<VariableId, usize> =
        variables.iter().enumerate().map(|(place, &variable)| (variable, place)).collect();
    let edges: Vec<Edge<D>> = start
        .graph()
        .factors()
        .filter_map(|(_, factor)| P::between(factor))
        .map(|(ends, measurement, noise)| {
            let (rotation, translation) = measurement.parts();
            let information = noise.information();
            let mean = |from: usize, to: usize| {
                (from..to).map(|i| information[(i, i)]).sum::<f64>() / (to - from) as f64
            };
            Edge {
                ends: ends.map(|end| places[&end]),
                rotation,
                translation,
                rotation_weight: mean(D, information.nrows()),
                translation_weight: mean(0, D),
            }
        })
        .collect();
    turn(&mut poses, &is_fixed, &edges, settings)?;
    shift(&mut poses, &is_fixed, &edges, settings)?;
    values.extend(variables.into_iter().zip(poses.iter().map(Value::new)));
    Ok(())
}

/// Rotations: `r_j = Zᵀ r_i` for each row `r` of R, then the nearest rotation.
fn turn<P: Rigid<D>, const D: usize>(
    poses: &mut [P],
    fixed: &[bool],
    edges: &[Edge<D>],
    settings: &Settings,
) -> Result<(), SmootherError> {
    let relations: Vec<Relation<D>> = edges
        .iter()
        .filter(|edge| edge.rotation_weight > 0.0)
        .map(|edge| Relation {
            from: edge.ends[0],
            to: edge.ends[1],
            matrix: edge.rotation.transpose(),
            offset: SVector::zeros(),
            weight: edge.rotation_weight,
        })
        .collect();
    let anchored = anchors(fixed, &relations);
    let mut matrices = vec![SMatrix::<f64, D, D>::zeros(); poses.len()];
    for row in 0..D {
        let known: Vec<Option<SVector<f64, D>>> = poses
            .iter()
            .zip(&anchored)
            .map(|(pose, anchored)| anchored.then(|| pose.parts().0.row(row).transpose()))
            .collect();
        for (matrix, solved) in matrices.iter_mut().zip(solve(&known, &relations, settings)?) {
            matrix.set_row(row, &solved.transpose());
        }
    }
    for ((pose, matrix), anchored) in poses.iter_mut().zip(&matrices).zip(anchored) {
        if !anchored && let Some(rotation) = P::nearest_rotation(matrix) {
            *pose = rotation.at(pose.parts().1);
        }
    }
    Ok(())
}

/// Translations: `t_j = t_i + R_i z`.
fn shift<P: Rigid<D>, const D: usize>(
    poses: &mut [P],
    fixed: &[bool],
    edges: &[Edge<D>],
    settings: &Settings,
) -> Result<(), SmootherError> {
    let relations: Vec<Relation<D>> = edges
        .iter()
        .filter(|edge| edge.translation_weight > 0.0)
        .map(|edge| Relation {
            from: edge.ends[0],
            to: edge.ends[1],
            matrix: SMatrix::identity(),
            offset: poses[edge.ends[0]].parts().0 * edge.translation,
            weight: edge.translation_weight,
        })
        .collect();
    let known: Vec<Option<SVector<f64, D>>> = poses
        .iter()
        .zip(anchors(fixed, &relations))
        .map(|(pose, anchored)| anchored.then(|| pose.parts().1))
        .collect();
    for (pose, translation) in poses.iter_mut().zip(solve(&known, &relations, settings)?) {
        *pose = pose.at(translation);
    }
    Ok(())
}

/// Who stays: what is fixed, and the first of each connected part in which nothing is.
fn anchors<const D: usize>(fixed: &[bool], relations: &[Relation<D>]) -> Vec<bool> {
    let mut neighbours = vec![Vec::new(); fixed.len()];
    for relation in relations {
        neighbours[relation.from].push(relation.to);
        neighbours[relation.to].push(relation.from);
    }
    let mut anchored = fixed.to_vec();
    let mut reached = vec![false; fixed.len()];
    // From what is fixed first, then from the first of what that has not reached.
    let seeds = (0..fixed.len()).filter(|&seed| fixed[seed]).chain(0..fixed.len());
    for seed in seeds {
        if reached[seed] {
            continue;
        }
        anchored[seed] = true;
        reached[seed] = true;
        let mut pending = vec![seed];
        while let Some(node) = pending.pop() {
            for &next in &neighbours[node] {
                if !reached[next] {
                    reached[next] = true;
                    pending.push(next);
                }
            }
        }
    }
    anchored
}

/// Puts each landmark where the first pose that sees it does.
fn place_landmarks(start: &Start, values: &mut HashMap<VariableId, Value>) {
    for (_, factor) in start.graph().factors() {
        if let Some(seen) = unwrapped::<RelativePosition2>(factor)
            && !values.contains_key(&seen.point())
            && let Some(pose) = values.get(&seen.pose()).and_then(Value::get::<Pose2>)
        {
            let point = pose.transform_point(&seen.measurement());
            values.insert(seen.point(), Value::new(&point));
        }
        if let Some(seen) = unwrapped::<RelativePosition3>(factor)
            && !values.contains_key(&seen.point())
            && let Some(pose) = values.get(&seen.pose()).and_then(Value::get::<Pose3>)
        {
            let point = pose.compose(seen.robot_from_sensor()).transform_point(&seen.measurement());
            values.insert(seen.point(), Value::new(&point));
        }
    }
}
