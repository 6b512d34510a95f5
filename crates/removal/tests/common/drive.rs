//! A drive through a small world.

use evergraph_factors::{BetweenPose2, GpsPosition2, Prior, RelativePosition2};
use evergraph_model::{Key, LieGroup, Noise, Point2, Pose2};
use evergraph_solver::{BatchSettings, Relinearization, Settings, Smoother, Status};

use super::Draw;

/// A drive around a square with closures, at its optimum. With `extras` there are landmarks and GPS
/// fixes too.
pub fn drive(count: usize, extras: bool, seed: u64) -> (Smoother, Vec<Key<Pose2>>) {
    let mut draw = Draw::new(seed);
    let settings = Settings::default().with_threads(1).with_relinearization(Relinearization::NEVER);
    let mut smoother = Smoother::new(settings).unwrap();
    let mut change = smoother.change();
    let side = |k: usize| (k / 3) % 4;
    let step = |k: usize| {
        let turn = if side(k) != side(k + 1) { std::f64::consts::FRAC_PI_2 } else { 0.0 };
        Pose2::new(1.0, 0.0, turn)
    };
    let mut truth = vec![Pose2::identity()];
    (1..count).for_each(|k| truth.push(truth[k - 1].compose(&step(k - 1))));
    let keys: Vec<Key<Pose2>> = truth
        .iter()
        .map(|x| change.add_variable(&x.compose(&Pose2::exp(&draw.vector(0.05)))))
        .collect();
    let noise = |draw: &mut Draw, n: usize| {
        let sigmas: Vec<f64> = (0..n).map(|_| 0.05 + draw.number(0.03)).collect();
        Noise::from_sigmas(&sigmas).unwrap()
    };
    change.add_factor(Prior::new(keys[0], truth[0], noise(&mut draw, 3)).unwrap());
    let mut edge = |draw: &mut Draw, i: usize, j: usize| {
        let z = truth[i].between(&truth[j]).compose(&Pose2::exp(&draw.vector(0.04)));
        change.add_factor(BetweenPose2::new(keys[i], keys[j], z, noise(draw, 3)).unwrap());
    };
    (1..count).for_each(|k| edge(&mut draw, k - 1, k));
    for k in 12..count {
        edge(&mut draw, k - 12, k);
        if draw.below(2) == 0 {
            edge(&mut draw, k - 11, k);
        }
    }
    if extras {
        let place = Point2::new(1.5, 4.0);
        let landmark = change.add_variable(&Point2::new(1.4, 4.1));
        for k in [1, 4, 5, count - 2] {
            let z = truth[k].inverse_transform_point(&place);
            let z = Point2::new(z.x() + draw.number(0.05), z.y());
            let factor = RelativePosition2::new(keys[k], landmark, z, noise(&mut draw, 2));
            change.add_factor(factor.unwrap());
            let fix = Point2::new(truth[k].x() + draw.number(0.1), truth[k].y());
            change.add_factor(GpsPosition2::new(keys[k], fix, noise(&mut draw, 2)).unwrap());
        }
    }
    smoother.apply(change).unwrap();
    optimum(&mut smoother);
    (smoother, keys)
}

pub fn optimum(smoother: &mut Smoother) {
    for _ in 0..3 {
        let report =
            smoother.optimize(&BatchSettings::default().with_relative_decrease(1e-15)).unwrap();
        assert!(matches!(report.status, Status::Converged), "{report:?}");
    }
}
