//! The factors and variables of the library. A new factor is a line of the table at the end, and
//! the two functions that store it.

use std::borrow::Cow;

use evergraph_model::{LieGroup, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VectorN};
use nalgebra::{DMatrix, DVector};

use super::error::{CatalogueError, DataError};
use super::quantity::{Description, Part, Quantity};
use super::registry::Catalogue;
use super::stored::{FactorReader, FactorWriter, StoredFactor};
use super::variables::StoredVariable;
use crate::attitude::{Attitude, RollPitch};
use crate::autodiff::{AutoDiff, Residual};
use crate::bearing2::{Bearing2, BearingRange2};
use crate::bearing3::{Bearing3, BearingRange3};
use crate::between::{
    Between, BetweenPoint2, BetweenPoint3, BetweenPose2, BetweenPose3, BetweenRot2, BetweenRot3,
};
use crate::differences::{
    DepthDifference, HeadingDifference, TranslationDifference2, TranslationDifference3,
};
use crate::gps::{GpsPosition2, GpsPosition3};
use crate::landmark::{RelativePosition2, RelativePosition3};
use crate::linear::Linear;
use crate::partial_between::{PartialBetween, PartialBetweenPose2, PartialBetweenPose3};
use crate::partial_prior::{Depth, Heading2, Heading3};
use crate::planar_motion::PlanarMotion;
use crate::positioned::Positioned;
use crate::prior::{LocalJacobian, Prior};
use crate::range::Range;
use crate::root_shift::RootShift;

/// Factors with a noise: type, name, what is written besides variables and noise, and the call of the
/// constructor, which reads it in the same order.
macro_rules! stored {
    ($(
        $type:ty [$($generic:tt)*], $name:expr;
        |$f:ident, $to:ident| $store:expr;
        |$at:ident, $noise:ident| $restore:expr;
    )+) => {$(
        impl<$($generic)*> StoredFactor for $type {
            fn stored_name() -> Cow<'static, str> {
                Cow::from($name)
            }

            fn store(&self, $to: &mut FactorWriter<'_>) -> Result<(), DataError> {
                let $f = self;
                $store;
                $to.noise(self.noise());
                Ok(())
            }

            fn restore($at: &mut FactorReader<'_>) -> Result<Self, DataError> {
                let $noise = $at.noise()?;
                Ok($restore?)
            }
        }
    )+};
}

