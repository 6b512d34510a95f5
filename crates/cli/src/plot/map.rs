//! What of a map a plot shows.

use std::collections::{BTreeMap, HashMap};

use evergraph::model::{Point2, Point3, Pose2, Pose3, Value, VariableId};
use evergraph::{Replayer, SmootherError};

/// A map from above.
#[derive(Clone, Debug, Default)]
pub(crate) struct Map {
    /// The poses in the order in which they came in, a new line where no measurement leads from
    /// an earlier one to a pose.
    pub trajectory: Vec<Vec<[f64; 2]>>,
    /// Ends of the measurements between any other two poses, each pair once.
    pub closures: Vec<[[f64; 2]; 2]>,
    pub landmarks: Vec<[f64; 2]>,
    pub in_space: bool,
}

impl Map {
    /// The current estimate.
    pub fn of(replayer: &Replayer) -> Result<Self, SmootherError> {
        let estimates = replayer.smoother().estimates()?;
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
        // How many numbers each pair of poses was measured by.
        let mut pairs: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        for (_, factor) in replayer.graph().factors() {
            let [a, b] = factor.keys() else { continue };
            let (Some(&a), Some(&b)) = (place_of.get(a), place_of.get(b)) else { continue };
            *pairs.entry([a.max(b), a.min(b)]).or_default() += factor.residual_dim();
        }
        map.connect(&poses, &pairs);
        Ok(map)
    }

    /// Makes lines of the poses; `pairs` holds the later of two poses first. Each pose goes on from
    /// the latest one that it is measured from and that none goes on from yet, so that robots that
    /// drive at once have a line each. A range alone is no motion.
    fn connect(&mut self, poses: &[[f64; 2]], pairs: &BTreeMap<[usize; 2], usize>) {
        // The line that ends at a pose.
        let mut ends: HashMap<usize, usize> = HashMap::new();
        for (place, &at) in poses.iter().enumerate() {
            let mut before: Vec<usize> = Vec::new();
            let mut line = None;
            for ([_, earlier], rows) in pairs.range([place, 0]..[place + 1, 0]).rev() {
                if line.is_none() && *rows > 1 {
                    line = ends.remove(earlier);
                    if line.is_some() {
                        continue;
                    }
                }
                before.push(*earlier);
            }
            self.closures.extend(before.iter().rev().map(|&earlier| [poses[earlier], at]));
            let line = line.unwrap_or_else(|| {
                self.trajectory.push(Vec::new());
                self.trajectory.len() - 1
            });
            self.trajectory[line].push(at);
            ends.insert(place, line);
        }
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
