//! Random sequences of changes (adding, dropping factors and variables, moving linearization
//! points, failing on purpose) against the batch oracle.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::num::NonZeroU32;

use evergraph::factors::RelativePosition2;
use evergraph::model::FactorId;
use evergraph::prelude::*;
use evergraph::solver::Fluid;
use evergraph_tests::check_against_batch;
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Operation {
    Pose { turn: f64 },
    Landmark { from: usize },
    Closure { from: usize, to: usize },
    DropFactor { which: usize },
    DropVariable { which: usize },
    Move { which: usize },
    Lonely,
    Optimize,
}

fn operation() -> impl Strategy<Value = Operation> {
    prop_oneof![
        6 => (-0.6..0.6_f64).prop_map(|turn| Operation::Pose { turn }),
        2 => any::<usize>().prop_map(|from| Operation::Landmark { from }),
        4 => (any::<usize>(), any::<usize>()).prop_map(|(from, to)| Operation::Closure { from, to }),
        2 => any::<usize>().prop_map(|which| Operation::DropFactor { which }),
        2 => any::<usize>().prop_map(|which| Operation::DropVariable { which }),
        1 => any::<usize>().prop_map(|which| Operation::Move { which }),
        1 => Just(Operation::Lonely),
        1 => Just(Operation::Optimize),
    ]
}

/// A robot driving about, with what it knows of its keys.
struct World {
    smoother: Smoother,
    poses: Vec<(Key<Pose2>, Pose2)>,
    landmarks: Vec<(Key<Point2>, Point2)>,
    count: u32,
}

impl World {
    fn new(elimination: Elimination) -> Self {
        let every = |n| NonZeroU32::new(n).unwrap();
        let settings = Settings::default().with_elimination(elimination).with_relinearization(
            Relinearization::NEVER
                .with_fluid(Some(Fluid::new(0.2, 1.0, every(5)))) // at once
                .with_sweep(Some(Fluid::new(0.01, 1.0, every(3)))) // in slices
                .with_spread(every(4))
                .with_batch(Some(every(17))),
        );
        let mut smoother = Smoother::new(settings).unwrap();
        let mut change = smoother.change();
        let start = change.add_variable(&Pose2::identity());
        change.add_factor(
            Prior::new(start, Pose2::identity(), Noise::isotropic(3, 0.01).unwrap()).unwrap(),
        );
        smoother.apply(change).unwrap();
        Self { smoother, poses: vec![(start, Pose2::identity())], landmarks: Vec::new(), count: 0 }
    }

    /// Measurement noise without randomness: proptest shrinks better when only operations vary.
    fn noise(&mut self) -> Pose2 {
        self.count += 1;
        let k = f64::from(self.count);
        Pose2::new(0.05 * (12.9 * k).sin(), 0.05 * (78.2 * k).sin(), 0.02 * (37.7 * k).sin())
    }

    fn between(&mut self, i: usize, j: usize) -> BetweenPose2 {
        let z = self.poses[i].1.between(&self.poses[j].1).compose(&self.noise());
        BetweenPose2::new(
            self.poses[i].0,
            self.poses[j].0,
            z,
            Noise::from_sigmas(&[0.1, 0.05, 0.02]).unwrap(),
        )
        .unwrap()
    }

