//! Gauge: the rigid motions of a part of a map that its measurements leave free.

use evergraph_factors::{FactorError, Linear, RootShift};
use evergraph_model::VariableId;
use nalgebra::{DMatrix, DVector};

use crate::geometry::Geometry;

/// Standard deviations (m, rad) within which a start value is good enough to linearize at.
const COARSE: (f64, f64) = (1e3, 0.5);

/// A direction is free when its row of the square root is below this share of the others: what the
/// solver's QR calls rank-deficient (1e-22 of the information), with some room.
const RANK: f64 = 1e-10;

/// Units in the last place by which a sum of whitened rows may be off.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Information about small motions of a rigid body, `(x, y, theta)` or `(x, y, z, rx, ry, rz)` in m and
/// rad, as a square root: rows `J` of whitened Jacobians, of which `JᵀJ` is the information.
///
/// Information is kept as rows since a square halves the digits: a heading known to 1 rad beside
/// positions known to 1 µm, a kilometre away, is lost in `JᵀJ`.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionInformation {
    /// Upper triangular.
    root: DMatrix<f64>,
    /// By direction, the squared size of what rounding leaves where the rows cancel.
    rounding: DVector<f64>,
}

impl MotionInformation {
    /// No information: 3 directions in the plane, 6 in space.
    pub fn none(planar: bool) -> Self {
        let dim = if planar { 3 } else { 6 };
        Self { root: DMatrix::zeros(dim, dim), rounding: DVector::zeros(dim) }
    }

    /// Adds whitened rows; `size` is the size of the numbers that they are differences of, by column.
    pub(crate) fn add(&mut self, rows: &DMatrix<f64>, size: &DVector<f64>) {
        self.stack(rows);
        self.rounding += size.map(|size| (ROUNDING * size).powi(2));
    }

    /// Adds the information of another body about motions about the same center. Nothing changes when
    /// one is of the plane and the other in space.
    pub fn merge(&mut self, other: &Self) {
        if self.root.ncols() == other.root.ncols() {
            self.stack(&other.root);
            self.rounding += &other.rounding;
        }
    }

    /// `JᵀJ`: 3 × 3 or 6 × 6.
    pub fn matrix(&self) -> DMatrix<f64> {
        self.root.tr_mul(&self.root)
    }

    fn stack(&mut self, rows: &DMatrix<f64>) {
        let (dim, count) = (self.root.ncols(), rows.nrows());
        let mut stacked = DMatrix::zeros(dim + count, dim);
        stacked.rows_mut(0, dim).copy_from(&self.root);
        stacked.rows_mut(dim, count).copy_from(rows);
        self.root = stacked.qr().unpack_r();
    }
}

/// The directions in which a [`Body`](crate::Body) can be moved, from the least held to the best.
///
/// A direction is *free* when no factor informs it: by rank, to rounding, whatever the units and the
/// weights. GPS at one pose holds two directions of the plane; at two poses, or with a compass, it
/// holds all three.
#[derive(Clone, Debug, PartialEq)]
pub struct Gauge {
    directions: DMatrix<f64>,
    free: usize,
    coarse: usize,
}

impl Gauge {
    /// The directions of information about small motions, as
    /// [`Body::information`](crate::Body::information) gives.
    pub fn of(information: &MotionInformation) -> Self {
        let root = &information.root;
        let dim = root.ncols();
        // Numbers beyond all measurements inform nothing.
        if !root.iter().all(|x| x.is_finite() && x.abs() < 1e150) {
            return Self { directions: DMatrix::identity(dim, dim), free: dim, coarse: dim };
        }
        let rounding = information.rounding.map(f64::sqrt);
        let norms = DVector::from_iterator(dim, root.column_iter().map(|column| column.norm()));
        // Columns of one length: a direction is compared with others in the same unit.
        let unit = |k: usize| if norms[k] > rounding[k] { 1.0 / norms[k] } else { 0.0 };
        let units = DVector::from_fn(dim, |k, _| unit(k));
        let scaled = root * DMatrix::from_diagonal(&units);
        let eigen = scaled.svd(false, true);
        let rows = eigen.v_t.unwrap_or_else(|| DMatrix::identity(dim, dim));
        let values = eigen.singular_values;
        let noise = units.component_mul(&rounding);
        let mut order: Vec<usize> = (0..dim).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let is_free = |k: usize| {
            let noise: f64 = rows.row(k).iter().zip(&noise).map(|(v, n)| v.abs() * n).sum();
            // A column of nothing but rounding has no length: its direction has none either.
            values[k] <= RANK.max(noise)
        };
        let free = order.iter().filter(|&&k| is_free(k)).count();
        let scales = DVector::from_fn(dim, |k, _| match units[k] {
            0.0 => 1.0,
            unit => unit,
        });
        let columns: Vec<DVector<f64>> =
            order.iter().map(|&k| rows.row(k).transpose().component_mul(&scales)).collect();
        let coarse = free.max(coarsely_free(information));
        Self { directions: DMatrix::from_columns(&columns), free, coarse }
    }

