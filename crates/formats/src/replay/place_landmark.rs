//! Where a landmark is that no single sighting places: seen by bearings or ranges only.

use std::sync::Arc;

use evergraph_model::{Factor, Pose2, Value};
use nalgebra::Vector3;
use smallvec::SmallVec;

use super::evaluate::{Linearized, Quadratic, minimize};
use super::geometry::Geometry;
use super::numbers::Numbers;
use super::observation::{Observation, Observed};
use super::rigid::sample;
use crate::coordinates::Kind;
use crate::measurement::Quantity;

/// Largest standard deviation of a landmark, as a share of the distance to whoever sees it from
/// nearest: beyond, bearings and ranges are too far from linear over the region that it may be in.
const PARALLAX: f64 = 0.3;

/// How much better, in chi2, the best place has to be than any other: three standard deviations.
const UNIQUE: f64 = 9.0;

/// Largest mean square of a whitened residual that passes for drift of the poses.
const PLAUSIBLE: f64 = 25.0;

/// A landmark that something measures without curvature is placed when its standard deviation is
/// below this, in metres.
const KNOWN: f64 = 1e3;

/// A measurement of a landmark.
pub(super) struct Sight {
    pub factor: Arc<dyn Factor>,
    /// All variables of the factor, the landmark's anything, and which it is.
    pub values: SmallVec<[Value; 2]>,
    pub landmark: usize,
    /// Where the others are.
    pub observers: SmallVec<[Vector3<f64>; 1]>,
    pub hint: Hint,
}

/// Where a measurement, by itself, puts a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Hint {
    At(Vector3<f64>),
    /// Somewhere along a unit vector.
    Along(Vector3<f64>, Vector3<f64>),
    /// At a distance.
    Around(Vector3<f64>, f64),
    Nowhere,
}

impl Hint {
    /// What an observation says of the landmark that is one of its ends.
    pub fn of(observation: &Observation, ends: &[Option<Geometry>], landmark: usize) -> Self {
        Self::find(observation, ends, landmark).unwrap_or(Self::Nowhere)
    }

    fn find(observed: &Observation, ends: &[Option<Geometry>], landmark: usize) -> Option<Self> {
        let Observed::Quantity { quantity, numbers, .. } = &observed.what else {
            let Observed::Linear(linear) = &observed.what else { return None };
            return Some(Self::At(linear.points.get(landmark)?.position()));
        };
        let numbers = Numbers(numbers);
        let point = |planar: bool| {
            if planar {
                numbers.point2(0).map(|p| Vector3::new(p.x(), p.y(), 0.0))
            } else {
                numbers.vector3(0)
            }
        };
        if *quantity == Quantity::Prior {
            return point(numbers.0.len() == 2).map(Self::At);
        }
        let other = ends.iter().enumerate().find(|(at, _)| *at != landmark)?.1.as_ref()?;
        let from = other.position();
        match quantity {
            Quantity::Between => {
                let z = point(matches!(other, Geometry::Point2(_)))?;
                Some(Self::At(if landmark == 1 { from + z } else { from - z }))
            }
            Quantity::Range => Some(Self::Around(from, numbers.number(0)?)),
            Quantity::Bearing | Quantity::BearingRange => {
                let (direction, range) = match other {
                    Geometry::Pose2(x) => {
                        let ahead = Pose2::new(0.0, 0.0, x.theta() + numbers.number(0)?);
                        let rotation = ahead.rotation();
                        (Vector3::new(rotation.cos(), rotation.sin(), 0.0), 1)
                    }
                    Geometry::Pose3(x) => {
                        (x.rotation().rotate(&numbers.vector3(0)?.try_normalize(0.0)?), 3)
                    }
                    Geometry::Point2(_) | Geometry::Point3(_) => return None,
                };
                Some(match numbers.number(range) {
                    Some(range) => Self::At(from + range * direction),
                    None => Self::Along(from, direction),
                })
            }
            _ => None,
        }
    }
}

/// Where the landmark is, if its measurements say so: see [`Replay`](super::Replay). With a
/// `vertex` that is taken, and only whether the measurements determine it is asked.
pub(super) fn place(kind: Kind, sights: &[Sight], vertex: Option<&Geometry>) -> Option<Geometry> {
    /// Measurements to choose between the starts with.
    const SAMPLE: usize = 200;
    let every: Vec<&Sight> = sights.iter().collect();
    let problem = Problem { kind, sights: &every };
    let known = sights.iter().find_map(|sight| match sight.hint {
        Hint::At(at) => Some(at),
        _ => None,
    });
    let determined = |at: &Vector3<f64>, spread: f64| {
        problem.deviation(at).is_some_and(|deviation| {
            let bound = known.map_or(PARALLAX * problem.nearest(at), |_| KNOWN);
            deviation * spread.sqrt() < bound
        })
    };
    if let Some(vertex) = vertex {
        return determined(&vertex.position(), 1.0).then_some(*vertex);
    }
    let start = match known {
        Some(at) => at,
        None => Problem { kind, sights: &sample(sights, SAMPLE) }.only_minimum()?,
    };
    let (at, end) = problem.descend(start)?;
    let spread = problem.spread(end.error);
    let plausible = known.is_some() || spread <= PLAUSIBLE;
    (plausible && determined(&at, spread)).then(|| Geometry::point(kind, &at)).flatten()
}

