//! A planned step, with its numbers, into a change.

use std::sync::Arc;

use evergraph_model::{Change, FactorId, Value, VariableId};

use super::measure::{self, Geometry};
use super::order::{Arrival, Link, Node, Planned};
use super::{GaugePrior, Initial, Replay, Step, StepKind};
use crate::check::bad;
use crate::error::FormatError;

/// Asks for the current estimate of a variable.
type Estimate<'a> = &'a mut dyn FnMut(VariableId) -> Option<Value>;

impl Replay {
    /// Adds a step to the change. Without `estimate` every start value is composed from start
    /// values.
    pub(super) fn emit(
        &mut self,
        step: &Planned,
        change: &mut Change,
        mut estimate: Option<Estimate<'_>>,
    ) -> Result<Step, FormatError> {
        let before = self.order.len();
        let mut newest = None;
        for &arrival in &step.arrivals {
            let start = match (self.options.initial, self.vertices[arrival.node]) {
                (Initial::FromFile, Some(vertex)) => vertex,
                _ => self.composed(arrival, before, &mut estimate)?,
            };
            let node = self.nodes[arrival.node];
            if !start.is_finite() {
                return Err(FormatError::StartNotFinite {
                    place: self.place(arrival.along),
                    id: node.id,
                });
            }
            let handle = start.add_to(change);
            self.handles[arrival.node] = Some(handle);
            self.starts[arrival.node] = Some((self.order.len(), start));
            self.order.push(arrival.node);
            if node.kind.is_pose() {
                newest = Some(handle.id());
            }
        }
        for &link in &step.links {
            let factor = self.add_factor(link, change)?;
            self.factors.push((factor, self.edges[link].line));
        }
        let mut gauge_priors = Vec::new();
        for &pose in &step.gauge {
            gauge_priors.extend(self.add_gauge_prior(pose, change)?);
        }
        self.priors.extend_from_slice(&gauge_priors);
        Ok(Step {
            pose: newest.ok_or_else(|| FormatError::NoPose { file: Arc::clone(&self.name) })?,
            kind: if step.closes { StepKind::Loop } else { StepKind::Explore },
            factors: step.links.len(),
            variables: step.arrivals.len(),
            gauge_priors,
        })
    }

    /// The start value of a newcomer along its link, `before` variables being of earlier steps.
    fn composed(
        &self,
        arrival: Arrival,
        before: usize,
        estimate: &mut Option<Estimate<'_>>,
    ) -> Result<Geometry, FormatError> {
        let Node { id, kind } = self.nodes[arrival.node];
        let Some(link) = arrival.along else {
            return Ok(self.vertices[arrival.node].unwrap_or_else(|| Geometry::origin(kind)));
        };
        let Link { from, to } = self.links[link];
        let backwards = from == arrival.node;
        let other = if backwards { to } else { from };
        let known = match (self.starts[other], estimate, self.handles[other]) {
            (Some((position, _)), Some(estimate), Some(handle)) if position < before => {
                let value = estimate(handle.id());
                value
                    .and_then(|value| Geometry::from_value(&value, self.nodes[other].kind))
                    .ok_or_else(|| FormatError::NoEstimate {
                        place: self.place(Some(link)),
                        id,
                        variable: handle.id(),
                    })?
            }
            (Some((_, start)), _, _) => start,
            (None, _, _) => {
                return Err(bad(&self.place(Some(link)), "its other end has not come in yet"));
            }
        };
        self.edges[link].compose(&known, backwards).ok_or_else(|| {
            bad(&self.place(Some(link)), "its ends are not of the kinds that it measures")
        })
    }

    fn add_factor(&self, link: usize, change: &mut Change) -> Result<FactorId, FormatError> {
        let Link { from, to } = self.links[link];
        match (self.handles[from], self.handles[to]) {
            (Some(from), Some(to)) => {
                self.edges[link]
                    .add_to(change, (from, to), self.options.kernel, || self.place(Some(link)))
            }
            _ => Err(bad(&self.place(Some(link)), "its ends have not come in yet")),
        }
    }

    fn add_gauge_prior(
        &self,
        pose: usize,
        change: &mut Change,
    ) -> Result<Option<GaugePrior>, FormatError> {
        let (Some(sigma), Some(handle)) = (self.options.prior, self.handles[pose]) else {
            return Ok(None);
        };
        let Node { id, kind } = self.nodes[pose];
        // Without a vertex, a fixed pose is held where it starts.
        let start = self.starts[pose].map_or_else(|| Geometry::origin(kind), |(_, start)| start);
        let at = self.vertices[pose].unwrap_or(start);
        let factor = measure::add_prior(change, handle, at, sigma, &self.place(None))?;
        Ok(Some(GaugePrior { id, variable: handle.id(), factor, sigma, fixed: self.fixed[pose] }))
    }
}
