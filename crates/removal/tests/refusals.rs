//! Plans that are refused, and why.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_factors::{BetweenPose2, Linear, Prior, RelativePosition2, RootShift};
use evergraph_model::{
    Arguments, Factor, Graph, GraphError, Kernel, LieGroup, Linearization, Manifold, Noise, Point2,
    Pose2, Robust, Value, VariableId, VariableType,
};
use evergraph_removal::{
    Guard, MutualInformation, Offset, Options, Order, Rank, Recovery, Removal, RemovalError,
};
use evergraph_solver::{Settings, Smoother, SmootherError};
use nalgebra::{DMatrix, DVector};

#[test]
fn a_plan_goes_stale_with_anything_that_it_read() {
    let (smoother, keys) = chain(5);
    let plan =
        Removal::new(smoother.graph(), &smoother.estimates().unwrap()).plan(keys[2]).unwrap();
    let edge = |smoother: &Smoother, a: usize, b: usize| {
        let mut change = smoother.change();
        let z = Pose2::new((b - a) as f64, 0.0, 0.0);
        change.add_factor(BetweenPose2::new(keys[a], keys[b], z, sigma()).unwrap());
        change
    };
    let stale = |smoother: &mut Smoother| {
        let before = smoother.fingerprint();
        let error = smoother.apply(plan.change().clone()).unwrap_err();
        assert!(matches!(error, SmootherError::Graph(GraphError::Stale { .. })), "{error}");
        assert_eq!(smoother.fingerprint(), before, "a refusal alters nothing");
    };
    // A new factor on a variable of the blanket, on the node, and a moved linearization point.
    for (a, b) in [(0, 1), (2, 4)] {
        let mut other = smoother.clone();
        other.apply(edge(&other, a, b)).unwrap();
        stale(&mut other);
    }
    let mut other = smoother.clone();
    let mut change = other.change();
    change.move_linearization_point(keys[3], &Pose2::new(3.0, 0.2, 0.0));
    other.apply(change).unwrap();
    stale(&mut other);
    // A dropped factor, in the place of which another keeps the graph whole.
    let mut other = smoother.clone();
    let mut change = edge(&other, 1, 2);
    let dropped = other.graph().factors_of(keys[2].id()).unwrap()[0];
    change.drop_factor(dropped);
    other.apply(change).unwrap();
    stale(&mut other);
    // Another plan that shares the blanket.
    let mut other = smoother.clone();
    let first = Removal::new(other.graph(), &other.estimates().unwrap()).plan(keys[1]).unwrap();
    other.apply(first.into_change()).unwrap();
    stale(&mut other);
    // Nothing has changed.
    let mut other = smoother;
    assert!(plan.drift(&other.estimates().unwrap()).unwrap() < 1e-12);
    other.apply(plan.into_change()).unwrap();
}

#[test]
fn what_cannot_be_removed_is_said() {
    let (smoother, keys) = chain(3);
    let (graph, estimates) = (smoother.graph(), smoother.estimates().unwrap());
    let plan = |nodes: &[VariableId]| {
        Removal::new(graph, &estimates).plan_many(nodes, Order::Given).unwrap_err()
    };
    let ids: Vec<VariableId> = keys.iter().map(|k| k.id()).collect();
    assert!(matches!(plan(&[]), RemovalError::Nothing));
    assert!(matches!(plan(&[ids[1], ids[1]]), RemovalError::Twice { .. }));
    // All poses, one by one and as a group.
    assert!(matches!(plan(&ids), RemovalError::LastPose { .. } | RemovalError::NoBlanket { .. }));
    let error = Removal::new(graph, &estimates)
        .with_options(Options::dense())
        .plan_many(&ids, Order::Given)
        .unwrap_err();
    assert!(matches!(error, RemovalError::NoBlanket { .. }), "{error}");
    let (lonely, lone) = chain(1);
    let error =
        Removal::new(lonely.graph(), &lonely.estimates().unwrap()).plan(lone[0]).unwrap_err();
    assert!(matches!(error, RemovalError::LastPose { .. }), "{error}");
    // Ids of another graph, and removed ones.
    assert!(matches!(plan(&[lone[0].id()]), RemovalError::Graph(GraphError::Foreign { .. })));
    let mut smaller = smoother.clone();
    let gone = Removal::new(smaller.graph(), &smaller.estimates().unwrap()).plan(ids[1]).unwrap();
    smaller.apply(gone.into_change()).unwrap();
    let error =
        Removal::new(smaller.graph(), &smaller.estimates().unwrap()).plan(ids[1]).unwrap_err();
    assert!(matches!(error, RemovalError::Graph(GraphError::UnknownVariable { .. })), "{error}");
    // Estimates of an older graph.
    let error = Removal::new(graph, &smaller.estimates().unwrap()).plan(ids[1]).unwrap_err();
    assert!(matches!(error, RemovalError::Graph(GraphError::UnknownVariable { .. })), "{error}");
}

