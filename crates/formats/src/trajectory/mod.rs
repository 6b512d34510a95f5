//! Poses along a path: what trajectory files hold, and what errors are measured on.
//!
//! | format | a line | fields |
//! |---|---|---|
//! | TUM | `timestamp tx ty tz qx qy qz qw` | time (s), position (m), unit quaternion |
//! | KITTI | `r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz` | the upper 3 rows of the matrix of the pose |
//!
//! Fields are separated by spaces or tabs; blank lines and lines that begin with `#` are passed
//! over. A pose is `world_from_robot`. References: J. Sturm et al., "A benchmark for the evaluation
//! of RGB-D SLAM systems" (2012); A. Geiger et al., "Are we ready for autonomous driving? The KITTI
//! vision benchmark suite" (2012).

mod error;
mod lines;
mod read;
mod stamps;
mod write;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use evergraph_model::{Point3, Pose2, Pose3, Rot3, Value};

pub use error::TrajectoryError;
pub use stamps::Stamps;

use crate::convert;
use crate::coordinates::Coordinates;
use crate::document::Document;
use crate::names;
use crate::record::Record;

/// A format of trajectory files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum TrajectoryFormat {
    /// A time, a position and a quaternion a line.
    Tum,
    /// The upper 3 rows of a pose's matrix a line; no times.
    Kitti,
}

impl TrajectoryFormat {
    /// The format that a file of this name is *written* in: `.tum`, `.kitti`.
    pub fn of_extension(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "tum" => Some(Self::Tum),
            "kitti" => Some(Self::Kitti),
            _ => None,
        }
    }
}

/// Poses in space in the order of their times, or of their ids where there are no times. Poses in
/// the plane are lifted to z = 0.
///
/// There is always at least one pose, every number is finite, and of ids and times at least one is
/// known: ids where the poses come from a graph, times where they come from a TUM file, both where
/// [`Stamps`] are added. The poses of a KITTI file have the numbers of their rows, from 0, as ids.
///
/// ```
/// use evergraph_formats::{Trajectory, TrajectoryFormat};
/// # fn main() -> Result<(), evergraph_formats::TrajectoryError> {
/// let text = "# timestamp tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0 1\n1.5 2 2 3 0 0 0 1\n";
/// let path = Trajectory::parse("example.tum", text.as_bytes(), TrajectoryFormat::Tum)?;
/// assert_eq!(path.times(), Some(&[0.5, 1.5][..]));
/// let mut kitti = Vec::new();
/// path.write(&mut kitti, TrajectoryFormat::Kitti)?;
/// assert_eq!(kitti, b"1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 2 0 1 0 2 0 0 1 3\n");
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    name: Arc<str>,
    poses: Vec<Pose3>,
    ids: Option<Vec<u64>>,
    times: Option<Vec<f64>>,
    /// The lines of a KITTI file in its own numbers, so that writing it again gives the same bits.
    matrices: Option<Vec<[f64; 12]>>,
    /// Whether the poses were given as poses of the plane.
    of_plane: bool,
}

impl Trajectory {
    /// The poses among these values, by id; values of other types are passed over. `name` stands
    /// for the trajectory in messages.
    ///
    /// # Errors
    /// [`TrajectoryError::NoPose`], [`TrajectoryError::DuplicatePose`],
    /// [`TrajectoryError::BadPose`] for one that is not finite.
    pub fn of_estimates(
        name: &str,
        values: impl IntoIterator<Item = (u64, Value)>,
    ) -> Result<Self, TrajectoryError> {
        let mut of_plane = true;
        let poses = values.into_iter().filter_map(|(id, value)| {
            let pose = lift(&value)?;
            of_plane &= value.get::<Pose2>().is_some();
            Some((id, pose))
        });
        let poses: Vec<(u64, Pose3)> = poses.collect();
        Self::by_id(name, poses, of_plane)
    }

    /// The pose vertices of a graph file, by time where they have times, else by id.
    ///
    /// # Errors
    /// As [`of_estimates`](Self::of_estimates), and [`TrajectoryError::NoTime`] when only some of
    /// the poses have a time.
    pub fn of_document(document: &Document) -> Result<Self, TrajectoryError> {
        let mut of_plane = true;
        let poses = document.records().filter_map(|record| match record {
            Record::Vertex { id, at } => {
                let pose = pose(at)?;
                of_plane &= matches!(at, Coordinates::Pose2(_));
                Some((*id, pose))
            }
            _ => None,
        });
        let poses: Vec<(u64, Pose3)> = poses.collect();
        let trajectory = Self::by_id(document.name(), poses, of_plane)?;
        let stamps = Stamps::of_document(document);
        if stamps.is_empty() { Ok(trajectory) } else { trajectory.with_stamps(&stamps) }
    }

