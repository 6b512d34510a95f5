//! A graph file in memory.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::Path;
use std::sync::Arc;

use crate::check;
use crate::contents::{Contents, Skipped, Summary};
use crate::coordinates::Kind;
use crate::error::{FormatError, Place};
use crate::kinds::Kinds;
use crate::options::{Dialect, G2oRotation, ReadOptions};
use crate::parse;
use crate::reconcile::reconcile;
use crate::record::{Line, Record};
use crate::source;
use crate::weight::WeightKind;

/// The records of a graph file, in the order of its lines and in the file's own numbers.
///
/// What a document holds fits together: each variable is of one kind, edges lead from poses to
/// variables that are there, matrices and quaternions are usable. Writing the dialect that was read
/// gives equal records, bit for bit.
///
/// ```
/// use evergraph_formats::{Document, ReadOptions};
/// # fn main() -> Result<(), evergraph_formats::FormatError> {
/// let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\n";
/// let document = Document::parse("two poses", text.as_bytes(), &ReadOptions::default())?;
/// assert_eq!((document.summary().poses, document.summary().pose_edges), (2, 1));
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Document {
    pub(crate) name: Arc<str>,
    pub(crate) dialect: Dialect,
    pub(crate) isam_matrix: WeightKind,
    pub(crate) g2o_rotation: G2oRotation,
    pub(crate) lines: Vec<Line>,
    pub(crate) kinds: Kinds,
    pub(crate) summary: Summary,
    pub(crate) skipped: Vec<Skipped>,
}

impl Document {
    /// Reads a graph file, a line at a time; one that is compressed with gzip as
    /// [`read_stream`](Self::read_stream) does.
    ///
    /// # Errors
    /// [`FormatError::Read`], and whatever is wrong with a line; with [`ReadOptions::lenient`] bad
    /// lines are skipped instead, and a file without any good line is [`FormatError::Empty`].
    pub fn read(path: impl AsRef<Path>, options: &ReadOptions) -> Result<Self, FormatError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let open = |source| FormatError::Read { file: name.as_str().into(), source };
        let file = File::open(path).map_err(open)?;
        let mut reader = BufReader::with_capacity(1 << 16, &file);
        if source::is_gzip(reader.fill_buf().map_err(open)?) || (&file).stream_position().is_err() {
            return Self::read_stream(&name, reader, options);
        }
        let as_toro = ReadOptions { format: Some(Dialect::Toro), ..options.clone() };
        match Self::parse(&name, reader, options) {
            Err(FormatError::EdgesBeforeVertices { .. }) if (&file).rewind().is_ok() => {
                Self::parse(&name, BufReader::with_capacity(1 << 16, &file), &as_toro)
            }
            result => result,
        }
    }

    /// Reads a graph from a stream, such as standard input, whole into memory; `name` stands for it in
    /// messages. A stream that is compressed with gzip is inflated, up to 4 GiB.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_stream(
        name: &str,
        stream: impl Read,
        options: &ReadOptions,
    ) -> Result<Self, FormatError> {
        let failed = |source| FormatError::Read { file: name.into(), source };
        let bytes = source::read(stream).map_err(failed)?;
        match Self::parse(name, &*bytes, options) {
            Err(FormatError::EdgesBeforeVertices { .. }) => {
                let as_toro = ReadOptions { format: Some(Dialect::Toro), ..options.clone() };
                Self::parse(name, &*bytes, &as_toro)
            }
            result => result,
        }
    }

    /// Reads a graph from anything that gives bytes, such as `text.as_bytes()`; `name` stands for
    /// the file in messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(
        name: &str,
        reader: impl BufRead,
        options: &ReadOptions,
    ) -> Result<Self, FormatError> {
        let name: Arc<str> = name.into();
        let contents = parse::read(&name, reader, options)?;
        let document = Self::reconcile(name, contents, options)?;
        if document.kinds.is_empty() {
            let ignored =
                document.summary.skipped + document.summary.ignored.values().sum::<usize>();
            return Err(FormatError::Empty { file: document.name, ignored });
        }
        Ok(document)
    }

    /// A document of records that were not read from a file, checked as a file's are.
    ///
    /// `dialect` says what the records are meant for; each may be in any form that can be converted
    /// to it. Lines are numbered from 1, as the records would be written.
    ///
    /// # Errors
    /// As [`read`](Self::read), for what a record can be wrong about.
    pub fn from_records(
        name: &str,
        dialect: Dialect,
        records: impl IntoIterator<Item = impl Into<Line>>,
    ) -> Result<Self, FormatError> {
        let name: Arc<str> = name.into();
        let mut contents = Contents { dialect: Some(dialect), ..Contents::default() };
        for (index, record) in records.into_iter().enumerate() {
            let mut line: Line = record.into();
            line.number = index + 1;
            let place = Place { file: Arc::clone(&name), line: line.number };
            let finding = check::inspect(&line, line.record.name(), &place, |_| Vec::new())?;
            contents.note(finding);
            contents.lines.push(line);
        }
        contents.total_lines = contents.lines.len();
        Self::reconcile(name, contents, &ReadOptions::default())
    }

    pub(crate) fn reconcile(
        name: Arc<str>,
        mut contents: Contents,
        options: &ReadOptions,
    ) -> Result<Self, FormatError> {
        let mut lines = std::mem::take(&mut contents.lines);
        let dialect = contents.dialect.unwrap_or(Dialect::G2o);
        let numbered_apart = matches!(dialect, Dialect::Isam | Dialect::Toro);
        let kinds = reconcile(&name, &mut lines, numbered_apart, |error| {
            let line = error.line();
            contents.reject(error, line, options.lenient)
        })?;
        contents.summary.lines = contents.total_lines;
        contents.summary.count(&lines, &kinds);
        contents.skipped.sort_by_key(|skipped| skipped.line);
        Ok(Self {
            name,
            dialect,
            isam_matrix: options.isam_matrix,
            g2o_rotation: options.g2o_rotation,
            lines,
            kinds,
            summary: contents.summary,
            skipped: contents.skipped,
        })
    }

    /// The file's name, as the caller gave it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The dialect that the records were read from, or are meant for.
    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// Whether VERTEX lines are ground truth rather than an estimate: they are in PyFactorGraph's
    /// files.
    pub fn vertices_are_truth(&self) -> bool {
        self.dialect == Dialect::Pyfg
    }

    /// The records with the lines they stand in.
    pub fn lines(&self) -> &[Line] {
        &self.lines
    }

    /// The records.
    pub fn records(&self) -> impl ExactSizeIterator<Item = &Record> {
        self.lines.iter().map(|line| &line.record)
    }

    /// What there is, counted.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// The bad lines that were skipped, in the order of the file; the first 1000 of them.
    pub fn skipped(&self) -> &[Skipped] {
        &self.skipped
    }

    /// What a variable is, if it is here. Where a pose and a landmark have the same id, as in some
    /// iSAM files, which number them apart, it is the pose.
    pub fn kind(&self, id: u64) -> Option<Kind> {
        self.kinds.get(id, true).or(self.kinds.get(id, false))
    }

    /// All variables, by id, a pose before a landmark.
    pub fn ids(&self) -> Vec<(u64, Kind)> {
        self.kinds.as_slice().to_vec()
    }

    /// A line of the file, for messages.
    pub fn place(&self, line: usize) -> Place {
        Place { file: Arc::clone(&self.name), line }
    }
}
