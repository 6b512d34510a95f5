//! Where a body stands in the world: poses and landmarks that their odometry holds together, moved
//! as one.

use std::sync::Arc;

use evergraph_model::{Factor, LieGroup, Point2, Point3, Pose2, Pose3, Rot3, Value};
use nalgebra::{DMatrix, DVector, Vector3};
use smallvec::SmallVec;

use super::evaluate::{Linearized, Quadratic, minimize};
use super::geometry::Geometry;

/// A direction counts as held when its standard deviation is below this, in metres or in radians:
/// far coarser than any measurement, far finer than what rounding leaves of a free direction.
const COARSE: (f64, f64) = (1e3, 0.5);

/// What the sum of a hundred thousand measurements, and its eigenvalues, may be off by, as a share
/// of the largest.
const ROUNDING: f64 = 1e-13;

/// A factor on a body.
pub(super) struct Tie {
    pub factor: Arc<dyn Factor>,
    /// Its variables, and which of them move with the body; the others stand still.
    pub ends: SmallVec<[(Geometry, bool); 2]>,
}

/// What measurements say of the place of a body; small motions turn about `center`.
pub(super) struct Body<'a> {
    pub ties: &'a [Tie],
    pub center: Vector3<f64>,
    pub planar: bool,
}

impl Body<'_> {
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

    /// The motion by which the measurements fit best: Levenberg-Marquardt from eight headings.
    /// `None` when nothing is measured.
    pub fn fit(&self) -> Option<Geometry> {
        const HEADINGS: u32 = 8;
        /// Ties to choose a start with.
        const SAMPLE: usize = 400;
        if self.ties.is_empty() {
            return None;
        }
        let sample = sample(self.ties, SAMPLE);
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

    /// What its ties say of motions of the whole body.
    pub fn quadratic(&self) -> Quadratic {
        let every: Vec<&Tie> = self.ties.iter().collect();
        self.at(&every, &self.unmoved())
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
        let mut linearized = Linearized::default();
        let center = self.center_at(motion);
        for tie in ties {
            let places: SmallVec<[Geometry; 2]> = tie
                .ends
                .iter()
                .map(|(at, moves)| at.moved(motion).filter(|_| *moves).unwrap_or(*at))
                .collect();
            let values: SmallVec<[Value; 2]> = places.iter().map(Geometry::value).collect();
            let values: SmallVec<[&Value; 2]> = values.iter().collect();
            linearized.set(&tie.factor, &values);
            let mut jacobian = DMatrix::zeros(tie.factor.residual_dim(), self.dim());
            for (position, (place, (_, moves))) in places.iter().zip(&tie.ends).enumerate() {
                if *moves {
                    jacobian += linearized.block(position) * place.by_world_motion(&center);
                }
            }
            sum.add(&jacobian, &linearized);
        }
        sum
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
pub(super) fn sample<T>(all: &[T], at_most: usize) -> Vec<&T> {
    let count = all.len().min(at_most);
    (0..count).map(|k| &all[k * all.len() / count]).collect()
}

fn scales(planar: bool) -> DVector<f64> {
    let ((length, angle), lengths, dim) =
        (COARSE, if planar { 2 } else { 3 }, if planar { 3 } else { 6 });
    DVector::from_fn(dim, |i, _| if i < lengths { length } else { angle })
}

/// The directions in which a body can be moved, from the least held to the best: columns, and how
/// many of them are free.
pub(super) fn directions(information: &DMatrix<f64>) -> (DMatrix<f64>, usize) {
    let scale = DMatrix::from_diagonal(&scales(information.nrows() == 3));
    let scaled = &scale * information * &scale;
    // Beyond all numbers is no measurement: nothing is held then.
    if !scaled.iter().all(|x| x.is_finite() && x.abs() < 1e150) {
        return (scale, information.nrows());
    }
    let eigen = scaled.symmetric_eigen();
    // In a sum of many measurements a free direction is zero only as far as the others round.
    let held = f64::max(1.0, ROUNDING * eigen.eigenvalues.amax());
    let mut order: Vec<usize> = (0..information.nrows()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let free = order.iter().filter(|&&k| eigen.eigenvalues[k] < held).count();
    let columns: Vec<DVector<f64>> =
        order.iter().map(|&k| &scale * eigen.eigenvectors.column(k)).collect();
    (DMatrix::from_columns(&columns), free)
}
