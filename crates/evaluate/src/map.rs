//! Poses and landmarks, estimated or true.

use std::collections::BTreeMap;
use std::path::Path;

use evergraph_formats::{
    Coordinates, Document, ReadOptions, Record, Stamps, Trajectory, TrajectoryFormat,
};
use evergraph_model::{Point2, Point3, Value};
use evergraph_replay::Initial;

use crate::error::EvaluateError;
use crate::start::Start;

/// A map to be measured, or to measure by.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Its poses.
    pub trajectory: Trajectory,
    /// Its landmarks by id; those of the plane at z = 0.
    pub landmarks: BTreeMap<u64, Point3>,
}

/// Noise-free edges leave what printing rounded away, over the 10000 poses of city10000 four
/// hundredths of a standard deviation; noisy ones about one even where everything is solved, and tens
/// where poses are composed.
const NOISE_FREE: f64 = 0.5;

impl Map {
    /// The poses and points among these values, which a file knows by these ids. `name` stands for
    /// the map in messages.
    ///
    /// # Errors
    /// As [`Trajectory::of_estimates`].
    pub fn of_estimates(
        name: &str,
        values: impl IntoIterator<Item = (u64, Value)>,
    ) -> Result<Self, EvaluateError> {
        let values: Vec<(u64, Value)> = values.into_iter().collect();
        let landmarks = values.iter().filter_map(|(id, value)| Some((*id, point(value)?)));
        let landmarks = landmarks.collect();
        Ok(Self { trajectory: Trajectory::of_estimates(name, values)?, landmarks })
    }

    /// The vertices of a graph file, in the order of their times where they have times. Where the
    /// file has no vertices, as iSAM's, the poses are composed from its edges, which has to be
    /// noise-free to mean anything: its other edges are asked whether they agree.
    ///
    /// # Errors
    /// [`EvaluateError::Contradiction`] where they do not agree (by half of their standard
    /// deviations or more, root mean square); [`EvaluateError::Format`],
    /// [`EvaluateError::Trajectory`] when there is no pose or the file is no graph.
    pub fn of_document(document: &Document) -> Result<Self, EvaluateError> {
        if document.summary().vertices == 0 {
            return Self::composed(document);
        }
        let landmark = |record: &Record| match *record {
            Record::Vertex { id, at: Coordinates::Point2([x, y]) } => {
                Some((id, Point3::new(x, y, 0.0)))
            }
            Record::Vertex { id, at: Coordinates::Point3(at) } => Some((id, at.into())),
            _ => None,
        };
        let landmarks = document.records().filter_map(landmark).collect();
        Ok(Self { trajectory: Trajectory::of_document(document)?, landmarks })
    }

    fn composed(document: &Document) -> Result<Self, EvaluateError> {
        let start = Start::of(document, Initial::FromOdometry)?;
        let rows = start.rows().max(1) as f64;
        let sigmas = (start.objective()?.chi2 / rows).sqrt();
        if sigmas.is_nan() || sigmas >= NOISE_FREE {
            return Err(EvaluateError::Contradiction { file: document.name().into(), sigmas });
        }
        Self::of_estimates(document.name(), start.values())
    }

    /// Reads whatever says where a robot was: a TUM or KITTI file (without landmarks), or a graph
    /// file as [`of_document`](Self::of_document). What it is is told by its content unless
    /// `format` says that it is a trajectory.
    ///
    /// # Errors
    /// [`EvaluateError`]: the file cannot be read, or not used.
    pub fn read(
        path: impl AsRef<Path>,
        format: Option<TrajectoryFormat>,
        options: &ReadOptions,
    ) -> Result<Self, EvaluateError> {
        let path = path.as_ref();
        let format = match format {
            Some(format) => Some(format),
            None => TrajectoryFormat::of_content(path)?,
        };
        match format {
            Some(format) => {
                let trajectory = Trajectory::read(path, format)?;
                Ok(Self { trajectory, landmarks: BTreeMap::new() })
            }
            None => Self::of_document(&Document::read(path, options)?),
        }
    }

    /// The same map with times for its poses.
    ///
    /// # Errors
    /// As [`Trajectory::with_stamps`].
    pub fn with_stamps(self, stamps: &Stamps) -> Result<Self, EvaluateError> {
        Ok(Self { trajectory: self.trajectory.with_stamps(stamps)?, ..self })
    }
}

fn point(value: &Value) -> Option<Point3> {
    let planar = value.get::<Point2>().map(|point| Point3::new(point.x(), point.y(), 0.0));
    planar.or_else(|| value.get::<Point3>())
}
