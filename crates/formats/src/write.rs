//! From records to text.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use evergraph_model::Graph;

use crate::convert::Converter;
use crate::document::Document;
use crate::error::FormatError;
use crate::options::Dialect;
use crate::record::{Coordinates, Line, Record};
use crate::replay::{Replay, ReplayOptions};
use crate::tags::{Shape, TAGS, Tag};

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Lines.
    pub lines: usize,
    /// Vertices that the target has no line for: an iSAM file has none, and its readers start from
    /// odometry.
    pub dropped_vertices: usize,
    /// Vertices composed from the edges, for a TORO file, which is known by its vertices.
    pub added_vertices: usize,
    /// Landmarks that got another id: iSAM numbers poses and landmarks apart, g2o does not. Those
    /// whose id a pose has, too, are numbered on from the largest id, in order.
    pub renumbered_landmarks: usize,
}

impl Document {
    /// Writes the records as `dialect` does, numbers with the fewest digits that read back as the
    /// same bits.
    ///
    /// The dialect that was read gets equal records, bit for bit. Any other gets the same graph:
    /// matrices of its own kind and order (iSAM square roots by Cholesky), quaternions or Euler
    /// angles, landmarks in the robot's frame where there are no sensor offsets. What gets lost,
    /// added or another id is counted in [`Written`].
    ///
    /// # Errors
    /// [`FormatError::Unsupported`] for what the dialect cannot hold (landmarks in TORO, FIX outside
    /// g2o), [`FormatError::BadMeasurement`] for a matrix that cannot be converted,
    /// [`FormatError::Write`].
    pub fn write(&self, out: &mut impl Write, dialect: Dialect) -> Result<Written, FormatError> {
        let is_bare = self.summary().vertices == 0 && self.summary().landmarks == 0;
        if dialect == Dialect::Toro && self.dialect != Dialect::Toro && is_bare {
            // Without vertices nothing would tell TORO's EDGE2 from iSAM's.
            let complete = self.with_composed_vertices()?;
            let written = complete.write(out, dialect)?;
            return Ok(Written { added_vertices: complete.summary().vertices, ..written });
        }
        let io_error = |source| FormatError::Write { file: self.name().into(), source };
        let converter = Converter::new(self, dialect);
        let mut written = Written::default();
        let mut text = String::with_capacity(512);
        let mut put = |record: &Record| -> Result<(), FormatError> {
            text.clear();
            let Some(tag) = tag_for(record, dialect) else { return Ok(()) };
            format_record(&mut text, tag, record);
            written.lines += 1;
            out.write_all(text.as_bytes()).map_err(io_error)
        };
        let (id, needed) = converter.default_offset;
        if needed {
            let at = Coordinates::Pose3Quaternion([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
            put(&Record::SensorOffset { id, at })?;
        }
        // TORO tells its EDGE2 from iSAM's by the vertices before it.
        let vertices_first = dialect == Dialect::Toro && self.edges_come_first();
        let passes: &[Option<bool>] =
            if vertices_first { &[Some(true), Some(false)] } else { &[None] };
        let mut dropped_vertices = 0;
        for &pass in passes {
            for Line { number: line, record, .. } in &self.lines {
                let is_vertex = matches!(record, Record::Vertex { .. });
                if pass.is_some_and(|vertices| vertices != is_vertex) {
                    continue;
                }
                match converter.record(*line, record)? {
                    Some(record) => put(&record)?,
                    None => dropped_vertices += usize::from(is_vertex),
                }
            }
        }
        out.flush().map_err(io_error)?;
        let renumbered_landmarks = converter.renumbered();
        Ok(Written { dropped_vertices, renumbered_landmarks, ..written })
    }

    /// Writes a file; the dialect goes by the extension, see [`Dialect::of_extension`].
    ///
    /// # Errors
    /// [`FormatError::UnknownExtension`] and those of [`write`](Self::write). What the dialect
    /// cannot hold is found before the file is touched.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<Written, FormatError> {
        let path = path.as_ref();
        let file = || path.display().to_string().into();
        let Some(dialect) = Dialect::of_extension(path) else {
            return Err(FormatError::UnknownExtension { file: file() });
        };
        if dialect != self.dialect {
            self.write(&mut io::sink(), dialect)?;
        }
        let target =
            File::create(path).map_err(|source| FormatError::Write { file: file(), source })?;
        match self.write(&mut BufWriter::new(target), dialect) {
            Err(FormatError::Write { source, .. }) => {
                Err(FormatError::Write { file: file(), source })
            }
            other => other,
        }
    }

    fn edges_come_first(&self) -> bool {
        let first =
            self.records().find(|r| matches!(r, Record::Vertex { .. } | Record::Edge { .. }));
        matches!(first, Some(Record::Edge { .. }))
    }

    /// The document with vertices composed from its edges.
    fn with_composed_vertices(&self) -> Result<Self, FormatError> {
        let options = ReplayOptions { prior: None, ..ReplayOptions::default() };
        let mut replay = Replay::new(self, &options)?;
        let mut change = Graph::new().change();
        replay.everything(&mut change)?;
        let values = change.new_variables().iter().map(|(_, value)| value.clone());
        let ids: Vec<u64> = replay.ids().map(|(id, _)| id).collect();
        self.with_vertices(ids.into_iter().zip(values))
    }
}

/// The line of a dialect that holds a record, which is in the dialect's form.
fn tag_for(record: &Record, dialect: Dialect) -> Option<&'static Tag> {
    TAGS.iter().filter(|tag| tag.dialect == dialect).find(|tag| match (record, tag.shape) {
        (Record::Fix { .. }, Shape::Fix) => true,
        (Record::Vertex { at, .. }, Shape::Vertex(form))
        | (Record::SensorOffset { at, .. }, Shape::Offset(form)) => form.holds(at),
        (
            Record::Edge { measurement, .. },
            Shape::Edge(form) | Shape::EdgeOptionalMatrix(form) | Shape::EdgeWithParameter(form),
        ) => form.holds(measurement),
        _ => false,
    })
}

fn format_record(text: &mut String, tag: &Tag, record: &Record) {
    text.push_str(tag.name);
    let mut id = |id: u64| {
        text.push(' ');
        text.push_str(&id.to_string());
    };
    let (coordinates, entries): (&[f64], &[f64]) = match record {
        Record::Fix { id: vertex } => {
            id(*vertex);
            (&[], &[])
        }
        Record::Vertex { id: vertex, at } | Record::SensorOffset { id: vertex, at } => {
            id(*vertex);
            (at.numbers(), &[])
        }
        Record::Edge { from, to, measurement, weight, parameter } => {
            id(*from);
            id(*to);
            parameter.map(&mut id);
            (measurement.numbers(), &weight.entries)
        }
        _ => (&[], &[]),
    };
    for &x in coordinates.iter().chain(entries) {
        text.push(' ');
        push_number(text, x);
    }
    text.push('\n');
}

/// The shortest text that reads back as the same bits. Both notations have that property; the
/// exponent saves long runs of zeros.
pub(crate) fn push_number(text: &mut String, x: f64) {
    use std::fmt::Write;
    let size = x.abs();
    let plain = size == 0.0 || (1e-5..1e16).contains(&size);
    // Writing to a string cannot fail.
    let _ = if plain { write!(text, "{x}") } else { write!(text, "{x:e}") };
}
