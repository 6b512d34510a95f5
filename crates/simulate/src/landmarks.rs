//! Points beside the streets.

use evergraph_formats::{Coordinates, Record};
use nalgebra::{Isometry2, Point2};

use crate::builder::{Builder, squared_distance};
use crate::cells::Cells;
use crate::error::{WorldError, check_at_least, check_positive, check_probability, check_sigmas};
use crate::noise::{Purpose, Stream};
use crate::pose::information;

/// Point landmarks, spread evenly over the area of a [`crate::Grid`] and seen by Cartesian
/// coordinates in the frame of the pose.
///
/// Only landmarks that were seen are part of the world.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Landmarks {
    /// How many there are in a square meter (1/m²); 0 for none.
    pub density: f64,
    /// How far a pose can see (m).
    pub range: f64,
    /// How likely a landmark in range is seen.
    pub probability: f64,
    /// At most so many sightings at one pose, the nearest first.
    pub per_pose: u32,
    /// Standard deviations along the robot's x and y axes (m).
    pub sigmas: [f64; 2],
}

impl Default for Landmarks {
    /// One landmark in 25 m², seen within 5 m three times out of four, with 0.1 m of noise.
    fn default() -> Self {
        Self { density: 0.04, range: 5.0, probability: 0.75, per_pose: 4, sigmas: [0.1, 0.1] }
    }
}

impl Landmarks {
    /// Sets [`density`](Self::density).
    #[must_use]
    pub const fn with_density(mut self, density: f64) -> Self {
        self.density = density;
        self
    }

    /// Sets [`range`](Self::range).
    #[must_use]
    pub const fn with_range(mut self, range: f64) -> Self {
        self.range = range;
        self
    }

    /// Sets [`probability`](Self::probability).
    #[must_use]
    pub const fn with_probability(mut self, probability: f64) -> Self {
        self.probability = probability;
        self
    }

    /// Sets [`per_pose`](Self::per_pose).
    #[must_use]
    pub const fn with_per_pose(mut self, per_pose: u32) -> Self {
        self.per_pose = per_pose;
        self
    }

    /// Sets [`sigmas`](Self::sigmas).
    #[must_use]
    pub const fn with_sigmas(mut self, sigmas: [f64; 2]) -> Self {
        self.sigmas = sigmas;
        self
    }

    /// How many landmarks stand in a square with sides of `side` meters.
    pub(crate) fn count(&self, side: f64, poses: u32) -> Result<u32, WorldError> {
        check_at_least("landmarks.density", self.density, 0.0)?;
        check_positive("landmarks.range", self.range)?;
        check_probability("landmarks.probability", self.probability)?;
        check_sigmas("landmarks.sigmas", &self.sigmas)?;
        let count = (self.density * side * side).round();
        let limit = u32::MAX - poses;
        if count > f64::from(limit) {
            return Err(WorldError::TooManyLandmarks { count, limit });
        }
        Ok(count as u32)
    }
}

/// The landmarks of one world and what has been seen of them.
pub(crate) struct Field<'a> {
    settings: &'a Landmarks,
    places: Vec<[f64; 2]>,
    cells: Cells<2>,
    /// By landmark: its place in `seen`.
    ids: Vec<Option<u32>>,
    /// Guess and truth of the landmarks in the order of their first sighting.
    seen: Vec<(Record, Record)>,
    sightings: Stream,
    /// Scratch: squared distance, landmark.
    candidates: Vec<(f64, u32)>,
}

impl<'a> Field<'a> {
    pub(crate) fn new(settings: &'a Landmarks, count: u32, side: f64, seed: u64) -> Self {
        let mut places_stream = Stream::new(seed, Purpose::LandmarkPlaces);
        let mut cells = Cells::new(settings.range);
        let mut places = Vec::with_capacity(count as usize);
        for index in 0..count {
            let place = [(); 2].map(|()| side * (places_stream.uniform() - 0.5));
            cells.insert(&place, index);
            places.push(place);
        }
        Self {
            settings,
            ids: vec![None; places.len()],
            places,
            cells,
            seen: Vec::new(),
            sightings: Stream::new(seed, Purpose::LandmarkSightings),
            candidates: Vec::new(),
        }
    }

    /// Records what pose `index`, just added to `builder`, sees.
    pub(crate) fn observe(
        &mut self,
        index: usize,
        builder: &mut Builder<'_, Isometry2<f64>, 3, 2>,
    ) {
        let settings = self.settings;
        let (here, guess) = (builder.truth[index], builder.guess[index]);
        let at: [f64; 2] = here.translation.vector.into();
        self.candidates.clear();
        self.cells.near(&at, u32::MAX, |landmark| {
            let distance = squared_distance(&at, &self.places[landmark as usize]);
            if distance <= settings.range * settings.range {
                self.candidates.push((distance, landmark));
            }
        });
        self.candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut sighted = 0;
        for &(_, landmark) in &self.candidates {
            if sighted == settings.per_pose {
                break;
            }
            if !self.sightings.chance(settings.probability) {
                continue;
            }
            sighted += 1;
            let place = self.places[landmark as usize];
            let noise = self.sightings.normals(&settings.sigmas);
            let exact = here.inverse_transform_point(&Point2::from(place));
            let measured = Point2::new(exact.x + noise[0], exact.y + noise[1]);
            let next = self.seen.len() as u32;
            let number = *self.ids[landmark as usize].get_or_insert(next);
            let id = builder.truth.len() as u64 + u64::from(number);
            if number == next {
                let guessed = guess.transform_point(&measured);
                self.seen.push((
                    Record::Vertex { id, at: Coordinates::Point2(guessed.coords.into()) },
                    Record::Vertex { id, at: Coordinates::Point2(place) },
                ));
            }
            builder.edges.push(Record::Edge {
                from: index as u64,
                to: id,
                measurement: Coordinates::Point2(measured.coords.into()),
                weight: information(&settings.sigmas),
                parameter: None,
            });
        }
    }

    /// Guess and truth of every landmark that was seen.
    pub(crate) fn into_seen(self) -> Vec<(Record, Record)> {
        self.seen
    }
}
