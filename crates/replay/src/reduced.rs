//! A reduced graph as a document.

use std::collections::HashMap;

use evergraph_formats::{Document, Record};
use evergraph_model::VariableId;
use evergraph_solver::Smoother;

use crate::error::ReplayerError;
use crate::replayer::Replayer;

impl Replayer {
    /// The graph of a smoother from which variables of this replay were removed, with the estimates as its
    /// vertices, in the ids of the file. Gauge priors are left out, as the file has none; a replay of the
    /// new document puts them where they were. The geodetic origin of `original`, the document that is
    /// replayed, is kept.
    ///
    /// # Errors
    /// [`ReplayerError::Format`] for factors that no file can hold, [`ReplayerError::Graph`] when `reduced`
    /// is no smoother of this replay.
    pub fn reduced_document(
        &self,
        name: &str,
        reduced: &Smoother,
        original: &Document,
    ) -> Result<Document, ReplayerError> {
        let mut graph = reduced.graph().clone();
        let mut change = graph.change();
        for prior in self.replay().gauge_priors() {
            if graph.check_factor(prior.factor).is_ok() {
                change.drop_factor(prior.factor);
            }
        }
        let staged = graph.stage(&change)?;
        graph.commit(staged);
        let ids: HashMap<VariableId, u64> =
            self.replay().ids().map(|(id, variable)| (variable, id)).collect();
        let estimates = reduced.estimates()?;
        let document = Document::from_graph_with(
            name,
            &graph,
            |variable| ids.get(&variable).copied(),
            |variable| Some(estimates.value(variable).ok()?.to_value()),
        )?;
        let origins = original.lines().iter();
        let origins = origins.filter(|line| matches!(line.record, Record::GeodeticOrigin { .. }));
        let lines = origins.cloned().chain(document.lines().iter().cloned());
        Ok(Document::from_records(name, document.dialect(), lines)?)
    }
}
