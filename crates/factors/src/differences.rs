//! How two poses differ in one quantity of the world: depth, heading, position.
//!
//! Each side is that of the partial prior of the same quantity, so the difference says nothing
//! about where in the world the pair is. Barometers, pressure gauges, compasses and gyroscopes with
//! an unknown but constant offset measure such differences.

use evergraph_model::{
    Arguments, Factor, Key, Linearization, Noise, Point2, Point3, Pose2, Pose3, VariableId,
    geometry::wrap_angle,
};
use nalgebra::{Matrix1, Matrix2, Matrix3};

use crate::error::{FactorError, finite, fixed, fixed_shape};
use crate::partial_prior::{heading, height_jacobian};
use crate::positioned::Positioned;

macro_rules! difference_interface {
    ($name:ident, $text:literal, $pose:ty, $quantity:ty, $numbers:expr, $what:literal) => {
        impl $name {
            #[doc = concat!("`difference` is ", $what, " of `to` less that of `from`.")]
            ///
            /// # Errors
            /// [`FactorError::NoiseDimension`], [`FactorError::NotFinite`].
            pub fn new(
                from: Key<$pose>,
                to: Key<$pose>,
                difference: $quantity,
                noise: Noise,
            ) -> Result<Self, FactorError> {
                finite($text, "difference", &$numbers(difference))?;
                let sqrt_information = fixed($text, &noise)?;
                let keys = [from.id(), to.id()];
                Ok(Self { keys, measurement: difference, noise, sqrt_information })
            }

            /// The pose that the difference is counted from.
            pub fn from(&self) -> VariableId {
                self.keys[0]
            }

            /// The pose that it is counted to.
            pub fn to(&self) -> VariableId {
                self.keys[1]
            }

            /// The measured difference.
            pub fn measurement(&self) -> $quantity {
                self.measurement
            }

            /// The noise.
            pub fn noise(&self) -> &Noise {
                &self.noise
            }
        }
    };
}

/// The height of a pose above another: `r = R (t_j,z - t_i,z - d)`, metres.
///
/// `t` are the translations of `world_from_robot`, `d` the measured difference. Jacobians
/// `∓R [c 0 0 0]` with `c` the third row of each rotation. Sees neither horizontal motion nor any
/// rotation of a pose in place.
#[derive(Clone, Debug)]
pub struct DepthDifference {
    keys: [VariableId; 2],
    measurement: f64,
    noise: Noise,
    sqrt_information: Matrix1<f64>,
}

difference_interface!(
    DepthDifference,
    "DepthDifference",
    Pose3,
    f64,
    |d| [d],
    "the world z coordinate, in metres,"
);

impl Factor for DepthDifference {
    fixed_shape!("DepthDifference", 1, [Pose3, Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let difference = at.get::<Pose3>(1).z() - at.get::<Pose3>(0).z();
        out[0] = self.sqrt_information.x * (difference - self.measurement);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let r = self.sqrt_information.x;
        out.set_block(0, &(-r * height_jacobian(&at.get(0))));
        out.set_block(1, &(r * height_jacobian(&at.get(1))));
        self.residual(at, out.residual_mut());
    }
}

/// The turn from one heading in space to another: `r = R wrap(psi_j - psi_i - d)`, radians.
///
/// Headings, their derivative and where there is none as in [`Heading3`](crate::Heading3).
#[derive(Clone, Debug)]
pub struct HeadingDifference {
    keys: [VariableId; 2],
    measurement: f64,
    noise: Noise,
    sqrt_information: Matrix1<f64>,
}

difference_interface!(
    HeadingDifference,
    "HeadingDifference",
    Pose3,
    f64,
    |d| [d],
    "the heading, in radians,"
);

impl Factor for HeadingDifference {
    fixed_shape!("HeadingDifference", 1, [Pose3, Pose3]);

    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let ((from, _), (to, _)) = (heading(&at.get(0)), heading(&at.get(1)));
        out[0] = self.sqrt_information.x * wrap_angle(to - from - self.measurement);
    }

    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let r = self.sqrt_information.x;
        let ((_, by_from), (_, by_to)) = (heading(&at.get(0)), heading(&at.get(1)));
        out.set_block(0, &(-r * by_from));
        out.set_block(1, &(r * by_to));
        self.residual(at, out.residual_mut());
    }
}

macro_rules! translation_difference {
    ($name:ident, $text:literal, $dim:literal, $pose:ty, $point:ty, $matrix:ty, $doc:literal) => {
        #[doc = $doc]
        #[derive(Clone, Debug)]
        pub struct $name {
            keys: [VariableId; 2],
            measurement: $point,
            noise: Noise,
            sqrt_information: $matrix,
        }

        difference_interface!(
            $name,
            $text,
            $pose,
            $point,
            |d: $point| <[f64; $dim]>::from(d.vector()),
            "the position in the world, in metres,"
        );

        impl Factor for $name {
            fixed_shape!($text, $dim, [$pose, $pose]);

            fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
                let (from, to): ($pose, $pose) = (at.get(0), at.get(1));
                let error = to.position() - from.position() - self.measurement.vector();
                out.copy_from_slice((self.sqrt_information * error).as_slice());
            }

            fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
                at.get::<$pose>(0).chain(&-self.sqrt_information, out.block_mut(0));
                at.get::<$pose>(1).chain(&self.sqrt_information, out.block_mut(1));
                self.residual(at, out.residual_mut());
            }
        }
    };
}

translation_difference!(
    TranslationDifference2,
    "TranslationDifference2",
    2,
    Pose2,
    Point2,
    Matrix2<f64>,
    "The way from one pose in the plane to another along the world's axes: `r = R (tⱼ - tᵢ - d)`,
metres.

`t` are the translations of `world_from_robot`, `d` the measured way in the world. Jacobians
`∓R [C 0]` with `C` the rotation of each pose. Differences of GPS fixes are of this kind;
[`Between`](crate::Between) measures the way along the first pose's axes instead."
);
translation_difference!(
    TranslationDifference3,
    "TranslationDifference3",
    3,
    Pose3,
    Point3,
    Matrix3<f64>,
    "The way from one pose in space to another along the world's axes: `r = R (tⱼ - tᵢ - d)`, metres.

As [`TranslationDifference2`]."
);
