//! Every graph that can be built from the library's factors can be written and read back.

use std::sync::Arc;

use evergraph_factors::{
    Attitude, Bearing2, Bearing3, BearingRange2, BearingRange3, BetweenPoint2, BetweenPoint3,
    BetweenPose2, BetweenPose3, Conditioned, Depth, DepthDifference, GpsPosition2, GpsPosition3,
    Heading2, Heading3, HeadingDifference, Linear, PartialBetweenPose2, PartialBetweenPose3,
    PlanarMotion, Prior, Range, RelativePosition2, RelativePosition3, RollPitch, RootShift,
    TranslationDifference2, TranslationDifference3,
};
use evergraph_formats::{Dialect, Document, FormatError, Line, ReadOptions, Record};
use evergraph_model::{
    Arguments, Change, Factor, Graph, Kernel, Key, Manifold, Noise, Point2, Point3, Pose2, Pose3,
    Robust, Rot2, Rot3, Value, Values, VariableId,
};
use evergraph_replay::{Replay, ReplayOptions};
use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

struct World {
    rng: ChaCha8Rng,
    change: Change,
    singular: bool,
}

impl World {
    fn number(&mut self) -> f64 {
        self.rng.random_range(-3.0..3.0)
    }

    fn pose2(&mut self) -> Pose2 {
        Pose2::new(self.number(), self.number(), self.number())
    }

    fn point2(&mut self) -> Point2 {
        Point2::new(self.number(), self.number())
    }

    fn point3(&mut self) -> Point3 {
        Point3::new(self.number(), self.number(), self.number())
    }

    fn pose3(&mut self) -> Pose3 {
        let rotation = Rot3::from_roll_pitch_yaw(self.number(), self.number(), self.number());
        Pose3::new(rotation, self.point3())
    }

    fn direction(&mut self) -> Vector3<f64> {
        Vector3::new(self.number(), self.number(), self.number())
    }

    fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| self.number())
    }

    /// Any noise: correlated, diagonal or, where asked for, singular.
    fn noise(&mut self, dim: usize) -> Noise {
        let mut root = self.matrix(dim, dim) * 10.0;
        match self.rng.random_range(0..4) {
            0 if self.singular && dim > 1 => root.row_mut(0).fill(0.0),
            1 => root = DMatrix::from_diagonal(&root.diagonal()),
            _ => {}
        }
        Noise::from_sqrt_information(&root).expect("the numbers are finite")
    }

    fn add<F: Factor>(&mut self, factor: Result<F, evergraph_factors::FactorError>) {
        let factor = factor.expect("the factor is good");
        let kernel = match self.rng.random_range(0..4) {
            0 => Kernel::huber(1.345),
            1 => Kernel::pseudo_huber(0.7),
            _ => {
                self.change.add_factor(factor);
                return;
            }
        };
        let kernel = kernel.expect("the threshold is positive");
        self.change.add_factor(Robust::new(factor, kernel));
    }
}

