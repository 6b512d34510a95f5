//! Generic linear constraints.

mod common;

use common::{POINTS, Sample, Source, linearize};
use evergraph_factors::{FactorError, Linear, RootShift};
use evergraph_model::testing::assert_jacobian;
use evergraph_model::{
    Factor, Graph, LieGroup, Manifold, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VariableId,
    VectorN,
};
use nalgebra::{DMatrix, DVector, Vector3};

const SHIFTS: [RootShift; 3] = [RootShift::None, RootShift::Root, RootShift::InverseRoot];

/// A type that the library does not know.
#[derive(Clone, Debug, PartialEq)]
struct Foreign(Rot3);

impl Manifold for Foreign {
    const NAME: &'static str = "Foreign";
    const COMPONENTS: &'static [&'static str] = &[];
    fn dim(&self) -> usize {
        3
    }
    fn storage_len(&self) -> usize {
        4
    }
    fn store(&self, out: &mut [f64]) {
        self.0.store(out);
    }
    fn load(storage: &[f64]) -> Self {
        Self(Rot3::load(storage))
    }
    fn retract(&self, delta: &[f64]) -> Self {
        Self(self.0.retract(delta))
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        self.0.local(&other.0, out);
    }
}

fn named(points: &[Value]) -> Vec<(VariableId, Value)> {
    let mut change = Graph::new().change();
    points.iter().map(|point| (change.add_value(point.clone()), point.clone())).collect()
}

fn matrix(source: &mut Source, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| source.uniform(-2.0, 2.0))
}

fn vector(source: &mut Source, len: usize) -> DVector<f64> {
    DVector::from_fn(len, |_, _| source.uniform(-0.5, 0.5))
}

/// The same values, moved: translations by metres, rotations by up to half a turn.
fn moved<G: Sample<N>, const N: usize>(g: &G, source: &mut Source) -> Value {
    Value::new(&g.compose(&G::sample(source)))
}

#[test]
fn jacobians_hold_away_from_the_linearization_point() {
    let mut source = Source::new(71);
    for n in 0..POINTS {
        let shift = SHIFTS[n % 3];
        let (a, b, c) =
            (Pose2::sample(&mut source), Pose2::sample(&mut source), Pose2::sample(&mut source));
        let (p, q) = (source.point2(), Rot2::sample(&mut source));
        let points =
            [Value::new(&a), Value::new(&b), Value::new(&p), Value::new(&c), Value::new(&q)];
        let (g, d) = (matrix(&mut source, 4, 12), vector(&mut source, 12));
        let factor = Linear::new(&named(&points), shift, g, d).unwrap();
        let s = &mut source;
        let at = [moved(&a, s), moved(&b, s), moved(&p, s), moved(&c, s), moved(&q, s)];
        assert_jacobian(&factor, &at);

        let (a, b, r) =
            (Pose3::sample(&mut source), Pose3::sample(&mut source), Rot3::sample(&mut source));
        let p = source.point3();
        let points = [Value::new(&a), Value::new(&r), Value::new(&b), Value::new(&p)];
        let (g, d) = (matrix(&mut source, 9, 18), vector(&mut source, 18));
        let factor = Linear::new(&named(&points), shift, g, d).unwrap();
        let s = &mut source;
        let at = [moved(&a, s), moved(&r, s), moved(&b, s), moved(&p, s)];
        assert_jacobian(&factor, &at);
    }
}

#[test]
fn types_from_outside_are_differentiated_numerically() {
    let mut source = Source::new(72);
    for shift in SHIFTS {
        let (root, r) = (Pose3::sample(&mut source), Rot3::exp(&Vector3::new(0.3, -0.2, 1.0)));
        let vector_n = VectorN::new([1.0, 2.0]);
        let points = [Value::new(&root), Value::new(&Foreign(r)), Value::new(&vector_n)];
        let (g, d) = (matrix(&mut source, 5, 11), vector(&mut source, 11));
        let factor = Linear::new(&named(&points), shift, g, d).unwrap();
        let at = [
            moved(&root, &mut source),
            Value::new(&Foreign(r.compose(&Rot3::exp(&Vector3::new(0.5, 1.0, -1.5))))),
            Value::new(&VectorN::new([4.0, -1.0])),
        ];
        assert_jacobian(&factor, &at);
    }
}

#[test]
fn at_the_linearization_point_every_shift_gives_back_the_target() {
    let mut source = Source::new(73);
    let points = [
        Value::new(&Pose3::sample(&mut source)),
        Value::new(&Pose3::sample(&mut source)),
        Value::new(&source.point3()),
    ];
    // Of rank 7 out of 15, as targets are.
    let root = matrix(&mut source, 7, 15);
    let target = root.tr_mul(&root);
    let gradient = vector(&mut source, 15);
    for shift in SHIFTS {
        // Λ = RᵀΛ'R, so that G' = G R⁻¹ is a square root of Λ'.
        let inverse = shift.jacobian(&points).unwrap().try_inverse().unwrap();
        let factor =
            Linear::new(&named(&points), shift, &root * &inverse, DVector::zeros(15)).unwrap();
        let (jacobian, residual) = linearize(&factor, &points);
        assert!(residual.amax() < 1e-12);
        let information = jacobian.tr_mul(&jacobian);
        assert!((&information - &target).amax() < 1e-9 * target.amax(), "{shift:?}");
        // η = -Jᵀr = Rᵀ Λ' d'.
        let offset = shift.jacobian(&points).unwrap() * &gradient;
        let factor = Linear::new(&named(&points), shift, &root * &inverse, offset).unwrap();
        let (jacobian, residual) = linearize(&factor, &points);
        let eta = -jacobian.tr_mul(&residual);
        assert!((eta - &target * &gradient).amax() < 1e-9 * target.amax(), "{shift:?}");
    }
}

