//! A robot that moves on a floor.

use evergraph_model::{Arguments, Factor, Key, Linearization, Noise, Pose3, VariableId};
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

use crate::cross::times_skew;
use crate::error::{FactorError, finite, fixed, fixed_shape};
use crate::partial_prior::height_jacobian;
use crate::sphere::Sphere;

/// A pose in space that moves in a plane parallel to the world's xy plane:
/// `r = R (t_z - h, e)`, metres and radians.
///
/// `t` and `C` are the translation and rotation of `world_from_robot`, `h` the height of the plane
/// and `e` the logarithm on the sphere of the world's up direction as the robot sees it, `u = Cᵀ z`,
/// at `m = (0, 0, 1)`: the tilt as in [`Attitude`](crate::Attitude), whose basis there is
/// `(y, -x)`. For small tilts `e` is (roll, pitch); its length is the angle between the robot's z
/// axis and the vertical. Jacobian `R [c 0 0 0; 0 (∂e/∂u) [u]×]` with `c` the third row of `C`.
///
/// Position in the plane and heading are left free: the noise says how uneven the floor is. Upside
/// down there is no logarithm: `e` is (π, 0) and its Jacobian zero.
#[derive(Clone, Debug)]
pub struct PlanarMotion {
    keys: [VariableId; 1],
    height: f64,
    up: Sphere,
    noise: Noise,
    sqrt_information: Matrix3<f64>,
}

impl PlanarMotion {
    /// `height` is the world z coordinate of the plane that the pose's origin moves in, metres; the
    /// noise has three dimensions: height, roll, pitch.
    ///
    /// # Errors
    /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
    pub fn new(key: Key<Pose3>, height: f64, noise: Noise) -> Result<Self, FactorError> {
        finite("PlanarMotion", "height", &[height])?;
        let sqrt_information = fixed("PlanarMotion", &noise)?;
        let up = Sphere::at_unit(Vector3::z());
        Ok(Self { keys: [key.id()], height, up, noise, sqrt_information })
    }

    fn error(&self, pose: &Pose3, tilt: Vector2<f64>) -> Vector3<f64> {
        Vector3::new(pose.z() - self.height, tilt.x, tilt.y)
    }

    /// The pose.
    pub fn key(&self) -> VariableId {
        self.keys[0]
    }

    /// The height of the plane, in metres.
    pub fn measurement(&self) -> f64 {
        self.height
    }

    /// The noise of height, roll and pitch.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }
}

impl Factor for PlanarMotion {
    fixed_shape!("PlanarMotion", 3, [Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let pose: Pose3 = at.get(0);
        let (tilt, _) = self.up.log(&pose.rotation().inverse_rotate(&Vector3::z()));
        out.copy_from_slice((self.sqrt_information * self.error(&pose, tilt)).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let pose: Pose3 = at.get(0);
        let u = pose.rotation().inverse_rotate(&Vector3::z());
        let (tilt, by_direction) = self.up.log(&u);
        let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
        jacobian.set_row(0, &height_jacobian(&pose));
        jacobian.fixed_view_mut::<2, 3>(1, 3).copy_from(&times_skew(&by_direction, &u));
        out.set_block(0, &(self.sqrt_information * jacobian));
        out.set_residual(&(self.sqrt_information * self.error(&pose, tilt)));
    }
}
