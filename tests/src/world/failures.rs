//! Changes that must be refused, each for its own reason.

use evergraph::factors::{BetweenPose2, Prior};
use evergraph::model::{
    Arguments, Factor, GraphError, Key, LieGroup, Linearization, Noise, Point3, Pose2, Value,
    VariableId, VariableType, VectorN,
};
use evergraph::{Settings, Smoother, SmootherError};

use super::World;

/// A factor whose residual is not a number.
#[derive(Debug)]
struct NotANumber([VariableId; 1]);

impl Factor for NotANumber {
    fn name(&self) -> String {
        "NotANumber".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.0
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, _: usize, _: &VariableType, _: usize) -> bool {
        true
    }
    fn residual(&self, _: &Arguments<'_>, out: &mut [f64]) {
        out[0] = f64::NAN;
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

impl World {
    pub(super) fn fail(&mut self, how: u8) {
        let mut change = self.smoother.change();
        let some = self.variables[usize::from(how) % self.variables.len()].clone();
        let noise = |dim| Noise::isotropic(dim, 0.1).expect("a sound sigma");
        let prior =
            |key: Key<Pose2>| Prior::new(key, Pose2::identity(), noise(3)).expect("sound numbers");
        match how % 9 {
            0 => {
                change.add_variable(&Point3::new(0.0, 0.0, 0.0));
            }
            1 => {
                let a = change.add_variable(&Pose2::identity());
                let b = change.add_variable(&Pose2::identity());
                let z = Pose2::new(1.0, 0.0, 0.0);
                let between = BetweenPose2::new(a, b, z, noise(3));
                change.add_factor(between.expect("sound numbers"));
            }
            2 => {
                change.add_factor(NotANumber([some.id()]));
            }
            3 => {
                let start = change.add_variable(&Pose2::new(f64::INFINITY, 0.0, 0.0));
                change.add_factor(prior(start));
            }
            4 => {
                let Some(stale) = self.stale else { return };
                change.add_factor(prior(stale));
            }
            5 => {
                // Held by its factors, all of which stay.
                change.drop_variable(some.id());
            }
            6 => {
                let factors = self.smoother.graph().factors_of(some.id()).expect("it is there");
                let Some(&factor) = factors.first() else { return };
                change.drop_factor(factor).drop_factor(factor);
            }
            7 => {
                change = Smoother::new(Settings::default()).expect("sound settings").change();
                let start = change.add_variable(&Pose2::identity());
                change.add_factor(prior(start));
            }
            _ => {
                change.move_value(some.id(), Value::new(&VectorN::zeros(5)));
            }
        }
        let before = self.smoother.fingerprint();
        let error = match self.smoother.apply(change) {
            Ok(_) => panic!("failure {} was accepted", how % 9),
            Err(error) => error,
        };
        assert_eq!(self.smoother.fingerprint(), before, "failure {} left traces", how % 9);
        let expected = match how % 9 {
            0 | 1 => matches!(error, SmootherError::Singular(_)),
            2 => matches!(error, SmootherError::NonFinite { .. }),
            3 => matches!(error, SmootherError::Graph(GraphError::NonFiniteValue { .. })),
            4 => matches!(error, SmootherError::Graph(GraphError::UnknownVariable { .. })),
            5 => matches!(error, SmootherError::Graph(GraphError::StillHeld { .. })),
            6 => matches!(error, SmootherError::Graph(GraphError::Twice { .. })),
            7 => matches!(error, SmootherError::Graph(GraphError::Foreign { .. })),
            _ => matches!(error, SmootherError::Graph(GraphError::ValueMismatch { .. })),
        };
        assert!(expected, "failure {}: {error}", how % 9);
        self.refused += 1;
    }
}
