//! Benchmarks of the engine on simulated worlds. Run `cargo bench -p evergraph-benches`.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use evergraph::prelude::*;
use evergraph_benches::{city, replayed, sphere};

const NO_RELINEARIZATION: Settings = Settings {
    elimination: Elimination::Cholesky,
    relinearization: Relinearization::NEVER,
    back_substitution_tolerance: 1e-3,
    threads: 1,
};

/// A pose that continues the trajectory, in maps of different sizes: the time must not grow.
fn exploration(c: &mut Criterion) {
    let mut group = c.benchmark_group("exploration step");
    for poses in [100, 1000, 5000] {
        let base = replayed(&city(poses), NO_RELINEARIZATION, poses as usize).into_smoother();
        let newest = newest_pose(&base);
        let noise = Noise::isotropic(3, 0.1).expect("a positive sigma");
        group.bench_function(format!("city of {poses} poses"), |b| {
            // Many steps on one clone: cloning a map takes far longer than a step.
            b.iter_custom(|steps| {
                let mut smoother = base.clone();
                let mut last = newest;
                let mut total = Duration::ZERO;
                for _ in 0..steps {
                    let step = Pose2::new(1.0, 0.0, 0.0);
                    let guess = smoother.estimate(last).expect("the pose is there").compose(&step);
                    let mut change = smoother.change();
                    let pose = change.add_variable(&guess);
                    let odometry = BetweenPose2::new(last, pose, step, noise.clone());
                    change.add_factor(odometry.expect("a valid measurement"));
                    let start = Instant::now();
                    smoother.apply(change).expect("odometry determines a pose");
                    black_box(smoother.estimate(pose).expect("the pose is there"));
                    total += start.elapsed();
                    last = pose;
                }
                total
            });
        });
    }
    group.finish();
}

/// An edge between the newest pose and the oldest, in maps of different sizes.
fn loop_closure(c: &mut Criterion) {
    let mut group = c.benchmark_group("loop closure");
    group.sample_size(20);
    for poses in [1000, 5000] {
        let base = replayed(&city(poses), NO_RELINEARIZATION, poses as usize).into_smoother();
        let newest = newest_pose(&base);
        let first: Key<Pose2> = base
            .graph()
            .variables()
            .find_map(|id| base.graph().key(id).ok())
            .expect("the map has poses");
        let z = base
            .estimate(newest)
            .expect("the pose is there")
            .between(&base.estimate(first).expect("the pose is there"));
        let noise = Noise::isotropic(3, 0.1).expect("a positive sigma");
        group.bench_function(format!("city of {poses} poses"), |b| {
            b.iter_batched(
                || {
                    let smoother = base.clone();
                    let mut change = smoother.change();
                    let closure = BetweenPose2::new(newest, first, z, noise.clone());
                    change.add_factor(closure.expect("a valid measurement"));
                    (smoother, change)
                },
                |(mut smoother, change)| {
                    smoother.apply(change).expect("a loop closure only adds information");
                    smoother
                },
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

/// Whole replays with default settings, and one batch optimization at their end.
fn replays(c: &mut Criterion) {
    let mut group = c.benchmark_group("replay");
    group.sample_size(10);
    for (name, document, poses) in
        [("city 2000", city(2000), 2000), ("sphere 500", sphere(500), 500)]
    {
        group.bench_function(name, |b| b.iter(|| replayed(&document, Settings::default(), poses)));
        let base = replayed(&document, Settings::default(), poses).into_smoother();
        group.bench_function(format!("{name}, batch at the end"), |b| {
            b.iter_batched(
                || base.clone(),
                |mut smoother| {
                    smoother
                        .optimize(&BatchSettings::default())
                        .expect("the map is well determined");
                    smoother
                },
                BatchSize::LargeInput,
            );
        });
        group.bench_function(format!("{name}, all estimates"), |b| b.iter(|| base.estimates()));
    }
    group.finish();
}

fn newest_pose(smoother: &Smoother) -> Key<Pose2> {
    let poses = smoother.graph().variables().filter_map(|id| smoother.graph().key(id).ok());
    poses.last().expect("the map has poses")
}

criterion_group!(benches, exploration, loop_closure, replays);
criterion_main!(benches);