/// A graph with each factor on each of its types of variables.
fn everything(seed: u64, singular: bool) -> (Graph, Values) {
    let mut graph = Graph::new();
    let mut w = World { rng: ChaCha8Rng::seed_from_u64(seed), change: graph.change(), singular };
    let w = &mut w;
    let add = |w: &mut World, p: Pose2| w.change.add_variable(&p);
    let (p, p2) = (w.pose2(), w.pose2());
    let (a, b) = (add(w, p), add(w, p2));
    let (p, p2) = (w.pose3(), w.pose3());
    let (c, d): (Key<Pose3>, Key<Pose3>) = (w.change.add_variable(&p), w.change.add_variable(&p2));
    let (p, p2) = (w.point2(), w.point2());
    let (l, m): (Key<Point2>, Key<Point2>) =
        (w.change.add_variable(&p), w.change.add_variable(&p2));
    let (p, p2) = (w.point3(), w.point3());
    let (n, o): (Key<Point3>, Key<Point3>) =
        (w.change.add_variable(&p), w.change.add_variable(&p2));

    macro_rules! add {
        ($($type:ident($($argument:expr),*) of $dim:literal;)*) => {
            $({
                let arguments = ($($argument,)*);
                let noise = w.noise($dim);
                add!(@ $type arguments noise ($($argument),*));
            })*
        };
        (@ $type:ident $arguments:ident $noise:ident ($a:expr)) => {
            w.add($type::new($arguments.0, $noise))
        };
        (@ $type:ident $arguments:ident $noise:ident ($a:expr, $b:expr)) => {
            w.add($type::new($arguments.0, $arguments.1, $noise))
        };
        (@ $type:ident $arguments:ident $noise:ident ($a:expr, $b:expr, $c:expr)) => {
            w.add($type::new($arguments.0, $arguments.1, $arguments.2, $noise))
        };
        (@ $type:ident $arguments:ident $noise:ident ($a:expr, $b:expr, $c:expr, $d:expr)) => {
            w.add($type::new($arguments.0, $arguments.1, $arguments.2, $arguments.3, $noise))
        };
    }
    let range = |w: &mut World| w.rng.random_range(0.0..5.0);
    let identity = Pose3::new(Rot3::from_roll_pitch_yaw(0.0, 0.0, 0.0), [0.0; 3]);
    add! {
        Prior(a, w.pose2()) of 3;
        Prior(c, w.pose3()) of 6;
        Prior(l, w.point2()) of 2;
        Prior(n, w.point3()) of 3;
        BetweenPose2(a, b, w.pose2()) of 3;
        BetweenPose3(d, c, w.pose3()) of 6;
        BetweenPoint2(l, m, w.point2()) of 2;
        BetweenPoint3(n, o, w.point3()) of 3;
        PartialBetweenPose2(a, b, w.pose2(), &[0, 2]) of 2;
        PartialBetweenPose3(c, d, w.pose3(), &[1, 2, 5]) of 3;
        RelativePosition2(a, l, w.point2()) of 2;
        RelativePosition3(c, n, w.point3()) of 3;
        GpsPosition2(a, w.point2()) of 2;
        GpsPosition3(c, w.point3()) of 3;
        Depth(c, w.number()) of 1;
        Heading2(a, w.number()) of 1;
        Heading3(c, w.number()) of 1;
        RollPitch(c, w.number(), 0.3) of 2;
        Attitude(d, w.direction(), w.direction()) of 2;
        PlanarMotion(c, w.number()) of 3;
        DepthDifference(c, d, w.number()) of 1;
        HeadingDifference(c, d, w.number()) of 1;
        TranslationDifference2(a, b, w.point2()) of 2;
        TranslationDifference3(d, c, w.point3()) of 3;
        Range(a, b, range(w)) of 1;
        Range(a, l, range(w)) of 1;
        Range(l, b, range(w)) of 1;
        Range(l, m, range(w)) of 1;
        Range(c, d, range(w)) of 1;
        Range(c, n, range(w)) of 1;
        Range(n, d, 0.0) of 1;
        Range(n, o, range(w)) of 1;
        Bearing2(a, b, w.number()) of 1;
        Bearing2(a, m, w.number()) of 1;
        Bearing3(c, d, w.direction()) of 2;
        Bearing3(c, o, w.direction()) of 2;
        BearingRange2(a, b, w.number(), range(w)) of 2;
        BearingRange2(a, m, w.number(), range(w)) of 2;
        BearingRange3(c, d, w.direction(), range(w)) of 3;
        BearingRange3(d, o, w.direction(), range(w)) of 3;
    }
    let (noise, z, arm) = (w.noise(2), w.point2(), w.point2());
    w.add(GpsPosition2::with_lever_arm(a, z, arm, noise));
    let (noise, z, arm) = (w.noise(3), w.point3(), w.point3());
    w.add(GpsPosition3::with_lever_arm(c, z, arm, noise));
    for sensor in [w.pose3(), identity, w.pose3()] {
        let (noise, z) = (w.noise(3), w.point3());
        w.add(RelativePosition3::with_sensor(d, o, z, sensor, noise));
    }
    // More combinations than the tangent has components, too.
    for rows in [1, 2, 3, 5] {
        let (noise, z, combinations) = (w.noise(rows), w.pose2(), w.matrix(rows, 3));
        w.add(PartialBetweenPose2::with_combinations(b, a, z, combinations, noise));
    }
    for rows in [1, 6, 9] {
        let (noise, z, combinations) = (w.noise(rows), w.pose3(), w.matrix(rows, 6));
        w.add(PartialBetweenPose3::with_combinations(c, d, z, combinations, noise));
    }
    for shift in [RootShift::None, RootShift::Root, RootShift::InverseRoot] {
        let points = [
            (c.id(), Value::new(&w.pose3())),
            (d.id(), Value::new(&w.pose3())),
            (n.id(), Value::new(&w.point3())),
        ];
        let (g, offset) = (w.matrix(4, 15), DVector::from_fn(15, |k, _| 0.01 * k as f64));
        w.add(Linear::new(&points, shift, g, offset));
        let points = [
            (b.id(), Value::new(&w.pose2())),
            (a.id(), Value::new(&w.pose2())),
            (m.id(), Value::new(&w.point2())),
        ];
        let (g, offset) = (w.matrix(9, 8), DVector::from_fn(8, |k, _| -0.01 * k as f64));
        w.add(Linear::new(&points, shift, g, offset));
    }
    let data: Vec<f64> =
        w.change.new_variables().iter().flat_map(|(_, value)| value.storage().to_vec()).collect();
    let staged = graph.stage(&w.change).expect("the change fits");
    graph.commit(staged);
    let values = Values::from_arena(&graph, &data);
    (graph, values)
}

