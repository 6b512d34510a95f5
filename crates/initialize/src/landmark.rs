//! The position of a landmark that no single measurement gives, from bearings and ranges.

use std::marker::PhantomData;
use std::sync::Arc;

use evergraph_model::{
    Factor, LinearizedFactor, Manifold, Point2, Point3, Value, ValueRef, VariableId,
};
use nalgebra::Vector3;
use smallvec::SmallVec;

use crate::geometry::Geometry;
use crate::hint::Hint;
use crate::minimize::{Quadratic, minimize};
use crate::rigid::sample;

/// The certainty that the position of a landmark needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Certainty {
    /// The largest standard deviation is below 0.3 of the distance to the nearest variable that sees it:
    /// over a larger region bearings and ranges are too far from linear. No other position fits within a
    /// chi2 of 9. For a landmark that more measurements may come for.
    Sure,
    /// The same with 0.5 of the distance, and a chi2 of 1: for a landmark of which all measurements are there.
    Likely,
}

impl Certainty {
    /// Largest standard deviation, as a share of the distance to the nearest observer.
    fn parallax(self) -> f64 {
        match self {
            Self::Sure => 0.3,
            Self::Likely => 0.5,
        }
    }

    /// The margin, in chi2, by which a position has to fit better than any other.
    fn margin(self) -> f64 {
        match self {
            Self::Sure => 9.0,
            Self::Likely => 1.0,
        }
    }
}

/// Largest mean square of a whitened residual that passes for drift of the poses.
const PLAUSIBLE: f64 = 25.0;

/// A landmark that something measures without curvature is placed when its standard deviation is
/// below this, in metres.
const KNOWN: f64 = 1e3;

/// A point that [`place_landmark`] can place: [`Point2`] or [`Point3`].
pub trait Landmark: Manifold + sealed::Sealed {
    /// Whether it is of the plane.
    #[doc(hidden)]
    const PLANAR: bool;

    /// The landmark at a position; the plane is at `z = 0`.
    #[doc(hidden)]
    fn at(position: &Vector3<f64>) -> Self;

    /// The position; in the plane z is zero.
    #[doc(hidden)]
    fn position(&self) -> Vector3<f64>;
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for evergraph_model::Point2 {}
    impl Sealed for evergraph_model::Point3 {}
}

impl Landmark for Point2 {
    const PLANAR: bool = true;

    fn at(position: &Vector3<f64>) -> Self {
        Self::new(position.x, position.y)
    }

    fn position(&self) -> Vector3<f64> {
        Vector3::new(self.x(), self.y(), 0.0)
    }
}

impl Landmark for Point3 {
    const PLANAR: bool = false;

    fn at(position: &Vector3<f64>) -> Self {
        Self::new(position.x, position.y, position.z)
    }

    fn position(&self) -> Vector3<f64> {
        self.vector()
    }
}

/// A measurement of a landmark, with the values of its other variables.
#[derive(Clone, Debug)]
pub struct Sighting {
    factor: Arc<dyn Factor>,
    /// Of all variables of the factor; that of the landmark is not read.
    values: SmallVec<[Value; 2]>,
    landmark: usize,
    /// Positions of the other variables.
    observers: SmallVec<[Vector3<f64>; 1]>,
    hint: Hint,
}

impl Sighting {
    /// A factor on `landmark` and on variables whose values are known.
    ///
    /// `None` when the factor is not on `landmark`, when `known` has no value for one of its other
    /// variables, or when one of those is neither a pose nor a point.
    pub fn new(
        factor: Arc<dyn Factor>,
        landmark: VariableId,
        mut known: impl FnMut(VariableId) -> Option<Value>,
    ) -> Option<Self> {
        let at = factor.keys().iter().position(|&key| key == landmark)?;
        let mut ends: SmallVec<[Option<Geometry>; 2]> = SmallVec::new();
        for &key in factor.keys() {
            ends.push(if key == landmark { None } else { Some(Geometry::of(&known(key)?)?) });
        }
        let anything = Value::new(&Point3::new(0.0, 0.0, 0.0));
        let value = |end: &Option<Geometry>| end.map_or_else(|| anything.clone(), |it| it.value());
        Some(Self {
            values: ends.iter().map(value).collect(),
            observers: ends.iter().flatten().map(Geometry::position).collect(),
            hint: Hint::of(&*factor, &ends, at),
            landmark: at,
            factor,
        })
    }
}