stored! {
    Prior<V> [V: LocalJacobian + StoredVariable], format!("Prior<{}>", V::NAME);
    |f, to| to.value(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.value()?, noise);

    Between<G, N> [G: LieGroup<N> + StoredVariable, const N: usize], format!("Between<{}>", G::NAME);
    |f, to| to.value(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.value()?, noise);

    PartialBetween<G, N> [G: LieGroup<N> + StoredVariable, const N: usize],
        format!("PartialBetween<{}>", G::NAME);
    |f, to| {
        to.value(f.measurement());
        to.numbers(f.combinations().transpose().iter().copied());
    };
    |at, noise| {
        let (from, to, measurement) = (at.key(0)?, at.key(1)?, at.value()?);
        // Numbers beyond the last whole row are left over, which is an error.
        let rows = at.remaining() / N;
        let combinations = DMatrix::from_row_slice(rows, N, at.numbers(rows * N)?);
        Self::with_combinations(from, to, measurement, combinations, noise)
    };

    RelativePosition2 [], "RelativePosition2";
    |f, to| to.value(&f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.value()?, noise);

    RelativePosition3 [], "RelativePosition3";
    |f, to| {
        to.value(&f.measurement());
        to.value(f.robot_from_sensor());
    };
    |at, noise| Self::with_sensor(at.key(0)?, at.key(1)?, at.value()?, at.value()?, noise);

    GpsPosition2 [], "GpsPosition2";
    |f, to| {
        to.value(&f.measurement());
        to.value(&f.lever_arm());
    };
    |at, noise| Self::with_lever_arm(at.key(0)?, at.value()?, at.value()?, noise);

    GpsPosition3 [], "GpsPosition3";
    |f, to| {
        to.value(&f.measurement());
        to.value(&f.lever_arm());
    };
    |at, noise| Self::with_lever_arm(at.key(0)?, at.value()?, at.value()?, noise);

    Depth [], "Depth";
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.number()?, noise);

    Heading2 [], "Heading2";
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.number()?, noise);

    Heading3 [], "Heading3";
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.number()?, noise);

    PlanarMotion [], "PlanarMotion";
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.number()?, noise);

    RollPitch [], "RollPitch";
    |f, to| to.numbers([f.roll(), f.pitch()]);
    |at, noise| Self::new(at.key(0)?, at.number()?, at.number()?, noise);

    Attitude [], "Attitude";
    |f, to| {
        to.direction(f.world_direction());
        to.direction(f.measurement());
    };
    |at, noise| {
        let world_direction = at.direction("Attitude", "world direction")?;
        let measurement = at.direction("Attitude", "measurement")?;
        Self::of_units(at.key(0)?, world_direction, measurement, noise)
    };

    Range<A, B, D> [A: Positioned<D>, B: Positioned<D>, const D: usize],
        format!("Range<{}, {}>", A::NAME, B::NAME);
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.number()?, noise);

    Bearing2<B> [B: Positioned<2>], format!("Bearing2<{}>", B::NAME);
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.number()?, noise);

    BearingRange2<B> [B: Positioned<2>], format!("BearingRange2<{}>", B::NAME);
    |f, to| to.numbers([f.bearing(), f.range()]);
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.number()?, at.number()?, noise);

    Bearing3<B> [B: Positioned<3>], format!("Bearing3<{}>", B::NAME);
    |f, to| to.direction(f.measurement());
    |at, noise| {
        let direction = at.direction("Bearing3", "direction")?;
        Self::of_unit(at.key(0)?, at.key(1)?, direction, noise)
    };

    BearingRange3<B> [B: Positioned<3>], format!("BearingRange3<{}>", B::NAME);
    |f, to| {
        to.direction(f.direction());
        to.number(f.range());
    };
    |at, noise| {
        let direction = at.direction("BearingRange3", "direction")?;
        Self::of_unit(at.key(0)?, at.key(1)?, direction, at.number()?, noise)
    };

    DepthDifference [], "DepthDifference";
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.number()?, noise);

    HeadingDifference [], "HeadingDifference";
    |f, to| to.number(f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.number()?, noise);

    TranslationDifference2 [], "TranslationDifference2";
    |f, to| to.value(&f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.value()?, noise);

    TranslationDifference3 [], "TranslationDifference3";
    |f, to| to.value(&f.measurement());
    |at, noise| Self::new(at.key(0)?, at.key(1)?, at.value()?, noise);

    AutoDiff<E, ROWS> [E: StoredResidual<ROWS>, const ROWS: usize], E::NAME;
    |f, to| to.numbers(f.inner().numbers());
    |at, noise| {
        let (expected, actual) = (Self::VARIABLES, at.ends().len());
        let error = E::from_numbers(at.numbers(at.remaining())?)?;
        Self::of_ids(at.ends(), error, noise).ok_or(DataError::Ends { expected, actual })?
    };
}

/// An error function whose numbers can be stored, so that its [`AutoDiff`] factor can.
/// [`Residual::NAME`] is the stable name.
pub trait StoredResidual<const ROWS: usize>: Residual<ROWS> + Sized {
    /// Its numbers.
    fn numbers(&self) -> Vec<f64>;

    /// The error function with these numbers, which are finite.
    ///
    /// # Errors
    /// [`DataError`] for numbers that [`numbers`](Self::numbers) cannot have given.
    fn from_numbers(numbers: &[f64]) -> Result<Self, DataError>;
}

/// The number of each root shift in the data of a linear factor.
const SHIFTS: [(f64, RootShift); 3] =
    [(0.0, RootShift::None), (1.0, RootShift::Root), (2.0, RootShift::InverseRoot)];

