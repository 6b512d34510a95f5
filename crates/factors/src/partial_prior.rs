//! Parts of a pose measured against the world: depth and heading.

use evergraph_model::{
    Arguments, Factor, Key, Linearization, Noise, Pose2, Pose3, VariableId, geometry::wrap_angle,
};
use nalgebra::{Matrix1, SMatrix};

use crate::error::{FactorError, finite, fixed, fixed_shape};

macro_rules! scalar_interface {
    ($name:ident, $text:literal, $pose:ty, $quantity:literal) => {
        impl $name {
            #[doc = concat!("`measurement` is the ", $quantity, "; the noise has one dimension.")]
            ///
            /// # Errors
            /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
            pub fn new(
                key: Key<$pose>,
                measurement: f64,
                noise: Noise,
            ) -> Result<Self, FactorError> {
                finite($text, "measurement", &[measurement])?;
                let sqrt_information: Matrix1<f64> = fixed($text, &noise)?;
                Ok(Self {
                    keys: [key.id()],
                    measurement,
                    noise,
                    sqrt_information: sqrt_information.x,
                })
            }

            /// The pose.
            pub fn key(&self) -> VariableId {
                self.keys[0]
            }

            #[doc = concat!("The measured ", $quantity, ".")]
            pub fn measurement(&self) -> f64 {
                self.measurement
            }

            /// The noise.
            pub fn noise(&self) -> &Noise {
                &self.noise
            }
        }
    };
}

/// The height of a pose in the world: `r = R (t_z - z)`, metres.
///
/// `t` is the translation of `world_from_robot`. Jacobian `R [c 0 0 0]` with `c` the third row of
/// the rotation: right perturbations move along the robot's axes.
#[derive(Clone, Debug)]
pub struct Depth {
    keys: [VariableId; 1],
    measurement: f64,
    noise: Noise,
    sqrt_information: f64,
}

scalar_interface!(Depth, "Depth", Pose3, "world z coordinate of the pose, in metres");

impl Factor for Depth {
    fixed_shape!("Depth", 1, [Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out[0] = self.sqrt_information * (at.get::<Pose3>(0).z() - self.measurement);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        out.set_block(0, &(self.sqrt_information * height_jacobian(&at.get(0))));
        self.residual(at, out.residual_mut());
    }
}

/// The heading of a pose in the plane: `r = R wrap(theta - psi)`, radians.
///
/// Jacobian `R [0 0 1]`.
#[derive(Clone, Debug)]
pub struct Heading2 {
    keys: [VariableId; 1],
    measurement: f64,
    noise: Noise,
    sqrt_information: f64,
}

scalar_interface!(Heading2, "Heading2", Pose2, "heading, in radians");

impl Factor for Heading2 {
    fixed_shape!("Heading2", 1, [Pose2]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out[0] = self.sqrt_information * wrap_angle(at.get::<Pose2>(0).theta() - self.measurement);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        out.set_block(0, &SMatrix::<f64, 1, 3>::new(0.0, 0.0, self.sqrt_information));
        self.residual(at, out.residual_mut());
    }
}

/// The heading of a pose in space: `r = R wrap(atan2(C₁₀, C₀₀) - psi)`, radians.
///
/// `C` is the rotation of `world_from_robot`; the heading is the direction of the robot's x axis
/// in the world's horizontal plane, the yaw of `Rz(yaw) Ry(pitch) Rx(roll)`. With
/// `h² = C₀₀² + C₁₀²` the Jacobian is `R/h² [0 0 0 0 C₂₁ C₂₂]`. There is no heading where the x
/// axis is vertical; the Jacobian grows without bound towards it and is taken as zero at it.
#[derive(Clone, Debug)]
pub struct Heading3 {
    keys: [VariableId; 1],
    measurement: f64,
    noise: Noise,
    sqrt_information: f64,
}

scalar_interface!(Heading3, "Heading3", Pose3, "heading, in radians");

impl Factor for Heading3 {
    fixed_shape!("Heading3", 1, [Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let (heading, _) = heading(&at.get(0));
        out[0] = self.sqrt_information * wrap_angle(heading - self.measurement);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let (heading, jacobian) = heading(&at.get(0));
        out.set_block(0, &(self.sqrt_information * jacobian));
        out.residual_mut()[0] = self.sqrt_information * wrap_angle(heading - self.measurement);
    }
}

/// The derivative of the height of a pose.
#[inline]
pub(crate) fn height_jacobian(pose: &Pose3) -> SMatrix<f64, 1, 6> {
    let c = pose.rotation().matrix();
    SMatrix::<f64, 1, 6>::new(c[(2, 0)], c[(2, 1)], c[(2, 2)], 0.0, 0.0, 0.0)
}

/// The heading of a pose in space, as in [`Heading3`], and its derivative.
#[inline]
pub(crate) fn heading(pose: &Pose3) -> (f64, SMatrix<f64, 1, 6>) {
    let c = pose.rotation().matrix();
    let heading = c[(1, 0)].atan2(c[(0, 0)]);
    let horizontal = c[(0, 0)] * c[(0, 0)] + c[(1, 0)] * c[(1, 0)];
    if !horizontal.is_normal() {
        return (heading, SMatrix::zeros());
    }
    let (by_y, by_z) = (c[(2, 1)] / horizontal, c[(2, 2)] / horizontal);
    (heading, SMatrix::<f64, 1, 6>::new(0.0, 0.0, 0.0, 0.0, by_y, by_z))
}
