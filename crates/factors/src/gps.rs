//! Positions in the world.

use evergraph_model::{
    Arguments, Factor, Key, Linearization, Noise, Point2, Point3, Pose2, Pose3, VariableId,
};
use nalgebra::{Matrix2, Matrix2x3, Matrix3};

use crate::cross::times_skew;
use crate::error::{FactorError, finite_value, fixed, fixed_shape};

macro_rules! gps_interface {
    ($name:ident, $text:literal, $pose:ty, $point:ty) => {
        impl $name {
            /// `measurement` is the position of the pose's origin in the world, metres.
            ///
            /// # Errors
            /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
            pub fn new(
                key: Key<$pose>,
                measurement: $point,
                noise: Noise,
            ) -> Result<Self, FactorError> {
                Self::with_lever_arm(
                    key,
                    measurement,
                    <$point as evergraph_model::LieGroup<_>>::identity(),
                    noise,
                )
            }

            /// `measurement` is the position in the world of an antenna that is fixed at
            /// `lever_arm` in the robot's frame, metres.
            ///
            /// # Errors
            /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
            pub fn with_lever_arm(
                key: Key<$pose>,
                measurement: $point,
                lever_arm: $point,
                noise: Noise,
            ) -> Result<Self, FactorError> {
                finite_value($text, "measurement", &measurement)?;
                finite_value($text, "lever arm", &lever_arm)?;
                let sqrt_information = fixed($text, &noise)?;
                Ok(Self { keys: [key.id()], measurement, lever_arm, noise, sqrt_information })
            }

            /// The pose.
            pub fn key(&self) -> VariableId {
                self.keys[0]
            }

            /// The antenna's position in the world.
            pub fn measurement(&self) -> $point {
                self.measurement
            }

            /// The antenna's position in the robot's frame.
            pub fn lever_arm(&self) -> $point {
                self.lever_arm
            }

            /// The noise.
            pub fn noise(&self) -> &Noise {
                &self.noise
            }
        }
    };
}

/// The world position of an antenna on a pose in the plane: `r = R (t + C a - z)`.
///
/// `t` and `C` are the translation and rotation of `world_from_robot`, `a` the lever arm in the
/// robot's frame (zero by default), `z` the measured position, all in metres. Jacobian
/// `R C [I (-a_y, a_x)ᵀ]`.
#[derive(Clone, Debug)]
pub struct GpsPosition2 {
    keys: [VariableId; 1],
    measurement: Point2,
    lever_arm: Point2,
    noise: Noise,
    sqrt_information: Matrix2<f64>,
}

gps_interface!(GpsPosition2, "GpsPosition2", Pose2, Point2);

impl Factor for GpsPosition2 {
    fixed_shape!("GpsPosition2", 2, [Pose2]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let antenna = at.get::<Pose2>(0) * self.lever_arm;
        let error = antenna.vector() - self.measurement.vector();
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let a = self.lever_arm;
        let arm = Matrix2x3::new(1.0, 0.0, -a.y(), 0.0, 1.0, a.x());
        out.set_block(0, &(self.sqrt_information * at.get::<Pose2>(0).rotation().matrix() * arm));
        self.residual(at, out.residual_mut());
    }
}

/// The world position of an antenna on a pose in space: `r = R (t + C a - z)`.
///
/// As [`GpsPosition2`]; Jacobian `R C [I -[a]×]`.
#[derive(Clone, Debug)]
pub struct GpsPosition3 {
    keys: [VariableId; 1],
    measurement: Point3,
    lever_arm: Point3,
    noise: Noise,
    sqrt_information: Matrix3<f64>,
}

gps_interface!(GpsPosition3, "GpsPosition3", Pose3, Point3);

impl Factor for GpsPosition3 {
    fixed_shape!("GpsPosition3", 3, [Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let antenna = at.get::<Pose3>(0) * self.lever_arm;
        let error = antenna.vector() - self.measurement.vector();
        out.copy_from_slice((self.sqrt_information * error).as_slice());
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let turned = self.sqrt_information * at.get::<Pose3>(0).rotation().matrix();
        let (position, rotation) = out.block_mut(0).split_at_mut(9);
        position.copy_from_slice(turned.as_slice());
        rotation.copy_from_slice((-times_skew(&turned, &self.lever_arm.vector())).as_slice());
        self.residual(at, out.residual_mut());
    }
}