    fn by_id(
        name: &str,
        poses: Vec<(u64, Pose3)>,
        of_plane: bool,
    ) -> Result<Self, TrajectoryError> {
        let name: Arc<str> = name.into();
        let mut sorted = BTreeMap::new();
        for (id, pose) in poses {
            if !is_finite(&pose) {
                return Err(TrajectoryError::BadPose { name, id });
            }
            if sorted.insert(id, pose).is_some() {
                return Err(TrajectoryError::DuplicatePose { name, id });
            }
        }
        if sorted.is_empty() {
            return Err(TrajectoryError::NoPose { name });
        }
        let (ids, poses) = sorted.into_iter().unzip();
        Ok(Self { name, poses, ids: Some(ids), times: None, matrices: None, of_plane })
    }

    /// The same poses with times, in their order; equal times by id.
    ///
    /// # Errors
    /// [`TrajectoryError::NoTime`] for a pose that has none, [`TrajectoryError::NoIds`] for a
    /// trajectory without ids.
    pub fn with_stamps(&self, stamps: &Stamps) -> Result<Self, TrajectoryError> {
        let Some(ids) = &self.ids else {
            return Err(TrajectoryError::NoIds { name: Arc::clone(&self.name) });
        };
        let time = |(place, &id): (usize, &u64)| {
            let time = stamps.time(id);
            time.map(|time| (time, id, place)).ok_or_else(|| TrajectoryError::NoTime {
                name: Arc::clone(&self.name),
                id,
                stamps: stamps.name().into(),
            })
        };
        let mut order = ids.iter().enumerate().map(time).collect::<Result<Vec<_>, _>>()?;
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let matrices = self.matrices.as_ref();
        Ok(Self {
            name: Arc::clone(&self.name),
            poses: order.iter().map(|&(_, _, place)| self.poses[place]).collect(),
            ids: Some(order.iter().map(|&(_, id, _)| id).collect()),
            times: Some(order.iter().map(|&(time, _, _)| time).collect()),
            matrices: matrices.map(|m| order.iter().map(|&(_, _, place)| m[place]).collect()),
            of_plane: self.of_plane,
        })
    }

    /// What stands for the trajectory in messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How many poses there are.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is none; never so.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The poses, `world_from_robot`.
    pub fn poses(&self) -> &[Pose3] {
        &self.poses
    }

    /// The ids of the poses, where they are known.
    pub fn ids(&self) -> Option<&[u64]> {
        self.ids.as_deref()
    }

    /// The times of the poses in seconds, where they are known; they never descend.
    pub fn times(&self) -> Option<&[f64]> {
        self.times.as_deref()
    }

    /// The time of a pose, or its id as a number where times are not known. Of ids that are names of
    /// one robot (`x12`, GTSAM's keys) the number counts.
    ///
    /// # Panics
    /// When there is no pose of this index.
    pub fn time_or_id(&self, index: usize) -> f64 {
        match (&self.times, &self.ids) {
            (Some(times), _) => times[index],
            (None, Some(ids)) => names::number_of(ids[index], ids) as f64,
            (None, None) => index as f64,
        }
    }

    /// Whether all poses were given as poses of the plane, such as `Pose2` or the vertices of a 2D graph.
    pub fn is_of_plane(&self) -> bool {
        self.of_plane
    }

    /// Whether all poses lie in the plane z = 0 and are turned about its normal only, to the bit.
    pub fn is_planar(&self) -> bool {
        self.poses.iter().all(|pose| {
            let [qx, qy, _, _] = pose.rotation().quaternion();
            pose.z() == 0.0 && qx == 0.0 && qy == 0.0
        })
    }
}

/// A pose of the plane in space.
fn in_space(x: f64, y: f64, theta: f64) -> Pose3 {
    Pose3::new(Rot3::from_roll_pitch_yaw(0.0, 0.0, theta), Point3::new(x, y, 0.0))
}

/// The pose that coordinates name, lifted to space; `None` for those of a landmark.
fn pose(at: &Coordinates) -> Option<Pose3> {
    match *at {
        Coordinates::Pose2([x, y, theta]) => Some(in_space(x, y, theta)),
        _ => convert::pose3(at),
    }
}

/// A value as a pose in space; `None` when it is no pose.
fn lift(value: &Value) -> Option<Pose3> {
    let planar = value.get::<Pose2>().map(|pose| in_space(pose.x(), pose.y(), pose.theta()));
    planar.or_else(|| value.get::<Pose3>())
}

fn is_finite(pose: &Pose3) -> bool {
    let [qx, qy, qz, qw] = pose.rotation().quaternion();
    [pose.x(), pose.y(), pose.z(), qx, qy, qz, qw].iter().all(|x| x.is_finite())
}