    /// How many directions are free: 0 to 3 in the plane, 0 to 6 in space.
    pub fn free(&self) -> usize {
        self.free
    }

    /// Whether no direction is free.
    pub fn is_fixed(&self) -> bool {
        self.free == 0
    }

    /// The number of directions that are free, or known to no better than 1000 m or 0.5 rad: start values cannot
    /// be trusted along these yet.
    pub fn coarsely_free(&self) -> usize {
        self.coarse
    }

    /// The directions as small motions of the world, one a column; the first [`free`](Self::free) of
    /// them are free. 3 × 3 or 6 × 6; their lengths mean nothing.
    pub fn directions(&self) -> &DMatrix<f64> {
        &self.directions
    }

    /// The directions in the tangent of a pose of the body that stands at the body's center; `None` for
    /// a pose in space where the body is of the plane, or the other way round.
    pub fn in_tangent_of(&self, pose: &Geometry) -> Option<DMatrix<f64>> {
        let by_motion = pose.by_world_motion(&pose.position());
        (by_motion.ncols() == self.directions.nrows()).then(|| by_motion * &self.directions)
    }

    /// A prior on a pose at the body's center that holds exactly what is free, with one standard
    /// deviation (m and rad) for each direction; `None` when nothing is free.
    ///
    /// # Errors
    /// [`FactorError`] for a standard deviation that is zero or not finite, and for a pose in space where
    /// the body is of the plane or the other way round.
    pub fn prior(
        &self,
        variable: VariableId,
        pose: &Geometry,
        sigma: f64,
    ) -> Result<Option<Linear>, FactorError> {
        if self.is_fixed() {
            return Ok(None);
        }
        let all = self.in_tangent_of(pose).unwrap_or_else(|| self.directions.clone());
        hold(&all.columns(0, self.free).into_owned(), variable, pose, sigma).map(Some)
    }
}

/// A prior on the directions of a pose's tangent that the columns of `free` span.
///
/// # Errors
/// [`FactorError`] for a standard deviation (m and rad) that is zero or not finite, and for columns that
/// are not as long as the tangent.
pub fn hold(
    free: &DMatrix<f64>,
    variable: VariableId,
    pose: &Geometry,
    sigma: f64,
) -> Result<Linear, FactorError> {
    let basis = free.clone().qr().q();
    let (rows, zero) = (basis.transpose() / sigma, DVector::zeros(basis.nrows()));
    Linear::new(&[(variable, pose.value())], RootShift::None, rows, zero)
}

/// The number of directions that are not even known to [`COARSE`].
fn coarsely_free(information: &MotionInformation) -> usize {
    let scale = DMatrix::from_diagonal(&scales(information.root.ncols() == 3));
    let values = (&information.root * scale).singular_values();
    values.iter().filter(|&&value| value < 1.0).count()
}

