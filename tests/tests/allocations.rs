//! A steady stream of updates allocates nothing in nearly all steps. What grows with the map does so
//! now and then: arrays double, and buffers for the cliques that the map keeps are made many at a
//! time.

use std::alloc::System;

use evergraph::factors::{Between, LocalJacobian};
use evergraph::prelude::*;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Poses before the counting: until then buffers find their sizes.
const WARM_UP: usize = 500;
/// Poses when it ends: the map doubles three times while steps are counted.
const POSES: usize = 8 * WARM_UP;
/// Arrays that grow with the map may have this many doublings between them.
const DOUBLINGS: usize = 3 * 30;
/// A map that grows by a pose keeps up to this many buffers more; they are made many at a time.
const KEPT_PER_STEP: usize = 1;

/// Drives on by `step` from pose to pose, and counts what each `apply` allocates. Making the change
/// and its factors is not counted.
fn allocations_of_steps<P, const N: usize>(step: P, settings: Settings) -> Vec<usize>
where
    P: LieGroup<N> + LocalJacobian,
{
    // Headings so good that dead reckoning over the whole drive stays well-conditioned.
    let sigmas: [f64; N] = std::array::from_fn(|i| if i < N.div_ceil(2) { 0.1 } else { 1e-4 });
    let noise = Noise::from_sigmas(&sigmas).expect("positive sigmas");
    let mut smoother = Smoother::new(settings).expect("valid settings");
    let mut change = smoother.change();
    let mut last = change.add_variable(&P::identity());
    let prior = Prior::new(last, P::identity(), noise.clone());
    change.add_factor(prior.expect("a valid measurement"));
    smoother.apply(change).expect("a prior determines a pose");

    let mut counts = Vec::with_capacity(POSES);
    for _ in 1..POSES {
        // As a replay does: on from the estimate, which is what it asks for in each step.
        let guess = smoother.estimate(last).expect("the pose is there").compose(&step);
        let mut change = smoother.change();
        let pose = change.add_variable(&guess);
        let odometry = Between::new(last, pose, step, noise.clone());
        change.add_factor(odometry.expect("a valid measurement"));

        let region = Region::new(ALLOCATOR);
        let applied = smoother.apply(change);
        let made = region.change();

        applied.expect("odometry determines a pose");
        counts.push(made.allocations + made.reallocations);
        last = pose;
    }
    counts.split_off(WARM_UP)
}

/// How many steps made how many allocations.
fn in_words(counts: &[usize]) -> String {
    let mut sorted = counts.to_vec();
    sorted.sort_unstable();
    let groups = sorted.chunk_by(|a, b| a == b);
    let groups: Vec<String> =
        groups.map(|it| format!("{} in each of {} steps", it[0], it.len())).collect();
    groups.join(", ")
}

/// What is wrong with these counts, if anything is.
fn complaint(name: &str, counts: &[usize]) -> Option<String> {
    let total: usize = counts.iter().sum();
    let steps = counts.iter().filter(|&&count| count > 0).count();
    let most = DOUBLINGS + KEPT_PER_STEP * counts.len();
    let is_steady = 20 * steps <= counts.len() && total <= most + most / 4;
    let sizes = in_words(counts);
    (!is_steady).then(|| format!("{name}: {total} allocations in {steps} steps; {sizes}"))
}

/// One test, because the counters are those of the process.
#[test]
fn a_steady_state_allocates_nothing() {
    let never = Settings::default().with_relinearization(Relinearization::NEVER);
    let default = Settings::default();
    let qr = never.with_elimination(Elimination::Qr);
    let flat = Pose2::new(1.0, 0.0, 0.01);
    let turn = Rot3::exp(&[0.002, 0.001, 0.01].into());
    let space = Pose3::new(turn, Point3::new(1.0, 0.0, 0.02));
    let complaints: Vec<String> = [
        complaint("2D", &allocations_of_steps(flat, never)),
        complaint("2D, relinearizing", &allocations_of_steps(flat, default)),
        complaint("2D, QR", &allocations_of_steps(flat, qr)),
        complaint("3D", &allocations_of_steps(space, never)),
        complaint("3D, relinearizing", &allocations_of_steps(space, default)),
        complaint("3D, QR", &allocations_of_steps(space, qr)),
    ]
    .into_iter()
    .flatten()
    .collect();
    assert!(complaints.is_empty(), "{complaints:#?}");
}