/// Its values are the linearization points, its numbers the root shift (0 none, 1 root, 2 inverse
/// root), the rows of `G`, and `d'`.
impl StoredFactor for Linear {
    fn stored_name() -> Cow<'static, str> {
        "Linear".into()
    }

    fn store(&self, to: &mut FactorWriter<'_>) -> Result<(), DataError> {
        let shift = SHIFTS.iter().find(|(_, shift)| *shift == self.root_shift());
        to.number(shift.map_or(f64::NAN, |(number, _)| *number));
        to.numbers(self.sqrt_information().transpose().iter().copied());
        to.numbers(self.offset().iter().copied());
        self.linearization_points().iter().try_for_each(|point| to.any_value(point))
    }

    fn restore(from: &mut FactorReader<'_>) -> Result<Self, DataError> {
        let points: Vec<Value> =
            from.ends().iter().map(|_| from.any_value()).collect::<Result<_, _>>()?;
        let variables: Vec<_> = from.ends().iter().copied().zip(points).collect();
        let number = from.number()?;
        let (_, shift) =
            *SHIFTS.iter().find(|(code, _)| *code == number).ok_or(DataError::Choice {
                what: "root shift",
                number,
                choices: "0 (none), 1 (root) and 2 (inverse root)",
            })?;
        let width: usize = variables.iter().map(|(_, point)| point.dim()).sum();
        let rows = (from.remaining() / width.max(1)).saturating_sub(1);
        let g = DMatrix::from_row_slice(rows, width, from.numbers(rows * width)?);
        let offset = DVector::from_column_slice(from.numbers(width)?);
        Ok(Self::new(&variables, shift, g, offset)?)
    }
}

/// The table of factors.
macro_rules! standard {
    ($($name:literal $type:ty: $quantity:ident of [$($end:literal)*] is [$($part:ident)*] in $rows:expr;)+) => {
        /// All factors of this crate, sorted by quantity.
        pub const STANDARD: &[Description] = &[$(Description {
            name: $name,
            quantity: Quantity::$quantity,
            ends: &[$($end),*],
            parts: &[$(Part::$part),*],
            rows: $rows,
        }),+];

        fn register(catalogue: &mut Catalogue) -> Result<(), CatalogueError> {
            catalogue.register_variable::<Rot2>()?;
            catalogue.register_variable::<Rot3>()?;
            catalogue.register_variable::<Pose2>()?;
            catalogue.register_variable::<Pose3>()?;
            catalogue.register_variable::<Point2>()?;
            catalogue.register_variable::<Point3>()?;
            catalogue.register_variable::<VectorN>()?;
            $(catalogue.register_factor::<$type>()?;)+
            Ok(())
        }
    };
}

