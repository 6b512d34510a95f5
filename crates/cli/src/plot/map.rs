//! What of a map a plot shows.

use std::collections::{HashMap, HashSet};

use evergraph::Replayer;
use evergraph::model::{Point2, Point3, Pose2, Pose3, Value, VariableId};

/// A map from above.
#[derive(Clone, Debug, Default)]
pub(crate) struct Map {
    /// The poses in the order in which they came in, a new line where no measurement ties a pose
    /// to the one before it.
    pub trajectory: Vec<Vec<[f64; 2]>>,
    /// Ends of the measurements between any other two poses, each pair once.
    pub closures: Vec<[[f64; 2]; 2]>,
    pub landmarks: Vec<[f64; 2]>,
    pub in_space: bool,
}

impl Map {
    /// The current estimate.
    pub fn of(replayer: &Replayer) -> Self {
        let estimates = replayer.smoother().estimates();
        let mut map = Self::default();
        let mut poses: Vec<[f64; 2]> = Vec::new();
        let mut place_of: HashMap<VariableId, usize> = HashMap::new();
        for (_, variable) in replayer.replay().ids() {
            let Ok(value) = estimates.value(variable) else { continue };
            let Some(seen) = Seen::of(&value.to_value()) else { continue };
            map.in_space |= seen.in_space;
            if seen.is_pose {
                place_of.insert(variable, poses.len());
                poses.push(seen.at);
            } else {
                map.landmarks.push(seen.at);
            }
        }
        let mut pairs: HashSet<[usize; 2]> = HashSet::new();
        for (_, factor) in replayer.graph().factors() {
            let [a, b] = factor.keys() else { continue };
            let (Some(&a), Some(&b)) = (place_of.get(a), place_of.get(b)) else { continue };
            let pair = [a.min(b), a.max(b)];
            if pairs.insert(pair) && pair[1] - pair[0] > 1 {
                map.closures.push(pair.map(|place| poses[place]));
            }
        }
        for (place, &at) in poses.iter().enumerate() {
            match map.trajectory.last_mut() {
                Some(line) if pairs.contains(&[place - 1, place]) => line.push(at),
                _ => map.trajectory.push(vec![at]),
            }
        }
        map
    }

    /// Everything that has to be seen.
    pub fn points(&self) -> impl Iterator<Item = [f64; 2]> {
        self.trajectory.iter().flatten().chain(&self.landmarks).copied()
    }

    pub fn poses(&self) -> usize {
        self.trajectory.iter().map(Vec::len).sum()
    }
}

/// A variable from above.
struct Seen {
    at: [f64; 2],
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
