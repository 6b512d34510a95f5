//! Gauge priors: the directions of a component that no measurement of the world informs.

use evergraph_factors::Prior;
use evergraph_formats::Quantity;
use evergraph_initialize::{Body, End, Gauge, MotionInformation, hold};
use evergraph_model::{Change, Noise};
use nalgebra::{DMatrix, DVector};

use crate::error::ReplayerError;
use crate::geometry::{Geometry, Handle, bad, origin, point};
use crate::known::Known;
use crate::observation::{Observed, has_full_rank};
use crate::options::GaugePrior;
use crate::order::{Node, Planned};
use crate::state::Replay;

/// Standard deviation (m, rad) of a prior on directions that no factor informs.
const WEAK: f64 = 1.0;

/// The numbers of directions of a component that the steps so far leave free, and know only coarsely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Freedom {
    free: usize,
    coarse: usize,
}

impl Replay {
    /// Decides which components absolute measurements hold, wholly or partly: the steps until they
    /// do become one, and the gauge prior goes or is for the free directions only.
    pub(crate) fn settle_gauge(&mut self) -> Result<(), ReplayerError> {
        let held = self.components_that_may_be_held();
        if held.is_empty() {
            return Ok(());
        }
        let mut steps = std::mem::take(&mut self.steps);
        for step in &steps {
            self.compose(&step.arrivals, &mut Known { before: 0, estimate: &mut None })?;
        }
        let mut members = vec![Vec::new(); self.nodes.len()];
        for (at, step) in steps.iter().enumerate() {
            if let Some(first) = step.arrivals.first() {
                members[self.component[first.node]].push(at);
            }
        }
        for component in held {
            self.settle_component(&members[component], &mut steps)?;
        }
        steps.retain(|step| !step.arrivals.is_empty());
        self.steps = steps;
        self.starts.fill(None);
        Ok(())
    }

    /// Components with a measurement that is not purely relative, or one of a known landmark. Those
    /// with a fixed pose are held by that.
    fn components_that_may_be_held(&mut self) -> Vec<usize> {
        let planned = self.steps.iter().flat_map(|step| &step.arrivals);
        let mut is_planned = vec![false; self.nodes.len()];
        planned.for_each(|arrival| is_planned[arrival.node] = true);
        let mut held = vec![false; self.nodes.len()];
        for (link, observation) in self.links.iter().zip(&self.observations) {
            let first = link.ends[0];
            held[self.component[first]] |= !observation.what.is_relative();
            held[self.component[first]] |= link.ends.iter().any(|&end| self.fixed[end]);
            if let Observed::Quantity { quantity: Quantity::Prior, numbers, noise, .. } =
                &observation.what
                && !self.nodes[first].kind.is_pose()
                && !is_planned[first]
                && has_full_rank(noise)
            {
                let mut at = DVector::zeros(3);
                at.rows_mut(0, numbers.len().min(3)).copy_from_slice(numbers);
                let at = at.fixed_rows::<3>(0).into_owned();
                self.anchors[first] = point(self.nodes[first].kind, &at);
            }
        }
        for node in (0..self.nodes.len()).filter(|&node| self.fixed[node]) {
            self.anchors[node] = self.vertices[node];
            if self.nodes[node].kind.is_pose() {
                held[self.component[node]] = false;
            }
        }
        (0..self.nodes.len()).filter(|&component| held[component]).collect()
    }

