//! Gauge: the rigid motions of a part of a map that its measurements leave free.

use evergraph_factors::{FactorError, Linear, RootShift};
use evergraph_model::VariableId;
use nalgebra::{DMatrix, DVector};

use crate::geometry::Geometry;

/// A direction counts as held when its standard deviation is below this, in metres or in radians:
/// far coarser than any measurement, far finer than what rounding leaves of a free direction.
const COARSE: (f64, f64) = (1e3, 0.5);

/// What the sum of a hundred thousand measurements, and its eigenvalues, may be off by, as a share
/// of the largest.
const ROUNDING: f64 = 1e-13;

/// The directions in which a [`Body`](crate::Body) can be moved, from the least held to the best.
///
/// A direction counts as held when it is known to 1000 m or 0.5 rad: far coarser than any measurement,
/// far finer than what rounding leaves of a free direction. GPS at one pose holds two directions of the
/// plane; at two poses, or with a compass, it holds all three.
#[derive(Clone, Debug, PartialEq)]
pub struct Gauge {
    directions: DMatrix<f64>,
    free: usize,
}

impl Gauge {
    /// The directions of information about small motions, `(x, y, theta)` or `(x, y, z, rx, ry, rz)`:
    /// a symmetric matrix, 3 × 3 or 6 × 6, such as [`Body::information`](crate::Body::information) gives.
    /// Information of several bodies about the same center adds up. `None` for a matrix of another size.
    pub fn of(information: &DMatrix<f64>) -> Option<Self> {
        matches!(information.shape(), (3, 3) | (6, 6)).then(|| Self::of_motion(information))
    }

    pub(crate) fn of_motion(information: &DMatrix<f64>) -> Self {
        let scale = DMatrix::from_diagonal(&scales(information.nrows() == 3));
        let scaled = &scale * information * &scale;
        // Beyond all numbers is no measurement: nothing is held then.
        if !scaled.iter().all(|x| x.is_finite() && x.abs() < 1e150) {
            return Self { free: information.nrows(), directions: scale };
        }
        let eigen = scaled.symmetric_eigen();
        // In a sum of many measurements a free direction is zero only as far as the others round.
        let held = f64::max(1.0, ROUNDING * eigen.eigenvalues.amax());
        let mut order: Vec<usize> = (0..information.nrows()).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let free = order.iter().filter(|&&k| eigen.eigenvalues[k] < held).count();
        let columns: Vec<DVector<f64>> =
            order.iter().map(|&k| &scale * eigen.eigenvectors.column(k)).collect();
        Self { directions: DMatrix::from_columns(&columns), free }
    }

    /// How many directions are free: 0 to 3 in the plane, 0 to 6 in space.
    pub fn free(&self) -> usize {
        self.free
    }

    /// Whether no direction is free.
    pub fn is_fixed(&self) -> bool {
        self.free == 0
    }

    /// The directions as small motions of the world, one a column; the first [`free`](Self::free) of
    /// them are free. 3 × 3 or 6 × 6, scaled to the coarsest standard deviations that count as held.
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

/// The coarsest standard deviations that count as held.
pub(crate) fn scales(planar: bool) -> DVector<f64> {
    let ((length, angle), lengths, dim) =
        (COARSE, if planar { 2 } else { 3 }, if planar { 3 } else { 6 });
    DVector::from_fn(dim, |i, _| if i < lengths { length } else { angle })
}
