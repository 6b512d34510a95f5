//! What holds a component in the world, and where in it a part starts.

use std::collections::BTreeMap;

use evergraph_factors::Prior;
use evergraph_formats::Quantity;
use evergraph_initialize::{Body, End, Gauge, MotionInformation, hold};
use evergraph_model::{Change, Noise};
use nalgebra::{DMatrix, DVector};
use smallvec::SmallVec;

use crate::error::ReplayerError;
use crate::geometry::{Geometry, Handle, bad, origin, point};
use crate::known::Known;
use crate::observation::Observed;
use crate::options::{GaugePrior, Initial};
use crate::order::{Arrival, Node, Planned};
use crate::state::Replay;

/// Standard deviation (m, rad) of a prior on directions that no factor informs.
const WEAK: f64 = 1.0;

/// The parts of a step that nothing places by odometry, by their first pose.
#[derive(Default)]
pub(crate) struct Bodies {
    /// First pose, and its directions as [`Gauge`] gives them, in its own tangent.
    directions: Vec<(usize, DMatrix<f64>)>,
    /// Those that nothing before them determines, by their number.
    undetermined: Vec<usize>,
    /// Of those, the first pose and the directions of its tangent that no factor informs at all.
    free: Vec<(usize, DMatrix<f64>)>,
}

/// One of them: its nodes, the first pose first, and the links that touch it.
#[derive(Default)]
struct Part {
    nodes: Vec<usize>,
    links: Vec<usize>,
}

/// How many directions of a component the steps so far leave free, and known only coarsely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Freedom {
    free: usize,
    coarse: usize,
}

impl Bodies {
    /// Whether what is there already holds each of them, but for those with a gauge prior.
    pub fn are_determined(&self) -> bool {
        self.undetermined.is_empty()
    }

    /// The `free` least held directions of a first pose; `None` if that is all of them.
    pub fn free(&self, pose: usize, free: usize) -> Option<DMatrix<f64>> {
        let (_, directions) = self.directions.iter().find(|(first, _)| *first == pose)?;
        (free < directions.ncols()).then(|| directions.columns(0, free).into_owned())
    }