    fn run(&mut self, operation: &Operation) {
        let mut change = self.smoother.change();
        match *operation {
            Operation::Pose { turn } => {
                let (last, true_last) = self.poses[self.poses.len() - 1];
                let truth = true_last.compose(&Pose2::new(1.0, 0.0, turn));
                let guess =
                    self.smoother.estimate(last).unwrap().compose(&Pose2::new(1.0, 0.1, turn));
                self.poses.push((change.add_variable(&guess), truth));
                let n = self.poses.len();
                let factor = self.between(n - 2, n - 1);
                change
                    .add_factor(Robust::new(factor, evergraph::model::Kernel::huber(2.0).unwrap()));
            }
            Operation::Landmark { from } => {
                let (pose, truth) = self.poses[from % self.poses.len()];
                let seen = Point2::new(2.0, 1.0 + 0.1 * self.noise().x());
                let noise = Noise::isotropic(2, 0.1).unwrap();
                let again = self.landmarks.get(from % (self.landmarks.len() + 1)).copied();
                let (landmark, at) = again.unwrap_or_else(|| {
                    let at = truth.transform_point(&seen);
                    let landmark = change.add_variable(&at);
                    self.landmarks.push((landmark, at));
                    (landmark, at)
                });
                let seen = truth.inverse_transform_point(&at);
                change.add_factor(RelativePosition2::new(pose, landmark, seen, noise).unwrap());
            }
            Operation::Closure { from, to } => {
                let (i, j) = (from % self.poses.len(), to % self.poses.len());
                if i == j {
                    return;
                }
                change.add_factor(self.between(i, j));
            }
            Operation::DropFactor { which } => {
                let factors: Vec<FactorId> =
                    self.smoother.graph().factors().map(|(id, _)| id).collect();
                change.drop_factor(factors[which % factors.len()]);
            }
            Operation::DropVariable { which } => {
                // Landmarks, or the newest pose: what leaves the rest connected most often.
                let variable = match self.landmarks.get(which % (self.landmarks.len() + 1)) {
                    Some(landmark) => landmark.0.id(),
                    None if self.poses.len() == 1 => return,
                    None => self.poses[self.poses.len() - 1].0.id(),
                };
                change.drop_variable_and_factors(self.smoother.graph(), variable).unwrap();
            }
            Operation::Move { which } => {
                let (pose, _) = self.poses[which % self.poses.len()];
                let to = self.smoother.estimate(pose).unwrap().compose(&self.noise());
                change.move_linearization_point(pose, &to);
            }
            Operation::Lonely => {
                change.add_variable(&Point2::new(0.0, 0.0));
            }
            Operation::Optimize => {
                let before = self.smoother.error().unwrap();
                let report = self.smoother.optimize(&BatchSettings::default()).unwrap();
                assert!(report.error <= before * (1.0 + 1e-12));
                return;
            }
        }
        self.apply(change, operation);
    }

    fn apply(&mut self, change: Change, operation: &Operation) {
        let before = self.smoother.fingerprint();
        let dropped: Vec<VariableId> = change.dropped_variables().to_vec();
        let new: Vec<VariableId> = change.new_variables().iter().map(|v| v.0).collect();
        match self.smoother.apply(change) {
            Ok(_) => {
                assert!(
                    !matches!(operation, Operation::Lonely),
                    "a variable without factors was accepted"
                );
                self.poses.retain(|p| !dropped.contains(&p.0.id()));
                self.landmarks.retain(|l| !dropped.contains(&l.0.id()));
            }
            Err(error) => {
                assert!(matches!(error, SmootherError::Singular(_)), "{operation:?}: {error}");
                assert_eq!(
                    self.smoother.fingerprint(),
                    before,
                    "{operation:?} failed and left something behind"
                );
                self.poses.retain(|p| !new.contains(&p.0.id()));
                self.landmarks.retain(|l| !new.contains(&l.0.id()));
            }
        }
    }
}

fn check(operations: &[Operation], elimination: Elimination) {
    let mut world = World::new(elimination);
    for (step, operation) in operations.iter().enumerate() {
        world.run(operation);
        check_against_batch(&world.smoother, &format!("step {step}, {operation:?}"));
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 300,
        failure_persistence: Some(Box::new(proptest::test_runner::FileFailurePersistence::Direct(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/proptest-regressions/changes.txt"
        )))),
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_sequence_with_cholesky(operations in prop::collection::vec(operation(), 1..80)) {
        check(&operations, Elimination::Cholesky);
    }

    #[test]
    fn any_sequence_with_qr(operations in prop::collection::vec(operation(), 1..80)) {
        check(&operations, Elimination::Qr);
    }
}
