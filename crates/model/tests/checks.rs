//! The checks in `testing` find what they are for.

use std::any::Any;

use evergraph_model::testing::{JacobianError, check_gradient, check_jacobian, check_manifold};
use evergraph_model::{
    Arguments, EvaluationError, Factor, Graph, Kernel, Linearization, Manifold, Pose2, Robust,
    Value, VariableId, VariableType,
};

/// `r = (x², x θ)` of a pose's stored numbers, with one entry of its Jacobian off by a factor.
#[derive(Clone, Debug)]
struct Distorted {
    key: [VariableId; 1],
    factor: f64,
    residual_shift: f64,
}

impl Factor for Distorted {
    fn name(&self) -> String {
        "Distorted".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.key
    }
    fn residual_dim(&self) -> usize {
        2
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Pose2>()
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        let pose: Pose2 = at.get(0);
        out.copy_from_slice(&[pose.x() * pose.x(), pose.x() * pose.theta()]);
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        let pose: Pose2 = at.get(0);
        let (sin, cos) = pose.theta().sin_cos();
        let (x, theta) = (pose.x(), pose.theta());
        let block =
            [2.0 * x * cos, theta * cos, -2.0 * x * sin, -theta * sin, 0.0, x * self.factor];
        out.block_mut(0).copy_from_slice(&block);
        self.residual(at, out.residual_mut());
        out.residual_mut()[0] += self.residual_shift;
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}

fn distorted(factor: f64, residual_shift: f64) -> (Distorted, Value) {
    let pose = Pose2::new(3.0, 4.0, 0.5);
    let key = Graph::new().change().add_variable(&pose).id();
    (Distorted { key: [key], factor, residual_shift }, Value::new(&pose))
}

#[test]
fn a_wrong_entry_is_named() {
    let (right, at) = distorted(1.0, 0.0);
    let check = check_jacobian(&right, std::slice::from_ref(&at)).unwrap();
    assert_eq!(check.entries, 6);
    assert!(check.largest_deviation < 1e-9);
    for factor in [1.0 + 1e-5, -1.0, 0.0, f64::NAN] {
        let (wrong, at) = distorted(factor, 0.0);
        let error = check_jacobian(&wrong, &[at]).unwrap_err();
        let JacobianError::Entry { position: 0, row: 1, column: 2, component, .. } = &error else {
            panic!("{error}")
        };
        assert_eq!(component, "theta");
    }
    let (shifted, at) = distorted(1.0, 1e-6);
    assert!(matches!(check_jacobian(&shifted, &[at]), Err(JacobianError::Residual { row: 0, .. })));
    let (right, _) = distorted(1.0, 0.0);
    assert!(matches!(
        check_jacobian(&right, &[]),
        Err(JacobianError::Evaluation(EvaluationError::Count { .. }))
    ));
}

#[test]
fn a_gradient_without_its_weight_is_found() {
    let (right, at) = distorted(1.0, 0.0);
    let robust = Robust::new(right, Kernel::huber(0.5).unwrap());
    check_gradient(&robust, std::slice::from_ref(&at)).unwrap();
    let (wrong, _) = distorted(1.01, 0.0);
    let robust = Robust::new(wrong, Kernel::huber(0.5).unwrap());
    assert!(check_gradient(&robust, &[at]).is_err());
}

/// A manifold whose `local` is the wrong way round, or whose storage loses its sign.
#[derive(Clone, Debug, PartialEq)]
struct Broken<const HOW: u8>(f64);

impl<const HOW: u8> Manifold for Broken<HOW> {
    const NAME: &'static str = "Broken";
    const COMPONENTS: &'static [&'static str] = &["x"];
    fn dim(&self) -> usize {
        1
    }
    fn storage_len(&self) -> usize {
        1
    }
    fn store(&self, out: &mut [f64]) {
        out[0] = if HOW == 1 { self.0.abs() } else { self.0 };
    }
    fn load(storage: &[f64]) -> Self {
        Self(storage[0])
    }
    fn retract(&self, delta: &[f64]) -> Self {
        Self(self.0 + delta[0])
    }
    fn local(&self, other: &Self, out: &mut [f64]) {
        out[0] = if HOW == 2 { self.0 - other.0 } else { other.0 - self.0 };
    }
}

#[test]
fn broken_manifolds_are_found() {
    fn check<const HOW: u8>() -> Result<(), String> {
        check_manifold(&[Broken::<HOW>(1.0), Broken(-2.0)], &[vec![0.5]])
    }
    assert_eq!(check::<0>(), Ok(()));
    assert!(check::<1>().unwrap_err().contains("load(store(x))"));
    assert!(check::<2>().unwrap_err().contains("local(x, retract(x, d)) = d"));
}
