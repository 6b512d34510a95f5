//! Points in the plane and in space, as additive groups.

use std::fmt;

use nalgebra::{SMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::manifold::LieGroup;

macro_rules! point {
    ($(#[$doc:meta])* $name:ident, $vector:ident, $dim:literal, $text:literal, [$($c:ident),*], [$($label:literal),*]) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
        pub struct $name {
            $($c: f64),*
        }

        impl $name {
            /// The point with these coordinates.
            #[inline]
            pub const fn new($($c: f64),*) -> Self {
                Self { $($c),* }
            }

            $(
                /// This coordinate.
                #[inline]
                pub const fn $c(&self) -> f64 {
                    self.$c
                }
            )*

            /// The coordinates as a vector.
            #[inline]
            pub fn vector(&self) -> $vector<f64> {
                $vector::new($(self.$c),*)
            }

            #[inline]
            pub(super) fn to_storage(self) -> [f64; $dim] {
                [$(self.$c),*]
            }

            #[inline]
            pub(super) fn from_storage([$($c),*]: [f64; $dim]) -> Self {
                Self { $($c),* }
            }
        }


        impl LieGroup<$dim> for $name {
            #[inline]
            fn identity() -> Self {
                Self { $($c: 0.0),* }
            }

            #[inline]
            fn compose(&self, other: &Self) -> Self {
                Self { $($c: self.$c + other.$c),* }
            }

            #[inline]
            fn inverse(&self) -> Self {
                Self { $($c: -self.$c),* }
            }

            #[inline]
            fn exp(tangent: &$vector<f64>) -> Self {
                (*tangent).into()
            }

            #[inline]
            fn log(&self) -> $vector<f64> {
                self.vector()
            }

            #[inline]
            fn adjoint(&self) -> SMatrix<f64, $dim, $dim> {
                SMatrix::identity()
            }

            #[inline]
            fn right_jacobian(_: &$vector<f64>) -> SMatrix<f64, $dim, $dim> {
                SMatrix::identity()
            }

            #[inline]
            fn right_jacobian_inverse(_: &$vector<f64>) -> SMatrix<f64, $dim, $dim> {
                SMatrix::identity()
            }

            #[inline]
            fn between(&self, other: &Self) -> Self {
                Self { $($c: other.$c - self.$c),* }
            }
        }

        impl From<$vector<f64>> for $name {
            #[inline]
            fn from(vector: $vector<f64>) -> Self {
                Self { $($c: vector.$c),* }
            }
        }

        impl From<[f64; $dim]> for $name {
            #[inline]
            fn from(coordinates: [f64; $dim]) -> Self {
                Self::from_storage(coordinates)
            }
        }

        impl From<$name> for $vector<f64> {
            #[inline]
            fn from(point: $name) -> Self {
                point.vector()
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let mut tuple = f.debug_tuple($text);
                $(tuple.field(&self.$c);)*
                tuple.finish()
            }
        }
    };
}

point! {
    /// A point in the plane, in metres.
    Point2, Vector2, 2, "Point2", [x, y], ["x", "y"]
}

point! {
    /// A point in space, in metres.
    Point3, Vector3, 3, "Point3", [x, y, z], ["x", "y", "z"]
}