    /// Settles a component, of which the steps at `members` are.
    fn settle_component(
        &self,
        members: &[usize],
        steps: &mut [Planned],
    ) -> Result<(), ReplayerError> {
        let Some(first) = members.first().map(|&at| steps[at].arrivals[0].node) else {
            return Ok(());
        };
        let Some((_, origin)) = self.starts[first] else { return Ok(()) };
        let mut information = MotionInformation::none(origin.is_planar());
        let mut known: Vec<Freedom> = Vec::with_capacity(members.len());
        for &at in members {
            if let Some(now @ Freedom { free: 0, coarse: 0 }) = known.last().copied() {
                known.push(now);
                continue;
            }
            let mut body = Body::new(&origin);
            let mut tied = false;
            for &link in steps[at].links.iter().chain(&steps[at].waiting) {
                tied |= self.tie(&mut body, link, |node| {
                    Ok(match (self.starts[node], self.anchors[node]) {
                        (Some((_, start)), _) if !self.fixed[node] => Some(End::Moving(start)),
                        (_, anchor) => anchor.map(End::Standing),
                    })
                })?;
            }
            if tied {
                information.merge(&body.information());
            }
            let gauge = Gauge::of(&information);
            known.push(Freedom { free: gauge.free(), coarse: gauge.coarsely_free() });
        }
        let Some(end) = known.last().copied() else { return Ok(()) };
        let free = end.free;
        if free == origin.value().dim() {
            return Ok(());
        }
        // Not before start values are as good as they get: a heading that rests on the noise of a few
        // positions would be a bad one to linearize at.
        let reached = known.iter().position(|now| *now == end).unwrap_or(0);
        let mut whole = Planned::default();
        for &at in &members[..=reached] {
            whole.append(std::mem::take(&mut steps[at]));
        }
        whole.gauge.retain_mut(|(_, directions)| {
            *directions = free;
            free > 0
        });
        steps[members[reached]] = whole;
        Ok(())
    }

    /// Adds a prior on a pose, or on the `free` directions of its tangent.
    pub(crate) fn add_gauge_prior(
        &self,
        pose: usize,
        free: Option<DMatrix<f64>>,
        change: &mut Change,
    ) -> Result<Option<GaugePrior>, ReplayerError> {
        let (Some(sigma), Some(handle)) = (self.options.prior, self.handles[pose]) else {
            return Ok(None);
        };
        let place = self.place(None);
        let (id, kind) = (self.nodes[pose].id, self.nodes[pose].kind);
        let start = self.starts[pose].map_or_else(|| origin(kind), |(_, start)| start);
        let (factor, directions) = if let Some(free) = free {
            let factor = hold(&free, handle.id(), &start, sigma);
            (change.add_factor(factor.map_err(|error| bad(&place, error))?), free.ncols())
        } else {
            let at = self.vertices[pose].unwrap_or(start);
            let noise = Noise::isotropic(kind.dim(), sigma).map_err(|e| bad(&place, e))?;
            let factor = match (handle, at) {
                (Handle::Pose2(key), Geometry::Pose2(at)) => {
                    Prior::new(key, at, noise).map(|prior| change.add_factor(prior))
                }
                (Handle::Pose3(key), Geometry::Pose3(at)) => {
                    Prior::new(key, at, noise).map(|prior| change.add_factor(prior))
                }
                _ => return Err(bad(&place, "a gauge prior is for poses")),
            };
            (factor.map_err(|error| bad(&place, error))?, kind.dim())
        };
        let (variable, dim) = (handle.id(), kind.dim());
        Ok(Some(GaugePrior { id, variable, factor, sigma, dim, directions, weak: false }))
    }

    /// Adds a prior on directions of a pose that no factor informs; they stay about where they start.
    pub(crate) fn add_weak_prior(
        &self,
        pose: usize,
        free: &DMatrix<f64>,
        change: &mut Change,
    ) -> Result<Option<GaugePrior>, ReplayerError> {
        let (Some(_), Some(handle), Some((_, start))) =
            (self.options.prior, self.handles[pose], self.starts[pose])
        else {
            return Ok(None);
        };
        let (variable, Node { id, kind }) = (handle.id(), self.nodes[pose]);
        let factor = hold(free, variable, &start, WEAK).map_err(|e| bad(&self.place(None), e))?;
        let (factor, dim, directions) = (change.add_factor(factor), kind.dim(), free.ncols());
        Ok(Some(GaugePrior { id, variable, factor, sigma: WEAK, dim, directions, weak: true }))
    }
}
