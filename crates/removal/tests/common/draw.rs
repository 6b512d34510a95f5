//! Random neighborhoods with factors of every kind.

use evergraph_factors::*;
use evergraph_model::*;
use nalgebra::{DMatrix, DVector, SVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Scene;

/// Draws for random graphs.
pub struct Draw(pub ChaCha8Rng);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn number(&mut self, size: f64) -> f64 {
        self.0.random_range(-size..size)
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.0.random_range(0..n)
    }

    pub fn vector<const N: usize>(&mut self, size: f64) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.number(size))
    }

    pub fn pose2(&mut self) -> Pose2 {
        let [x, y, theta] = [8.0, 8.0, 3.0].map(|size| self.number(size));
        Pose2::new(x, y, theta)
    }

    pub fn pose3(&mut self) -> Pose3 {
        let mut d = self.vector::<6>(6.0);
        for k in 3..6 {
            d[k] *= 0.25;
        }
        Pose3::exp(&d)
    }

    /// A full noise with sigmas of quite different size.
    pub fn noise(&mut self, n: usize) -> Noise {
        let root = DMatrix::from_fn(n, n, |i, j| match i.cmp(&j) {
            std::cmp::Ordering::Less => self.number(3.0),
            std::cmp::Ordering::Equal => 5.0 + self.number(4.0),
            std::cmp::Ordering::Greater => 0.0,
        });
        Noise::from_sqrt_information(&root).unwrap()
    }
}

/// What a random neighborhood is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Full relative poses in the plane.
    Plane,
    /// Full relative poses in space.
    Space,
    /// Poses and points in the plane, all relative, of any rank.
    RelativePlane,
    /// Anything in the plane.
    AnyPlane,
    /// Anything in space.
    AnySpace,
    /// Poses in the plane and in space.
    Mixed,
}

pub const KINDS: [Kind; 6] =
    [Kind::Plane, Kind::Space, Kind::RelativePlane, Kind::AnyPlane, Kind::AnySpace, Kind::Mixed];

/// A node (the first variable) with `count` others around it; every factor is on it or on two of
/// the others, and a few intra-clique ones close loops.
pub fn neighborhood(kind: Kind, count: usize, seed: u64) -> Scene {
    let mut draw = Draw::new(seed);
    Scene::of(|change| match kind {
        Kind::Plane => {
            let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
            let keys: Vec<Key<Pose2>> = values.iter().map(|x| change.add_variable(x)).collect();
            for (i, j) in pairs(count, &mut draw) {
                between(change, &mut draw, (keys[i], values[i]), (keys[j], values[j]));
            }
        }
        Kind::Space => {
            let values: Vec<Pose3> = (0..=count).map(|_| draw.pose3()).collect();
            let keys: Vec<Key<Pose3>> = values.iter().map(|x| change.add_variable(x)).collect();
            for (i, j) in pairs(count, &mut draw) {
                between(change, &mut draw, (keys[i], values[i]), (keys[j], values[j]));
            }
        }
        Kind::RelativePlane | Kind::AnyPlane => plane(change, &mut draw, kind, count),
        Kind::AnySpace => space(change, &mut draw, count),
        Kind::Mixed => mixed(change, &mut draw, count),
    })
}

/// The node with each other, and some of the others with each other.
fn pairs(count: usize, draw: &mut Draw) -> Vec<(usize, usize)> {
    let mut pairs: Vec<(usize, usize)> = (1..=count).map(|k| (0, k)).collect();
    for _ in 0..draw.below(count + 1) {
        let (i, j) = (1 + draw.below(count), 1 + draw.below(count));
        if i != j {
            pairs.push((i, j));
        }
    }
    pairs
}

fn between<G: LieGroup<N>, const N: usize>(
    change: &mut Change,
    draw: &mut Draw,
    (i, from): (Key<G>, G),
    (j, to): (Key<G>, G),
) {
    let z = from.between(&to).compose(&G::exp(&draw.vector(0.03)));
    change.add_factor(Between::new(i, j, z, draw.noise(N)).unwrap());
}

