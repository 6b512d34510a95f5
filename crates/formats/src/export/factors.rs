//! The record of each factor.

use evergraph_factors::{
    Attitude, Bearing2, Bearing3, BearingRange2, BearingRange3, BetweenPoint2, BetweenPoint3,
    BetweenPose2, BetweenPose3, Depth, DepthDifference, GpsPosition2, GpsPosition3, Heading2,
    Heading3, HeadingDifference, Linear, PartialBetween, PartialBetweenPose2, PartialBetweenPose3,
    PlanarMotion, Prior, Range, RelativePosition2, RelativePosition3, RollPitch,
    TranslationDifference2, TranslationDifference3,
};
use evergraph_model::{
    Factor, LieGroup, Manifold, Noise, Point2, Point3, Pose2, Pose3, Value, VariableId,
};
use nalgebra::DMatrix;
use smallvec::SmallVec;

use super::{Exporter, settle, settled};
use crate::measurement::{LinearMeasurement, Measurement, Quantity};
use crate::record::{Coordinates, Kind, Line, Record};

/// A factor that a line can hold.
trait Written {
    /// Its record; `None` for what only looks like such a factor.
    fn record(&self, exporter: &mut Exporter) -> Option<Record>;
}

/// The line of a factor, if it is of one of these types, under a kernel or not.
macro_rules! line_of {
    ($exporter:expr, $factor:expr, $($type:ty,)*) => {{
        $(
            if let Some((factor, kernel)) = $factor.downcast::<$type>() {
                let mut line = Line::from(factor.record($exporter)?);
                line.set_kernel(kernel);
                return Some(line);
            }
        )*
        None
    }};
}

impl Exporter {
    /// The line of a factor; `None` for factors of others.
    pub(super) fn line(&mut self, factor: &dyn Factor) -> Option<Line> {
        line_of!(
            self, factor,
            BetweenPose2, BetweenPose3, RelativePosition2, RelativePosition3,
            Prior<Pose2>, Prior<Pose3>, Prior<Point2>, Prior<Point3>,
            Linear, PartialBetweenPose2, PartialBetweenPose3, BetweenPoint2, BetweenPoint3,
            GpsPosition2, GpsPosition3, Depth, Heading2, Heading3, RollPitch, Attitude,
            PlanarMotion, DepthDifference, HeadingDifference,
            TranslationDifference2, TranslationDifference3,
            Range<Pose2, Pose2, 2>, Range<Pose2, Point2, 2>,
            Range<Point2, Pose2, 2>, Range<Point2, Point2, 2>,
            Range<Pose3, Pose3, 3>, Range<Pose3, Point3, 3>,
            Range<Point3, Pose3, 3>, Range<Point3, Point3, 3>,
            Bearing2<Pose2>, Bearing2<Point2>, Bearing3<Pose3>, Bearing3<Point3>,
            BearingRange2<Pose2>, BearingRange2<Point2>,
            BearingRange3<Pose3>, BearingRange3<Point3>,
        )
    }

    /// A factor between a pose and what it sees.
    fn edge(
        &mut self,
        [from, to]: [VariableId; 2],
        measurement: Coordinates,
        noise: &Noise,
        parameter: Option<u64>,
    ) -> Option<Record> {
        let weight = settle::weight(noise);
        Some(Record::Edge {
            from: self.id(from)?,
            to: self.id(to)?,
            measurement,
            weight,
            parameter,
        })
    }

    /// Any other measurement.
    fn measurement(
        &mut self,
        quantity: Quantity,
        variables: &[VariableId],
        numbers: impl IntoIterator<Item = f64>,
        noise: &Noise,
    ) -> Option<Record> {
        let mut ends: SmallVec<[(u64, Kind); 2]> = SmallVec::new();
        for variable in variables {
            ends.push(*self.ends.get(variable)?);
        }
        let numbers = numbers.into_iter().collect();
        let weight = settle::weight(noise);
        let needs_sensor = ends[..].iter().map(|(_, kind)| *kind).eq([Kind::Pose3])
            && matches!(quantity, Quantity::Prior | Quantity::Position);
        let parameter = needs_sensor.then(|| self.sensor(&Pose3::identity()));
        let measurement = Measurement { quantity, ends, numbers, weight, parameter };
        Some(Record::Measurement(Box::new(measurement)))
    }
}

fn numbers(value: &impl Manifold) -> Option<Coordinates> {
    settled(&Value::new(value))
}

macro_rules! edges {
    ($($type:ty: $from:ident $to:ident),*) => {
        $(impl Written for $type {
            fn record(&self, exporter: &mut Exporter) -> Option<Record> {
                let seen = numbers(&self.measurement().clone())?;
                exporter.edge([self.$from(), self.$to()], seen, self.noise(), None)
            }
        })*
    };
}

edges!(BetweenPose2: from to, BetweenPose3: from to, RelativePosition2: pose point);

impl Written for RelativePosition3 {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let sensor = exporter.sensor(self.robot_from_sensor());
        let seen = numbers(&self.measurement())?;
        exporter.edge([self.pose(), self.point()], seen, self.noise(), Some(sensor))
    }
}

impl<V: Manifold> Written for Prior<V> {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let at = numbers(self.measurement())?;
        let numbers = at.numbers().iter().copied();
        exporter.measurement(Quantity::Prior, &[self.key()], numbers, self.noise())
    }
}

/// Factors whose measurement is one number or a point.
macro_rules! plain {
    ($($type:ty: $quantity:ident of $($key:ident)*, $measurement:expr;)*) => {
        $(impl Written for $type {
            fn record(&self, exporter: &mut Exporter) -> Option<Record> {
                let measurement: fn(&Self) -> _ = $measurement;
                let variables = [$(self.$key()),*];
                exporter.measurement(Quantity::$quantity, &variables, measurement(self), self.noise())
            }
        })*
    };
}

