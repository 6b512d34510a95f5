//! Rigid alignment: the place in the world of poses and landmarks that odometry holds together.

use std::sync::Arc;

use evergraph_model::{
    Factor, LieGroup, LinearizedFactor, Point2, Point3, Pose2, Pose3, Rot3, Value, ValueRef,
    VariableId,
};
use nalgebra::{DMatrix, DVector, Vector3};
use smallvec::SmallVec;

use crate::gauge::{Gauge, MotionInformation, scales};
use crate::geometry::Geometry;
use crate::minimize::{Quadratic, minimize};

/// A factor on a [`Body`]: its variables, and which of them move with the body.
#[derive(Clone, Debug)]
struct Tie {
    factor: Arc<dyn Factor>,
    /// Each variable, and whether it moves; the others stand still.
    ends: SmallVec<[(Geometry, bool); 2]>,
}

/// Whitened rows of a factor by small motions of a [`Body`].
struct Rows {
    jacobian: DMatrix<f64>,
    /// By column, the size of the numbers that it is a difference of.
    size: DVector<f64>,
}

/// A variable of a factor, seen from a [`Body`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum End {
    /// A variable of the body; it moves with it.
    Moving(Geometry),
    /// A variable of the rest of the map; it stays.
    Standing(Geometry),
}

/// Poses and landmarks that move as one, with the factors that tie them to the world and to variables
/// that do not move.
///
/// A *body* is a part of a map whose inner shape is known, from odometry for example, but not its place.
/// [`fit`](Self::fit) gives the rigid motion by which the factors fit best, [`gauge`](Self::gauge) says
/// which motions they leave free. Factors between variables of the body alone need not be added unless
/// they measure the world too: they say nothing of its place.
///
/// ```
/// use std::sync::Arc;
///
/// use evergraph_factors::GpsPosition2;
/// use evergraph_initialize::{Body, End, Geometry};
/// use evergraph_model::{Graph, Noise, Point2, Pose2};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// // Ten metres ahead by odometry; two positions by GPS say that ahead is north.
/// let poses = [Pose2::new(0.0, 0.0, 0.0), Pose2::new(10.0, 0.0, 0.0)];
/// let fixes = [Point2::new(100.0, 200.0), Point2::new(100.0, 210.0)];
/// let mut change = Graph::new().change();
/// let mut body = Body::new(&Geometry::Pose2(poses[0]));
/// for (pose, fix) in poses.iter().zip(fixes) {
///     let key = change.add_variable(pose);
///     let gps = GpsPosition2::new(key, fix, Noise::isotropic(2, 1.0)?)?;
///     let free = body.gauge().free();
///     body.tie(Arc::new(gps), |_| Some(End::Moving(Geometry::Pose2(*pose))));
///     assert!(body.gauge().free() < free); // three directions, then one, then none
/// }
/// assert!(body.gauge().is_fixed());
/// let motion = body.fit().ok_or("it is tied to the world")?;
/// let Some(Geometry::Pose2(first)) = Geometry::Pose2(poses[0]).moved(&motion) else { unreachable!() };
/// assert!((first.x() - 100.0).abs() < 1e-6 && (first.theta() - 1.5707963).abs() < 1e-6);
/// # Ok(())
/// # }
/// ```
///
/// The search is a Levenberg-Marquardt method on the three or six unknowns of the motion, from eight
/// headings. It is not that of `evergraph-solver`: the motion turns about the body's center, so that
/// its damping does not depend on the distance of the body from the origin of the world.
#[derive(Clone, Debug)]
pub struct Body {
    ties: Vec<Tie>,
    /// The variable that small motions turn about.
    first: Geometry,
    center: Vector3<f64>,
    planar: bool,
}

impl Body {
    /// A body that nothing ties yet. Its small motions turn about the position of `first`, a variable
    /// of it; of the plane or in space as that is.
    pub fn new(first: &Geometry) -> Self {
        let (center, planar) = (first.position(), first.is_planar());
        Self { ties: Vec::new(), first: *first, center, planar }
    }