/// The residuals of each factor at the values that `value` gives.
fn residuals(graph: &Graph, value: impl Fn(VariableId) -> Value) -> Vec<(Vec<u64>, f64)> {
    let mut all = Vec::new();
    for (_, factor) in graph.factors() {
        let values: Vec<Value> = factor.keys().iter().map(|key| value(*key)).collect();
        let storages: Vec<&[f64]> = values.iter().map(Value::storage).collect();
        let mut residual = vec![0.0; factor.residual_dim()];
        factor.residual(&Arguments::new(&storages), &mut residual);
        let bits = storages.iter().map(|s| (s[0] * 1e6) as i64 as u64).collect();
        all.push((bits, factor.error(&residual)));
    }
    all
}

fn written(document: &Document) -> String {
    let mut text = Vec::new();
    document.write(&mut text, Dialect::G2o).unwrap_or_else(|error| panic!("{error}"));
    String::from_utf8(text).expect("text is UTF-8")
}

#[test]
fn graphs_are_written_and_read_back() {
    for seed in 0..60 {
        // What is written of singular information is only equal to rounding the second time.
        let singular = seed % 2 == 1;
        let (graph, values) = everything(seed, singular);
        let document = Document::from_graph("graph", &graph, &values).unwrap();
        assert_eq!(
            document.records().filter(|record| record.is_factor()).count(),
            graph.factor_count()
        );
        let text = written(&document);
        let read = Document::parse("read", text.as_bytes(), &ReadOptions::default()).unwrap();
        assert!(document.lines().iter().map(same).eq(read.lines().iter().map(same)), "{text}");

        // The graph that the file makes has the same residuals.
        let options = ReplayOptions::default()
            .with_prior(None)
            .with_initial(evergraph_replay::Initial::FromFile);
        let mut replay = Replay::new(&read, &options).unwrap();
        let mut again = Graph::new();
        let mut change = again.change();
        replay.everything(&mut change).unwrap();
        let staged = again.stage(&change).unwrap();
        again.commit(staged);
        let start = change.new_variables().to_vec();
        let value_again =
            |id| start.iter().find(|(other, _)| *other == id).map(|(_, value)| value.clone());
        let mut before = residuals(&graph, |id| values.value(id).unwrap().to_value());
        let mut after = residuals(&again, |id| value_again(id).unwrap());
        let order = |a: &(Vec<u64>, f64), b: &(Vec<u64>, f64)| a.1.total_cmp(&b.1);
        before.sort_by(order);
        after.sort_by(order);
        assert_eq!(before.len(), after.len());
        for (b, a) in before.iter().zip(&after) {
            assert!((b.1 - a.1).abs() <= 1e-9 * (1.0 + b.1), "seed {seed}: {b:?} {a:?}");
        }

        // And is, as a document, the same to the last bit.
        let ids: std::collections::HashMap<VariableId, u64> =
            replay.ids().map(|(id, variable)| (variable, id)).collect();
        let second =
            Document::from_graph_with("again", &again, |id| ids.get(&id).copied(), value_again);
        let second = written(&second.unwrap());
        let sorted = |text: &str| {
            let mut lines: Vec<String> = text.lines().map(String::from).collect();
            lines.sort();
            lines
        };
        assert_eq!(text.lines().count(), second.lines().count());
        for (a, b) in sorted(&text).iter().zip(&sorted(&second)).filter(|_| !singular) {
            assert_eq!(a, b, "seed {seed}");
        }
    }
}

