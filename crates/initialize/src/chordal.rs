//! Start values for batch optimization without a start value: chordal initialization.

use std::collections::{HashMap, HashSet};

use evergraph_factors::{BetweenPose2, BetweenPose3, RelativePosition2, RelativePosition3};
use evergraph_model::{
    Factor, LieGroup, Manifold, Noise, Pose2, Pose3, Rot2, Rot3, Value, VariableId,
};
use evergraph_solver::{Settings, SmootherError};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::chordal_linear::{Relation, solve};

/// Values for poses and landmarks from their relative measurements alone, near enough to the optimum that
/// a batch optimization from them mostly finds it; in the order of `start`.
///
/// With the rotations relaxed to any matrices, `R_j = R_i Z_ij` is linear, row by row the same system.
/// Its least-squares solution, weighted by the mean rotation information, is projected to rotations; with
/// those held, translations are linear too. Landmarks follow from their first sighting, in the order of
/// `factors`.
///
/// `start` lists the variables with values of which little is used: poses in `fixed`, and the first pose
/// of each connected part that has none there, keep them. So do variables that only other measurements
/// tie to the rest: priors, ranges, bearings and what else says only a part of a pose are left out.
/// Factors on variables that `start` does not list are left out, too.
///
/// Of the settings, elimination and threads are used.
///
/// L. Carlone, R. Tron, K. Daniilidis, F. Dellaert, "Initialization techniques for 3D SLAM: a survey on
/// rotation estimation and its use in pose graph optimization", ICRA 2015, section III.
///
/// # Errors
/// [`SmootherError`] when the settings cannot be, or when weights differ so much that the linear systems
/// cannot be solved; variables in it are of a graph that is gone.
///
/// ```
/// use std::collections::HashSet;
///
/// use evergraph_factors::BetweenPose2;
/// use evergraph_initialize::chordal;
/// use evergraph_model::{Graph, LieGroup, Noise, Pose2};
/// use evergraph_solver::Settings;
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut change = Graph::new().change();
/// let poses = [(); 3].map(|()| change.add_variable(&Pose2::identity()));
/// let (turn, noise) = (Pose2::new(1.0, 0.0, 1.5), Noise::from_sigmas(&[0.1, 0.1, 0.05])?);
/// for pair in poses.windows(2) {
///     change.add_factor(BetweenPose2::new(pair[0], pair[1], turn, noise.clone())?);
/// }
/// let factors = change.new_factors().iter().map(|(_, factor)| &**factor);
/// let found =
///     chordal(change.new_variables(), factors, &HashSet::new(), &Settings::default())?;
/// let last: Pose2 = found[2].1.get().ok_or("a pose")?;
/// assert!((last.theta() - 3.0).abs() < 1e-9 && (last.y() - 1.5_f64.sin()).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
pub fn chordal<'a>(
    start: &[(VariableId, Value)],
    factors: impl IntoIterator<Item = &'a dyn Factor>,
    fixed: &HashSet<VariableId>,
    settings: &Settings,
) -> Result<Vec<(VariableId, Value)>, SmootherError> {
    settings.check()?;
    let values: HashMap<VariableId, Value> = start.iter().cloned().collect();
    let is_among = |factor: &&dyn Factor| factor.keys().iter().all(|key| values.contains_key(key));
    let mut map = Map {
        variables: start.iter().map(|(variable, _)| *variable).collect(),
        factors: factors.into_iter().filter(is_among).collect(),
        values,
        fixed,
    };
    map.place_poses::<Pose2, 2>(settings)?;
    map.place_poses::<Pose3, 3>(settings)?;
    map.place_landmarks();
    let values = map.values;
    Ok(map.variables.into_iter().map(|variable| (variable, values[&variable].clone())).collect())
}

/// A graph that is not built.
struct Map<'a> {
    variables: Vec<VariableId>,
    values: HashMap<VariableId, Value>,
    factors: Vec<&'a dyn Factor>,
    /// Poses that keep their values.
    fixed: &'a HashSet<VariableId>,
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
        let (it, _) = factor.downcast::<BetweenPose2>()?;
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
        let (it, _) = factor.downcast::<BetweenPose3>()?;
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