#[test]
fn the_derivative_of_a_shifted_pair_is_as_in_the_design() {
    let mut source = Source::new(74);
    let (a, b) = (Pose2::sample(&mut source), Pose2::sample(&mut source));
    let points = [Value::new(&a), Value::new(&b)];
    let jacobian = RootShift::Root.jacobian(&points).unwrap();
    let adjoint = a.between(&b).inverse().adjoint();
    let mut expected = DMatrix::<f64>::identity(6, 6);
    expected.view_mut((3, 0), (3, 3)).copy_from(&-adjoint);
    assert_eq!(jacobian, expected);
    let coordinates = RootShift::InverseRoot.coordinates(&points).unwrap();
    assert_eq!(coordinates[0].get::<Pose2>(), Some(a.inverse()));
    assert_eq!(coordinates[1].get::<Pose2>(), Some(a.between(&b)));
}

#[test]
fn a_purely_relative_factor_does_not_see_the_world_move() {
    let mut source = Source::new(75);
    let (a, b, world) =
        (Pose3::sample(&mut source), Pose3::sample(&mut source), Pose3::sample(&mut source));
    let p = source.point3();
    let points = [Value::new(&a), Value::new(&b), Value::new(&p)];
    let mut g = matrix(&mut source, 6, 15);
    g.columns_mut(0, 6).fill(0.0);
    let factor = Linear::new(&named(&points), RootShift::Root, g, vector(&mut source, 15)).unwrap();
    let residual = |a: &Pose3, b: &Pose3, p: &Point3| {
        linearize(&factor, &[Value::new(a), Value::new(b), Value::new(p)]).1
    };
    let c = b.compose(&Pose3::exp(&nalgebra::Vector6::new(0.1, 0.2, -0.3, 0.1, 0.0, 0.4)));
    let q = Point3::new(p.x() + 0.3, p.y() - 0.2, p.z() + 0.1);
    let moved = [world.compose(&a), world.compose(&c)];
    let difference =
        residual(&a, &c, &q) - residual(&moved[0], &moved[1], &world.transform_point(&q));
    assert!(difference.amax() < 1e-10, "{difference}");
}

#[test]
fn parts_that_do_not_fit_are_refused() {
    let points = named(&[Value::new(&Pose2::identity()), Value::new(&Point2::new(1.0, 2.0))]);
    let new = |shift, rows, columns, offset: Vec<f64>| {
        Linear::new(&points, shift, DMatrix::zeros(rows, columns), DVector::from_vec(offset))
    };
    assert!(new(RootShift::Root, 2, 5, vec![0.0; 5]).is_ok());
    for (rows, columns, offset) in [(2, 4, 5), (2, 5, 4), (0, 5, 5)] {
        let result = new(RootShift::Root, rows, columns, vec![0.0; offset]);
        assert!(matches!(result, Err(FactorError::Shape { .. })), "{rows} {columns} {offset}");
    }
    let result = new(RootShift::None, 2, 5, vec![0.0, 0.0, f64::NAN, 0.0, 0.0]);
    assert!(matches!(result, Err(FactorError::NotFinite { .. })));
    let none = Linear::new(&[], RootShift::None, DMatrix::zeros(1, 0), DVector::zeros(0));
    assert!(matches!(none, Err(FactorError::Shape { .. })));
    let point = named(&[Value::new(&Point3::identity())]);
    let shifted = Linear::new(&point, RootShift::Root, DMatrix::zeros(1, 3), DVector::zeros(3));
    assert_eq!(shifted.err(), Some(FactorError::RootIsNoPose { actual: "Point3" }));
}

#[test]
fn it_takes_only_the_types_of_its_linearization_points() {
    let points = named(&[Value::new(&Pose2::identity()), Value::new(&VectorN::new([1.0, 2.0]))]);
    let factor =
        Linear::new(&points, RootShift::None, DMatrix::zeros(1, 5), DVector::zeros(5)).unwrap();
    let accepts = |position, value: Value| factor.accepts(position, value.kind(), value.dim());
    assert!(accepts(0, Value::new(&Pose2::identity())));
    assert!(accepts(1, Value::new(&VectorN::new([0.0, 0.0]))));
    assert!(!accepts(1, Value::new(&VectorN::new([0.0]))));
    assert!(!accepts(1, Value::new(&Point2::identity())));
    assert!(!accepts(2, Value::new(&Point2::identity())));
}

/// A state of more numbers than a pose has.
#[test]
fn long_vectors_stand_beside_poses() {
    let mut source = Source::new(76);
    let long = VectorN::new((0..9).map(f64::from).collect::<Vec<_>>());
    let points = [Value::new(&Pose2::sample(&mut source)), Value::new(&long)];
    let (g, d) = (matrix(&mut source, 2, 12), vector(&mut source, 12));
    let factor = Linear::new(&named(&points), RootShift::Root, g, d).unwrap();
    assert_jacobian(&factor, &points);
}
