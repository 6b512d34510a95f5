//! The Lie groups of this module as variables, and their motions with the world.

use nalgebra::{Matrix2, SMatrix, SVector};

use super::{Point2, Point3, Pose2, Pose3, Rot2, Rot3};
use crate::manifold::{LieGroup, Manifold};
use crate::moves::{Frame, Moves};
use crate::world::Motion;

/// [`Manifold`] of a Lie group from its `to_storage` and `from_storage`.
macro_rules! group_manifold {
    ($group:ty, $dim:literal, $name:literal, $components:expr, $len:literal, $motion:expr) => {
        impl Manifold for $group {
            const NAME: &'static str = $name;
            const COMPONENTS: &'static [&'static str] = &$components;
            const MOTION: Option<Motion> = Some($motion);

            #[inline]
            fn dim(&self) -> usize {
                $dim
            }

            #[inline]
            fn storage_len(&self) -> usize {
                $len
            }

            #[inline]
            fn store(&self, out: &mut [f64]) {
                out.copy_from_slice(&self.to_storage());
            }

            #[inline]
            fn load(storage: &[f64]) -> Self {
                let storage: [f64; $len] = storage.try_into().expect(concat!(
                    "a stored ",
                    $name,
                    " has ",
                    $len,
                    " numbers"
                ));
                Self::from_storage(storage)
            }

            #[inline]
            fn retract(&self, delta: &[f64]) -> Self {
                self.compose(&Self::exp(&SVector::<f64, $dim>::from_column_slice(delta)))
            }

            #[inline]
            fn local(&self, other: &Self, out: &mut [f64]) {
                out.copy_from_slice(self.between(other).log().as_slice());
            }
        }

        impl std::ops::Mul for $group {
            type Output = Self;

            /// Composition.
            #[inline]
            fn mul(self, other: Self) -> Self {
                self.compose(&other)
            }
        }
    };
}

group_manifold!(Point2, 2, "Point2", ["x", "y"], 2, Motion::of::<Self, Pose2, 3>());
group_manifold!(Point3, 3, "Point3", ["x", "y", "z"], 3, Motion::of::<Self, Pose3, 6>());
group_manifold!(Rot2, 1, "Rot2", ["theta"], 2, Motion::of::<Self, Pose2, 3>());
group_manifold!(Rot3, 3, "Rot3", ["rx", "ry", "rz"], 4, Motion::of::<Self, Pose3, 6>());
group_manifold!(Pose2, 3, "Pose2", ["x", "y", "theta"], 4, Motion::of_pose::<Self, Self, 3>());
group_manifold!(
    Pose3,
    6,
    "Pose3",
    ["x", "y", "z", "rx", "ry", "rz"],
    7,
    Motion::of_pose::<Self, Self, 6>()
);

/// A pose moves by the adjoint, `exp(ξ) x = x exp(Ad(x⁻¹) ξ)`.
macro_rules! pose_moves {
    ($pose:ty, $dim:literal, $rotation:literal) => {
        impl Moves<$pose, $dim> for $pose {
            const ROTATION: usize = $rotation;

            fn seen_from(&self, frame: &Self) -> Self {
                frame.between(self)
            }

            fn lever(&self, out: &mut [f64]) {
                out.copy_from_slice(self.inverse().adjoint().as_slice());
            }

            /// `Ad(x⁻¹ T)`.
            fn carried(&self, frame: &Self, out: &mut [f64]) {
                out.copy_from_slice(self.between(frame).adjoint().as_slice());
            }
        }

        impl Frame<$pose, $dim> for $pose {
            fn frame(&self) -> Self {
                *self
            }
        }
    };
}

pose_moves!(Pose2, 3, 1);
pose_moves!(Pose3, 6, 3);

/// `[I  J p]`, J the quarter turn.
fn lever2(p: &Point2) -> SMatrix<f64, 2, 3> {
    SMatrix::<f64, 2, 3>::new(1.0, 0.0, -p.y(), 0.0, 1.0, p.x())
}

/// `[I  -[p]×]`.
fn lever3(p: &Point3) -> SMatrix<f64, 3, 6> {
    let mut lever = SMatrix::<f64, 3, 6>::identity();
    lever.fixed_view_mut::<3, 3>(0, 3).copy_from(&-p.vector().cross_matrix());
    lever
}

impl Moves<Pose2, 3> for Point2 {
    const ROTATION: usize = 0;

    fn seen_from(&self, frame: &Pose2) -> Self {
        frame.inverse_transform_point(self)
    }

    fn seen_from_derivative(&self, frame: &Pose2, out: &mut [f64]) {
        let (cos, sin) = (frame.rotation().cos(), frame.rotation().sin());
        out.copy_from_slice(Matrix2::new(cos, sin, -sin, cos).as_slice());
    }

    fn lever(&self, out: &mut [f64]) {
        out.copy_from_slice(lever2(self).as_slice());
    }

    /// `C [I  J c]`, with `C` the rotation of the frame and `c` the point as seen from it.
    fn carried(&self, frame: &Pose2, out: &mut [f64]) {
        let c = frame.inverse_transform_point(self);
        let (cos, sin) = (frame.rotation().cos(), frame.rotation().sin());
        let rotation = Matrix2::new(cos, -sin, sin, cos);
        out.copy_from_slice((rotation * lever2(&c)).as_slice());
    }
}

impl Moves<Pose3, 6> for Point3 {
    const ROTATION: usize = 0;

    fn seen_from(&self, frame: &Pose3) -> Self {
        frame.inverse_transform_point(self)
    }

    fn seen_from_derivative(&self, frame: &Pose3, out: &mut [f64]) {
        out.copy_from_slice(frame.rotation().matrix().transpose().as_slice());
    }

    fn lever(&self, out: &mut [f64]) {
        out.copy_from_slice(lever3(self).as_slice());
    }

    /// `C [I  -[c]×]`, with `C` the rotation of the frame and `c` the point as seen from it.
    fn carried(&self, frame: &Pose3, out: &mut [f64]) {
        let c = frame.inverse_transform_point(self);
        out.copy_from_slice((frame.rotation().matrix() * lever3(&c)).as_slice());
    }
}

impl Moves<Pose2, 3> for Rot2 {
    const ROTATION: usize = 1;
    const IS_SEEN: bool = false;

    fn seen_from(&self, frame: &Pose2) -> Self {
        frame.rotation().between(self)
    }

    fn lever(&self, out: &mut [f64]) {
        out.copy_from_slice(&[0.0, 0.0, 1.0]);
    }

    fn carried(&self, _: &Pose2, out: &mut [f64]) {
        self.lever(out);
    }
}

impl Moves<Pose3, 6> for Rot3 {
    const ROTATION: usize = 3;
    const IS_SEEN: bool = false;

    fn seen_from(&self, frame: &Pose3) -> Self {
        frame.rotation().between(self)
    }

    fn lever(&self, out: &mut [f64]) {
        out[9..].copy_from_slice(self.matrix().transpose().as_slice());
    }

    /// `[0  Rᵀ C]`, with `C` the rotation of the frame.
    fn carried(&self, frame: &Pose3, out: &mut [f64]) {
        let turn = self.matrix().transpose() * frame.rotation().matrix();
        out[9..].copy_from_slice(turn.as_slice());
    }
}