/// The position of a landmark, if its measurements determine it.
///
/// A landmark counts as placed when
///
/// - its largest standard deviation is as small as `certainty` demands, or below 1000 m where a measurement
///   gives its position outright;
/// - the fit is plausible: residuals are up to five times their noise, which then counts as that much
///   larger;
/// - no other position fits as well. Ranges from along a line fit two positions.
///
/// The starts of the search lie along the first bearing and all around the first range. O(n) per start
/// for n measurements, of which 200 choose the start.
///
/// ```
/// use std::sync::Arc;
///
/// use evergraph_factors::Bearing2;
/// use evergraph_initialize::{Certainty, Sighting, place_landmark};
/// use evergraph_model::{Graph, Noise, Point2, Pose2, Value};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut change = Graph::new().change();
/// let poses = [Pose2::new(0.0, 0.0, 0.0), Pose2::new(2.0, 0.0, 0.0)];
/// let [a, b] = poses.map(|pose| change.add_variable(&pose));
/// let light = change.add_variable(&Point2::new(0.0, 0.0));
/// let known = |id| Some(Value::new(if id == a.id() { &poses[0] } else { &poses[1] }));
///
/// let noise = Noise::isotropic(1, 0.01)?;
/// let ahead = Arc::new(Bearing2::new(a, light, std::f64::consts::FRAC_PI_4, noise.clone())?);
/// let left = Arc::new(Bearing2::new(b, light, std::f64::consts::FRAC_PI_2, noise)?);
/// let mut sightings = vec![Sighting::new(ahead, light.id(), known).ok_or("a bearing of it")?];
/// assert_eq!(place_landmark::<Point2>(&sightings, Certainty::Sure), None); // a single direction places nothing
/// sightings.push(Sighting::new(left, light.id(), known).ok_or("a bearing of it")?);
/// let at: Point2 = place_landmark(&sightings, Certainty::Sure).ok_or("two directions do")?;
/// assert!((at.x() - 2.0).abs() < 1e-6 && (at.y() - 2.0).abs() < 1e-6);
/// # Ok(())
/// # }
/// ```
pub fn place_landmark<L: Landmark>(sightings: &[Sighting], certainty: Certainty) -> Option<L> {
    /// Measurements to choose between the starts with.
    const SAMPLE: usize = 200;
    let problem = Problem::<L>::new(sightings.iter().collect());
    let start = match problem.known() {
        Some(at) => at,
        None => Problem::<L>::new(sample(sightings, SAMPLE)).only_minimum(certainty)?,
    };
    let (at, end) = problem.descend(start)?;
    let spread = problem.spread(end.error);
    let plausible = problem.known().is_some() || spread <= PLAUSIBLE;
    (plausible && problem.determines(&at, spread, certainty)).then(|| L::at(&at))
}

/// Whether the measurements of a landmark determine its position, by the parallax at `at`: the first
/// condition of [`place_landmark`], for a landmark whose position is known from elsewhere.
pub fn determines_landmark<L: Landmark>(
    sightings: &[Sighting],
    at: &L,
    certainty: Certainty,
) -> bool {
    Problem::<L>::new(sightings.iter().collect()).determines(&at.position(), 1.0, certainty)
}

struct Problem<'a, L> {
    sights: Vec<&'a Sighting>,
    kind: PhantomData<fn() -> L>,
}

impl<'a, L: Landmark> Problem<'a, L> {
    fn new(sights: Vec<&'a Sighting>) -> Self {
        Self { sights, kind: PhantomData }
    }

    fn dim(&self) -> usize {
        if L::PLANAR { 2 } else { 3 }
    }

    /// The position that a measurement gives outright.
    fn known(&self) -> Option<Vector3<f64>> {
        self.sights.iter().find_map(|sight| match sight.hint {
            Hint::At(at) => Some(at),
            _ => None,
        })
    }

    fn determines(&self, at: &Vector3<f64>, spread: f64, certainty: Certainty) -> bool {
        self.deviation(at).is_some_and(|deviation| {
            let bound = self.known().map_or(certainty.parallax() * self.nearest(at), |_| KNOWN);
            deviation * spread.sqrt() < bound
        })
    }

    /// The least-squares place, unless another place is as good.
    fn only_minimum(&self, certainty: Certainty) -> Option<Vector3<f64>> {
        let mut minima: Vec<(Vector3<f64>, f64)> = Vec::new();
        for start in self.starts() {
            minima.extend(self.descend(start).map(|(at, end)| (at, 2.0 * end.error)));
        }
        let (best, chi2) = *minima.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let apart = 0.01 * self.nearest(&best);
        let rival = |(at, other): &(Vector3<f64>, f64)| {
            (at - best).norm() > apart
                && other - chi2 < certainty.margin() * self.spread(0.5 * chi2)
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
        let planar = L::PLANAR;
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
        let least = vec![1.0 / (KNOWN * KNOWN); self.dim()];
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
        let mut sum = Quadratic::zeros(self.dim());
        let value = Value::new(&L::at(at));
        let mut linearized = LinearizedFactor::default();
        for sight in &self.sights {
            let mut values: SmallVec<[ValueRef<'_>; 2]> =
                sight.values.iter().map(Value::as_ref).collect();
            values[sight.landmark] = value.as_ref();
            match linearized.set(&*sight.factor, &values) {
                Ok(()) => {
                    sum.add(&linearized.jacobian(sight.landmark).into_owned(), &linearized);
                }
                Err(_) => sum.spoil(),
            }
        }
        sum
    }

    /// Mean square of the residuals, where that is above one: larger residuals than the noise
    /// explains count as that much more noise.
    fn spread(&self, error: f64) -> f64 {
        let rows: usize = self.sights.iter().map(|sight| sight.factor.residual_dim()).sum();
        let freedom = rows.saturating_sub(self.dim()).max(1);
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

    /// The distance to the nearest observer.
    fn nearest(&self, at: &Vector3<f64>) -> f64 {
        let observers = self.sights.iter().flat_map(|sight| &sight.observers);
        observers.map(|observer| (at - observer).norm()).fold(f64::INFINITY, f64::min)
    }
}
