//! From records to text.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::convert::Converter;
use crate::document::Document;
use crate::error::FormatError;
use crate::options::{Dialect, WriteOptions};
use crate::record::{Line, Record};
use crate::tags::{ROBUST, Tag};
use crate::write_line::push_line;

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Written {
    /// Lines.
    pub lines: usize,
    /// Vertices that the target has no line for: an iSAM file has none, a TORO file none of landmarks,
    /// and their readers start from odometry and sightings.
    pub dropped_vertices: usize,
    /// Landmarks that got another id: iSAM numbers poses and landmarks apart, g2o does not. Those
    /// whose id a pose has, too, are numbered on from the largest id, in order.
    pub renumbered_landmarks: usize,
    /// Variables that were numbers and are names now, as PyFactorGraph wants it: pose 5 is `A5`,
    /// landmark 5 is `L5`. Read again, their ids are those of the names.
    pub named: usize,
    /// Lines of a PyFactorGraph file that had no time: theirs is the rank of the pose, in the order
    /// of ids from 0, of a factor the highest of its poses.
    pub added_times: usize,
    /// Lines whose time was lost; only PyFactorGraph's files have times.
    pub dropped_times: usize,
    /// What [`WriteOptions::plain`] left out, by tag; `ROBUST` counts lines that lost their kernel.
    pub left_out: BTreeMap<&'static str, usize>,
}

impl Document {
    /// Writes the records as `dialect` does, numbers with the fewest digits that read back as the
    /// same bits.
    ///
    /// The dialect that was read gets equal lines, bit for bit. Any other gets the same graph:
    /// matrices of its own kind and order (iSAM square roots by Cholesky, PyFactorGraph
    /// covariances), quaternions or Euler angles, landmarks in the robot's frame where there are no
    /// sensor offsets. What gets lost, added or another id is counted in [`Written`].
    ///
    /// # Errors
    /// [`FormatError::Unsupported`] for what the dialect cannot hold (in TORO landmarks that are not seen by
    /// bearing and range, FIX outside g2o), [`FormatError::BadMeasurement`] for a matrix that cannot be converted,
    /// [`FormatError::NoName`] and [`FormatError::NameTaken`] where ids make no names,
    /// [`FormatError::NoVertices`] where [`needs_vertices`](Self::needs_vertices) says so,
    /// [`FormatError::NothingToWrite`], [`FormatError::Write`].
    pub fn write(&self, out: &mut impl Write, dialect: Dialect) -> Result<Written, FormatError> {
        self.write_with(out, dialect, &WriteOptions::default())
    }

    /// [`write`](Self::write) with options.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn write_with(
        &self,
        out: &mut impl Write,
        dialect: Dialect,
        options: &WriteOptions,
    ) -> Result<Written, FormatError> {
        if self.needs_vertices(dialect) {
            return Err(FormatError::NoVertices { file: self.name().into() });
        }
        let converter = Converter::new(self, dialect)?;
        let mut writer =
            Writer { out, dialect, options, text: String::new(), written: Written::default() };
        let failed = |source| FormatError::Write { file: self.name().into(), source };
        if let Some(offset) = converter.default_offset() {
            writer.line(offset.into()).map_err(failed)?;
        }
        // TORO tells its EDGE2 from iSAM's by the vertices before it.
        let vertices_first = dialect == Dialect::Toro && self.edges_come_first();
        let passes: &[Option<bool>] =
            if vertices_first { &[Some(true), Some(false)] } else { &[None] };
        for &pass in passes {
            for line in &self.lines {
                let is_vertex = matches!(line.record, Record::Vertex { .. });
                if pass.is_some_and(|vertices| vertices != is_vertex) {
                    continue;
                }
                let Some(converted) = converter.line(line)? else {
                    writer.written.dropped_vertices += usize::from(is_vertex);
                    continue;
                };
                writer.written.dropped_times +=
                    usize::from(line.time().is_some() && converted.time().is_none());
                writer.written.added_times +=
                    usize::from(line.time().is_none() && converted.time().is_some());
                writer.line(converted).map_err(failed)?;
            }
        }
        writer.out.flush().map_err(failed)?;
        let written = writer.written;
        if written.lines == 0 && !self.lines.is_empty() {
            return Err(FormatError::NothingToWrite { file: self.name().into(), dialect });
        }
        let (renumbered_landmarks, named) = (converter.renumbered(), converter.named());
        Ok(Written { renumbered_landmarks, named, ..written })
    }

    /// Writes a file; the dialect goes by the extension, see [`Dialect::of_extension`].
    ///
    /// # Errors
    /// [`FormatError::UnknownExtension`] and those of [`write`](Self::write). What the dialect
    /// cannot hold is found before the file is touched.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<Written, FormatError> {
        self.save_with(path, &WriteOptions::default())
    }

    /// [`save`](Self::save) with options.
    ///
    /// # Errors
    /// As [`save`](Self::save).
    pub fn save_with(
        &self,
        path: impl AsRef<Path>,
        options: &WriteOptions,
    ) -> Result<Written, FormatError> {
        let path = path.as_ref();
        let file = || path.display().to_string().into();
        let Some(dialect) = Dialect::of_extension(path) else {
            return Err(FormatError::UnknownExtension { file: file() });
        };
        if dialect != self.dialect || options.plain {
            self.write_with(&mut io::sink(), dialect, options)?;
        }
        let target =
            File::create(path).map_err(|source| FormatError::Write { file: file(), source })?;
        match self.write_with(&mut BufWriter::new(target), dialect, options) {
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

    /// Whether the document has to get vertices before it can be written as `dialect`: without them
    /// nothing would tell TORO's EDGE2 from iSAM's, and where there are vertices, only TORO's landmarks
    /// can do without. `evergraph_replay::with_start_vertices` composes them.
    pub fn needs_vertices(&self, dialect: Dialect) -> bool {
        let (summary, count) = (self.summary(), self.summary().vertices);
        if self.dialect == Dialect::Toro && matches!(dialect, Dialect::G2o | Dialect::Pyfg) {
            return count > 0 && count < summary.poses + summary.landmarks;
        }
        let is_bare = self.summary().vertices == 0 && self.summary().landmarks == 0;
        dialect == Dialect::Toro && self.dialect != Dialect::Toro && is_bare
    }
}

/// Where lines go, in the form of their dialect.
struct Writer<'a, W> {
    out: &'a mut W,
    dialect: Dialect,
    options: &'a WriteOptions,
    text: String,
    written: Written,
}

impl<W: Write> Writer<'_, W> {
    fn line(&mut self, mut line: Line) -> io::Result<()> {
        let Some(tag) = Tag::of(&line.record, self.dialect) else {
            // The converter leaves nothing that the dialect has no line for.
            let name = line.record.name();
            return Err(io::Error::other(format!("{} has no line for {name}", self.dialect)));
        };
        let mut leave_out = |what| *self.written.left_out.entry(what).or_default() += 1;
        if self.options.plain && tag.is_our_own() {
            leave_out(tag.name);
            return Ok(());
        }
        if self.options.plain && line.kernel().is_some() {
            leave_out(ROBUST);
            line.set_kernel(None);
        }
        self.text.clear();
        push_line(&mut self.text, tag, &line);
        self.written.lines += 1;
        self.out.write_all(self.text.as_bytes())
    }
}
