//! Small worlds of known truth, as records.

use std::collections::BTreeMap;

use evergraph::formats::{
    Coordinates, Dialect, Document, EntryOrder, Kind, Line, Measurement, Quantity, Record, Weight,
    WeightKind,
};
use evergraph::model::{LieGroup, Point2, Point3, Pose2, Pose3, Rot3, Value};
use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::BatchSettings;
use evergraph::{Replayer, Settings};

/// Truth by id, and exact measurements of it.
#[derive(Clone, Debug, Default)]
pub struct World {
    pub truth: BTreeMap<u64, Truth>,
    pub lines: Vec<Line>,
}

#[derive(Clone, Copy, Debug)]
pub enum Truth {
    Pose2(Pose2),
    Pose3(Pose3),
    Point2(Point2),
    Point3(Point3),
}

impl Truth {
    pub fn kind(&self) -> Kind {
        self.coordinates().kind()
    }

    pub fn coordinates(&self) -> Coordinates {
        match self {
            Self::Pose2(x) => Coordinates::Pose2([x.x(), x.y(), x.theta()]),
            Self::Pose3(x) => {
                let [qx, qy, qz, qw] = x.rotation().quaternion();
                Coordinates::Pose3Quaternion([x.x(), x.y(), x.z(), qx, qy, qz, qw])
            }
            Self::Point2(p) => Coordinates::Point2([p.x(), p.y()]),
            Self::Point3(p) => Coordinates::Point3([p.x(), p.y(), p.z()]),
        }
    }

    pub fn value(&self) -> Value {
        match self {
            Self::Pose2(x) => Value::new(x),
            Self::Pose3(x) => Value::new(x),
            Self::Point2(p) => Value::new(p),
            Self::Point3(p) => Value::new(p),
        }
    }

    pub fn position(&self) -> Vec<f64> {
        match self {
            Self::Pose2(x) => vec![x.x(), x.y()],
            Self::Point2(p) => vec![p.x(), p.y()],
            Self::Pose3(x) => vec![x.x(), x.y(), x.z()],
            Self::Point3(p) => vec![p.x(), p.y(), p.z()],
        }
    }
}

/// A diagonal square root of the information.
pub fn sigma(sigma: f64, rows: usize) -> Weight {
    let entry = |i, j| if i == j { 1.0 / sigma } else { 0.0 };
    let entries: Vec<f64> = (0..rows).flat_map(|i| (i..rows).map(move |j| entry(i, j))).collect();
    let entries = entries.as_slice().into();
    Weight { kind: WeightKind::SquareRoot, order: EntryOrder::UpperTriangle, entries }
}

impl World {
    /// Adds poses in the plane, each ahead of the one before and turned, from `start`.
    pub fn drive2(&mut self, ids: std::ops::Range<u64>, start: Pose2, turn: f64) {
        let mut at = start;
        for id in ids.clone() {
            self.truth.insert(id, Truth::Pose2(at));
            at = at * Pose2::new(1.0, 0.1, turn);
        }
        (ids.start + 1..ids.end).for_each(|id| self.edge(id - 1, id));
    }

    /// Adds poses in space along a curve that bends and twists.
    pub fn drive3(&mut self, ids: std::ops::Range<u64>, start: Pose3) {
        let mut at = start;
        for id in ids.clone() {
            self.truth.insert(id, Truth::Pose3(at));
            let turn = Rot3::from_roll_pitch_yaw(0.1, -0.15, 0.2);
            at = at * Pose3::new(turn, Point3::new(1.0, 0.1, 0.05));
        }
        (ids.start + 1..ids.end).for_each(|id| self.edge(id - 1, id));
    }

    pub fn landmark2(&mut self, id: u64, x: f64, y: f64) {
        self.truth.insert(id, Truth::Point2(Point2::new(x, y)));
    }

    pub fn landmark3(&mut self, id: u64, x: f64, y: f64, z: f64) {
        self.truth.insert(id, Truth::Point3(Point3::new(x, y, z)));
    }

    pub fn pose2(&self, id: u64) -> Pose2 {
        let Truth::Pose2(x) = self.truth[&id] else { panic!("{id} is no pose in the plane") };
        x
    }

    pub fn pose3(&self, id: u64) -> Pose3 {
        let Truth::Pose3(x) = self.truth[&id] else { panic!("{id} is no pose in space") };
        x
    }

    /// A full relative measurement: odometry, or a landmark seen in full.
    pub fn edge(&mut self, from: u64, to: u64) {
        let seen = match (self.truth[&from], self.truth[&to]) {
            (Truth::Pose2(a), Truth::Pose2(b)) => Truth::Pose2(a.between(&b)),
            (Truth::Pose3(a), Truth::Pose3(b)) => Truth::Pose3(a.between(&b)),
            (Truth::Pose2(a), Truth::Point2(p)) => Truth::Point2(a.inverse_transform_point(&p)),
            (Truth::Pose3(a), Truth::Point3(p)) => Truth::Point3(a.inverse_transform_point(&p)),
            other => panic!("nobody sees {other:?}"),
        };
        let measurement = seen.coordinates();
        let weight = sigma(0.02, measurement.kind().dim());
        self.add(Record::Edge { from, to, measurement, weight, parameter: None });
    }

