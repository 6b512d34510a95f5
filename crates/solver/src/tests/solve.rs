//! Back-substitution in a live smoother.

use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{LieGroup, Noise, Pose2, VariableIndex};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::factorization::Factorization;
use crate::settings::{Relinearization, Settings};
use crate::smoother::Smoother;
use crate::solve::{Pass, all};

/// One beyond the threshold takes those along that are within reach; none takes nobody.
#[test]
fn one_beyond_the_threshold_takes_others_along() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut change = smoother.change();
    for _ in 0..3 {
        let pose = change.add_variable(&Pose2::identity());
        change.add_factor(Prior::new(pose, Pose2::identity(), noise.clone()).unwrap());
    }
    smoother.apply(change).unwrap();
    let Factorization { graph, solution, .. } = &mut smoother.factorization;
    for (v, moved) in [(0, 0.3), (1, -0.15), (2, 0.05)] {
        let v = VariableIndex::new(v);
        solution.delta[graph.tangent_range(v).start] = moved;
        solution.far.push(v);
    }
    let mut moved = |threshold, reach| {
        let moved = solution.moved_beyond(graph, threshold, reach, 0.01);
        assert_eq!(moved.largest, 0.3);
        moved.variables.into_iter().map(VariableIndex::index).collect::<Vec<_>>()
    };
    assert_eq!(moved(0.25, 0.25), [0]);
    assert_eq!(moved(0.25, 0.1), [0, 1]);
    assert_eq!(moved(0.4, 0.1), [0; 0]);
}

/// After a fine pass δ is the exact one, whatever coarse passes have left.
#[test]
fn a_fine_pass_finds_all_small_changes() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let settings = Settings { relinearization: Relinearization::NEVER, ..Settings::default() };
    let mut smoother = Smoother::new(settings).unwrap();
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut change = smoother.change();
    let mut poses = vec![change.add_variable(&Pose2::identity())];
    let prior = Prior::new(poses[0], Pose2::identity(), noise.clone());
    change.add_factor(prior.unwrap());
    smoother.apply(change).unwrap();
    for k in 1..400_usize {
        let mut change = smoother.change();
        let pose = change.add_variable(&Pose2::new(k as f64, 0.0, 0.0));
        let mut tie = |from, length: f64| {
            let measured =
                Pose2::new(length + rng.random_range(-0.2..0.2), rng.random_range(-0.2..0.2), 0.0);
            change.add_factor(BetweenPose2::new(from, pose, measured, noise.clone()).unwrap());
        };
        tie(poses[k - 1], 1.0);
        if k % 3 == 0 {
            tie(poses[k / 2], (k - k / 2) as f64);
        }
        poses.push(pose);
        smoother.apply(change).unwrap();
        let is_fine = k % 20 == 0;
        let pass = Pass { fine: 1e-7, coarse: 0.05, is_fine, threshold: 1.0 };
        let Smoother { factorization, engine, .. } = &mut smoother;
        let Factorization { graph, tree, solution, .. } = factorization;
        solution.refresh(engine.instructions, graph, tree, pass);
        if is_fine {
            let exact = all(engine.instructions, graph, tree);
            let off = exact.iter().zip(&solution.delta).map(|(x, y)| (x - y).abs());
            let off = off.fold(0.0, f64::max);
            assert!(off < 1e-4, "step {k}: off by {off}");
        }
    }
}
