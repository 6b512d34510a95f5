//! From a true trajectory to what a robot records of it.

use evergraph_formats::{Dialect, Document, Record};

use crate::World;
use crate::cells::Cells;
use crate::error::{WorldError, check_positive, check_probability, check_sigmas};
use crate::noise::{Purpose, Stream};
use crate::pose::{Pose, information};

/// When a pose recognizes an earlier one.
///
/// Candidates are the poses within [`radius`](Self::radius) that are old enough and do not look the
/// other way. From the nearest on (at random where distances tie) each becomes a closure with
/// [`probability`](Self::probability), until there are [`per_pose`](Self::per_pose).
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Closures<const N: usize> {
    /// How likely a candidate becomes a closure; 0 for a world without closures.
    pub probability: f64,
    /// How far away a recognized pose may be (m). A large one finds more pairs and takes longer.
    pub radius: f64,
    /// At most so many closures at one pose.
    pub per_pose: u32,
    /// A recognized pose is at least so many steps older; 2 leaves out the odometry's own edges.
    pub gap: u32,
    /// Largest angle between the headings of the two poses (rad); π for any.
    pub turn: f64,
    /// Standard deviations of the measurement, in tangent order (m, rad).
    pub sigmas: [f64; N],
}

impl<const N: usize> Closures<N> {
    /// Sets [`probability`](Self::probability).
    #[must_use]
    pub const fn with_probability(mut self, probability: f64) -> Self {
        self.probability = probability;
        self
    }

    /// Sets [`radius`](Self::radius).
    #[must_use]
    pub const fn with_radius(mut self, radius: f64) -> Self {
        self.radius = radius;
        self
    }

    /// Sets [`per_pose`](Self::per_pose).
    #[must_use]
    pub const fn with_per_pose(mut self, per_pose: u32) -> Self {
        self.per_pose = per_pose;
        self
    }

    /// Sets [`gap`](Self::gap).
    #[must_use]
    pub const fn with_gap(mut self, gap: u32) -> Self {
        self.gap = gap;
        self
    }

    /// Sets [`turn`](Self::turn).
    #[must_use]
    pub const fn with_turn(mut self, turn: f64) -> Self {
        self.turn = turn;
        self
    }

    /// Sets [`sigmas`](Self::sigmas).
    #[must_use]
    pub const fn with_sigmas(mut self, sigmas: [f64; N]) -> Self {
        self.sigmas = sigmas;
        self
    }

    pub(crate) fn check(&self) -> Result<(), WorldError> {
        check_probability("closures.probability", self.probability)?;
        check_positive("closures.radius", self.radius)?;
        check_positive("closures.turn", self.turn)?;
        check_sigmas("closures.sigmas", &self.sigmas)
    }
}

/// A world in the making, one pose after the other.
pub(crate) struct Builder<'a, P, const N: usize, const D: usize> {
    /// The true poses.
    pub(crate) truth: &'a [P],
    /// The initial guess so far.
    pub(crate) guess: Vec<P>,
    /// The measurements so far.
    pub(crate) edges: Vec<Record>,
    odometry: &'a [f64; N],
    closures: &'a Closures<N>,
    cells: Cells<D>,
    odometry_noise: Stream,
    closure_choice: Stream,
    /// Scratch: squared distance, tie break, index.
    candidates: Vec<(f64, u32, u32)>,
}

impl<'a, P: Pose<N, D>, const N: usize, const D: usize> Builder<'a, P, N, D> {
    pub(crate) fn new(
        truth: &'a [P],
        odometry: &'a [f64; N],
        closures: &'a Closures<N>,
        seed: u64,
    ) -> Self {
        Self {
            truth,
            guess: Vec::with_capacity(truth.len()),
            edges: Vec::with_capacity(2 * truth.len()),
            odometry,
            closures,
            cells: Cells::new(closures.radius),
            odometry_noise: Stream::new(seed, Purpose::Odometry),
            closure_choice: Stream::new(seed, Purpose::Closures),
            candidates: Vec::new(),
        }
    }

    /// Adds the next pose with its odometry and its closures, and returns its index.
    pub(crate) fn step(&mut self) -> usize {
        let index = self.guess.len();
        match self.guess.last().copied() {
            None => self.guess.push(self.truth[0]),
            Some(last) => {
                let noise = self.odometry_noise.normals(self.odometry);
                let moved = self.measure(index - 1, index, self.odometry, &noise);
                self.guess.push(last.compose(&moved));
            }
        }
        self.close(index);
        self.cells.insert(&self.truth[index].position(), index as u32);
        index
    }

    /// The finished world; `landmarks` are pairs of guess and truth, with ids after the poses.
    pub(crate) fn finish(self, landmarks: &[(Record, Record)]) -> Result<World, WorldError> {
        let vertex =
            |(id, pose): (usize, &P)| Record::Vertex { id: id as u64, at: pose.coordinates() };
        let mut truth: Vec<Record> = self.truth.iter().enumerate().map(vertex).collect();
        truth.extend(landmarks.iter().map(|(_, truth)| truth.clone()));
        let mut records: Vec<Record> = self.guess.iter().enumerate().map(vertex).collect();
        records.extend(landmarks.iter().map(|(guess, _)| guess.clone()));
        records.extend(self.edges);
        Ok(World {
            document: Document::from_records("simulated world", Dialect::G2o, records)?,
            truth: Document::from_records("simulated truth", Dialect::G2o, truth)?,
        })
    }

    fn close(&mut self, index: usize) {
        let closures = self.closures;
        let Some(before) = (index + 1).checked_sub(closures.gap.max(1) as usize) else { return };
        let here = self.truth[index];
        let at = here.position();
        // Quarter turns and the like must not depend on how the cosine of the limit was rounded.
        let least_cosine = libm::cos(closures.turn.min(std::f64::consts::PI)) - 1e-9;
        let candidates = &mut self.candidates;
        let choice = &mut self.closure_choice;
        candidates.clear();
        self.cells.near(&at, before as u32, |other| {
            let there = &self.truth[other as usize];
            let distance = squared_distance(&at, &there.position());
            if distance <= closures.radius * closures.radius
                && here.between(there).cosine() >= least_cosine
            {
                candidates.push((distance, choice.integer(), other));
            }
        });
        candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut chosen: Vec<u32> = candidates
            .iter()
            .filter(|_| choice.chance(closures.probability))
            .take(closures.per_pose as usize)
            .map(|candidate| candidate.2)
            .collect();
        chosen.sort_unstable();
        for earlier in chosen {
            let noise = self.closure_choice.normals(&closures.sigmas);
            self.measure(earlier as usize, index, &closures.sigmas, &noise);
        }
    }

    /// Records `z = Xᵢ⁻¹ Xⱼ Exp(noise)` and returns it.
    fn measure(&mut self, from: usize, to: usize, sigmas: &[f64; N], noise: &[f64; N]) -> P {
        let measured = self.truth[from].between(&self.truth[to]).compose(&P::exp(noise));
        self.edges.push(Record::Edge {
            from: from as u64,
            to: to as u64,
            measurement: measured.coordinates(),
            weight: information(sigmas),
            parameter: None,
        });
        measured
    }
}

/// `|a - b|²`, summed in order.
pub(crate) fn squared_distance<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}