#[test]
fn the_last_pose_stays_with_its_landmarks() {
    use evergraph_factors::RelativePosition2;
    use evergraph_model::Point2;
    let scene = Scene::of(|change| {
        let pose = change.add_variable(&Pose2::identity());
        for k in 0..3 {
            let p = Point2::new(1.0, f64::from(k));
            let point = change.add_variable(&p);
            let noise = Noise::isotropic(2, 0.1).unwrap();
            change.add_factor(RelativePosition2::new(pose, point, p, noise).unwrap());
        }
    });
    let error = Removal::new(&scene.graph, &scene.values()).plan(scene.ids()[0]).unwrap_err();
    assert!(matches!(error, RemovalError::LastPose { .. }), "{error}");
}

/// Two poses that have nothing to do with each other: each could go, not both.
#[test]
fn the_last_pose_stays_whatever_the_order() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut change = smoother.change();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut poses = Vec::new();
    for k in 0..2 {
        let pose = change.add_variable(&Pose2::new(f64::from(k), 0.0, 0.0));
        let point = change.add_variable(&Point2::new(f64::from(k), 1.0));
        let prior = Prior::new(pose, Pose2::new(f64::from(k), 0.0, 0.0), noise.clone());
        change.add_factor(prior.unwrap());
        let two = Noise::isotropic(2, 0.1).unwrap();
        let seen = RelativePosition2::new(pose, point, Point2::new(0.0, 1.0), two);
        change.add_factor(seen.unwrap());
        poses.push(pose.id());
    }
    smoother.apply(change).unwrap();
    for order in [Order::Given, Order::Random(1), Order::MinDegree, Order::MinLoss] {
        let mut joint = |ids: &[VariableId]| smoother.joint(ids);
        let estimates = smoother.estimates().unwrap();
        let mut removal = Removal::new(smoother.graph(), &estimates).priced_by(&mut joint);
        let error = removal.plan_many(&poses, order).unwrap_err();
        assert!(matches!(error, RemovalError::LastPose { .. }), "{order:?}: {error}");
        assert!(removal.plan_many(&poses[..1], order).is_ok());
    }
}

#[test]
fn numbers_that_are_not_finite_are_named() {
    let (smoother, keys) = chain(4);
    let graph: &Graph = smoother.graph();
    let with = |bad: VariableId, value: Value| {
        let estimates = smoother.estimates().unwrap();
        let lookup = move |id: VariableId| {
            Ok(if id == bad { value.clone() } else { estimates.value(id)?.to_value() })
        };
        Removal::new(graph, &lookup).plan(keys[1]).unwrap_err()
    };
    let nan = Value::new(&Pose2::new(f64::NAN, 0.0, 0.0));
    let error = with(keys[2].id(), nan);
    assert!(
        matches!(&error, RemovalError::NonFiniteEstimate { variable, .. } if *variable == keys[2].id())
    );
    let far = Value::new(&Pose2::new(1e200, 0.0, 0.0));
    let error = with(keys[2].id(), far);
    assert!(matches!(error, RemovalError::NonFiniteFactor { .. }), "{error}");
    let other = Value::new(&evergraph_model::Point2::new(1.0, 2.0));
    let error = with(keys[0].id(), other);
    assert!(matches!(error, RemovalError::EstimateMismatch { .. }), "{error}");
    assert!(Pose2::identity().dim() == 3);
}