    pub fn add(&mut self, record: Record) {
        self.lines.push(record.into());
    }

    /// Changes what the file says about the last line.
    pub fn note(&mut self, note: impl FnOnce(&mut Line)) {
        note(self.lines.last_mut().expect("a line was added"));
    }

    /// A measurement of one variable or two with these numbers.
    pub fn measure(&mut self, quantity: Quantity, ends: &[u64], numbers: &[f64]) {
        let kinds: Vec<Kind> = ends.iter().map(|id| self.truth[id].kind()).collect();
        let rows =
            Measurement::shape(quantity, &kinds).expect("the quantity is measured on these").1;
        self.measure_with(quantity, ends, numbers, sigma(0.1, rows));
    }

    pub fn measure_with(
        &mut self,
        quantity: Quantity,
        ends: &[u64],
        numbers: &[f64],
        weight: Weight,
    ) {
        let ends = ends.iter().map(|id| (*id, self.truth[id].kind())).collect();
        let numbers = numbers.into();
        self.add(Record::Measurement(Box::new(Measurement {
            quantity,
            ends,
            numbers,
            weight,
            parameter: None,
        })));
    }

    /// Where a pose is.
    pub fn position(&mut self, id: u64) {
        let at = self.truth[&id].position();
        self.measure(Quantity::Position, &[id], &at);
    }

    pub fn prior(&mut self, id: u64) {
        let at = self.truth[&id].coordinates();
        self.measure(Quantity::Prior, &[id], at.numbers());
    }

    pub fn range(&mut self, a: u64, b: u64) {
        let (p, q) = (self.truth[&a].position(), self.truth[&b].position());
        let range = p.iter().zip(&q).map(|(p, q)| (p - q).powi(2)).sum::<f64>().sqrt();
        self.measure(Quantity::Range, &[a, b], &[range]);
    }

    /// Where a target is seen, and at what distance.
    fn seen(&self, pose: u64, target: u64) -> (Vec<f64>, f64) {
        let to = self.truth[&target].position();
        let direction = match self.truth[&pose] {
            Truth::Pose2(x) => {
                let p = x.inverse_transform_point(&Point2::new(to[0], to[1]));
                return (vec![p.y().atan2(p.x())], p.vector().norm());
            }
            Truth::Pose3(x) => x.inverse_transform_point(&Point3::new(to[0], to[1], to[2])),
            other => panic!("{other:?} sees nothing"),
        };
        (direction.vector().normalize().as_slice().to_vec(), direction.vector().norm())
    }

    pub fn bearing(&mut self, pose: u64, target: u64) {
        let (direction, _) = self.seen(pose, target);
        let rows = if direction.len() == 1 { 1 } else { 2 };
        self.measure_with(Quantity::Bearing, &[pose, target], &direction, sigma(0.01, rows));
    }

    pub fn bearing_range(&mut self, pose: u64, target: u64) {
        let (mut numbers, range) = self.seen(pose, target);
        numbers.push(range);
        self.measure(Quantity::BearingRange, &[pose, target], &numbers);
    }

    pub fn document(&self) -> Document {
        Document::from_records("world", Dialect::G2o, self.lines.iter().cloned())
            .unwrap_or_else(|error| panic!("{error}"))
    }

    /// Replays and optimizes.
    pub fn replay(&self) -> Replayer {
        self.replay_with(&ReplayOptions::default())
    }

    pub fn replay_with(&self, options: &ReplayOptions) -> Replayer {
        let mut replayer = Replayer::new(&self.document(), options, Settings::default())
            .unwrap_or_else(|error| panic!("{error}"));
        while replayer.step().unwrap_or_else(|error| panic!("{error}")).is_some() {}
        Self::finish(replayer)
    }

    /// All at once.
    pub fn batch(&self, initial: Initial) -> Replayer {
        let options = ReplayOptions::default().with_initial(initial);
        let mut replayer = Replayer::new(&self.document(), &options, Settings::default())
            .unwrap_or_else(|error| panic!("{error}"));
        replayer.everything().unwrap_or_else(|error| panic!("{error}"));
        Self::finish(replayer)
    }

    fn finish(mut replayer: Replayer) -> Replayer {
        // Of exact measurements no step ends the descent: the error is rounding. `check` tells.
        replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
        replayer
    }

    /// Everything that is not held back came in and is where it truly is.
    pub fn check(&self, replayer: &Replayer) {
        assert!(replayer.error().unwrap() < 1e-9, "error {}", replayer.error().unwrap());
        let replay = replayer.replay();
        assert_eq!(replay.ids().count(), self.truth.len() - replay.held_back());
        for (id, variable) in replay.ids() {
            let estimate = replayer.smoother().estimate_value(variable).unwrap();
            let truth = self.truth[&id].value();
            let mut off = vec![0.0; truth.dim()];
            truth.kind().local(truth.storage(), estimate.storage(), &mut off);
            let off = off.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            assert!(off < 1e-5, "{id} is off by {off}: {estimate:?} instead of {truth:?}");
        }
    }
}
