//! Start values of newcomers, from where the variables before them are.

use evergraph_model::{Value, VariableId};

use crate::error::ReplayerError;
use crate::geometry::{Geometry, bad, of_kind, origin};
use crate::options::Initial;
use crate::order::{Arrival, Node};
use crate::state::Replay;

/// Asks for the current estimate of a variable.
pub(crate) type Estimate<'a> = &'a mut dyn FnMut(VariableId) -> Option<Value>;

/// Where variables are now: those of the first `before` that came in where they are estimated, if
/// there is an estimate, the others where they start.
pub(crate) struct Known<'a, 'b> {
    pub before: usize,
    pub estimate: &'b mut Option<Estimate<'a>>,
}

impl Replay {
    /// The start values of newcomers.
    pub(crate) fn compose(
        &mut self,
        arrivals: &[Arrival],
        known: &mut Known<'_, '_>,
    ) -> Result<(), ReplayerError> {
        for (at, &arrival) in arrivals.iter().enumerate() {
            let start = match (self.options.initial, self.vertices[arrival.node]) {
                (_, Some(vertex)) if self.fixed[arrival.node] => vertex,
                (Initial::FromFile, Some(vertex)) => vertex,
                _ => self.composed(arrival, known)?,
            };
            self.starts[arrival.node] = Some((known.before + at, start));
        }
        Ok(())
    }

    /// The start value of a newcomer along its link.
    fn composed(
        &self,
        arrival: Arrival,
        known: &mut Known<'_, '_>,
    ) -> Result<Geometry, ReplayerError> {
        let node = arrival.node;
        let Node { id, kind } = self.nodes[node];
        let Some((link, other)) = arrival.along else {
            return Ok(self.vertices[node].unwrap_or_else(|| origin(kind)));
        };
        let other_value = self.known(other, link, known).map_err(|error| match error {
            ReplayerError::NoEstimate { place, variable, .. } => {
                ReplayerError::NoEstimate { place, id, variable }
            }
            other => other,
        })?;
        let position = |node| self.links[link].ends.iter().position(|&end| end == node);
        let composed = position(node).zip(position(other)).and_then(|(target, other)| {
            self.observations[link].what.compose(other, &other_value, target)
        });
        composed.ok_or_else(|| {
            bad(&self.place(Some(link)), "its ends are not of the kinds that it measures")
        })
    }

    /// Where a variable is that a link leads to.
    pub(crate) fn known(
        &self,
        node: usize,
        link: usize,
        known: &mut Known<'_, '_>,
    ) -> Result<Geometry, ReplayerError> {
        match (self.starts[node], &mut *known.estimate, self.handles[node]) {
            (Some((position, _)), Some(estimate), Some(handle)) if position < known.before => {
                let value = estimate(handle.id());
                value.and_then(|value| of_kind(&value, self.nodes[node].kind)).ok_or_else(|| {
                    ReplayerError::NoEstimate {
                        place: self.place(Some(link)),
                        id: self.nodes[node].id,
                        variable: handle.id(),
                    }
                })
            }
            (Some((_, start)), _, _) => Ok(start),
            (None, _, _) => Err(bad(&self.place(Some(link)), "its other end has not come in yet")),
        }
    }
}
