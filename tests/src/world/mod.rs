//! Graphs of every kind of variable and every kind of factor, with known truth.

mod failures;
mod makers;
mod operations;
mod removals;
mod seen;
mod variables;

pub use makers::{MAKERS, Maker, catalogue};
pub use operations::{Operation, World};
pub use removals::Removals;

use evergraph::model::{
    Key, Manifold, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VariableId, VectorN,
};

/// A variable of a graph, with its true value.
#[derive(Clone, Debug)]
#[allow(missing_docs, reason = "each variant is the type of its name: key and truth")]
pub enum Variable {
    Pose2(Key<Pose2>, Pose2),
    Pose3(Key<Pose3>, Pose3),
    Point2(Key<Point2>, Point2),
    Point3(Key<Point3>, Point3),
    Rot2(Key<Rot2>, Rot2),
    Rot3(Key<Rot3>, Rot3),
    Vector(Key<VectorN>, VectorN),
}

/// The type of a [`Variable`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "each variant is the type of its name")]
pub enum Kind {
    Pose2,
    Pose3,
    Point2,
    Point3,
    Rot2,
    Rot3,
    Vector,
}

impl Variable {
    /// Its id.
    pub fn id(&self) -> VariableId {
        match self {
            Self::Pose2(key, _) => key.id(),
            Self::Pose3(key, _) => key.id(),
            Self::Point2(key, _) => key.id(),
            Self::Point3(key, _) => key.id(),
            Self::Rot2(key, _) => key.id(),
            Self::Rot3(key, _) => key.id(),
            Self::Vector(key, _) => key.id(),
        }
    }

    /// Its type.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Pose2(..) => Kind::Pose2,
            Self::Pose3(..) => Kind::Pose3,
            Self::Point2(..) => Kind::Point2,
            Self::Point3(..) => Kind::Point3,
            Self::Rot2(..) => Kind::Rot2,
            Self::Rot3(..) => Kind::Rot3,
            Self::Vector(..) => Kind::Vector,
        }
    }

    /// Its true value.
    pub fn truth(&self) -> Value {
        match self {
            Self::Pose2(_, truth) => Value::new(truth),
            Self::Pose3(_, truth) => Value::new(truth),
            Self::Point2(_, truth) => Value::new(truth),
            Self::Point3(_, truth) => Value::new(truth),
            Self::Rot2(_, truth) => Value::new(truth),
            Self::Rot3(_, truth) => Value::new(truth),
            Self::Vector(_, truth) => Value::new(truth),
        }
    }
}

/// Small numbers that look random and are the same in every run: a sequence shrinks better when
/// only its operations vary.
#[derive(Clone, Debug, Default)]
pub struct Wiggle(u32);

impl Wiggle {
    /// The next number, within ±`size`.
    pub fn next(&mut self, size: f64) -> f64 {
        self.0 = self.0.wrapping_add(1);
        size * (f64::from(self.0) * 12.9898).sin()
    }

    /// A vector of them.
    pub fn vector(&mut self, dim: usize, size: f64) -> Vec<f64> {
        (0..dim).map(|_| self.next(size)).collect()
    }

    /// A value moved a little.
    pub fn near<V: Manifold>(&mut self, value: &V, size: f64) -> V {
        value.retract(&self.vector(value.dim(), size))
    }
}
