//! A planned step, with its numbers, into a change.

use std::sync::Arc;

use evergraph_model::{Change, Factor, FactorId, Value, VariableId};

use super::geometry::{Geometry, Handle};
use super::order::{Arrival, Node, Planned};
use super::{Initial, Replay, Step, StepKind};
use crate::check::bad;
use crate::error::FormatError;

/// Asks for the current estimate of a variable.
pub(super) type Estimate<'a> = &'a mut dyn FnMut(VariableId) -> Option<Value>;

/// Where variables are now: those of the first `before` that came in where they are estimated, if
/// there is an estimate, the others where they start.
pub(super) struct Known<'a, 'b> {
    pub before: usize,
    pub estimate: &'b mut Option<Estimate<'a>>,
}

impl Replay {
    /// Adds a step to the change. Without `estimate` every start value is composed from start
    /// values.
    pub(super) fn emit(
        &mut self,
        mut step: Planned,
        change: &mut Change,
        mut estimate: Option<Estimate<'_>>,
    ) -> Result<Step, FormatError> {
        let mut known = Known { before: self.order.len(), estimate: &mut estimate };
        self.compose(&step.arrivals, &mut known)?;
        let mut bodies = self.place_bodies(&step, &mut known)?;
        let mut more = 1;
        while step.is_part && !bodies.are_determined() && self.append_parts(&mut step, more) {
            more *= 2;
            self.compose(&step.arrivals, &mut known)?;
            bodies = self.place_bodies(&step, &mut known)?;
        }
        let mut newest = None;
        for &Arrival { node, along } in &step.arrivals {
            let start = self.starts[node].map(|(_, start)| start);
            let start = start.filter(Geometry::is_finite).ok_or_else(|| {
                let place = self.place(along.map(|(link, _)| link));
                FormatError::StartNotFinite { place, id: self.nodes[node].id }
            })?;
            let handle = self.bring_in(node, start, change);
            if self.nodes[node].kind.is_pose() {
                newest = Some(handle.id());
            }
        }
        for &link in &step.links {
            self.add_factor(link, change)?;
        }
        let last = self.next == self.steps.len();
        let freed = self.free_landmarks(&step.waiting, last, &mut known, change)?;
        let mut gauge_priors = Vec::new();
        for &(pose, free) in &step.gauge {
            gauge_priors.extend(self.add_gauge_prior(pose, bodies.free(pose, free), change)?);
        }
        self.priors.extend_from_slice(&gauge_priors);
        let closes = step.closes || freed.closes;
        Ok(Step {
            pose: newest.ok_or_else(|| FormatError::NoPose { file: Arc::clone(&self.name) })?,
            kind: if closes { StepKind::Loop } else { StepKind::Explore },
            factors: step.links.len() + freed.factors,
            variables: step.arrivals.len() + freed.variables,
            gauge_priors,
        })
    }

    /// The start values of newcomers.
    pub(super) fn compose(
        &mut self,
        arrivals: &[Arrival],
        known: &mut Known<'_, '_>,
    ) -> Result<(), FormatError> {
        for (at, &arrival) in arrivals.iter().enumerate() {
            let start = match (self.options.initial, self.vertices[arrival.node]) {
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
    ) -> Result<Geometry, FormatError> {
        let node = arrival.node;
        let Node { id, kind } = self.nodes[node];
        let Some((link, other)) = arrival.along else {
            return Ok(self.vertices[node].unwrap_or_else(|| Geometry::origin(kind)));
        };
        let other_value = self.known(other, link, known).map_err(|error| match error {
            FormatError::NoEstimate { place, variable, .. } => {
                FormatError::NoEstimate { place, id, variable }
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
    pub(super) fn known(
        &self,
        node: usize,
        link: usize,
        known: &mut Known<'_, '_>,
    ) -> Result<Geometry, FormatError> {
        match (self.starts[node], &mut *known.estimate, self.handles[node]) {
            (Some((position, _)), Some(estimate), Some(handle)) if position < known.before => {
                let value = estimate(handle.id());
                value
                    .and_then(|value| Geometry::from_value(&value, self.nodes[node].kind))
                    .ok_or_else(|| FormatError::NoEstimate {
                        place: self.place(Some(link)),
                        id: self.nodes[node].id,
                        variable: handle.id(),
                    })
            }
            (Some((_, start)), _, _) => Ok(start),
            (None, _, _) => Err(bad(&self.place(Some(link)), "its other end has not come in yet")),
        }
    }

    pub(super) fn add_factor(
        &mut self,
        link: usize,
        change: &mut Change,
    ) -> Result<(), FormatError> {
        let ends = self.links[link].ends.iter().map(|&end| self.handles[end]);
        let ends: Option<Vec<Handle>> = ends.collect();
        let place = self.place(Some(link));
        let ends = ends.ok_or_else(|| bad(&place, "its ends have not come in yet"))?;
        let factor = self.observations[link].factor(&ends).map_err(|why| bad(&place, why))?;
        let factor: FactorId = change.add_shared_factor(factor);
        self.factors.push((factor, self.observations[link].line));
        Ok(())
    }

    /// A factor on variables of no graph, to evaluate it.
    pub(super) fn scratch_factor(&self, link: usize) -> Result<Arc<dyn Factor>, FormatError> {
        let ends: Vec<Handle> =
            self.links[link].ends.iter().map(|&end| self.scratch[end]).collect();
        let factor = self.observations[link].factor(&ends);
        factor.map_err(|why| bad(&self.place(Some(link)), why))
    }
}
