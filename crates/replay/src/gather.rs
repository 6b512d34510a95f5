//! The numbers out of a document's records.

use std::collections::HashMap;

use evergraph_formats::{Document, FormatError, Kind, Line, Record, spell_id};
use evergraph_model::Pose3;
use smallvec::SmallVec;

use crate::error::ReplayerError;
use crate::geometry::{bad, named_by, slot};
use crate::observation::{Observation, Observed};
use crate::order::Link;
use crate::state::Replay;

impl Replay {
    /// Takes vertices, fixed ones among them, and every factor.
    pub(crate) fn gather(&mut self, document: &Document) -> Result<(), ReplayerError> {
        let sensors = sensors(document);
        for line in document.lines() {
            let place = document.place(line.number);
            let missing = |id| FormatError::MissingVertex { place: place.clone(), id };
            let sensor = |id: &Option<u64>| match id {
                None => Ok(None),
                Some(id) => sensors
                    .get(id)
                    .map(|pose| Some(*pose))
                    .ok_or_else(|| FormatError::MissingOffset { place: place.clone(), id: *id }),
            };
            let observed = match &line.record {
                Record::SensorOffset { .. } | Record::GeodeticOrigin { .. } => continue,
                Record::Vertex { id, at } => {
                    let node =
                        self.places.get(&slot(*id, at.kind())).ok_or_else(|| missing(*id))?;
                    self.vertices[*node] = named_by(at);
                    continue;
                }
                Record::Fix { id } => {
                    let pose = self.places.get(&(*id, true));
                    let node = pose.or_else(|| self.places.get(&(*id, false)));
                    self.fixed[*node.ok_or_else(|| missing(*id))?] = true;
                    continue;
                }
                Record::Edge { measurement, weight, parameter, .. } => {
                    Observed::edge(document, line, (measurement, weight), sensor(parameter)?)?
                }
                Record::Measurement(measurement) => {
                    let sensor = sensor(&measurement.parameter)?;
                    Observed::measurement(document, line, measurement, sensor)?
                }
                Record::Linear(linear) => Observed::linear(document, line, linear)?,
            };
            self.observe(document, line, observed)?;
        }
        Ok(())
    }

    fn observe(
        &mut self,
        document: &Document,
        line: &Line,
        observed: Observed,
    ) -> Result<(), ReplayerError> {
        let place = document.place(line.number);
        let mut ends: SmallVec<[usize; 2]> = SmallVec::new();
        for (id, kind) in line.record.ends() {
            let node = self.places.get(&slot(id, kind)).copied();
            let node = node.filter(|&node| self.nodes[node].kind == kind);
            let node =
                node.ok_or_else(|| FormatError::MissingVertex { place: place.clone(), id })?;
            if ends.contains(&node) {
                return Err(bad(&place, format!("it names {} twice", spell_id(id))));
            }
            ends.push(node);
        }
        if ends.is_empty() {
            return Err(bad(&place, "it has no variables"));
        }
        let kinds: SmallVec<[Kind; 2]> = ends.iter().map(|&end| self.nodes[end].kind).collect();
        let kernel = line.kernel().or(observed.kernel(ends.len(), self.options.kernel));
        self.links.push(Link { ties: observed.ties(&kinds), ends, time: line.time() });
        self.observations.push(Observation { line: line.number, kernel, what: observed });
        Ok(())
    }
}

/// `robot_from_sensor` by id.
fn sensors(document: &Document) -> HashMap<u64, Pose3> {
    let offsets = document.records().filter_map(|record| match record {
        Record::SensorOffset { id, at } => Some((*id, at.value()?.get()?)),
        _ => None,
    });
    offsets.collect()
}
