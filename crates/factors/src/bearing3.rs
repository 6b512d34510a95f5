//! Bearings in space, alone and with a range.

use std::marker::PhantomData;

use evergraph_model::{Arguments, Factor, Key, Linearization, Noise, Pose3, VariableId};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, SMatrix, Vector2, Vector3};

use crate::cross::times_skew;
use crate::error::{FactorError, distance, fixed, fixed_shape};
use crate::positioned::{Positioned, polar};
use crate::sphere::{Sphere, unit};

/// The direction of something in space: the logarithm on the sphere of the direction to the target
/// at the measured one, radians.
///
/// `q = Cᵀ (p - t)` is the target's position `p` in the frame of the pose with rotation `C` and
/// translation `t`, `ρ = |q|`, `u = q/ρ`, `m` the measured unit vector in the same frame. Residual
/// `r = R e` with `e` and the basis `B` (3×2, [`basis`](Self::basis)) of
/// [`Attitude`](crate::Attitude): the length of `e` is the angle between `u` and `m`.
///
/// ```text
/// J_q = R (∂e/∂u) (I - uuᵀ)/ρ       J_pose = J_q [-I [q]×]       J_target = J_q Cᵀ ∂p/∂ξ
/// ```
///
/// The Jacobian grows without bound towards the target. A pose on its target sees it nowhere: the
/// direction is taken as the pose's x axis there, and the Jacobian as zero. It is zero too where
/// the target is opposite to the measurement; `e` is then half a turn along the first vector of the
/// basis.
#[derive(Clone, Debug)]
pub struct Bearing3<B> {
    keys: [VariableId; 2],
    measurement: Sphere,
    noise: Noise,
    sqrt_information: Matrix2<f64>,
    kind: PhantomData<fn() -> B>,
}

/// Direction and range of something in space: the two rows of [`Bearing3`], radians, then
/// `|q| - z_r`, metres.
///
/// One factor, so that their noise may be correlated.
#[derive(Clone, Debug)]
pub struct BearingRange3<B> {
    keys: [VariableId; 2],
    direction: Sphere,
    range: f64,
    noise: Noise,
    sqrt_information: Matrix3<f64>,
    kind: PhantomData<fn() -> B>,
}

impl<B: Positioned<3>> Bearing3<B> {
    /// `direction` points to `target` in the frame of `pose` and need not be normalized. The noise
    /// has two dimensions, in the [`basis`](Self::basis): for anything but isotropic noise look
    /// there first.
    ///
    /// # Errors
    /// [`FactorError::NoDirection`], [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        pose: Key<Pose3>,
        target: Key<B>,
        direction: Vector3<f64>,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        Self::of_unit(pose, target, unit("Bearing3", "direction", direction)?, noise)
    }

    /// [`new`](Self::new) for a direction of length one.
    pub(crate) fn of_unit(
        pose: Key<Pose3>,
        target: Key<B>,
        direction: Vector3<f64>,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        let measurement = Sphere::at_unit(direction);
        let sqrt_information = fixed("Bearing3", &noise)?;
        let keys = [pose.id(), target.id()];
        Ok(Self { keys, measurement, noise, sqrt_information, kind: PhantomData })
    }
}

impl<B: Positioned<3>> BearingRange3<B> {
    /// `direction` points to `target` in the frame of `pose` and need not be normalized, `range` is
    /// its distance, metres. The noise has three dimensions: two in the [`basis`](Self::basis), and
    /// the range.
    ///
    /// # Errors
    /// [`FactorError::NoDirection`], [`FactorError::NegativeRange`],
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        pose: Key<Pose3>,
        target: Key<B>,
        direction: Vector3<f64>,
        range: f64,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        let direction = unit("BearingRange3", "direction", direction)?;
        Self::of_unit(pose, target, direction, range, noise)
    }

    /// [`new`](Self::new) for a direction of length one.
    pub(crate) fn of_unit(
        pose: Key<Pose3>,
        target: Key<B>,
        direction: Vector3<f64>,
        range: f64,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        let direction = Sphere::at_unit(direction);
        let range = distance("BearingRange3", range)?;
        let sqrt_information = fixed("BearingRange3", &noise)?;
        let keys = [pose.id(), target.id()];
        Ok(Self { keys, direction, range, noise, sqrt_information, kind: PhantomData })
    }

    #[inline]
    fn error(&self, sight: &Sight, bearing: Vector2<f64>) -> Vector3<f64> {
        bearing.push(sight.range - self.range)
    }
}

