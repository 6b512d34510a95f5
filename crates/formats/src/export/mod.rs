//! From a graph in memory to the document of a file.

mod exporter;
mod factors;
mod settle;

use std::collections::HashMap;
use std::sync::Arc;

use evergraph_model::{Graph, Value, Values, VariableId};

use self::exporter::Exporter;
use crate::convert::quaternion;
use crate::document::Document;
use crate::error::FormatError;
use crate::estimate::coordinates;
use crate::options::Dialect;
use crate::record::{Line, Record};

impl Document {
    /// A graph as a document, with these values as its vertices; the variables are numbered from 0
    /// in the order of the graph.
    ///
    /// Files hold variables of the types `Pose2`, `Pose3`, `Point2` and `Point3`, and every factor
    /// of this library on them, under a robust kernel or not. Matrices are written as information:
    /// what is read again has the same residuals to rounding, and made into a document again it
    /// is the same document: bit for bit, but for the last digits of information that is singular.
    ///
    /// # Errors
    /// [`FormatError::NoLineForVariable`] and [`FormatError::NoLineForFactor`] for types of others,
    /// [`FormatError::NotGiven`] when a value is missing.
    ///
    /// ```
    /// use evergraph_factors::{Prior, Range};
    /// use evergraph_formats::{Dialect, Document};
    /// use evergraph_model::{Graph, Noise, Point2, Pose2, Values};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let mut graph = Graph::new();
    /// let mut change = graph.change();
    /// let pose = change.add_variable(&Pose2::new(1.0, 2.0, 0.5));
    /// let beacon = change.add_variable(&Point2::new(4.0, 6.0));
    /// change.add_factor(Range::new(pose, beacon, 5.0, Noise::isotropic(1, 0.5)?)?);
    /// let values: Vec<f64> =
    ///     change.new_variables().iter().flat_map(|(_, value)| value.storage().to_vec()).collect();
    /// let staged = graph.stage(&change)?;
    /// graph.commit(staged);
    ///
    /// let values = Values::from_arena(&graph, &values);
    /// let document = Document::from_graph("beacon.g2o", &graph, &values)?;
    /// let mut text = Vec::new();
    /// document.write(&mut text, Dialect::G2o)?;
    /// assert_eq!(
    ///     String::from_utf8(text)?,
    ///     "VERTEX_SE2 0 1 2 0.5\nVERTEX_XY 1 4 6\nFACTOR_RANGE_SE2_XY 0 1 5 4\n"
    /// );
    /// # Ok(())
    /// # }
    /// ```
    pub fn from_graph(name: &str, graph: &Graph, values: &Values) -> Result<Self, FormatError> {
        let mut ids: HashMap<VariableId, u64> = HashMap::new();
        ids.extend(graph.variables().zip(0..));
        let value = |id| Some(values.value(id).ok()?.to_value());
        Self::from_graph_with(name, graph, |id| ids.get(&id).copied(), value)
    }

    /// [`from_graph`](Self::from_graph) with the caller's ids and values, such as the ids of a
    /// replayed document and the estimates of a smoother.
    ///
    /// # Errors
    /// Those, and [`FormatError::NotGiven`] when an id is missing, [`FormatError::Duplicate`] when
    /// two are equal.
    pub fn from_graph_with(
        name: &str,
        graph: &Graph,
        mut id: impl FnMut(VariableId) -> Option<u64>,
        mut value: impl FnMut(VariableId) -> Option<Value>,
    ) -> Result<Self, FormatError> {
        let file: Arc<str> = name.into();
        let mut exporter = Exporter::default();
        let (mut vertices, mut fixed) = (Vec::new(), Vec::new());
        for variable in graph.variables() {
            let not_given =
                |what| FormatError::NotGiven { file: Arc::clone(&file), what, variable };
            let id = id(variable).ok_or_else(|| not_given("id"))?;
            let value = value(variable).ok_or_else(|| not_given("value"))?;
            let at = coordinates(&value, Dialect::G2o).map(settle::coordinates);
            let at = at.ok_or_else(|| FormatError::NoLineForVariable {
                file: Arc::clone(&file),
                variable,
                kind: value.kind().name(),
            })?;
            exporter.ends.insert(variable, (id, at.kind()));
            vertices.push(Line::from(Record::Vertex { id, at }));
            if graph.is_fixed(variable).unwrap_or(false) {
                fixed.push(Line::from(Record::Fix { id }));
            }
        }
        let mut lines = Vec::new();
        for (_, factor) in graph.factors() {
            let line = exporter.line(factor).ok_or_else(|| FormatError::NoLineForFactor {
                file: Arc::clone(&file),
                factor: factor.name(),
                ids: factor.keys().iter().filter_map(|key| exporter.id(*key)).collect(),
            })?;
            lines.push(line);
        }
        let sensors = exporter.sensors.iter().map(|sensor| settle::coordinates(quaternion(sensor)));
        let offsets =
            (0..).zip(sensors).map(|(id, at)| Line::from(Record::SensorOffset { id, at }));
        Self::from_records(name, Dialect::G2o, offsets.chain(vertices).chain(lines).chain(fixed))
    }
}