fn plane(change: &mut Change, draw: &mut Draw, kind: Kind, count: usize) {
    let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
    let keys: Vec<Key<Pose2>> = values.iter().map(|x| change.add_variable(x)).collect();
    let point = Point2::new(draw.number(8.0), draw.number(8.0));
    let landmark = change.add_variable(&point);
    let local = |x: &Pose2| x.inverse_transform_point(&point);
    change.add_factor(
        RelativePosition2::new(keys[0], landmark, local(&values[0]), draw.noise(2)).unwrap(),
    );
    let mut known = false;
    for (i, j) in pairs(count, draw) {
        let ((ki, xi), (kj, xj)) = ((keys[i], values[i]), (keys[j], values[j]));
        let distance = (xj.translation().vector() - xi.translation().vector()).norm();
        match draw.below(8) {
            0 | 1 => between(change, draw, (ki, xi), (kj, xj)),
            2 => {
                let z = (distance + draw.number(0.1)).abs();
                change.add_factor(Range::new(ki, kj, z, draw.noise(1)).unwrap());
            }
            3 => {
                let seen = xi.inverse_transform_point(&xj.translation());
                let angle = seen.y().atan2(seen.x()) + draw.number(0.05);
                change.add_factor(Bearing2::new(ki, kj, angle, draw.noise(1)).unwrap());
            }
            4 => {
                let z = xi.between(&xj);
                change.add_factor(
                    PartialBetweenPose2::new(ki, kj, z, &[0, 2], draw.noise(2)).unwrap(),
                );
            }
            5 => {
                let seen = xi.inverse_transform_point(&xj.translation());
                let angle = seen.y().atan2(seen.x()) + draw.number(0.05);
                let z = (distance + draw.number(0.1)).abs();
                change.add_factor(BearingRange2::new(ki, kj, angle, z, draw.noise(2)).unwrap());
            }
            6 if kind == Kind::AnyPlane => {
                let d = xj.translation().vector() - xi.translation().vector();
                let d = Point2::new(d.x + draw.number(0.1), d.y);
                change.add_factor(TranslationDifference2::new(ki, kj, d, draw.noise(2)).unwrap());
            }
            _ if kind == Kind::AnyPlane => {
                known = true;
                let z = Point2::new(xi.x() + draw.number(0.2), xi.y());
                change.add_factor(
                    GpsPosition2::with_lever_arm(ki, z, Point2::new(0.3, 0.1), draw.noise(2))
                        .unwrap(),
                );
                change.add_factor(Heading2::new(kj, xj.theta(), draw.noise(1)).unwrap());
                between(change, draw, (ki, xi), (kj, xj));
            }
            _ => between(change, draw, (ki, xi), (kj, xj)),
        }
        if draw.below(3) == 0 {
            let z = (local(&xj).vector()).norm();
            change.add_factor(Range::new(kj, landmark, z, draw.noise(1)).unwrap());
        }
    }
    if kind == Kind::AnyPlane && !known && draw.below(2) == 0 {
        let z = values[1].compose(&Pose2::exp(&draw.vector(0.03)));
        change.add_factor(Prior::new(keys[1], z, draw.noise(3)).unwrap());
    }
}

