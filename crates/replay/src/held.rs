//! Landmarks that no sighting brings in, held back until their measurements place them.

use std::collections::BTreeSet;

use evergraph_formats::Kind;
use evergraph_initialize::{Certainty, Landmark, Sighting, determines_landmark, place_landmark};
use evergraph_model::{Change, Point2, Point3, Value, VariableId};
use smallvec::SmallVec;

use crate::error::ReplayerError;
use crate::geometry::{Geometry, Handle, bad};
use crate::known::Known;
use crate::options::Initial;
use crate::state::{Held, Replay};

/// What came in with waiting links.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Freed {
    pub variables: usize,
    pub factors: usize,
    /// Whether what was connected before is tied together.
    pub closes: bool,
}

impl Replay {
    /// Takes the waiting links of a step, and brings in the landmarks that can be placed now; with
    /// `all` every landmark is tried.
    pub(crate) fn free_landmarks(
        &mut self,
        waiting: &[usize],
        all: bool,
        known: &mut Known<'_, '_>,
        change: &mut Change,
    ) -> Result<Freed, ReplayerError> {
        let mut freed = Freed::default();
        let mut touched = BTreeSet::new();
        for &link in waiting {
            let absent = self.absent(link);
            if absent.is_empty() {
                self.add_factor(link, change)?;
                freed.factors += 1;
                freed.closes |= self.links[link].ends.len() > 1;
            }
            for landmark in absent {
                let held = self.held.entry(landmark);
                let fresh = Held { usable: Vec::new(), pending: Vec::new(), next_try: 1 };
                held.or_insert(fresh).pending.push(link);
                touched.insert(landmark);
            }
        }
        if all {
            touched.extend(self.held.keys());
        }
        while let Some(landmark) = touched.pop_first() {
            let Some(start) = self.try_to_place(landmark, all, known)? else { continue };
            self.bring_in(landmark, start, change);
            freed.variables += 1;
            let Some(held) = self.held.remove(&landmark) else { continue };
            let mut usable = 0;
            for link in held.usable.into_iter().chain(held.pending) {
                let absent = self.absent(link);
                if absent.is_empty() {
                    self.add_factor(link, change)?;
                    usable += 1;
                }
                touched.extend(absent);
            }
            freed.factors += usable;
            freed.closes |= usable > 1;
        }
        Ok(freed)
    }

    /// Where a landmark is, if that can be told now. Trying costs as much as there are links, so it
    /// is done at each new one for the first twenty, then as their number grows by a quarter; in
    /// between only new links are looked at.
    fn try_to_place(
        &mut self,
        landmark: usize,
        last: bool,
        known: &mut Known<'_, '_>,
    ) -> Result<Option<Geometry>, ReplayerError> {
        if let Some(vertex) = self.vertices[landmark].filter(|_| self.fixed[landmark]) {
            return Ok(Some(vertex));
        }
        let Some(held) = self.held.get_mut(&landmark) else { return Ok(None) };
        let pending = std::mem::take(&mut held.pending);
        let (usable, pending): (Vec<usize>, Vec<usize>) =
            pending.into_iter().partition(|&link| self.absent(link).len() == 1);
        let Some(held) = self.held.get_mut(&landmark) else { return Ok(None) };
        held.usable.extend(usable);
        held.pending = pending;
        let count = held.usable.len();
        let seen = || held.usable.iter().any(|&link| self.links[link].ends.len() > 1);
        if count < held.next_try && !last || !seen() {
            return Ok(None);
        }
        held.next_try = count + 1 + if count < 20 { 0 } else { count / 4 };
        let mut sights = Vec::with_capacity(count);
        for &link in self.held.get(&landmark).map_or(&[][..], |held| &held.usable) {
            sights.push(self.sighting(link, landmark, known)?);
        }
        let certainty = if last { Certainty::Likely } else { Certainty::Sure };
        let vertex = self.vertices[landmark].filter(|_| self.options.initial == Initial::FromFile);
        Ok(match self.nodes[landmark].kind {
            Kind::Point2 => place::<Point2>(&sights, vertex.as_ref(), certainty),
            Kind::Point3 => place::<Point3>(&sights, vertex.as_ref(), certainty),
            Kind::Pose2 | Kind::Pose3 => None,
        })
    }

    /// The factor of a link with the values of its ends but the landmark.
    fn sighting(
        &self,
        link: usize,
        landmark: usize,
        known: &mut Known<'_, '_>,
    ) -> Result<Sighting, ReplayerError> {
        let mut values: SmallVec<[(VariableId, Value); 2]> = SmallVec::new();
        for &node in self.links[link].ends.iter().filter(|&&node| node != landmark) {
            values.push((self.scratch[node].id(), self.known(node, link, known)?.value()));
        }
        let value = |id| values.iter().find(|(known, _)| *known == id).map(|(_, it)| it.clone());
        Sighting::new(self.scratch_factor(link)?, self.scratch[landmark].id(), value)
            .ok_or_else(|| bad(&self.place(Some(link)), "it does not see the landmark"))
    }

    /// The ends of a link that have not come in.
    fn absent(&self, link: usize) -> SmallVec<[usize; 2]> {
        let ends = self.links[link].ends.iter().copied();
        ends.filter(|&end| self.handles[end].is_none()).collect()
    }

    /// How many landmarks have been seen, but not so that they can be placed: by one bearing, or by
    /// ranges from along a line. They and their measurements are left out so far.
    pub fn held_back(&self) -> usize {
        self.held.len()
    }

    /// The ids of the landmarks that are [`held_back`](Self::held_back), ascending.
    pub fn held_back_ids(&self) -> impl Iterator<Item = u64> {
        self.held.keys().map(|&node| self.nodes[node].id)
    }

    /// Adds a variable at its start, fixed if the file says so.
    pub(crate) fn bring_in(&mut self, node: usize, start: Geometry, change: &mut Change) -> Handle {
        let handle = Handle::add(&start, change);
        if self.fixed[node] {
            change.fix(handle.id());
        }
        self.handles[node] = Some(handle);
        self.starts[node] = Some((self.order.len(), start));
        self.order.push(node);
        handle
    }
}

/// The position of a landmark, if its measurements determine it. A `vertex` is its position if there is
/// one, and measurements only have to determine it.
fn place<L: Landmark>(
    sights: &[Sighting],
    vertex: Option<&Geometry>,
    certainty: Certainty,
) -> Option<Geometry> {
    if let Some(vertex) = vertex {
        let at: L = vertex.value().get()?;
        return determines_landmark(sights, &at, certainty).then_some(*vertex);
    }
    Geometry::of(&Value::new(&place_landmark::<L>(sights, certainty)?))
}
