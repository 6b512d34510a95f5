//! Roll and pitch of a pose in space, from a direction or as angles.

use evergraph_model::{
    Arguments, Factor, Key, Linearization, Noise, Pose3, VariableId, geometry::wrap_angle,
};
use nalgebra::{Matrix2, Matrix2x3, Matrix3x2, Vector2, Vector3};

use crate::cross::times_skew;
use crate::error::{FactorError, finite, fixed, fixed_shape};
use crate::sphere::{Sphere, unit};

/// A known direction in the world as the robot sees it: two degrees of freedom of the attitude.
///
/// With `C` the rotation of `world_from_robot`, `g` the direction in the world and `m` the measured
/// one in the robot's frame (unit vectors), the predicted one is `u = Cᵀ g`, and the residual is
/// its logarithm on the sphere at `m`,
///
/// ```text
/// e = α v/|v|,   v = Bᵀ u,   α = atan2(|v|, m·u),      r = R e
/// ```
///
/// in radians: the length of `e` is the angle between `u` and `m`, its components are in the basis
/// `B` (3×2, [`basis`](Self::basis)) of the plane normal to `m`. Jacobian `R (∂e/∂u) [0 [u]×]`.
/// Opposite directions have no logarithm: there `e` is half a turn along the basis's first vector
/// and the Jacobian zero.
///
/// An accelerometer at rest feels the reaction to gravity: give the *up* direction for `g` and its
/// normalized reading for `m`. A magnetometer or a sun sensor works the same way.
#[derive(Clone, Debug)]
pub struct Attitude {
    keys: [VariableId; 1],
    world_direction: Vector3<f64>,
    measurement: Sphere,
    noise: Noise,
    sqrt_information: Matrix2<f64>,
}

impl Attitude {
    /// `measurement` is `world_direction` in the robot's frame; neither needs to be normalized.
    /// The noise has two dimensions, in the [`basis`](Self::basis): for anything but isotropic
    /// noise look there first.
    ///
    /// # Errors
    /// [`FactorError::NoDirection`], [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(
        key: Key<Pose3>,
        world_direction: Vector3<f64>,
        measurement: Vector3<f64>,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        let world_direction = unit("Attitude", "world direction", world_direction)?;
        let measurement = unit("Attitude", "measurement", measurement)?;
        Self::of_units(key, world_direction, measurement, noise)
    }

    /// [`new`](Self::new) for directions of length one.
    pub(crate) fn of_units(
        key: Key<Pose3>,
        world_direction: Vector3<f64>,
        measurement: Vector3<f64>,
        noise: Noise,
    ) -> Result<Self, FactorError> {
        let measurement = Sphere::at_unit(measurement);
        let sqrt_information = fixed("Attitude", &noise)?;
        Ok(Self { keys: [key.id()], world_direction, measurement, noise, sqrt_information })
    }

    /// The pose.
    pub fn key(&self) -> VariableId {
        self.keys[0]
    }

    /// The direction in the world, of length one.
    pub fn world_direction(&self) -> &Vector3<f64> {
        &self.world_direction
    }

    /// The direction in the robot's frame, of length one.
    pub fn measurement(&self) -> &Vector3<f64> {
        self.measurement.direction()
    }

    /// `B`: `m × a` normalized with `a` the coordinate axis (the first of them) along which `m` is
    /// shortest, and `m` times that.
    pub fn basis(&self) -> &Matrix3x2<f64> {
        self.measurement.basis()
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// `u`, the world's direction in the robot's frame.
    fn predicted(&self, at: &Arguments<'_>) -> Vector3<f64> {
        at.get::<Pose3>(0).rotation().inverse_rotate(&self.world_direction)
    }
}

impl Factor for Attitude {
    fixed_shape!("Attitude", 2, [Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let (error, _) = self.measurement.log(&self.predicted(at));
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let u = self.predicted(at);
        let (error, by_direction) = self.measurement.log(&u);
        let by_rotation = times_skew(&(self.sqrt_information * by_direction), &u);
        out.block_mut(0)[6..].copy_from_slice(by_rotation.as_slice());
        out.set_residual(&(self.sqrt_information * error));
    }
}

/// Roll and pitch in the convention `C = Rz(yaw) Ry(pitch) Rx(roll)` (ZYX):
/// `r = R (wrap(roll(C) - roll), pitch(C) - pitch)`, radians.
///
/// `C` is the rotation of `world_from_robot`. For devices that report these angles; it is singular
/// at a pitch of ±π/2, where the Jacobian grows without bound and is taken as zero.
/// [`Attitude`] has no such place and is to be preferred where the direction itself is known.
/// With `u` the third row of `C` and `h² = u_y² + u_z²`:
///
/// ```text
/// roll = atan2(u_y, u_z)     pitch = atan2(-u_x, h)
/// J = R [0 (0, u_z, -u_y)/h² [u]×; 0 (-1, 0, 0)/h [u]×]
/// ```
#[derive(Clone, Debug)]
pub struct RollPitch {
    keys: [VariableId; 1],
    roll: f64,
    pitch: f64,
    noise: Noise,
    sqrt_information: Matrix2<f64>,
}

impl RollPitch {
    /// `roll` and `pitch` in radians; the noise has two dimensions in that order.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(key: Key<Pose3>, roll: f64, pitch: f64, noise: Noise) -> Result<Self, FactorError> {
        finite("RollPitch", "measurement", &[roll, pitch])?;
        let sqrt_information = fixed("RollPitch", &noise)?;
        Ok(Self { keys: [key.id()], roll, pitch, noise, sqrt_information })
    }

    /// The pose.
    pub fn key(&self) -> VariableId {
        self.keys[0]
    }

    /// The measured roll, in radians.
    pub fn roll(&self) -> f64 {
        self.roll
    }

    /// The measured pitch, in radians.
    pub fn pitch(&self) -> f64 {
        self.pitch
    }

    /// The noise.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl Factor for RollPitch {
    fixed_shape!("RollPitch", 2, [Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let u = at.get::<Pose3>(0).rotation().inverse_rotate(&Vector3::z());
        let roll = wrap_angle(u.y.atan2(u.z) - self.roll);
        let pitch = (-u.x).atan2(u.y.hypot(u.z)) - self.pitch;
        out.copy_from_slice((self.sqrt_information * Vector2::new(roll, pitch)).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let u = at.get::<Pose3>(0).rotation().inverse_rotate(&Vector3::z());
        let h2 = u.y * u.y + u.z * u.z;
        if h2.is_normal() {
            let by_direction = Matrix2x3::new(0.0, u.z / h2, -u.y / h2, -1.0 / h2.sqrt(), 0.0, 0.0);
            let by_rotation = times_skew(&(self.sqrt_information * by_direction), &u);
            out.block_mut(0)[6..].copy_from_slice(by_rotation.as_slice());
        }
        self.residual(at, out.residual_mut());
    }
}
