//! Factors and types that tests of the graph need; the real ones live in other crates.
#![allow(dead_code, reason = "each test uses its own part")]

use std::any::Any;

use evergraph_model::{
    Arguments, Factor, Linearization, Manifold, Point2, VariableId, VariableType,
};

/// `r = Σ (k + 1) xₖ` over points of the plane, in both coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Sum {
    pub keys: Vec<VariableId>,
}

impl Factor for Sum {
    fn name(&self) -> String {
        "Sum".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.keys
    }
    fn residual_dim(&self) -> usize {
        2
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Point2>()
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out.fill(0.0);
        for k in 0..at.len() {
            let point: Point2 = at.get(k);
            out[0] += (k + 1) as f64 * point.x();
            out[1] += (k + 1) as f64 * point.y();
        }
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        for k in 0..at.len() {
            let own = (k + 1) as f64;
            out.block_mut(k).copy_from_slice(&[own, 0.0, 0.0, own]);
        }
        self.residual(at, out.residual_mut());
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// Where code of a user fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    Name,
    Keys,
    Accepts,
    Residual,
    Linearize,
    /// A block of the wrong size.
    Block,
}

/// A factor on one point that fails as told.
#[derive(Clone, Debug)]
pub struct Faulty {
    pub key: [VariableId; 1],
    pub fault: Fault,
}

impl Faulty {
    fn fail_at(&self, place: Fault) {
        assert_ne!(self.fault, place, "the user's mistake");
    }
}

impl Factor for Faulty {
    fn name(&self) -> String {
        self.fail_at(Fault::Name);
        "Faulty".into()
    }
    fn keys(&self) -> &[VariableId] {
        self.fail_at(Fault::Keys);
        &self.key
    }
    fn residual_dim(&self) -> usize {
        2
    }
    fn accepts(&self, _: usize, _: &VariableType, _: usize) -> bool {
        self.fail_at(Fault::Accepts);
        // A factor that is not accepted is asked for its name.
        self.fault != Fault::Name
    }
    fn residual(&self, _: &Arguments<'_>, out: &mut [f64]) {
        self.fail_at(Fault::Residual);
        out.fill(1.0);
    }
    fn linearize(&self, _: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.fail_at(Fault::Linearize);
        if self.fault == Fault::Block {
            out.block_mut(0).copy_from_slice(&[1.0; 3]);
        }
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// A number whose `retract` fails for steps that are too long.
#[derive(Clone, Debug, PartialEq)]
pub struct Touchy(pub f64);

impl Manifold for Touchy {
    const NAME: &'static str = "Touchy";
    const COMPONENTS: &'static [&'static str] = &["x"];
    fn dim(&self) -> usize {
        1
    }
    fn storage_len(&self) -> usize {
        1
    }
    fn store(&self, out: &mut [f64]) {
        out[0] = self.0;
    }
    fn load(storage: &[f64]) -> Self {
        Self(storage[0])
    }
    fn retract(&self, delta: &[f64]) -> Self {
        assert!(delta[0].abs() < 10.0, "too far");
        Self(if delta[0].abs() > 1.0 { f64::NAN } else { self.0 + delta[0] })
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        out[0] = other.0 - self.0;
    }
}