fn same(line: &Line) -> (Option<Kernel>, &Record) {
    (line.kernel(), &line.record)
}

fn of_one<V: Manifold>(
    value: &V,
    factor: impl FnOnce(Key<V>) -> Arc<dyn Factor>,
) -> (Graph, Values) {
    let mut graph = Graph::new();
    let mut change = graph.change();
    let key = change.add_variable(value);
    change.add_shared_factor(factor(key));
    let staged = graph.stage(&change).expect("the change fits");
    graph.commit(staged);
    let values = Values::from_arena(&graph, Value::new(value).storage());
    (graph, values)
}

#[test]
fn what_files_cannot_hold_is_named() {
    let noise = || Noise::isotropic(1, 1.0).unwrap();
    let rot = Rot2::from_angle(0.5);
    let (graph, values) = of_one(&rot, |key| Arc::new(Prior::new(key, rot, noise()).unwrap()));
    let error = Document::from_graph("g", &graph, &values).unwrap_err();
    assert!(matches!(error, FormatError::NoLineForVariable { kind: "Rot2", .. }), "{error}");
    assert!(error.to_string().contains("Rot2"), "{error}");

    let huber = Kernel::huber(1.0).unwrap();
    let pose = Pose2::new(1.0, 2.0, 3.0);
    let twice = |key| {
        let inner = Robust::new(Heading2::new(key, 0.1, noise()).unwrap(), huber);
        Arc::new(Robust::new(inner, huber)) as Arc<dyn Factor>
    };
    let (graph, values) = of_one(&pose, twice);
    let error = Document::from_graph("g", &graph, &values).unwrap_err();
    assert!(matches!(&error, FormatError::NoLineForFactor { ids, .. } if ids == &[0]), "{error}");
    assert!(error.to_string().contains("Heading2"), "{error}");

    // No line has given values, though one has the whole factor.
    let conditioned = |key: Key<Pose2>| {
        let mut change = Graph::new().change();
        let other = change.add_variable(&pose);
        let noise = Noise::isotropic(3, 1.0).unwrap();
        let whole = BetweenPose2::new(key, other, pose, noise).unwrap();
        let given = [(other.id(), Value::new(&pose))];
        Arc::new(Conditioned::new(Arc::new(whole), &given).unwrap()) as Arc<dyn Factor>
    };
    let (graph, values) = of_one(&pose, conditioned);
    let error = Document::from_graph("g", &graph, &values).unwrap_err();
    assert!(
        matches!(&error, FormatError::NoLineForFactor { factor, .. } if factor == "Conditioned<Between<Pose2>>"),
        "{error}"
    );

    let once = |key| Arc::new(Heading2::new(key, 0.1, noise()).unwrap()) as Arc<dyn Factor>;
    let (graph, values) = of_one(&pose, once);
    let value = |id: VariableId| values.value(id).ok().map(|value| value.to_value());
    for (id, given) in [(None, "id"), (Some(3), "value")] {
        let value = |variable| value(variable).filter(|_| given == "id");
        let error = Document::from_graph_with("g", &graph, |_| id, value).unwrap_err();
        assert!(matches!(&error, FormatError::NotGiven { what, .. } if *what == given), "{error}");
    }
    let document = Document::from_graph_with("g", &graph, |_| Some(7), value).unwrap();
    assert!(written(&document).ends_with("FACTOR_HEADING_SE2 7 0.1 1\n"));
}
