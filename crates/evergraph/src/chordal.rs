//! Start values for batch optimization without a start value: chordal initialization.

use std::collections::{HashMap, HashSet};

use evergraph_factors::{BetweenPose2, BetweenPose3, RelativePosition2, RelativePosition3};
use evergraph_formats::{Document, Initial, Record, Replay, ReplayOptions};
use evergraph_model::{
    Factor, Graph, LieGroup, Manifold, Noise, Pose2, Pose3, Rot2, Rot3, Value, VariableId,
};
use evergraph_solver::{Settings, SmootherError};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::chordal_linear::{Relation, solve};
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
    let options = ReplayOptions { prior: None, initial: Initial::FromFile, kernel: None };
    let mut replay = Replay::new(document, &options)?;
    let mut change = Graph::new().change();
    replay.everything(&mut change)?;
    let fixed: HashSet<u64> = document
        .records()
        .filter_map(|record| match record {
            Record::Fix { id } => Some(*id),
            _ => None,
        })
        .collect();
    let failed =
        |source| ReplayerError::Chordal { file: document.name().into(), source: Box::new(source) };
    let mut map = Map {
        ids: replay.ids().collect(),
        values: change.new_variables().iter().cloned().collect(),
        factors: change.new_factors().iter().map(|(_, factor)| &**factor).collect(),
        fixed,
    };
    map.place_poses::<Pose2, 2>(settings).map_err(failed)?;
    map.place_poses::<Pose3, 3>(settings).map_err(failed)?;
    map.place_landmarks();
    Ok(map.ids.iter().map(|(id, variable)| (*id, map.values[variable].clone())).collect())
}

