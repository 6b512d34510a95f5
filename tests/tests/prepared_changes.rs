//! Changes and removals prepared by two threads while a third applies them.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, RwLock};

use evergraph::model::{GraphError, Ids};
use evergraph::prelude::*;
use evergraph::removal::Removal;

/// Changes applied in all.
const STEPS: usize = 10_000;
/// Poses behind the newest that stay.
const WINDOW: usize = 30;

/// A change on its way to the thread that applies it.
struct Prepared {
    change: Change,
    /// Changes applied when it was prepared.
    seen: usize,
    /// The variables that it refers to, but for those that it adds.
    refers_to: BTreeSet<VariableId>,
}

fn noise() -> Noise {
    Noise::from_sigmas(&[0.05, 0.05, 0.01]).unwrap()
}

/// Odometry around a circle, several poses ahead of the graph: it never looks at it.
fn measure(
    ids: &Ids,
    start: Key<Pose2>,
    out: &SyncSender<Prepared>,
    poses: &SyncSender<Key<Pose2>>,
) {
    let step = Pose2::new(1.0, 0.0, 0.05);
    let (mut last, mut at) = (start, Pose2::identity());
    loop {
        at = at * step;
        let mut change = ids.change();
        let next = change.add_variable(&at);
        change.add_factor(BetweenPose2::new(last, next, step, noise()).unwrap());
        let refers_to = BTreeSet::from([last.id()]);
        // The other side hangs up when it has enough.
        if out.send(Prepared { change, seen: 0, refers_to }).is_err() || poses.send(next).is_err() {
            return;
        }
        last = next;
    }
}

/// Removals of poses that have left the window, planned on the graph as it is at some moment.
fn thin(
    state: &RwLock<(Smoother, usize)>,
    start: Key<Pose2>,
    poses: &Receiver<Key<Pose2>>,
    out: &SyncSender<Prepared>,
) {
    let mut trail = vec![start];
    let mut next = 1;
    while let Ok(pose) = poses.recv() {
        trail.push(pose);
        if trail.len() < next + WINDOW {
            continue;
        }
        let prepared = {
            let state = state.read().unwrap();
            let (smoother, seen) = &*state;
            if smoother.graph().check_variable(trail[next + WINDOW - 1].id()).is_err() {
                continue;
            }
            let plan = Removal::new(smoother.graph(), smoother).plan(trail[next]).unwrap();
            let change = plan.into_change();
            let refers_to = change.requires().iter().map(|(id, _)| *id).collect();
            Prepared { change, seen: *seen, refers_to }
        };
        next += 1;
        if out.send(prepared).is_err() {
            return;
        }
    }
}

/// The variables whose versions a change moves.
fn touches(graph: &Graph, change: &Change) -> BTreeSet<VariableId> {
    let dropped = change.dropped_factors().iter().filter_map(|id| graph.factor(*id).ok());
    let factors = change.new_factors().iter().map(|(_, factor)| factor).chain(dropped);
    factors.flat_map(|factor| factor.keys().to_vec()).collect()
}

#[test]
fn only_conflicts_are_refused_and_the_order_alone_decides() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut change = smoother.change();
    let start = change.add_variable(&Pose2::identity());
    change.add_factor(Prior::new(start, Pose2::identity(), noise()).unwrap());
    smoother.apply(change).unwrap();
    let ids = smoother.graph().ids();
    let mut alone = smoother.clone();
    let state = Arc::new(RwLock::new((smoother, 0)));
    let (measured, measurements) = sync_channel(20);
    let (planned, plans) = sync_channel(4);
    let (said, heard) = sync_channel(100);

    let mut order: Vec<Change> = Vec::new();
    let (mut removed, mut conflicts) = (0, 0);
    std::thread::scope(|scope| {
        scope.spawn(move || measure(&ids, start, &measured, &said));
        let shared = Arc::clone(&state);
        scope.spawn(move || thin(&shared, start, &heard, &planned));
        // What each applied change has touched.
        let mut touched: Vec<BTreeSet<VariableId>> = Vec::new();
        while order.len() < STEPS {
            for prepared in [plans.try_recv().ok(), measurements.recv().ok()].into_iter().flatten()
            {
                let mut state = state.write().unwrap();
                let is_removal = prepared.change.new_variables().is_empty();
                let touches = touches(state.0.graph(), &prepared.change);
                match state.0.apply(prepared.change.clone()) {
                    Ok(_) => {
                        removed += usize::from(is_removal);
                        order.push(prepared.change);
                        touched.push(touches);
                        state.1 = order.len();
                    }
                    Err(SmootherError::Graph(GraphError::Stale { .. })) => {
                        conflicts += 1;
                        let since = &touched[prepared.seen..];
                        assert!(
                            since.iter().any(|t| !t.is_disjoint(&prepared.refers_to)),
                            "nothing that was read has changed"
                        );
                    }
                    Err(error) => panic!("{error}"),
                }
            }
        }
        drop((plans, measurements));
    });
    println!("{removed} removals, {conflicts} conflicts");
    assert!(removed > STEPS / 10, "{removed} removals, {conflicts} conflicts");

    // The same changes in the same order, by one thread.
    for change in order {
        alone.apply(change).unwrap();
    }
    assert_eq!(alone.fingerprint(), state.read().unwrap().0.fingerprint());
}

#[test]
fn a_pose_and_a_removal_fit_into_one_change() {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let step = Pose2::new(1.0, 0.0, 0.1);
    let mut change = smoother.change();
    let mut poses = vec![change.add_variable(&Pose2::identity())];
    change.add_factor(Prior::new(poses[0], Pose2::identity(), noise()).unwrap());
    for k in 1..20 {
        poses.push(change.add_variable(&Pose2::new(f64::from(k), 0.0, 0.0)));
        let (a, b) = (poses[poses.len() - 2], poses[poses.len() - 1]);
        change.add_factor(BetweenPose2::new(a, b, step, noise()).unwrap());
    }
    smoother.apply(change).unwrap();
    smoother.optimize(&BatchSettings::default()).unwrap();
    let mut apart = smoother.clone();

    let measurement = |smoother: &Smoother| {
        let mut change = smoother.change();
        let new = change.add_variable(&(smoother.estimate(poses[19]).unwrap() * step));
        change.add_factor(BetweenPose2::new(poses[19], new, step, noise()).unwrap());
        (change, new)
    };
    let plan = |smoother: &Smoother| {
        Removal::new(smoother.graph(), smoother).plan(poses[5]).unwrap().into_change()
    };
    let (mut change, new) = measurement(&smoother);
    change.merge(plan(&smoother)).unwrap();
    smoother.apply(change).unwrap();

    let removal = plan(&apart);
    let (change, other) = measurement(&apart);
    apart.apply(change).unwrap();
    apart.apply(removal).unwrap();

    assert!(smoother.graph().check_variable(poses[5].id()).is_err());
    let (a, b) = (smoother.estimate(new).unwrap(), apart.estimate(other).unwrap());
    assert!((a.x() - b.x()).abs() + (a.y() - b.y()).abs() < 1e-9, "{a:?} {b:?}");
}
