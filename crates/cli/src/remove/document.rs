//! The reduced graph as a file.

use std::collections::HashMap;

use evergraph::evaluate::EvaluateError;
use evergraph::formats::{Document, Line, Record};
use evergraph::model::VariableId;
use evergraph::{Replayer, Smoother};

use crate::error::Error;

/// The reduced graph at its optimum, in the ids of the file. Gauge priors are none of it, as they are
/// none of the file's; whoever reads it puts them where they were.
pub(super) fn reduced_document(
    name: &str,
    replayer: &Replayer,
    reduced: &Smoother,
    original: &Document,
) -> Result<Document, Error> {
    let mut graph = reduced.graph().clone();
    let mut change = graph.change();
    let mut fixed = Vec::new();
    for prior in replayer.replay().gauge_priors() {
        if graph.check_factor(prior.factor).is_ok() {
            change.drop_factor(prior.factor);
            fixed.extend(prior.fixed.then_some(Line::from(Record::Fix { id: prior.id })));
        }
    }
    let staged = graph.stage(&change).map_err(EvaluateError::Graph)?;
    graph.commit(staged);
    let ids: HashMap<VariableId, u64> =
        replayer.replay().ids().map(|(id, variable)| (variable, id)).collect();
    let estimates = reduced.estimates();
    let document = Document::from_graph_with(
        name,
        &graph,
        |variable| ids.get(&variable).copied(),
        |variable| Some(estimates.value(variable).ok()?.to_value()),
    )?;
    let origins = original.lines().iter();
    let origins = origins.filter(|line| matches!(line.record, Record::GeodeticOrigin { .. }));
    let lines = origins.cloned().chain(document.lines().iter().cloned()).chain(fixed);
    Ok(Document::from_records(name, document.dialect(), lines)?)
}