/// A user's factor with whatever numbers; one row on one or two poses.
#[derive(Debug)]
struct Odd {
    keys: Vec<VariableId>,
    jacobian: f64,
    residual: f64,
}

impl Factor for Odd {
    fn name(&self) -> String {
        "Odd".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.keys
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, _: usize, kind: &VariableType, _: usize) -> bool {
        kind.is::<Pose2>()
    }
    fn residual(&self, _: &Arguments<'_>, out: &mut [f64]) {
        out[0] = self.residual;
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.residual(at, out.residual_mut());
        for k in 0..self.keys.len() {
            out.block_mut(k)[0] = self.jacobian;
        }
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// The pose between two others, with an odd factor on it or beside it; every way to remove it.
#[test]
fn odd_factors_are_named_and_never_become_numbers() {
    let (inf, nan) = (f64::INFINITY, f64::NAN);
    for (jacobian, residual) in [
        (inf, 0.0),
        (nan, 0.0),
        (1.0, nan),
        (1.0, -inf),
        (1.0, 1e200),
        (1e200, 1.0),
        (1e300, 1e-300),
    ] {
        for pair in [[0, 1], [0, 2]] {
            let scene = Scene::of(|change| {
                let noise = || Noise::isotropic(3, 0.1).unwrap();
                let poses = [1.0, 0.0, 2.0].map(|x| Pose2::new(x, 0.0, 0.0));
                let keys = poses.map(|x| change.add_variable(&x));
                for k in [1, 2] {
                    let z = poses[0].between(&poses[k]);
                    change.add_factor(BetweenPose2::new(keys[0], keys[k], z, noise()).unwrap());
                }
                let keys = pair.map(|k| keys[k].id()).to_vec();
                change.add_factor(Odd { keys, jacobian, residual });
            });
            let others = [
                Options::default().with_offset(Offset::Zero),
                Options::dense().with_recovery(Recovery::Nonlinear),
                Options::isam(),
            ];
            for options in keeping().into_iter().chain(others) {
                let mut joint = |ids: &[VariableId]| {
                    Ok::<_, String>(DMatrix::identity(3 * ids.len(), 3 * ids.len()))
                };
                let result = Removal::new(&scene.graph, &scene.values())
                    .with_options(options)
                    .priced_by(&mut joint)
                    .plan(scene.ids()[0]);
                match result {
                    Err(RemovalError::NonFiniteFactor { name, variables, .. }) => {
                        assert_eq!((name.as_str(), variables.len()), ("Odd", 2));
                    }
                    // Finite, but their squares are not.
                    Err(
                        RemovalError::NotRepresentable { .. } | RemovalError::Covariance { .. },
                    ) => {
                        assert!(jacobian > 1e100 && jacobian.is_finite(), "{jacobian} {residual}");
                    }
                    Err(error) => panic!("{error}"),
                    Ok(plan) => {
                        assert!(jacobian.is_finite() && residual.is_finite());
                        assert!(plan.price().unwrap().is_finite() && plan.constant().is_finite());
                        let blanket = &plan.steps()[0].blanket;
                        let (j, r) = added(&scene, &plan, blanket);
                        assert!(j.iter().chain(r.iter()).all(|x| x.is_finite()));
                    }
                }
            }
        }
    }
}

/// Two trajectories that have nothing to do with each other, a pose that nobody measures, and a pose
/// that only its prior holds.
#[test]
fn parts_of_a_map_go_by_themselves() {
    let mut ids = Vec::new();
    let mut scene = Scene::of(|change| {
        for part in 0..2 {
            let poses = [0.0, 1.0, 2.0, 3.0].map(|x| Pose2::new(x, f64::from(part), 0.1));
            let keys = poses.map(|x| change.add_variable(&x));
            change.add_factor(Prior::new(keys[0], poses[0], sigma()).unwrap());
            for k in 1..4 {
                let z = poses[k - 1].between(&poses[k]);
                change.add_factor(BetweenPose2::new(keys[k - 1], keys[k], z, sigma()).unwrap());
            }
            ids.extend(keys.map(|key| key.id()));
        }
        ids.push(change.add_variable(&Pose2::identity()).id());
        let held = change.add_variable(&Pose2::identity());
        change.add_factor(Prior::new(held, Pose2::identity(), sigma()).unwrap());
        ids.push(held.id());
    });
    // Nothing of others is lost with a pose that has no factors, or only priors of its own.
    for (alone, dropped) in [(ids[8], 0), (ids[9], 1)] {
        let plan = Removal::new(&scene.graph, &scene.values()).plan(alone).unwrap();
        let [step] = plan.steps() else { panic!("{plan:?}") };
        assert_eq!((step.absorbed.len(), step.added.len(), step.rank), (dropped, 0, 0));
        scene.graph.stage(plan.change()).map(|staged| scene.graph.unstage(staged)).unwrap();
    }
    // A whole part cannot go, by whatever order; nodes of both parts can, each from its own.
    for order in [Order::Given, Order::Random(3), Order::MinDegree] {
        for options in [Options::default(), Options::dense()] {
            let values = scene.values();
            let mut removal = Removal::new(&scene.graph, &values).with_options(options);
            let error = removal.plan_many(&ids[..4], order).unwrap_err();
            assert!(matches!(error, RemovalError::NoBlanket { .. }), "{error}");
            let plan = removal.plan_many(&[ids[1], ids[5], ids[2], ids[6]], order).unwrap();
            for step in plan.steps() {
                let part = |id: &VariableId| ids.iter().position(|other| other == id).unwrap() / 4;
                let all: Vec<usize> = step.removed.iter().chain(&step.blanket).map(part).collect();
                assert!(all.iter().all(|&p| p == all[0]), "{step:?}");
            }
            scene.graph.stage(plan.change()).map(|staged| scene.graph.unstage(staged)).unwrap();
        }
    }
}

/// Compounding where a variable hangs on the node by a factor that is too light alone.
#[test]
fn composition_beside_a_light_factor_joins_the_others() {
    let scene = Scene::of(|change| {
        let poses = [0.0, 1.0, 2.0, 3.0].map(|x| Pose2::new(x, 0.0, 0.0));
        let keys = poses.map(|x| change.add_variable(&x));
        let kernel = Kernel::huber(1.0).unwrap();
        for (k, off) in [(1, 100.0), (2, 0.0), (3, 0.0)] {
            let z = Pose2::new(poses[k].x() + off, 0.0, 0.0);
            let factor = BetweenPose2::new(keys[0], keys[k], z, sigma()).unwrap();
            change.add_factor(Robust::new(factor, kernel));
        }
    });
    let ids = scene.ids();
    let options = Options::default().with_recovery(Recovery::Composition);
    let plan = scene.plan(ids[0], options);
    let step = &plan.steps()[0];
    assert_eq!((step.rejected.len(), step.absorbed.len(), step.added.len()), (1, 2, 1));
    let mut joined = step.added[0].variables.clone();
    joined.sort_unstable();
    assert_eq!(joined, [ids[2], ids[3]]);
}

/// With a least weight of 1 only what a kernel has taken from is left out. Sums of many squares in
/// two orders make weights of 1 ± ε.
#[test]
fn whole_weights_are_whole_to_rounding() {
    for seed in 0..20 {
        let mut draw = Draw::new(seed);
        let scene = Scene::of(|change| {
            let values = [(); 3].map(|()| draw.pose3());
            let keys = values.map(|x| change.add_variable(&x));
            for k in [1, 2] {
                let ends = [0, k].map(|k| (keys[k].id(), Value::new(&values[k])));
                let rows = DMatrix::from_fn(12, 12, |_, _| draw.number(3.0));
                let offset = DVector::from_fn(12, |_, _| draw.number(0.05));
                change.add_factor(Linear::new(&ends, RootShift::None, rows, offset).unwrap());
            }
        });
        let options = Options::default().with_least_weight(1.0);
        let plan = scene.plan(scene.ids()[0], options);
        assert!(plan.steps()[0].rejected.is_empty(), "no factor here is robust");
    }
}

#[test]
fn options_without_meaning_and_missing_parts_are_refused() {
    let (smoother, keys) = chain(4);
    let estimates = smoother.estimates().unwrap();
    let with = |options: Options| {
        Removal::new(smoother.graph(), &estimates).with_options(options).plan(keys[1]).unwrap_err()
    };
    let default = Options::default();
    for options in [
        default.with_least_weight(f64::NAN),
        default.with_least_weight(2.0),
        default.with_guard(Guard::default().with_rotation(0.0)),
        default.with_guard(Guard::default().with_mahalanobis(f64::NAN)),
        default.with_rank(Rank::Absolute(-1.0)),
        default.with_rank(Rank::Absolute(f64::INFINITY)),
    ] {
        let error = with(options);
        assert!(matches!(error, RemovalError::Option { .. }), "{error}");
    }
    let error = Removal::new(smoother.graph(), &estimates)
        .plan_many(&[keys[1].id()], Order::MinLoss)
        .unwrap_err();
    assert!(matches!(error, RemovalError::NeedsCovariance), "{error}");
    // The prior cannot be composed.
    let composition = default.with_recovery(Recovery::Composition);
    let error = Removal::new(smoother.graph(), &estimates)
        .with_options(composition)
        .plan(keys[0])
        .unwrap_err();
    let text = error.to_string();
    assert!(text.contains("x0") && text.contains("f0") && text.contains("Prior"), "{text}");
    // A covariance of another shape, one that is singular, one that cannot be had.
    let mut empty = |_: &[VariableId]| Ok::<_, String>(nalgebra::DMatrix::zeros(1, 1));
    let mut zero = |ids: &[VariableId]| {
        Ok::<_, String>(nalgebra::DMatrix::zeros(3 * ids.len(), 3 * ids.len()))
    };
    let mut none = |_: &[VariableId]| Err("no tree yet");
    let price: [&mut dyn evergraph_removal::Covariance; 3] = [&mut empty, &mut zero, &mut none];
    for covariance in price {
        let error = Removal::new(smoother.graph(), &estimates)
            .priced_by(covariance)
            .plan(keys[1])
            .unwrap_err();
        assert!(matches!(error, RemovalError::Covariance { .. }), "{error}");
    }
}

#[test]
fn options_are_data() {
    for options in [Options::default(), Options::dense(), Options::paper(), Options::isam()] {
        let text = serde_json::to_string(&options).unwrap();
        assert_eq!(serde_json::from_str::<Options>(&text).unwrap(), options, "{text}");
    }
    let given: Options = serde_json::from_str(r#"{"recovery":"nonlinear"}"#).unwrap();
    assert_eq!(given, Options::default().with_recovery(Recovery::Nonlinear));
    let given: Options = serde_json::from_str(r#"{"mutual_information":"limit"}"#).unwrap();
    let limit = MutualInformation::Limit;
    assert_eq!(given, Options::default().with_mutual_information(limit));
}

#[test]
fn a_blanket_that_would_take_too_long_is_refused() {
    let (smoother, keys) = chain(5);
    let plan = |largest_blanket| {
        let options = Options::default().with_largest_blanket(largest_blanket);
        Removal::new(smoother.graph(), &smoother.estimates().unwrap())
            .with_options(options)
            .plan(keys[2])
    };
    let error = plan(5).unwrap_err();
    assert!(
        matches!(error, RemovalError::LargeBlanket { dim: 6, largest: 5, variable } if variable == keys[2].id()),
        "{error}"
    );
    assert!(plan(6).is_ok());
}