/// A document as a graph.
struct Map<'a> {
    /// The variables with their ids in the file, in the order of arrival.
    ids: Vec<(u64, VariableId)>,
    values: HashMap<VariableId, Value>,
    factors: Vec<&'a dyn Factor>,
    /// Ids of poses that stay where they are.
    fixed: HashSet<u64>,
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
        for (id, variable) in &self.ids {
            if let Some(pose) = self.values[variable].get::<P>() {
                places.insert(*variable, poses.len());
                poses.push(pose);
                fixed.push(self.fixed.contains(id));
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

    /// Puts each landmark where the first pose that sees it does.
    fn place_landmarks(&mut self) {
        let mut placed: HashSet<VariableId> = HashSet::new();
        for factor in &self.factors {
            let Some((point, value)) = self.sighting(*factor) else { continue };
            if placed.insert(point) {
                self.values.insert(point, value);
            }
        }
    }

    /// The point that a factor sees, and where.
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

#[cfg(test)]
mod tests {
    use evergraph_formats::{Coordinates, Line, ReadOptions};
    use evergraph_model::Point2;
    use evergraph_simulate::{Grid, Landmarks, Surface};

    use super::*;

    fn parse(text: &str) -> Document {
        Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap()
    }

    fn start(document: &Document) -> HashMap<u64, Value> {
        chordal(document, &Settings::default()).unwrap().into_iter().collect()
    }

    /// The vertices of a document as values.
    fn vertices(document: &Document) -> HashMap<u64, Value> {
        let value = |at: &Coordinates| match *at {
            Coordinates::Pose2([x, y, theta]) => Value::new(&Pose2::new(x, y, theta)),
            Coordinates::Pose3Quaternion([x, y, z, qx, qy, qz, qw]) => {
                let rotation = Rot3::from_quaternion(qx, qy, qz, qw).unwrap();
                Value::new(&Pose3::new(rotation, Vector3::new(x, y, z)))
            }
            Coordinates::Point2([x, y]) => Value::new(&Point2::new(x, y)),
            _ => panic!("no world has {at:?}"),
        };
        let vertex = |record: &Record| match record {
            Record::Vertex { id, at } => Some((*id, value(at))),
            _ => None,
        };
        document.records().filter_map(vertex).collect()
    }

    /// The document with every vertex but the first far from where it belongs.
    fn scattered(document: &Document) -> Document {
        let scatter = |line: &Line| {
            let mut line = line.clone();
            if let Record::Vertex { id, at } = &mut line.record
                && *id > 0
            {
                *at = match *at {
                    Coordinates::Pose2([x, y, a]) => Coordinates::Pose2([7.0 - y, x, 2.0 - a]),
                    Coordinates::Pose3Quaternion([x, y, z, ..]) => {
                        Coordinates::Pose3Quaternion([y, 3.0 - z, x, 1.0, 0.0, 0.0, 0.0])
                    }
                    Coordinates::Point2([x, y]) => Coordinates::Point2([y, -x]),
                    other => other,
                };
            }
            line
        };
        let lines: Vec<Line> = document.lines().iter().map(scatter).collect();
        Document::from_records("scattered", document.dialect(), lines).unwrap()
    }

    fn distance(a: &Value, b: &Value) -> f64 {
        let mut local = vec![0.0; a.dim()];
        a.kind().local(a.storage(), b.storage(), &mut local);
        local.iter().fold(0.0, |most, x| most.max(x.abs()))
    }

    #[test]
    fn without_noise_the_truth_is_recovered() {
        let mut manhattan = Grid::manhattan(300, 1);
        let mut city = Grid::city(300, 2);
        for grid in [&mut manhattan, &mut city] {
            grid.odometry = [1e-9; 3];
            grid.closures.sigmas = [1e-9; 3];
        }
        city.landmarks =
            Some(Landmarks { density: 0.05, sigmas: [1e-9; 2], ..Landmarks::default() });
        let mut sphere = Surface::sphere(300, 3);
        let mut torus = Surface::torus(300, 4);
        for surface in [&mut sphere, &mut torus] {
            surface.odometry = [1e-9; 6];
            surface.closures.sigmas = [1e-9; 6];
        }
        for world in [manhattan.generate(), city.generate(), sphere.generate(), torus.generate()] {
            let world = world.unwrap();
            let truth = vertices(&world.truth);
            let document = scattered(&world.document);
            let (found, scattered) = (start(&document), vertices(&document));
            assert!(found.len() >= 300);
            for (id, value) in &found {
                assert!(distance(value, &truth[id]) < 1e-5, "{id}: {value:?}");
            }
            assert!(distance(&scattered[&7], &truth[&7]) > 0.1);
        }
    }

    const UNIT: &str = "1 0 0 1 0 1";

    #[test]
    fn what_is_fixed_stays_and_parts_begin_at_their_vertices() {
        let text = format!(
            "VERTEX_SE2 0 5 6 1\nVERTEX_SE2 1 9 9 0\nVERTEX_SE2 2 7 7 0.5\nVERTEX_SE2 8 1 2 3\n\
             VERTEX_SE2 9 0 0 0\nEDGE_SE2 0 1 1 0 0 {UNIT}\nEDGE_SE2 1 2 1 0 0 {UNIT}\n\
             EDGE_SE2 8 9 1 0 0 {UNIT}\nFIX 2\n"
        );
        let document = parse(&text);
        let (found, given) = (start(&document), vertices(&document));
        assert_eq!((&found[&2], &found[&8]), (&given[&2], &given[&8]));
        let first: Pose2 = found[&0].get().unwrap();
        let (sin, cos) = 0.5_f64.sin_cos();
        let expected = Value::new(&Pose2::new(7.0 - 2.0 * cos, 7.0 - 2.0 * sin, 0.5));
        assert!(distance(&Value::new(&first), &expected) < 1e-9, "{first:?}");
    }

    #[test]
    fn parts_of_an_edge_without_weight_do_not_count() {
        // The second edge says nothing of the rotation: pose 2 keeps that of its vertex.
        let text = format!(
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\nVERTEX_SE2 2 0 0 0.25\n\
             EDGE_SE2 0 1 1 0 1 {UNIT}\nEDGE_SE2 1 2 1 0 1 1 0 0 1 0 0\n"
        );
        let last: Pose2 = start(&parse(&text))[&2].get().unwrap();
        assert!((last.theta() - 0.25).abs() < 1e-12);
        assert!((last.y() - 1.0_f64.sin()).abs() < 1e-12, "{last:?}");
    }

    #[test]
    fn a_part_with_a_fixed_pose_follows_it_wherever_it_comes() {
        // As to rotations, poses 1 and 2 are a part of their own, and 2 is fixed.
        let text = format!(
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 2\nVERTEX_SE2 2 2 0 0.5\n\
             EDGE_SE2 0 1 1 0 1 1 0 0 1 0 0\nEDGE_SE2 1 2 1 0 0.25 {UNIT}\nFIX 0\nFIX 2\n"
        );
        let found = start(&parse(&text));
        let theta = |id: u64| found[&id].get::<Pose2>().unwrap().theta();
        assert!((theta(1) - 0.25).abs() < 1e-12 && theta(2) == 0.5, "{found:?}");
    }

    /// The polar factor of a reflection is none: the nearest rotation turns the weakest direction.
    #[test]
    fn reflections_become_rotations() {
        let reflected = Matrix3::from_diagonal(&Vector3::new(2.0, -0.1, 3.0));
        let nearest = <Pose3 as Rigid<3>>::nearest_rotation(&reflected).unwrap();
        assert!((nearest.rotation().matrix() - Matrix3::identity()).norm() < 1e-12);
    }
}
