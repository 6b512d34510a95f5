//! What of a map a plot shows.

use std::collections::{BTreeMap, HashMap};

use evergraph::formats::{Document, Quantity, Record};
use evergraph::model::{FactorId, Point2, Point3, Pose2, Pose3, Value, VariableId};
use evergraph::replay::Replay;
use evergraph::{Smoother, SmootherError};

use super::layer::Place;

/// A map from above.
#[derive(Clone, Debug, Default)]
pub(crate) struct Map {
    /// The poses by their ids, in the order in which they came in; a new line where no measurement
    /// leads from an earlier one to a pose.
    pub trajectory: Vec<Vec<(u64, Place)>>,
    /// Measurements of two variables, in the order of the file's factors.
    pub edges: Vec<Edge>,
    pub landmarks: Vec<(u64, Place)>,
    pub in_space: bool,
}

/// A measurement of two variables.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edge {
    pub ends: [Place; 2],
    pub kind: EdgeKind,
    pub factor: FactorId,
}

/// What a measurement is to the map. Every one of the file has one kind, so that counts agree with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EdgeKind {
    /// The first that leads from the pose before to a pose.
    Motion,
    /// Any other relative pose.
    Closure,
    /// Ranges, bearings and the like between poses.
    Other,
    /// Of a landmark.
    Sighting,
}

impl Map {
    /// The estimate of `smoother` of what `replay` has brought in of `document`.
    pub fn of(
        replay: &Replay,
        smoother: &Smoother,
        document: &Document,
    ) -> Result<Self, SmootherError> {
        let mut map = Self::default();
        let mut poses: Vec<(u64, Place)> = Vec::new();
        let mut seen_of: HashMap<VariableId, (Seen, usize)> = HashMap::new();
        for (id, variable, seen) in seen(replay, smoother)? {
            map.in_space |= seen.in_space;
            let list = if seen.is_pose { &mut poses } else { &mut map.landmarks };
            seen_of.insert(variable, (seen, list.len()));
            list.push((id, seen.at));
        }
        let records: HashMap<usize, &Record> =
            document.lines().iter().map(|line| (line.number, &line.record)).collect();
        // Edges that lead to each pose, by it and by the earlier one.
        let mut motions: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        for &(factor, line) in replay.factors() {
            // What was refused or removed is not in the graph.
            let Ok(known) = smoother.graph().factor(factor) else { continue };
            let [a, b] = known.keys() else { continue };
            let (Some((a, at_a)), Some((b, at_b))) = (seen_of.get(a), seen_of.get(b)) else {
                continue;
            };
            let is_relative = records.get(&line).is_some_and(|record| is_relative_pose(record));
            let kind = match (a.is_pose && b.is_pose, is_relative) {
                (true, true) => EdgeKind::Closure,
                (true, false) => EdgeKind::Other,
                (false, _) => EdgeKind::Sighting,
            };
            // A single number is no motion.
            if kind == EdgeKind::Closure && known.residual_dim() > 1 {
                let pair = [*at_a.max(at_b), *at_a.min(at_b)];
                motions.entry(pair).or_insert(map.edges.len());
            }
            map.edges.push(Edge { ends: [a.at, b.at], kind, factor });
        }
        map.connect(&poses, &motions);
        Ok(map)
    }

    /// Makes lines of the poses; `motions` holds the later of two poses first. Each pose goes on from
    /// the latest one that it is measured from and that none goes on from yet, so that robots that
    /// drive at once have a line each.
    fn connect(&mut self, poses: &[(u64, Place)], motions: &BTreeMap<[usize; 2], usize>) {
        // The line that ends at a pose.
        let mut ends: HashMap<usize, usize> = HashMap::new();
        for (place, &pose) in poses.iter().enumerate() {
            let mut before = motions.range([place, 0]..[place, place]).rev();
            let found = before.find_map(|([_, earlier], edge)| Some((ends.remove(earlier)?, edge)));
            let line = if let Some((line, edge)) = found {
                self.edges[*edge].kind = EdgeKind::Motion;
                line
            } else {
                self.trajectory.push(Vec::new());
                self.trajectory.len() - 1
            };
            self.trajectory[line].push(pose);
            ends.insert(place, line);
        }
    }

    /// The ends of all edges of a kind.
    pub fn ends_of(&self, kind: EdgeKind) -> Vec<Vec<Place>> {
        let of_kind = self.edges.iter().filter(|edge| edge.kind == kind);
        of_kind.map(|edge| edge.ends.to_vec()).collect()
    }
}

/// Whether a line measures a relative pose, whole or in part, or stands for such measurements.
fn is_relative_pose(record: &Record) -> bool {
    match record {
        Record::Edge { measurement, .. } => measurement.kind().is_pose(),
        Record::Measurement(it) => matches!(
            it.quantity,
            Quantity::Relative | Quantity::Partial | Quantity::TranslationDifference
        ),
        Record::Linear(_) => true,
        _ => false,
    }
}

/// Where the variables are that a file knows by ids, poses and landmarks apart.
#[derive(Clone, Debug, Default)]
pub(crate) struct Places {
    pub poses: HashMap<u64, Place>,
    pub landmarks: HashMap<u64, Place>,
}

impl Places {
    /// Those that are in the graph of `smoother`, by its estimate.
    pub fn of(replay: &Replay, smoother: &Smoother) -> Result<Self, SmootherError> {
        let mut places = Self::default();
        for (id, _, seen) in seen(replay, smoother)? {
            let list = if seen.is_pose { &mut places.poses } else { &mut places.landmarks };
            list.insert(id, seen.at);
        }
        Ok(places)
    }
}

fn seen(
    replay: &Replay,
    smoother: &Smoother,
) -> Result<Vec<(u64, VariableId, Seen)>, SmootherError> {
    let estimates = smoother.estimates()?;
    let seen = replay.ids().filter_map(|(id, variable)| {
        // What is no longer in the graph has no estimate.
        let value = estimates.value(variable).ok()?.to_value();
        Some((id, variable, Seen::of(&value)?))
    });
    Ok(seen.collect())
}

/// A variable from above.
#[derive(Clone, Copy, Debug)]
struct Seen {
    at: Place,
    is_pose: bool,
    in_space: bool,
}

impl Seen {
    fn of(value: &Value) -> Option<Self> {
        if let Some(pose) = value.get::<Pose2>() {
            return Some(Self { at: [pose.x(), pose.y()], is_pose: true, in_space: false });
        }
        if let Some(pose) = value.get::<Pose3>() {
            return Some(Self { at: [pose.x(), pose.y()], is_pose: true, in_space: true });
        }
        if let Some(point) = value.get::<Point2>() {
            return Some(Self { at: [point.x(), point.y()], is_pose: false, in_space: false });
        }
        let point = value.get::<Point3>()?;
        Some(Self { at: [point.x(), point.y()], is_pose: false, in_space: true })
    }
}