fn space(change: &mut Change, draw: &mut Draw, count: usize) {
    let values: Vec<Pose3> = (0..=count).map(|_| draw.pose3()).collect();
    let keys: Vec<Key<Pose3>> = values.iter().map(|x| change.add_variable(x)).collect();
    let point = Point3::new(draw.number(8.0), draw.number(8.0), draw.number(8.0));
    let landmark = change.add_variable(&point);
    let local = |x: &Pose3| x.inverse_transform_point(&point);
    change.add_factor(
        Bearing3::new(keys[0], landmark, local(&values[0]).vector(), draw.noise(2)).unwrap(),
    );
    for (i, j) in pairs(count, draw) {
        let ((ki, xi), (kj, xj)) = ((keys[i], values[i]), (keys[j], values[j]));
        match draw.below(12) {
            0..=2 => between(change, draw, (ki, xi), (kj, xj)),
            3 => {
                change.add_factor(
                    RelativePosition3::new(kj, landmark, local(&xj), draw.noise(3)).unwrap(),
                );
                between(change, draw, (ki, xi), (kj, xj));
            }
            4 => {
                let z = (xj.translation().vector() - xi.translation().vector()).norm();
                change.add_factor(Range::new(ki, kj, z, draw.noise(1)).unwrap());
            }
            5 => {
                change
                    .add_factor(Depth::new(kj, xj.z() + draw.number(0.1), draw.noise(1)).unwrap());
                change.add_factor(
                    DepthDifference::new(ki, kj, xj.z() - xi.z(), draw.noise(1)).unwrap(),
                );
            }
            6 => {
                let down = Vector3::new(0.0, 0.0, -9.81);
                let seen = xj.rotation().inverse_rotate(&down) + draw.vector::<3>(0.1);
                change.add_factor(Attitude::new(kj, down, seen, draw.noise(2)).unwrap());
                between(change, draw, (ki, xi), (kj, xj));
            }
            7 => {
                let [roll, pitch, yaw] = xj.rotation().roll_pitch_yaw();
                let roll = roll + draw.number(0.02);
                change.add_factor(RollPitch::new(kj, roll, pitch, draw.noise(2)).unwrap());
                let yaw_from = xi.rotation().roll_pitch_yaw()[2];
                change.add_factor(Heading3::new(ki, yaw_from, draw.noise(1)).unwrap());
                let turn = yaw - yaw_from + draw.number(0.02);
                change.add_factor(HeadingDifference::new(ki, kj, turn, draw.noise(1)).unwrap());
            }
            8 => {
                let z = xj.z() + draw.number(0.1);
                change.add_factor(PlanarMotion::new(kj, z, draw.noise(3)).unwrap());
                let d = xj.translation().vector() - xi.translation().vector();
                let d = Point3::new(d.x, d.y + draw.number(0.1), d.z);
                change.add_factor(TranslationDifference3::new(ki, kj, d, draw.noise(3)).unwrap());
            }
            9 => {
                let seen = local(&xj).vector();
                let (z, noise) = (seen.norm() + draw.number(0.1), draw.noise(3));
                let direction = seen.normalize() + draw.vector::<3>(0.02);
                change.add_factor(BearingRange3::new(kj, landmark, direction, z, noise).unwrap());
                between(change, draw, (ki, xi), (kj, xj));
            }
            10 => {
                let picked = [0, 2, 5];
                let z = xi.between(&xj);
                change.add_factor(
                    PartialBetweenPose3::new(ki, kj, z, &picked, draw.noise(3)).unwrap(),
                );
            }
            _ => {
                let z = Point3::new(xj.x(), xj.y() + draw.number(0.1), xj.z());
                let lever = Point3::new(0.2, 0.0, -0.1);
                change
                    .add_factor(GpsPosition3::with_lever_arm(kj, z, lever, draw.noise(3)).unwrap());
                between(change, draw, (ki, xi), (kj, xj));
            }
        }
    }
}

/// Poses of both kinds around a pose in the plane, joined by linear factors.
fn mixed(change: &mut Change, draw: &mut Draw, count: usize) {
    let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
    let keys: Vec<Key<Pose2>> = values.iter().map(|x| change.add_variable(x)).collect();
    for (i, j) in pairs(count, draw) {
        between(change, draw, (keys[i], values[i]), (keys[j], values[j]));
    }
    let above: Vec<Pose3> = (0..2).map(|_| draw.pose3()).collect();
    let others: Vec<Key<Pose3>> = above.iter().map(|x| change.add_variable(x)).collect();
    between(change, draw, (others[0], above[0]), (others[1], above[1]));
    for (k, other) in others.iter().enumerate() {
        let rows = 2 + draw.below(4);
        let root = DMatrix::from_fn(rows, 9, |_, _| draw.number(4.0));
        let offset = DVector::from_fn(9, |_, _| draw.number(0.05));
        let variables =
            [(keys[0].id(), Value::new(&values[0])), (other.id(), Value::new(&above[k]))];
        change.add_factor(Linear::new(&variables, RootShift::None, root, offset).unwrap());
    }
}
