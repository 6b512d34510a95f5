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

    /// How many directions are free, or known to no better than 1000 m or 0.5 rad: start values cannot be
    /// trusted along these yet.
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

/// How many directions are not even known to [`COARSE`].
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
