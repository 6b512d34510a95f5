//! Vertices for documents that have none.

use evergraph_formats::Document;
use evergraph_model::Graph;

use crate::error::ReplayerError;
use crate::options::ReplayOptions;
use crate::state::Replay;

/// The document with vertices at the start values of a replay: what a file of edges alone needs to be
/// written as TORO, which is known by its vertices ([`Document::needs_vertices`]).
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
    let options = ReplayOptions { prior: None, ..ReplayOptions::default() };
    let mut replay = Replay::new(document, &options)?;
    let mut change = Graph::new().change();
    replay.everything(&mut change)?;
    let values = change.new_variables().iter().map(|(_, value)| value.clone());
    let ids: Vec<u64> = replay.ids().map(|(id, _)| id).collect();
    Ok(document.with_vertices(ids.into_iter().zip(values))?)
}
