//! Documents with other vertices.

use std::collections::BTreeMap;
use std::sync::Arc;

use evergraph_model::{Point2, Point3, Pose2, Pose3, Value};

use crate::check::slot;
use crate::contents::Contents;
use crate::convert;
use crate::coordinates::Coordinates;
use crate::document::Document;
use crate::error::FormatError;
use crate::options::{Dialect, ReadOptions};
use crate::record::{Line, Record};

impl Document {
    /// The same graph with these values as its vertices.
    ///
    /// A VERTEX record keeps its place and takes the new value; vertices that the document has none
    /// for come after its last one, by id. The document's other lines are as they were. Values that
    /// are not given stay as the file has them.
    ///
    /// # Errors
    /// [`FormatError::BadEstimate`] for an id that is not in the document or is given twice, or a
    /// value of another type or that is not finite; [`FormatError::MissingVertex`] when the document
    /// had no vertices and not all are given.
    pub fn with_vertices(
        &self,
        estimates: impl IntoIterator<Item = (u64, Value)>,
    ) -> Result<Self, FormatError> {
        self.part_with_vertices(|_| true, estimates)
    }

    /// [`with_vertices`](Self::with_vertices) for a part of the graph: `keep` says which edges, FIX lines and sensor offsets stay, and which vertices that have no
    /// estimate.
    ///
    /// # Errors
    /// As [`with_vertices`](Self::with_vertices), and where an edge stays without its vertices.
    pub fn part_with_vertices(
        &self,
        keep: impl Fn(&Line) -> bool,
        estimates: impl IntoIterator<Item = (u64, Value)>,
    ) -> Result<Self, FormatError> {
        let mut estimates = self.coordinates_of(estimates)?;
        let mut lines = Vec::with_capacity(self.lines.len() + estimates.len());
        let mut after_vertices = 0;
        for line in &self.lines {
            let mut line = line.clone();
            let mut given = false;
            if let Record::Vertex { id, at } = &mut line.record
                && let Some(estimate) = estimates.remove(&slot(*id, at.kind()))
            {
                *at = estimate;
                given = true;
            }
            if given || keep(&line) {
                if matches!(line.record, Record::Vertex { .. }) {
                    after_vertices = lines.len() + 1;
                }
                lines.push(line);
            }
        }
        let added =
            estimates.into_iter().map(|((id, _), at)| Line::from(Record::Vertex { id, at }));
        lines.splice(after_vertices..after_vertices, added);

        let options = ReadOptions {
            isam_matrix: self.isam_matrix,
            g2o_rotation: self.g2o_rotation,
            ..ReadOptions::default()
        };
        let contents = Contents {
            dialect: Some(self.dialect),
            lines,
            total_lines: self.summary.lines,
            summary: self.summary.clone(),
            skipped: Vec::new(),
        };
        Self::reconcile(Arc::clone(&self.name), contents, &options)
    }

    fn coordinates_of(
        &self,
        estimates: impl IntoIterator<Item = (u64, Value)>,
    ) -> Result<BTreeMap<(u64, bool), Coordinates>, FormatError> {
        let mut all = BTreeMap::new();
        for (id, value) in estimates {
            let bad =
                |problem| FormatError::BadEstimate { file: Arc::clone(&self.name), id, problem };
            let at = coordinates(&value, self.dialect)
                .ok_or_else(|| bad(format!("no vertex is a {}", value.kind().name())))?;
            match self.kinds.get(id, at.kind().is_pose()).or(self.kind(id)) {
                None => return Err(bad("the document has no such vertex".into())),
                Some(kind) if kind != at.kind() => {
                    return Err(bad(format!(
                        "it is a {}, the vertex is a {}",
                        at.kind().name(),
                        kind.name()
                    )));
                }
                Some(_) => {}
            }
            if at.numbers().iter().any(|x| !x.is_finite()) {
                return Err(bad(format!("it is not finite: {:?}", at.numbers())));
            }
            if all.insert(slot(id, at.kind()), at).is_some() {
                return Err(bad("it is given twice".into()));
            }
        }
        Ok(all)
    }
}

/// A value in the numbers that a dialect writes, if files can hold its type.
pub(crate) fn coordinates(value: &Value, dialect: Dialect) -> Option<Coordinates> {
    if let Some(pose) = value.get::<Pose2>() {
        return Some(Coordinates::Pose2([pose.x(), pose.y(), pose.theta()]));
    }
    if let Some(pose) = value.get::<Pose3>() {
        let write = if dialect == Dialect::Toro { convert::euler } else { convert::quaternion };
        return Some(write(&pose));
    }
    if let Some(point) = value.get::<Point2>() {
        return Some(Coordinates::Point2([point.x(), point.y()]));
    }
    let point = value.get::<Point3>()?;
    Some(Coordinates::Point3([point.x(), point.y(), point.z()]))
}