struct Problem<'a> {
    kind: Kind,
    sights: &'a [&'a Sight],
}

impl Problem<'_> {
    /// The least-squares place, unless another place is as good.
    fn only_minimum(&self) -> Option<Vector3<f64>> {
        let mut minima: Vec<(Vector3<f64>, f64)> = Vec::new();
        for start in self.starts() {
            minima.extend(self.descend(start).map(|(at, end)| (at, 2.0 * end.error)));
        }
        let (best, chi2) = *minima.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let apart = 0.01 * self.nearest(&best);
        let rival = |(at, other): &(Vector3<f64>, f64)| {
            (at - best).norm() > apart && other - chi2 < UNIQUE * self.spread(0.5 * chi2)
        };
        (!minima.iter().any(rival)).then_some(best)
    }

    /// Along the first bearing, and all around the first range.
    fn starts(&self) -> Vec<Vector3<f64>> {
        const DISTANCES: [f64; 6] = [0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
        let mut starts = Vec::new();
        let hints = || self.sights.iter().map(|sight| sight.hint);
        if let Some(Hint::Along(from, direction)) = hints().find(|h| matches!(h, Hint::Along(..))) {
            let observers = self.sights.iter().flat_map(|sight| &sight.observers);
            let baseline = observers.map(|at| (at - from).norm()).fold(0.0, f64::max);
            starts.extend(DISTANCES.map(|distance| from + distance * baseline * direction));
        }
        if let Some(Hint::Around(center, radius)) = hints().find(|h| matches!(h, Hint::Around(..)))
        {
            starts.extend(self.directions().map(|direction| center + radius * direction));
        }
        starts
    }

    /// Unit vectors all around: a circle, or a sphere along a spiral of golden angles.
    fn directions(&self) -> impl Iterator<Item = Vector3<f64>> {
        const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
        let planar = self.kind == Kind::Point2;
        let count = if planar { 16 } else { 32 };
        (0..count).map(move |k| {
            let k = f64::from(k);
            let (z, angle) = if planar {
                (0.0, std::f64::consts::TAU * k / f64::from(count))
            } else {
                (1.0 - 2.0 * (k + 0.5) / f64::from(count), GOLDEN_ANGLE * k)
            };
            let horizontal: f64 = f64::sqrt(1.0 - z * z);
            Vector3::new(horizontal * angle.cos(), horizontal * angle.sin(), z)
        })
    }

    fn descend(&self, start: Vector3<f64>) -> Option<(Vector3<f64>, Quadratic)> {
        let least = vec![1.0 / (KNOWN * KNOWN); self.kind.dim()];
        minimize(
            start,
            &least,
            |at| self.quadratic(at),
            |at, step| {
                let mut next = *at;
                next.iter_mut().zip(step.iter()).for_each(|(x, d)| *x += d);
                Some(next)
            },
        )
    }

    fn quadratic(&self, at: &Vector3<f64>) -> Quadratic {
        let mut sum = Quadratic::zeros(self.kind.dim());
        let Some(place) = Geometry::point(self.kind, at) else { return sum };
        let value = place.value();
        let mut linearized = Linearized::default();
        for sight in self.sights {
            let mut values: SmallVec<[&Value; 2]> = sight.values.iter().collect();
            values[sight.landmark] = &value;
            linearized.set(&sight.factor, &values);
            sum.add(&linearized.block(sight.landmark).into_owned(), &linearized);
        }
        sum
    }

    /// Mean square of the residuals, where that is above one: larger residuals than the noise
    /// explains count as that much more noise.
    fn spread(&self, error: f64) -> f64 {
        let rows: usize = self.sights.iter().map(|sight| sight.factor.residual_dim()).sum();
        let freedom = rows.saturating_sub(self.kind.dim()).max(1);
        (2.0 * error / freedom as f64).max(1.0)
    }

    /// The largest standard deviation; `None` where a direction is free.
    fn deviation(&self, at: &Vector3<f64>) -> Option<f64> {
        let information = self.quadratic(at).information;
        if !information.iter().all(|x| x.is_finite() && x.abs() < 1e150) {
            return None;
        }
        let eigenvalues = information.symmetric_eigenvalues();
        (eigenvalues.min() > 1e-12 * eigenvalues.max()).then(|| 1.0 / eigenvalues.min().sqrt())
    }

    /// The distance to whoever sees it from nearest.
    fn nearest(&self, at: &Vector3<f64>) -> f64 {
        let observers = self.sights.iter().flat_map(|sight| &sight.observers);
        observers.map(|observer| (at - observer).norm()).fold(f64::INFINITY, f64::min)
    }
}
