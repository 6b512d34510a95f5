//! What a file costs as it stands.

use evergraph_formats::{Document, G2oRotation};
use evergraph_model::{Graph, Value, VariableId};
use evergraph_replay::{Initial, Objective, Replay, ReplayOptions};

use crate::conventions;
use crate::error::EvaluateError;

/// The graph of a document at its start values, not solved and without gauge priors.
#[derive(Debug)]
pub struct Start {
    graph: Graph,
    points: Vec<f64>,
    ids: Vec<(u64, VariableId)>,
}

impl Start {
    /// Sets the graph up at the start values that `initial` says.
    ///
    /// # Errors
    /// [`EvaluateError::Replay`], [`EvaluateError::Graph`] when the document is no graph.
    pub fn of(document: &Document, initial: Initial) -> Result<Self, EvaluateError> {
        let options = ReplayOptions::default().with_prior(None).with_initial(initial);
        let (replay, graph, points) = everything(document, &options)?;
        Ok(Self { graph, points, ids: replay.ids().collect() })
    }

    /// Error and chi2 in this library's convention.
    ///
    /// # Errors
    /// [`EvaluateError::Graph`] for a factor that panics.
    pub fn objective(&self) -> Result<Objective, EvaluateError> {
        Ok(Objective::at(&self.graph, &self.points, |_| true)?)
    }

    /// chi2 in g2o's convention; `rotation` as the document was read.
    ///
    /// # Errors
    /// [`EvaluateError::Graph`] for a factor that panics.
    pub fn g2o_chi2(&self, rotation: G2oRotation) -> Result<f64, EvaluateError> {
        Ok(conventions::g2o_chi2(&self.graph, &self.points, rotation)?)
    }

    /// Rows of all residuals together.
    pub fn rows(&self) -> usize {
        self.graph.factor_indices().map(|factor| self.graph.rows_at(factor)).sum()
    }

    /// The start values by the file's ids, in the order of arrival.
    pub fn values(&self) -> impl Iterator<Item = (u64, Value)> {
        self.ids.iter().filter_map(|(id, variable)| {
            let index = self.graph.variable_index(*variable).ok()?;
            Some((*id, self.graph.value(index, &self.points[self.graph.value_range(index)])))
        })
    }
}

/// All of a document as a graph at its start values.
pub(crate) fn everything(
    document: &Document,
    options: &ReplayOptions,
) -> Result<(Replay, Graph, Vec<f64>), EvaluateError> {
    let mut replay = Replay::new(document, options)?;
    let mut graph = Graph::new();
    let mut change = graph.change();
    replay.everything(&mut change)?;
    let staged = graph.stage(&change)?;
    graph.commit(staged);
    let mut points = vec![0.0; graph.value_len()];
    for (variable, value) in change.new_variables() {
        let range = graph.value_range(graph.variable_index(*variable)?);
        points[range].copy_from_slice(value.storage());
    }
    Ok((replay, graph, points))
}
