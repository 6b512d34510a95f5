//! Parts of a step that no odometry ties to the poses before them, placed as rigid bodies.

use std::collections::BTreeMap;

use evergraph_initialize::{Body, End};
use nalgebra::DMatrix;
use smallvec::SmallVec;

use crate::error::ReplayerError;
use crate::known::Known;
use crate::options::Initial;
use crate::order::{Arrival, Planned};
use crate::state::Replay;

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
    /// Ties a body by the factor of a link, if all of its ends are known, some move, and it does not
    /// only say how those lie to each other; `end` gives the value of a variable. Returns whether it ties.
    pub(crate) fn tie(
        &self,
        body: &mut Body,
        link: usize,
        mut end: impl FnMut(usize) -> Result<Option<End>, ReplayerError>,
    ) -> Result<bool, ReplayerError> {
        let mut found: SmallVec<[Option<End>; 2]> = SmallVec::new();
        for &node in &self.links[link].ends {
            found.push(end(node)?);
        }
        let what = &self.observations[link].what;
        // A landmark that is not placed yet is where a linear factor has it relative to what is.
        let standing = found.iter().enumerate().find_map(|(at, end)| match end {
            Some(End::Standing(value)) if value.is_pose() => Some((at, *value)),
            _ => None,
        });
        let composed = |at: usize| {
            let (known, value) = standing?;
            let is_landmark = !self.nodes[self.links[link].ends[at]].kind.is_pose();
            let is_held = is_landmark && what.is_rigid();
            is_held.then(|| what.compose(known, &value, at))?.map(End::Standing)
        };
        let mut ends: SmallVec<[End; 2]> = SmallVec::new();
        for (at, end) in found.iter().enumerate() {
            let Some(end) = end.or_else(|| composed(at)) else {
                return Ok(false);
            };
            ends.push(end);
        }
        let all_move = ends.iter().all(|end| matches!(end, End::Moving(_)));
        if all_move && what.is_relative() {
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
                // Fixed, or tied to what is there by odometry in this step.
                None => Ok(match self.starts[node] {
                    Some((_, start)) => Some(End::Standing(start)),
                    None => self.anchors[node].map(End::Standing),
                }),
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
}