impl Map<'_> {
    /// Gives the poses of one kind their values.
    fn place_poses<P: Rigid<D>, const D: usize>(
        &mut self,
        settings: &Settings,
    ) -> Result<(), SmootherError> {
        let mut places: HashMap<VariableId, usize> = HashMap::new();
        let mut poses: Vec<P> = Vec::new();
        let mut fixed: Vec<bool> = Vec::new();
        for variable in &self.variables {
            if let Some(pose) = self.values[variable].get::<P>() {
                places.insert(*variable, poses.len());
                poses.push(pose);
                fixed.push(self.fixed.contains(variable));
            }
        }
        let edge = |(ends, measurement, noise): ([VariableId; 2], P, &Noise)| {
            let (rotation, translation) = measurement.parts();
            let information = noise.information().diagonal();
            Edge {
                ends: ends.map(|end| places[&end]),
                rotation,
                translation,
                rotation_weight: information.rows_range(D..).mean(),
                translation_weight: information.rows_range(..D).mean(),
            }
        };
        let edges: Vec<Edge<D>> =
            self.factors.iter().filter_map(|factor| P::between(*factor)).map(edge).collect();
        turn(&mut poses, &fixed, &edges, settings)?;
        shift(&mut poses, &fixed, &edges, settings)?;
        for (variable, place) in places {
            self.values.insert(variable, Value::new(&poses[place]));
        }
        Ok(())
    }

    /// Places each landmark by its first sighting.
    fn place_landmarks(&mut self) {
        let mut placed: HashSet<VariableId> = HashSet::new();
        for factor in &self.factors {
            let Some((point, value)) = self.sighting(*factor) else { continue };
            if placed.insert(point) {
                self.values.insert(point, value);
            }
        }
    }

    /// The point that a factor sees, and its position.
    fn sighting(&self, factor: &dyn Factor) -> Option<(VariableId, Value)> {
        if let Some((seen, _)) = factor.downcast::<RelativePosition2>() {
            let pose: Pose2 = self.values[&seen.pose()].get()?;
            return Some((seen.point(), Value::new(&pose.transform_point(&seen.measurement()))));
        }
        let (seen, _) = factor.downcast::<RelativePosition3>()?;
        let pose: Pose3 = self.values[&seen.pose()].get()?;
        let sensor = pose.compose(seen.robot_from_sensor());
        Some((seen.point(), Value::new(&sensor.transform_point(&seen.measurement()))))
    }
}

/// Rotations: `r_j = Zᵀ r_i` for each row `r` of R, then the nearest rotation.
fn turn<P: Rigid<D>, const D: usize>(
    poses: &mut [P],
    fixed: &[bool],
    edges: &[Edge<D>],
    settings: &Settings,
) -> Result<(), SmootherError> {
    let relations = relations(edges, |edge| {
        (edge.rotation.transpose(), SVector::zeros(), edge.rotation_weight)
    });
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
    let relations = relations(edges, |edge| {
        let offset = poses[edge.ends[0]].parts().0 * edge.translation;
        (SMatrix::identity(), offset, edge.translation_weight)
    });
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

/// The relation of each edge, from its matrix, offset and weight; edges without a weight give none.
fn relations<const D: usize>(
    edges: &[Edge<D>],
    terms: impl Fn(&Edge<D>) -> (SMatrix<f64, D, D>, SVector<f64, D>, f64),
) -> Vec<Relation<D>> {
    let relation = |edge: &Edge<D>| {
        let (matrix, offset, weight) = terms(edge);
        Relation { from: edge.ends[0], to: edge.ends[1], matrix, offset, weight }
    };
    edges.iter().map(relation).filter(|relation| relation.weight > 0.0).collect()
}

/// The poses that stay: what is fixed, and the first of each connected part in which nothing is.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The polar factor of a reflection is none: the nearest rotation turns the weakest direction.
    #[test]
    fn reflections_become_rotations() {
        let reflected = Matrix3::from_diagonal(&Vector3::new(2.0, -0.1, 3.0));
        let nearest = <Pose3 as Rigid<3>>::nearest_rotation(&reflected).unwrap();
        assert!((nearest.rotation().matrix() - Matrix3::identity()).norm() < 1e-12);
    }
}