    /// Adds a factor; `end` gives the values of its variables. Returns whether the factor says anything
    /// of the body: all of its variables are known, some of them move, and all are of the plane or in
    /// space as the body is.
    pub fn tie(
        &mut self,
        factor: Arc<dyn Factor>,
        mut end: impl FnMut(VariableId) -> Option<End>,
    ) -> bool {
        let mut ends = SmallVec::new();
        for &key in factor.keys() {
            let (at, moves) = match end(key) {
                Some(End::Moving(at)) => (at, true),
                Some(End::Standing(at)) => (at, false),
                None => return false,
            };
            if at.is_planar() != self.planar {
                return false;
            }
            ends.push((at, moves));
        }
        let says = ends.iter().any(|(_, moves)| *moves);
        if says {
            self.ties.push(Tie { factor, ends });
        }
        says
    }

    /// Moves the body by a rigid motion, a pose of the plane or in space as the body is; any other
    /// geometry is no motion of it and moves nothing.
    pub fn apply(&mut self, motion: &Geometry) {
        if !motion.is_pose() || motion.is_planar() != self.planar {
            return;
        }
        self.first = self.first.moved(motion).unwrap_or(self.first);
        self.center = self.first.position();
        for (at, moves) in self.ties.iter_mut().flat_map(|tie| &mut tie.ends) {
            if *moves && let Some(moved) = at.moved(motion) {
                *at = moved;
            }
        }
    }

    /// The directions in which the body can be moved, and how many of them its factors leave free.
    pub fn gauge(&self) -> Gauge {
        Gauge::of(&self.information())
    }

    fn dim(&self) -> usize {
        if self.planar { 3 } else { 6 }
    }

    fn unmoved(&self) -> Geometry {
        if self.planar {
            Geometry::Pose2(Pose2::identity())
        } else {
            Geometry::Pose3(Pose3::identity())
        }
    }

    /// The rigid motion by which the factors fit best; `None` when there is none, or where numbers
    /// overflow. Directions that are free do not move. O(n) for n factors, of which 400 choose between
    /// the headings.
    pub fn fit(&self) -> Option<Geometry> {
        const HEADINGS: u32 = 8;
        /// Ties to choose a start with.
        const SAMPLE: usize = 400;
        if self.ties.is_empty() {
            return None;
        }
        let sample = sample(&self.ties, SAMPLE);
        let mut best: Option<(Geometry, f64)> = None;
        for k in 0..HEADINGS {
            let yaw = f64::from(k) * std::f64::consts::TAU / f64::from(HEADINGS);
            let Some((motion, end)) = self.descend(&sample, self.turned(yaw)) else { continue };
            // A later start has to be better by more than rounding.
            let enough = |error: f64| error * (1.0 - 1e-6) - 1e-9;
            if best.as_ref().is_none_or(|best| end.error < enough(best.1)) {
                best = Some((motion, end.error));
            }
        }
        let every: Vec<&Tie> = self.ties.iter().collect();
        self.descend(&every, best?.0).map(|(motion, _)| motion)
    }

    /// The information of the factors about small motions of the body about its center.
    pub fn information(&self) -> MotionInformation {
        let mut sum = MotionInformation::none(self.planar);
        let unmoved = self.unmoved();
        for tie in &self.ties {
            // A factor that cannot be evaluated informs nothing.
            if let Some(rows) = self.linearize(tie, &unmoved, &mut LinearizedFactor::default()) {
                sum.add(&rows.jacobian, &rows.size);
            }
        }
        sum
    }

    fn descend(&self, ties: &[&Tie], start: Geometry) -> Option<(Geometry, Quadratic)> {
        let least = scales(self.planar).map(|scale| 1.0 / (scale * scale));
        minimize(
            start,
            least.as_slice(),
            |motion| self.at(ties, motion),
            |motion, step| self.stepped(motion, step),
        )
    }

    fn at(&self, ties: &[&Tie], motion: &Geometry) -> Quadratic {
        let mut sum = Quadratic::zeros(self.dim());
        let mut linearized = LinearizedFactor::default();
        for tie in ties {
            match self.linearize(tie, motion, &mut linearized) {
                Some(rows) => sum.add(&rows.jacobian, &linearized),
                None => sum.spoil(),
            }
        }
        sum
    }