    /// First poses of bodies that are not determined, with the directions that no factor informs.
    pub fn unmeasured(&self) -> &[(usize, DMatrix<f64>)] {
        &self.free
    }
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
            {
                let eigenvalues = noise.information().symmetric_eigenvalues();
                if eigenvalues.min() > 1e-12 * eigenvalues.max() {
                    let mut at = DVector::zeros(3);
                    at.rows_mut(0, numbers.len().min(3)).copy_from_slice(numbers);
                    let at = at.fixed_rows::<3>(0).into_owned();
                    self.anchors[first] = point(self.nodes[first].kind, &at);
                }
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

    /// Ties a body by the factor of a link, if all of its ends are known, some move, and it does not
    /// only say how those lie to each other; `end` gives the value of a variable. Returns whether it ties.
    fn tie(
        &self,
        body: &mut Body,
        link: usize,
        mut end: impl FnMut(usize) -> Result<Option<End>, ReplayerError>,
    ) -> Result<bool, ReplayerError> {
        let mut ends: SmallVec<[End; 2]> = SmallVec::new();
        for &node in &self.links[link].ends {
            let Some(end) = end(node)? else { return Ok(false) };
            ends.push(end);
        }
        let all_move = ends.iter().all(|end| matches!(end, End::Moving(_)));
        if all_move && self.observations[link].what.is_relative() {
            return Ok(false);
        }
        let mut ends = ends.into_iter();
        Ok(body.tie(self.scratch_factor(link)?, |_| ends.next()))
    }

    /// Moves each part of a step that no odometry ties to what is there, as a whole, to where its
    /// measurements of the world and of what is there fit best.
    pub(crate) fn place_bodies(
        &mut self,
        step: &Planned,
        known: &mut Known<'_, '_>,
    ) -> Result<Bodies, ReplayerError> {
        let mut bodies = Bodies::default();
        // By node, the body that it is part of.
        let mut body_of: BTreeMap<usize, usize> = BTreeMap::new();
        let mut parts: Vec<Part> = Vec::new();
        let moving = |arrival: &&Arrival| !self.fixed[arrival.node];
        for arrival in step.arrivals.iter().filter(moving) {
            let body = match arrival.along {
                None => {
                    parts.push(Part::default());
                    Some(parts.len() - 1)
                }
                Some((_, from)) => body_of.get(&from).copied(),
            };
            if let Some(body) = body {
                body_of.insert(arrival.node, body);
                parts[body].nodes.push(arrival.node);
            }
        }
        for &link in step.links.iter().chain(&step.waiting) {
            for body in self.links[link].ends.iter().filter_map(|node| body_of.get(node)) {
                if parts[*body].links.last() != Some(&link) {
                    parts[*body].links.push(link);
                }
            }
        }
        for (body, part) in parts.iter().enumerate() {
            self.place_body((body, part), step, &body_of, known, &mut bodies)?;
        }
        for &body in &bodies.undetermined {
            let part = &parts[body];
            let Some((first, body)) = self.tied(body, part, parts.len(), &body_of, known)? else {
                continue;
            };
            let (gauge, start) = (body.gauge(), self.starts[first].map(|(_, start)| start));
            let directions = start.and_then(|start| gauge.in_tangent_of(&start));
            let free = directions.map(|all| all.columns(0, gauge.free()).into_owned());
            bodies.free.extend(free.filter(|it| it.ncols() > 0).map(|it| (first, it)));
        }
        Ok(bodies)
    }

    /// A part with all that ties it to variables that are known, to the first `placed` parts among them;
    /// and its first pose.
    fn tied(
        &self,
        this: usize,
        part: &Part,
        placed: usize,
        body_of: &BTreeMap<usize, usize>,
        known: &mut Known<'_, '_>,
    ) -> Result<Option<(usize, Body)>, ReplayerError> {
        let Some(&first) = part.nodes.first() else { return Ok(None) };
        let Some((_, origin)) = self.starts[first] else { return Ok(None) };
        let mut body = Body::new(&origin);
        for &link in &part.links {
            self.tie(&mut body, link, |node| match body_of.get(&node) {
                Some(&other) if other >= placed => Ok(None),
                Some(&other) => Ok(self.starts[node].map(|(_, start)| match other == this {
                    true => End::Moving(start),
                    false => End::Standing(start),
                })),
                None if self.handles[node].is_some() => {
                    Ok(Some(End::Standing(self.known(node, link, known)?)))
                }
                None if self.fixed[node] => {
                    Ok(self.starts[node].map(|(_, start)| End::Standing(start)))
                }
                None => Ok(self.anchors[node].map(End::Standing)),
            })?;
        }
        Ok(Some((first, body)))
    }

    fn place_body(
        &mut self,
        (this, part): (usize, &Part),
        step: &Planned,
        body_of: &BTreeMap<usize, usize>,
        known: &mut Known<'_, '_>,
        bodies: &mut Bodies,
    ) -> Result<(), ReplayerError> {
        let Some((first, mut body)) = self.tied(this, part, this + 1, body_of, known)? else {
            return Ok(());
        };
        let Some((_, origin)) = self.starts[first] else { return Ok(()) };
        let members = || part.nodes.iter().copied();
        let from_file = self.options.initial == Initial::FromFile
            && members().any(|node| self.vertices[node].is_some());
        let gauge = |node| step.gauge.iter().find(|(pose, _)| *pose == node);
        let is_held = members()
            .any(|node| gauge(node).is_some_and(|(_, free)| *free == origin.value().dim()));
        let motion = if from_file || is_held { None } else { body.fit() };
        if let Some(motion) = motion {
            for node in members() {
                let Some((position, start)) = self.starts[node] else { continue };
                self.starts[node] = start.moved(&motion).map(|start| (position, start));
            }
            body.apply(&motion);
        }
        let Some((_, origin)) = self.starts[first] else { return Ok(()) };
        let freedom = body.gauge();
        if !freedom.is_fixed() && gauge(first).is_none() {
            bodies.undetermined.push(this);
        }
        bodies.directions.extend(freedom.in_tangent_of(&origin).map(|it| (first, it)));
        Ok(())
    }

    /// Appends the next parts of the same component to a step, up to `count`; whether there was any.
    pub(crate) fn append_parts(&mut self, step: &mut Planned, count: usize) -> bool {
        let component = step.arrivals.first().map(|first| self.component[first.node]);
        let is_part = |step: &Planned| {
            let first = step.arrivals.first().map(|first| self.component[first.node]);
            step.is_part && first == component
        };
        let next: Vec<usize> = (self.next..self.steps.len())
            .filter(|&at| is_part(&self.steps[at]))
            .take(count)
            .collect();
        for &at in &next {
            step.append(std::mem::take(&mut self.steps[at]));
        }
        let next_step = self.next;
        let mut at = 0;
        self.steps.retain(|step| {
            at += 1;
            at <= next_step || !step.arrivals.is_empty()
        });
        !next.is_empty()
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
