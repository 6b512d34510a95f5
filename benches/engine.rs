//! Benchmarks of the engine on simulated worlds. Run `cargo bench -p evergraph-benches`.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::measurement::WallTime;
use criterion::{
    BatchSize, BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main,
};
use evergraph::Phase;
use evergraph::factors::LocalJacobian;
use evergraph::formats::Dialect;
use evergraph::prelude::*;
use evergraph_benches::{city, complete_graph, replayed, sphere};

type Group<'a> = BenchmarkGroup<'a, WallTime>;

fn no_relinearization() -> Settings {
    Settings::default().with_relinearization(Relinearization::NEVER)
}

/// A pose that continues the trajectory, in maps of different sizes: the time must not grow.
fn exploration(c: &mut Criterion) {
    let mut group = c.benchmark_group("exploration step");
    for poses in [100, 1000, 5000] {
        let base = replayed(&city(poses), no_relinearization(), poses as usize).into_smoother();
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
        let base = replayed(&city(poses), no_relinearization(), poses as usize).into_smoother();
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

/// Whole replays with default settings.
fn replays(c: &mut Criterion) {
    let mut group = c.benchmark_group("replay");
    group.sample_size(10);
    for (name, document) in worlds() {
        group.bench_function(name, |b| {
            b.iter(|| replayed(&document, Settings::default(), usize::MAX));
        });
    }
    group.finish();
}

/// An iteration of a batch optimization of the map that a replay leaves.
fn batch_iterations(c: &mut Criterion) {
    let mut group = c.benchmark_group("batch iteration");
    group.sample_size(10);
    for (name, document) in worlds() {
        let base = replayed(&document, Settings::default(), usize::MAX).into_smoother();
        // Linearize, order, eliminate; no step is taken.
        group.bench_function(format!("{name}, fresh ordering"), |b| {
            b.iter_custom(|times| (0..times).map(|_| iterations_of(&base, 0)).sum());
        });
        // A step solves, linearizes and eliminates again in the ordering that is there.
        group.bench_function(format!("{name}, cached ordering"), |b| {
            let step = || iterations_of(&base, 1).saturating_sub(iterations_of(&base, 0));
            b.iter_custom(|times| (0..times).map(|_| step()).sum());
        });
    }
    group.finish();
}

/// The time of so many iterations from `base`, and of the elimination before them.
fn iterations_of(base: &Smoother, iterations: u32) -> Duration {
    let settings = BatchSettings::default().with_max_iterations(iterations);
    let mut smoother = base.clone();
    let start = Instant::now();
    smoother.optimize(&settings).expect("the map is well determined");
    start.elapsed()
}

/// The elimination order of a whole graph that comes in as one change.
fn ordering(c: &mut Criterion) {
    let mut group = c.benchmark_group("ordering");
    group.sample_size(10);
    for (name, document) in worlds() {
        group.bench_function(name, |b| {
            b.iter_custom(|times| {
                let order = |_| {
                    let mut replayer = replayed(&document, no_relinearization(), 0);
                    replayer.smoother_mut().set_profiling(true);
                    replayer.everything().expect("the map is well determined");
                    replayer.smoother().profile().time(Phase::Order)
                };
                (0..times).map(order).sum()
            });
        });
    }
    group.finish();
}

/// Poses that are all measured from each other make a single front: the time of its dense
/// elimination, and operations per second (n³/3 for n scalars).
fn fronts(c: &mut Criterion) {
    let mut group = c.benchmark_group("front");
    for poses in [4, 16, 64] {
        front::<Pose2, 3>(&mut group, "2D", poses);
        front::<Pose3, 6>(&mut group, "3D", poses);
    }
    group.finish();
}

fn front<P, const N: usize>(group: &mut Group<'_>, name: &str, poses: usize)
where
    P: LieGroup<N> + LocalJacobian,
{
    let (base, keys) = complete_graph::<P, N>(poses);
    let noise = Noise::isotropic(N, 1.0).expect("a positive sigma");
    let scalars = (N * poses) as u64;
    group.throughput(Throughput::Elements(scalars.pow(3) / 3));
    group.bench_function(format!("{name}, {scalars} scalars"), |b| {
        b.iter_custom(|times| {
            let eliminate = |_| {
                let mut smoother = base.clone();
                let mut change = smoother.change();
                // Every pose is touched, so that the whole front is eliminated.
                for &key in &keys {
                    let prior = Prior::new(key, P::identity(), noise.clone());
                    change.add_factor(prior.expect("a valid measurement"));
                }
                smoother.set_profiling(true);
                let report = smoother.apply(change).expect("priors only add information");
                assert_eq!((report.cliques_eliminated, report.variables_eliminated), (1, poses));
                smoother.profile().time(Phase::Eliminate)
            };
            (0..times).map(eliminate).sum()
        });
    });
}

/// All estimates: back-substitution through the whole tree.
fn back_substitution(c: &mut Criterion) {
    let mut group = c.benchmark_group("back-substitution");
    for (name, document) in worlds() {
        let base = replayed(&document, Settings::default(), usize::MAX).into_smoother();
        group.bench_function(name, |b| b.iter(|| base.estimates()));
    }
    group.finish();
}

/// Text to records, in each format.
fn parsing(c: &mut Criterion) {
    let mut group = c.benchmark_group("parsing");
    for (name, document) in worlds() {
        for dialect in [Dialect::G2o, Dialect::Toro, Dialect::Isam, Dialect::Pyfg] {
            let mut text = Vec::new();
            document.write(&mut text, dialect).expect("every format holds poses");
            let options = ReadOptions::default().with_format(Some(dialect));
            group.throughput(Throughput::Bytes(text.len() as u64));
            group.bench_function(format!("{name}, {dialect}"), |b| {
                b.iter(|| {
                    Document::parse(name, text.as_slice(), &options)
                        .expect("what was written reads")
                });
            });
        }
    }
    group.finish();
}

/// A small map in 2D and one in 3D.
fn worlds() -> [(&'static str, Document); 2] {
    [("city of 2000 poses", city(2000)), ("sphere of 500 poses", sphere(500))]
}

fn newest_pose(smoother: &Smoother) -> Key<Pose2> {
    let poses = smoother.graph().variables().filter_map(|id| smoother.graph().key(id).ok());
    poses.last().expect("the map has poses")
}

criterion_group!(
    benches,
    exploration,
    loop_closure,
    batch_iterations,
    ordering,
    fronts,
    back_substitution,
    parsing,
    replays,
);
criterion_main!(benches);