    /// A factor after `motion`, by small motions about the center as it is then; `None` when it cannot be
    /// evaluated.
    fn linearize(
        &self,
        tie: &Tie,
        motion: &Geometry,
        linearized: &mut LinearizedFactor,
    ) -> Option<Rows> {
        let places: SmallVec<[Geometry; 2]> = tie
            .ends
            .iter()
            .map(|(at, moves)| at.moved(motion).filter(|_| *moves).unwrap_or(*at))
            .collect();
        let values: SmallVec<[Value; 2]> = places.iter().map(Geometry::value).collect();
        let values: SmallVec<[ValueRef<'_>; 2]> = values.iter().map(Value::as_ref).collect();
        linearized.set(&*tie.factor, &values).ok()?;
        let center = self.center_at(motion);
        let mut jacobian = DMatrix::zeros(tie.factor.residual_dim(), self.dim());
        let mut size = DVector::zeros(self.dim());
        for (position, (place, (_, moves))) in places.iter().zip(&tie.ends).enumerate() {
            if *moves {
                let by_value = linearized.jacobian(position);
                let by_motion = by_value * place.by_world_motion(&center);
                let lengths = if self.planar { 2 } else { 3 };
                let moved = by_value.columns(0, lengths).norm();
                let turned = by_value.columns(lengths, by_value.ncols() - lengths).norm();
                // The lever arm of a turn is a difference of positions.
                let far = place.position().norm() + center.norm();
                size.rows_mut(0, lengths).add_scalar_mut(moved);
                size.rows_mut(lengths, self.dim() - lengths).add_scalar_mut(turned + far * moved);
                jacobian += by_motion;
            }
        }
        Some(Rows { jacobian, size })
    }

    fn center_at(&self, motion: &Geometry) -> Vector3<f64> {
        match motion {
            Geometry::Pose2(t) => {
                let at = t.transform_point(&Point2::new(self.center.x, self.center.y));
                Vector3::new(at.x(), at.y(), 0.0)
            }
            Geometry::Pose3(t) => t.transform_point(&self.center.into()).vector(),
            Geometry::Point2(_) | Geometry::Point3(_) => self.center,
        }
    }

    /// `motion`, then a turn about the center as it is then, then a translation; apart, so that a
    /// long way down does not become one aside.
    fn stepped(&self, motion: &Geometry, d: &DVector<f64>) -> Option<Geometry> {
        let p = self.center_at(motion);
        match motion {
            Geometry::Pose2(t) => {
                let out = Pose2::new(p.x + d[0], p.y + d[1], d[2]);
                Some(Geometry::Pose2(out * Pose2::new(-p.x, -p.y, 0.0) * *t))
            }
            Geometry::Pose3(t) => {
                let turn = Rot3::exp(&Vector3::new(d[3], d[4], d[5]));
                let out = Pose3::new(turn, Point3::from(p + Vector3::new(d[0], d[1], d[2])));
                let back = Pose3::new(LieGroup::identity(), Point3::from(-p));
                Some(Geometry::Pose3(out * back * *t))
            }
            Geometry::Point2(_) | Geometry::Point3(_) => None,
        }
    }

    /// The motion that turns by `yaw` about the center.
    fn turned(&self, yaw: f64) -> Geometry {
        let c = self.center;
        if self.planar {
            let back = Pose2::new(-c.x, -c.y, 0.0);
            Geometry::Pose2(Pose2::new(c.x, c.y, yaw) * back)
        } else {
            let rotation = Rot3::from_roll_pitch_yaw(0.0, 0.0, yaw);
            let back = Pose3::new(LieGroup::identity(), Point3::from(-c));
            Geometry::Pose3(Pose3::new(rotation, Point3::from(c)) * back)
        }
    }
}

/// Of a long list an even sample.
pub(crate) fn sample<T>(all: &[T], at_most: usize) -> Vec<&T> {
    let count = all.len().min(at_most);
    (0..count).map(|k| &all[k * all.len() / count]).collect()
}