/// [`COARSE`] for each direction.
pub(crate) fn scales(planar: bool) -> DVector<f64> {
    let ((length, angle), lengths, dim) =
        (COARSE, if planar { 2 } else { 3 }, if planar { 3 } else { 6 });
    DVector::from_fn(dim, |i, _| if i < lengths { length } else { angle })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use evergraph_factors::{Depth, GpsPosition2, Heading2, Prior};
    use evergraph_model::{Graph, Key, LieGroup, Noise, Point2, Point3, Pose2, Pose3, Rot3};
    use nalgebra::Vector3;

    use super::*;
    use crate::rigid::{Body, End};

    fn pose(change: &mut evergraph_model::Change, at: &Pose2) -> Key<Pose2> {
        change.add_variable(at)
    }

    /// Poses of the plane with a position of each, of `sigma`, and a heading of the first of `heading`.
    fn plane(poses: &[Pose2], sigma: f64, heading: Option<f64>) -> Body {
        let mut change = Graph::new().change();
        let mut body = Body::new(&Geometry::Pose2(poses[0]));
        for at in poses {
            let key = pose(&mut change, at);
            let noise = Noise::isotropic(2, sigma).unwrap();
            let gps = GpsPosition2::new(key, Point2::new(at.x(), at.y()), noise).unwrap();
            assert!(body.tie(Arc::new(gps), |_| Some(End::Moving(Geometry::Pose2(*at)))));
        }
        if let Some(sigma) = heading {
            let key = pose(&mut change, &poses[0]);
            let compass = Heading2::new(key, 0.1, Noise::isotropic(1, sigma).unwrap()).unwrap();
            body.tie(Arc::new(compass), |_| Some(End::Moving(Geometry::Pose2(poses[0]))));
        }
        body
    }

    #[test]
    fn rank_does_not_depend_on_weights_units_or_places() {
        for far in [0.0, 1e3, 5e6] {
            for sigma in [1e-4, 1.0, 1e4] {
                let first = Pose2::new(far, -far, 0.3);
                let second = Pose2::new(far + 3.0, 4.0 - far, 1.0);
                assert_eq!(plane(&[first], sigma, None).gauge().free(), 1, "{far} {sigma}");
                // A robot that stands still does not show where it looks.
                assert_eq!(plane(&[first; 9], sigma, None).gauge().free(), 1, "{far} {sigma}");
                assert_eq!(plane(&[first, second], sigma, None).gauge().free(), 0, "{far} {sigma}");
                for heading in [1e-3, 3.0, 30.0] {
                    let held = plane(&[first], sigma, Some(heading)).gauge();
                    assert_eq!(held.free(), 0, "{far} {sigma} {heading}");
                }
            }
        }
    }

    #[test]
    fn weakly_known_directions_are_coarse_and_not_free() {
        let poses = [Pose2::identity(), Pose2::new(1e-3, 0.0, 0.0)];
        let gauge = plane(&poses, 1.0, None).gauge();
        assert_eq!((gauge.free(), gauge.coarsely_free()), (0, 1));
        let gauge = plane(&poses[..1], 1.0, Some(0.6)).gauge();
        assert_eq!((gauge.free(), gauge.coarsely_free()), (0, 1));
        assert_eq!(plane(&poses[..1], 1.0, Some(0.1)).gauge().coarsely_free(), 0);
    }

    /// Positions far from the body's center and close to each other hold its heading, if barely.
    #[test]
    fn a_direction_that_others_nearly_hide_is_not_free() {
        let center = Pose2::identity();
        let mut change = Graph::new().change();
        let mut body = Body::new(&Geometry::Pose2(center));
        for x in [100.0, 100.0 + 1e-4] {
            let at = Pose2::new(x, 0.0, 0.0);
            let key = pose(&mut change, &at);
            let noise = Noise::isotropic(2, 0.01).unwrap();
            let gps = GpsPosition2::new(key, Point2::new(x, 0.0), noise).unwrap();
            body.tie(Arc::new(gps), |_| Some(End::Moving(Geometry::Pose2(at))));
        }
        assert_eq!(body.gauge().free(), 0);
    }

    /// Depths hold height and tilt. The parts of their rows along x and y cancel to rounding only.
    #[test]
    fn rounding_of_rotations_informs_nothing() {
        for k in 0..40 {
            let k = f64::from(k);
            let turn = Rot3::exp(&Vector3::new(0.3 * k, 1.1 - 0.2 * k, 0.7 * k));
            let base = Pose3::new(turn, Point3::new(1e4 * k, 3.0, -7.0 * k));
            let arms = [[0.0; 3], [2.0, 0.3, 0.1], [-0.4, 1.7, 0.9], [1.0, 1.0, -1.0]];
            let mut change = Graph::new().change();
            let mut body = Body::new(&Geometry::Pose3(base));
            for [x, y, z] in arms {
                let at = base.compose(&Pose3::new(turn, Point3::new(x, y, z)));
                let key = change.add_variable(&at);
                let depth = Depth::new(key, at.z(), Noise::isotropic(1, 0.1).unwrap()).unwrap();
                body.tie(Arc::new(depth), |_| Some(End::Moving(Geometry::Pose3(at))));
            }
            assert_eq!(body.gauge().free(), 3, "{k}");
        }
    }

    #[test]
    fn information_adds_up() {
        let at = Pose2::new(3.0, 4.0, 0.5);
        let mut change = Graph::new().change();
        let key = pose(&mut change, &at);
        let noise = Noise::from_sigmas(&[0.5, 0.25, 0.1]).unwrap();
        let prior = Arc::new(Prior::new(key, at, noise).unwrap());
        let body = |count: usize| {
            let mut body = Body::new(&Geometry::Pose2(at));
            for _ in 0..count {
                body.tie(prior.clone(), |_| Some(End::Moving(Geometry::Pose2(at))));
            }
            body.information()
        };
        let mut sum = body(1);
        sum.merge(&body(2));
        assert!((sum.matrix() - body(3).matrix()).norm() < 1e-9 * sum.matrix().norm());
        assert!((sum.matrix()[(2, 2)] - 300.0).abs() < 1e-9);
        let before = sum.clone();
        sum.merge(&MotionInformation::none(false));
        assert_eq!(sum, before);
        assert_eq!(Gauge::of(&MotionInformation::none(false)).free(), 6);
    }
}
