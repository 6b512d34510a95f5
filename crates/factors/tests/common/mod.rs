//! Seeded random variables and measurements, with the hard angles among them.
#![allow(dead_code, reason = "each test program uses its own part")]

use std::f64::consts::PI;

use evergraph_model::{
    Arguments, Factor, Graph, Key, LieGroup, Linearization, Manifold, Noise, Point2, Point3, Pose2,
    Pose3, Rot2, Rot3, Value,
};
use nalgebra::{DMatrix, DVector, SVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub const POINTS: usize = 1000;

pub struct Source(ChaCha8Rng);

impl Source {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.0.random_range(0..n)
    }

    /// A third anywhere, a third from 1e-10 to 1e-1, a third within 1e-1 to 1e-4 of half a turn.
    pub fn angle(&mut self) -> f64 {
        let sign = if self.below(2) == 0 { 1.0 } else { -1.0 };
        sign * match self.below(3) {
            0 => self.uniform(0.0, 3.1),
            1 => 10_f64.powf(self.uniform(-10.0, -1.0)),
            _ => PI - 10_f64.powf(self.uniform(-4.0, -1.0)),
        }
    }

    pub fn direction(&mut self) -> Vector3<f64> {
        loop {
            let v = Vector3::from_fn(|_, _| self.uniform(-1.0, 1.0));
            if v.norm() > 0.1 && v.norm() < 1.0 {
                return v.normalize();
            }
        }
    }

    pub fn point2(&mut self) -> Point2 {
        Point2::new(self.uniform(-50.0, 50.0), self.uniform(-50.0, 50.0))
    }

    pub fn point3(&mut self) -> Point3 {
        Point3::new(self.uniform(-50.0, 50.0), self.uniform(-50.0, 50.0), self.uniform(-50.0, 50.0))
    }

    /// Any noise that is well conditioned, with correlations.
    pub fn noise(&mut self, dim: usize) -> Noise {
        let root = DMatrix::from_fn(dim, dim, |i, j| {
            self.uniform(-1.0, 1.0) + if i == j { self.uniform(2.0, 20.0) } else { 0.0 }
        });
        Noise::from_sqrt_information(&root).expect("a finite square matrix")
    }
}

/// A manifold that can be sampled, with errors that reach half a turn.
pub trait Sample<const N: usize>: LieGroup<N> {
    fn tangent(source: &mut Source) -> SVector<f64, N>;
    fn sample(source: &mut Source) -> Self {
        Self::exp(&Self::tangent(source))
    }
}

impl Sample<1> for Rot2 {
    fn tangent(source: &mut Source) -> SVector<f64, 1> {
        SVector::<f64, 1>::new(source.angle())
    }
}
impl Sample<3> for Rot3 {
    fn tangent(source: &mut Source) -> SVector<f64, 3> {
        source.angle() * source.direction()
    }
}
impl Sample<2> for Point2 {
    fn tangent(source: &mut Source) -> SVector<f64, 2> {
        source.point2().vector()
    }
}
impl Sample<3> for Point3 {
    fn tangent(source: &mut Source) -> SVector<f64, 3> {
        source.point3().vector()
    }
}
impl Sample<3> for Pose2 {
    fn tangent(source: &mut Source) -> SVector<f64, 3> {
        let p = source.point2();
        Vector3::new(p.x(), p.y(), source.angle())
    }
}
impl Sample<6> for Pose3 {
    fn tangent(source: &mut Source) -> SVector<f64, 6> {
        let (p, r) = (source.point3(), Rot3::tangent(source));
        SVector::<f64, 6>::new(p.x(), p.y(), p.z(), r.x, r.y, r.z)
    }
}

/// A key of some graph; the value does not matter.
pub fn key<V: Manifold>(value: &V) -> Key<V> {
    Graph::new().change().add_variable(value)
}

/// Keys of one graph.
pub fn keys<A: Manifold, B: Manifold>(a: &A, b: &B) -> (Key<A>, Key<B>) {
    let mut change = Graph::new().change();
    (change.add_variable(a), change.add_variable(b))
}

pub fn values<A: Manifold, B: Manifold>(a: &A, b: &B) -> [Value; 2] {
    [Value::new(a), Value::new(b)]
}

/// A pose that is neither rolled nor pitched.
pub fn level(x: f64, y: f64, z: f64, yaw: f64) -> Pose3 {
    Pose3::new(Rot3::from_roll_pitch_yaw(0.0, 0.0, yaw), [x, y, z])
}

pub fn unit(dim: usize) -> Noise {
    Noise::isotropic(dim, 1.0).expect("one is a standard deviation")
}

pub fn residual(factor: &dyn Factor, values: &[Value]) -> Vec<f64> {
    let storages: Vec<&[f64]> = values.iter().map(Value::storage).collect();
    let mut out = vec![f64::NAN; factor.residual_dim()];
    factor.residual(&Arguments::new(&storages), &mut out);
    out
}

/// The whole Jacobian and the residual.
pub fn linearize(factor: &dyn Factor, at: &[Value]) -> (DMatrix<f64>, DVector<f64>) {
    let mut columns = vec![0];
    columns.extend(at.iter().scan(0, |end, v| {
        *end += v.dim() as u32;
        Some(*end)
    }));
    let (rows, width) = (factor.residual_dim(), columns[at.len()] as usize);
    let mut data = vec![0.0; rows * (width + 1)];
    let storages: Vec<&[f64]> = at.iter().map(Value::storage).collect();
    factor
        .linearize(&Arguments::new(&storages), &mut Linearization::new(rows, &columns, &mut data));
    let residual = data.split_off(rows * width);
    (DMatrix::from_vec(rows, width, data), DVector::from_vec(residual))
}

#[track_caller]
pub fn close(actual: &[f64], expected: &[f64]) {
    let close = actual.iter().zip(expected).all(|(a, e)| (a - e).abs() < 1e-12);
    assert!(close && actual.len() == expected.len(), "{actual:?} is not {expected:?}");
}