#[rustfmt::skip]
standard! {
    "Prior<Pose2>" Prior<Pose2>: Prior of ["Pose2"] is [Pose2] in Some(3);
    "Prior<Pose3>" Prior<Pose3>: Prior of ["Pose3"] is [Pose3] in Some(6);
    "Prior<Point2>" Prior<Point2>: Prior of ["Point2"] is [Point2] in Some(2);
    "Prior<Point3>" Prior<Point3>: Prior of ["Point3"] is [Point3] in Some(3);
    "Prior<Rot2>" Prior<Rot2>: Prior of ["Rot2"] is [Rot2] in Some(1);
    "Prior<Rot3>" Prior<Rot3>: Prior of ["Rot3"] is [Rot3] in Some(3);
    "Prior<VectorN>" Prior<VectorN>: Prior of ["VectorN"] is [Vector] in None;
    "Between<Pose2>" BetweenPose2: Relative of ["Pose2" "Pose2"] is [Pose2] in Some(3);
    "Between<Pose3>" BetweenPose3: Relative of ["Pose3" "Pose3"] is [Pose3] in Some(6);
    "RelativePosition2" RelativePosition2: Relative of ["Pose2" "Point2"] is [Point2] in Some(2);
    "RelativePosition3" RelativePosition3: Relative of ["Pose3" "Point3"] is [Point3 Pose3] in Some(3);
    "GpsPosition2" GpsPosition2: AntennaPosition of ["Pose2"] is [Point2 Point2] in Some(2);
    "GpsPosition3" GpsPosition3: AntennaPosition of ["Pose3"] is [Point3 Point3] in Some(3);
    "Depth" Depth: Depth of ["Pose3"] is [Number] in Some(1);
    "Heading2" Heading2: Heading of ["Pose2"] is [Number] in Some(1);
    "Heading3" Heading3: Heading of ["Pose3"] is [Number] in Some(1);
    "RollPitch" RollPitch: RollPitch of ["Pose3"] is [Number Number] in Some(2);
    "Attitude" Attitude: Attitude of ["Pose3"] is [Direction Direction] in Some(2);
    "PlanarMotion" PlanarMotion: PlanarMotion of ["Pose3"] is [Number] in Some(3);
    "Between<Point2>" BetweenPoint2: Between of ["Point2" "Point2"] is [Point2] in Some(2);
    "Between<Point3>" BetweenPoint3: Between of ["Point3" "Point3"] is [Point3] in Some(3);
    "Between<Rot2>" BetweenRot2: Between of ["Rot2" "Rot2"] is [Rot2] in Some(1);
    "Between<Rot3>" BetweenRot3: Between of ["Rot3" "Rot3"] is [Rot3] in Some(3);
    "Range<Pose2, Pose2>" Range<Pose2, Pose2, 2>: Range of ["Pose2" "Pose2"] is [Number] in Some(1);
    "Range<Pose2, Point2>" Range<Pose2, Point2, 2>: Range of ["Pose2" "Point2"] is [Number] in Some(1);
    "Range<Point2, Pose2>" Range<Point2, Pose2, 2>: Range of ["Point2" "Pose2"] is [Number] in Some(1);
    "Range<Point2, Point2>" Range<Point2, Point2, 2>: Range of ["Point2" "Point2"] is [Number] in Some(1);
    "Range<Pose3, Pose3>" Range<Pose3, Pose3, 3>: Range of ["Pose3" "Pose3"] is [Number] in Some(1);
    "Range<Pose3, Point3>" Range<Pose3, Point3, 3>: Range of ["Pose3" "Point3"] is [Number] in Some(1);
    "Range<Point3, Pose3>" Range<Point3, Pose3, 3>: Range of ["Point3" "Pose3"] is [Number] in Some(1);
    "Range<Point3, Point3>" Range<Point3, Point3, 3>: Range of ["Point3" "Point3"] is [Number] in Some(1);
    "Bearing2<Pose2>" Bearing2<Pose2>: Bearing of ["Pose2" "Pose2"] is [Number] in Some(1);
    "Bearing2<Point2>" Bearing2<Point2>: Bearing of ["Pose2" "Point2"] is [Number] in Some(1);
    "Bearing3<Pose3>" Bearing3<Pose3>: Bearing of ["Pose3" "Pose3"] is [Direction] in Some(2);
    "Bearing3<Point3>" Bearing3<Point3>: Bearing of ["Pose3" "Point3"] is [Direction] in Some(2);
    "BearingRange2<Pose2>" BearingRange2<Pose2>: BearingRange of ["Pose2" "Pose2"] is [Number Number] in Some(2);
    "BearingRange2<Point2>" BearingRange2<Point2>: BearingRange of ["Pose2" "Point2"] is [Number Number] in Some(2);
    "BearingRange3<Pose3>" BearingRange3<Pose3>: BearingRange of ["Pose3" "Pose3"] is [Direction Number] in Some(3);
    "BearingRange3<Point3>" BearingRange3<Point3>: BearingRange of ["Pose3" "Point3"] is [Direction Number] in Some(3);
    "DepthDifference" DepthDifference: DepthDifference of ["Pose3" "Pose3"] is [Number] in Some(1);
    "HeadingDifference" HeadingDifference: HeadingDifference of ["Pose3" "Pose3"] is [Number] in Some(1);
    "TranslationDifference2" TranslationDifference2: TranslationDifference of ["Pose2" "Pose2"] is [Point2] in Some(2);
    "TranslationDifference3" TranslationDifference3: TranslationDifference of ["Pose3" "Pose3"] is [Point3] in Some(3);
    "PartialBetween<Pose2>" PartialBetweenPose2: Partial of ["Pose2" "Pose2"] is [Pose2 Combinations3] in None;
    "PartialBetween<Pose3>" PartialBetweenPose3: Partial of ["Pose3" "Pose3"] is [Pose3 Combinations6] in None;
    "Linear" Linear: Linear of [] is [Number Vector] in None;
}

impl Catalogue {
    /// All factors and variables of the library.
    ///
    /// # Panics
    /// Never: no two types of the library have one name.
    pub fn standard() -> Self {
        let mut catalogue = Self::empty();
        register(&mut catalogue).expect("each name in the library belongs to one type");
        catalogue
    }
}

impl Description {
    /// The description of the factor with a stable name.
    pub fn named(name: &str) -> Option<&'static Self> {
        STANDARD.iter().find(|line| line.name == name)
    }

    /// The description of the factor that measures a quantity on variables of types with these
    /// names.
    pub fn of(quantity: Quantity, ends: &[&str]) -> Option<&'static Self> {
        STANDARD.iter().find(|line| line.quantity == quantity && line.ends == ends)
    }
}
