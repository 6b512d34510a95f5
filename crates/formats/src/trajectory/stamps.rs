//! Times of poses that a graph file knows by their ids only.

use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::Path;
use std::sync::Arc;

use super::error::TrajectoryError;
use super::lines::{for_each_line, number, open};
use crate::document::Document;
use crate::error::{Field, FormatError, excerpt};
use crate::record::Record;

const LAYOUT: &str = "id,timestamp";

/// When the poses of a graph were, by id, in seconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamps {
    name: Arc<str>,
    times: BTreeMap<u64, f64>,
}

impl Stamps {
    /// Reads a csv file of lines `id,timestamp`. A first line `id,timestamp` is the header; blank
    /// lines and `#` lines are passed over.
    ///
    /// # Errors
    /// [`FormatError::Read`], and for a line that is not an id and a finite number, or gives an id
    /// again.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, TrajectoryError> {
        let (name, file) = open(path.as_ref())?;
        Self::parse(&name, file)
    }

    /// Reads times from anything that gives bytes; `name` stands for the file in messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(name: &str, reader: impl BufRead) -> Result<Self, TrajectoryError> {
        let name: Arc<str> = name.into();
        let mut lines: BTreeMap<u64, (f64, usize)> = BTreeMap::new();
        let mut is_first = true;
        for_each_line(&name, reader, |place, text| {
            let words: Vec<&str> = text.split(',').map(str::trim).collect();
            if std::mem::take(&mut is_first) && words == ["id", "timestamp"] {
                return Ok(());
            }
            let &[id, time] = words.as_slice() else {
                let (place, found) = (place.clone(), words.len());
                let (format, expected) = ("a file of times", 2);
                let layout = LAYOUT;
                return Err(TrajectoryError::FieldCount { place, format, expected, found, layout });
            };
            let field =
                |number, name, word| Field { tag: "the line", number, name, text: excerpt(word) };
            let (id, word): (Result<u64, _>, _) = (id.parse(), id);
            let id = id.map_err(|_| FormatError::NotAnId {
                place: place.clone(),
                field: Box::new(field(1, "id", word)),
            })?;
            let time = number(time, place, || field(2, "timestamp", time))?;
            if let Some((_, first)) = lines.insert(id, (time, place.line)) {
                let (place, what) = (place.clone(), "the time of pose");
                return Err(FormatError::Duplicate { place, what, id, first }.into());
            }
            Ok(())
        })?;
        let times = lines.into_iter().map(|(id, (time, _))| (id, time)).collect();
        Ok(Self { name, times })
    }

    /// The times that the pose vertices of a document have; empty where its format has none.
    pub fn of_document(document: &Document) -> Self {
        let times = document.lines().iter().filter_map(|line| match &line.record {
            Record::Vertex { id, at } if at.kind().is_pose() => Some((*id, line.time()?)),
            _ => None,
        });
        Self { name: document.name().into(), times: times.collect() }
    }

    /// Where the times come from.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// When a pose was, if that is known.
    pub fn time(&self, id: u64) -> Option<f64> {
        self.times.get(&id).copied()
    }

    /// How many times there are.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }
}