plain! {
    BetweenPoint2: Between of from to, |f| [f.measurement().x(), f.measurement().y()];
    BetweenPoint3: Between of from to,
        |f| [f.measurement().x(), f.measurement().y(), f.measurement().z()];
    Depth: Depth of key, |f| [f.measurement()];
    Heading2: Heading of key, |f| [f.measurement()];
    Heading3: Heading of key, |f| [f.measurement()];
    RollPitch: RollPitch of key, |f| [f.roll(), f.pitch()];
    PlanarMotion: PlanarMotion of key, |f| [f.measurement()];
    DepthDifference: DepthDifference of from to, |f| [f.measurement()];
    HeadingDifference: HeadingDifference of from to, |f| [f.measurement()];
    TranslationDifference2: TranslationDifference of from to,
        |f| [f.measurement().x(), f.measurement().y()];
    TranslationDifference3: TranslationDifference of from to,
        |f| [f.measurement().x(), f.measurement().y(), f.measurement().z()];
    Bearing2<Pose2>: Bearing of pose target, |f| [f.measurement()];
    Bearing2<Point2>: Bearing of pose target, |f| [f.measurement()];
    Bearing3<Pose3>: Bearing of pose target, |f| settle::direction(f.measurement());
    Bearing3<Point3>: Bearing of pose target, |f| settle::direction(f.measurement());
    BearingRange2<Pose2>: BearingRange of pose target, |f| [f.bearing(), f.range()];
    BearingRange2<Point2>: BearingRange of pose target, |f| [f.bearing(), f.range()];
    BearingRange3<Pose3>: BearingRange of pose target,
        |f| settle::direction(f.direction()).into_iter().chain([f.range()]);
    BearingRange3<Point3>: BearingRange of pose target,
        |f| settle::direction(f.direction()).into_iter().chain([f.range()]);
    Attitude: Attitude of key, |f| {
        let (world, seen) = (f.world_direction(), f.measurement());
        settle::direction(world).into_iter().chain(settle::direction(seen))
    };
}

impl Written for GpsPosition2 {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let (z, arm) = (self.measurement(), self.lever_arm());
        let all = [z.x(), z.y(), arm.x(), arm.y()];
        position(exporter, self.key(), &all, self.noise())
    }
}

impl Written for GpsPosition3 {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let (z, arm) = (self.measurement(), self.lever_arm());
        let all = [z.x(), z.y(), z.z(), arm.x(), arm.y(), arm.z()];
        position(exporter, self.key(), &all, self.noise())
    }
}

/// A position, of an antenna if its lever arm, the second half, has a length.
fn position(
    exporter: &mut Exporter,
    pose: VariableId,
    position_and_arm: &[f64],
    noise: &Noise,
) -> Option<Record> {
    let (position, arm) = position_and_arm.split_at(position_and_arm.len() / 2);
    let (quantity, numbers) = if arm.iter().all(|x| *x == 0.0) {
        (Quantity::Position, position)
    } else {
        (Quantity::AntennaPosition, position_and_arm)
    };
    exporter.measurement(quantity, &[pose], numbers.iter().copied(), noise)
}

impl<A: Manifold, B: Manifold, const D: usize> Written for Range<A, B, D> {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let mut ends = [self.a(), self.b()];
        let is_pose = |id| exporter.ends.get(&id).is_some_and(|(_, kind)| kind.is_pose());
        // Files name the pose first.
        if is_pose(ends[1]) && !is_pose(ends[0]) {
            ends.reverse();
        }
        exporter.measurement(Quantity::Range, &ends, [self.measurement()], self.noise())
    }
}

impl<G: LieGroup<N>, const N: usize> Written for PartialBetween<G, N> {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let at = numbers(self.measurement())?;
        let (combinations, noise) = self.few_combinations()?;
        let rows = combinations.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>());
        let numbers: Vec<f64> = at.numbers().iter().copied().chain(rows).collect();
        exporter.measurement(Quantity::Partial, &[self.from(), self.to()], numbers, &noise)
    }
}

/// More combinations than there are components say what `N` of them say.
trait FewCombinations {
    /// At most `N` combinations and their noise, with the same error at every point.
    fn few_combinations(&self) -> Option<(DMatrix<f64>, Noise)>;
}

impl<G, const N: usize> FewCombinations for PartialBetween<G, N> {
    fn few_combinations(&self) -> Option<(DMatrix<f64>, Noise)> {
        let combinations = self.combinations();
        if combinations.nrows() <= N {
            return Some((combinations.clone(), self.noise().clone()));
        }
        // ‖R A e‖ = ‖U e‖ with R A = Q U.
        let upper = (self.noise().sqrt_information() * combinations).qr().r();
        let rows: Vec<_> = upper.row_iter().filter(|row| row.amax() > 0.0).collect();
        let noise = Noise::isotropic(rows.len(), 1.0).ok()?;
        Some((DMatrix::from_rows(&rows), noise))
    }
}

impl Written for Linear {
    fn record(&self, exporter: &mut Exporter) -> Option<Record> {
        let mut points = Vec::new();
        for (variable, point) in self.keys().iter().zip(self.linearization_points()) {
            points.push((exporter.id(*variable)?, settled(point)?));
        }
        let g = self.sqrt_information();
        Some(Record::Linear(Box::new(LinearMeasurement {
            points,
            root_shift: self.root_shift(),
            rows: g.nrows(),
            sqrt_information: g.transpose().as_slice().to_vec(),
            offset: self.offset().as_slice().to_vec(),
        })))
    }
}
