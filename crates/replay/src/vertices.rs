//! Vertices for documents that lack some.

use std::collections::BTreeSet;

use evergraph_formats::{Document, Record};
use evergraph_model::{Graph, Pose2, Pose3, Value};

use crate::error::ReplayerError;
use crate::options::{Initial, ReplayOptions};
use crate::state::Replay;

/// The document with a vertex for each variable, at the start values of a replay where the file has none.
/// A file of edges alone needs them to be written as TORO, and landmarks of a TORO file need them elsewhere
/// ([`Document::needs_vertices`]). Vertices of the file stay as they are.
///
/// # Errors
/// [`ReplayerError`] when the document is no graph.
///
/// ```
/// use evergraph_formats::{Dialect, Document, ReadOptions};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let text = "EDGE2 0 1 1 2 0 2 1 0 2 0 3\n";
/// let isam = Document::parse("edges", text.as_bytes(), &ReadOptions::default())?;
/// assert!(isam.needs_vertices(Dialect::Toro));
/// let mut toro = Vec::new();
/// evergraph_replay::with_start_vertices(&isam)?.write(&mut toro, Dialect::Toro)?;
/// assert!(toro.starts_with(b"VERTEX2 0 0 0 0\nVERTEX2 1 1 2 0\n"));
/// # Ok(())
/// # }
/// ```
pub fn with_start_vertices(document: &Document) -> Result<Document, ReplayerError> {
    let options =
        ReplayOptions { prior: None, initial: Initial::FromFile, ..ReplayOptions::default() };
    let mut replay = Replay::new(document, &options)?;
    let mut change = Graph::new().change();
    replay.everything(&mut change)?;
    let values = change.new_variables().iter().map(|(_, value)| value.clone());
    let there: BTreeSet<(u64, bool)> = document
        .records()
        .filter_map(|record| match record {
            Record::Vertex { id, at } => Some((*id, at.kind().is_pose())),
            _ => None,
        })
        .collect();
    let is_pose = |value: &Value| value.get::<Pose2>().is_some() || value.get::<Pose3>().is_some();
    let ids: Vec<u64> = replay.ids().map(|(id, _)| id).collect();
    let is_missing = |(id, value): &(u64, Value)| !there.contains(&(*id, is_pose(value)));
    let missing = ids.into_iter().zip(values).filter(is_missing);
    Ok(document.with_vertices(missing)?)
}