impl<B> Bearing3<B> {
    /// The pose that sees.
    pub fn pose(&self) -> VariableId {
        self.keys[0]
    }

    /// What is seen.
    pub fn target(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured direction in the pose's frame, of length one.
    pub fn measurement(&self) -> &Vector3<f64> {
        self.measurement.direction()
    }

    /// The basis of the residual, as [`Attitude::basis`](crate::Attitude::basis).
    pub fn basis(&self) -> &Matrix3x2<f64> {
        self.measurement.basis()
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<B> BearingRange3<B> {
    /// The pose that sees.
    pub fn pose(&self) -> VariableId {
        self.keys[0]
    }

    /// What is seen.
    pub fn target(&self) -> VariableId {
        self.keys[1]
    }

    /// The measured direction in the pose's frame, of length one.
    pub fn direction(&self) -> &Vector3<f64> {
        self.direction.direction()
    }

    /// The measured distance, in metres.
    pub fn range(&self) -> f64 {
        self.range
    }

    /// The basis of the first two rows, as [`Attitude::basis`](crate::Attitude::basis).
    pub fn basis(&self) -> &Matrix3x2<f64> {
        self.direction.basis()
    }

    /// The noise of direction and range.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl<B: Positioned<3>> Factor for Bearing3<B> {
    fixed_shape!(format!("Bearing3<{}>", B::NAME), 2, [Pose3, B]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let sight = Sight::new(&at.get(0), &at.get::<B>(1));
        let (error, _) = self.measurement.log(&sight.direction());
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (pose, target): (Pose3, B) = (at.get(0), at.get(1));
        let sight = Sight::new(&pose, &target);
        let (error, by_direction) = self.measurement.log(&sight.direction());
        if let Some((direction_by_place, _)) = sight.derivatives() {
            let by_place = self.sqrt_information * by_direction * direction_by_place;
            sight.set_blocks(&pose, &target, &by_place, out);
        }
        out.set_residual(&(self.sqrt_information * error));
    }
}

impl<B: Positioned<3>> Factor for BearingRange3<B> {
    fixed_shape!(format!("BearingRange3<{}>", B::NAME), 3, [Pose3, B]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let sight = Sight::new(&at.get(0), &at.get::<B>(1));
        let (bearing, _) = self.direction.log(&sight.direction());
        let error = self.error(&sight, bearing);
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (pose, target): (Pose3, B) = (at.get(0), at.get(1));
        let sight = Sight::new(&pose, &target);
        let (bearing, by_direction) = self.direction.log(&sight.direction());
        if let Some((direction_by_place, range_by_place)) = sight.derivatives() {
            let by_place = by_direction * direction_by_place;
            let by_place = Matrix3::from_rows(&[
                by_place.row(0).into_owned(),
                by_place.row(1).into_owned(),
                range_by_place,
            ]);
            sight.set_blocks(&pose, &target, &(self.sqrt_information * by_place), out);
        }
        out.set_residual(&(self.sqrt_information * self.error(&sight, bearing)));
    }
}

/// A target as a pose sees it.
struct Sight {
    /// `q`.
    place: Vector3<f64>,
    range: f64,
    /// `u`, where there is one.
    direction: Option<Vector3<f64>>,
}

impl Sight {
    #[inline]
    fn new<B: Positioned<3>>(pose: &Pose3, target: &B) -> Self {
        let place = pose.rotation().inverse_rotate(&(target.position() - pose.position()));
        let (range, direction) = polar(&place);
        Self { place, range, direction }
    }

    #[inline]
    fn direction(&self) -> Vector3<f64> {
        self.direction.unwrap_or_else(Vector3::x)
    }

    /// Of direction and range by `q`.
    #[inline]
    fn derivatives(&self) -> Option<(Matrix3<f64>, nalgebra::RowVector3<f64>)> {
        let u = self.direction?;
        let along = u.transpose();
        Some(((Matrix3::identity() - u * along) / self.range, along))
    }

    /// Both blocks, from the whitened derivative by `q`.
    #[inline]
    fn set_blocks<B: Positioned<3>, const R: usize>(
        &self,
        pose: &Pose3,
        target: &B,
        by_place: &SMatrix<f64, R, 3>,
        out: &mut Linearization<'_>,
    ) {
        let (position, rotation) = out.block_mut(0).split_at_mut(3 * R);
        position.copy_from_slice((-by_place).as_slice());
        rotation.copy_from_slice(times_skew(by_place, &self.place).as_slice());
        target.chain(&(by_place * pose.rotation().matrix().transpose()), out.block_mut(1));
    }
}
