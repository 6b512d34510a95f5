//! A planned step, with its numbers, into a change.

use std::sync::Arc;

use evergraph_model::{Change, Factor, FactorId};

use crate::error::ReplayerError;
use crate::geometry::{Geometry, Handle, bad};
use crate::known::{Estimate, Known};
use crate::options::{Step, StepKind};
use crate::order::{Arrival, Planned};
use crate::state::Replay;

impl Replay {
    /// Adds a step to the change. Without `estimate` every start value is composed from start
    /// values.
    pub(crate) fn emit(
        &mut self,
        mut step: Planned,
        change: &mut Change,
        mut estimate: Option<Estimate<'_>>,
    ) -> Result<Step, ReplayerError> {
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
                ReplayerError::StartNotFinite { place, id: self.nodes[node].id }
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
        for (pose, free) in bodies.unmeasured() {
            gauge_priors.extend(self.add_weak_prior(*pose, free, change)?);
        }
        self.priors.extend_from_slice(&gauge_priors);
        let closes = step.closes || freed.closes;
        Ok(Step {
            pose: newest.ok_or_else(|| ReplayerError::NoPose { file: Arc::clone(&self.name) })?,
            kind: if closes { StepKind::Loop } else { StepKind::Explore },
            factors: step.links.len() + freed.factors,
            variables: step.arrivals.len() + freed.variables,
            gauge_priors,
        })
    }

    pub(crate) fn add_factor(
        &mut self,
        link: usize,
        change: &mut Change,
    ) -> Result<(), ReplayerError> {
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
    pub(crate) fn scratch_factor(&self, link: usize) -> Result<Arc<dyn Factor>, ReplayerError> {
        let ends: Vec<Handle> =
            self.links[link].ends.iter().map(|&end| self.scratch[end]).collect();
        let factor = self.observations[link].factor(&ends);
        factor.map_err(|why| bad(&self.place(Some(link)), why))
    }
}
