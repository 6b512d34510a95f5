//! Nodes taken out of a live smoother, one by one.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_factors::{BetweenPose2, Prior, RelativePosition2};
use evergraph_longterm::{Needed, Rules, Thinned, Thinning, ThinningFailure};
use evergraph_model::{GraphError, Key, LieGroup, Noise, Point2, Pose2, VariableId};
use evergraph_removal::{Options, Order, Recovery, RemovalError};
use evergraph_solver::{BatchSettings, Settings, Smoother};

/// A way with closures at its optimum; near its end poses see a landmark.
fn world(threads: usize) -> (Smoother, Vec<VariableId>) {
    let settings = Settings::default().with_threads(threads);
    let mut smoother = Smoother::new(settings).unwrap();
    let mut change = smoother.change();
    let noise = Noise::from_sigmas(&[0.1, 0.1, 0.02]).unwrap();
    let wiggle = |k: usize| 0.05 * ((7 * k) % 5) as f64 - 0.1;
    let poses: Vec<_> =
        (0..40).map(|k| change.add_variable(&Pose2::new(k as f64, wiggle(k), 0.0))).collect();
    change.add_factor(Prior::new(poses[0], Pose2::identity(), noise.clone()).unwrap());
    let mut edge = |from: usize, to: usize| {
        let z = Pose2::new((to - from) as f64, wiggle(to), 0.1 * wiggle(from));
        change.add_factor(BetweenPose2::new(poses[from], poses[to], z, noise.clone()).unwrap());
    };
    (1..40).for_each(|k| edge(k - 1, k));
    (3..40).step_by(3).for_each(|k| edge(k - 3, k));
    let landmark = change.add_variable(&Point2::new(30.0, 3.0));
    for (k, pose) in poses.iter().enumerate().take(33).skip(28) {
        let seen = Point2::new(30.0 - k as f64 + wiggle(k), 3.0);
        let noise = Noise::isotropic(2, 0.3).unwrap();
        change.add_factor(RelativePosition2::new(*pose, landmark, seen, noise).unwrap());
    }
    smoother.apply(change).unwrap();
    smoother.optimize(&BatchSettings::default()).unwrap();
    (smoother, poses.into_iter().map(Key::id).collect())
}

fn rules(order: Order, options: Options) -> Rules<'static> {
    Rules::default().with_order(order).with_options(options).with_prices(true)
}

fn run(order: Order, options: Options, threads: usize) -> (Thinning, Smoother, Vec<usize>) {
    let (mut smoother, poses) = world(threads);
    let mut done = 0;
    let rules = rules(order, options);
    let thinning = Thinning::run(&mut smoother, &poses[1..25], &rules, || done += 1).unwrap();
    assert_eq!((done, thinning.removed.len(), thinning.kept.len()), (24, 24, 0));
    assert_eq!(smoother.graph().variable_count(), 41 - 24);
    let place = |it: &Thinned| poses.iter().position(|pose| *pose == it.variable).unwrap();
    let order = thinning.removed.iter().map(place).collect();
    (thinning, smoother, order)
}

#[test]
fn orders_are_kept() {
    let (given, _, order) = run(Order::Given, Options::default(), 1);
    assert_eq!(order, (1..25).collect::<Vec<_>>());
    let (random, _, shuffled) = run(Order::Random(3), Options::default(), 1);
    assert_ne!(shuffled, order);
    assert_eq!(shuffled, run(Order::Random(3), Options::default(), 1).2);
    // Two neighbours in the chain are the fewest that any of them has.
    let (degree, ..) = run(Order::MinDegree, Options::default(), 1);
    assert!(degree.removed.iter().take(10).all(|it| it.blanket == 2), "{:?}", degree.removed);
    let (loss, ..) = run(Order::MinLoss, Options::default(), 1);
    let price = |thinning: &Thinning| thinning.price().unwrap();
    let first = |thinning: &Thinning| thinning.removed[0].price.unwrap();
    assert!(first(&loss) <= first(&given) && first(&loss) <= first(&random));
    assert!(price(&loss) <= price(&random) + 1e-12, "{} {}", price(&loss), price(&random));
}

#[test]
fn dense_removals_are_free() {
    for order in [Order::Given, Order::MinDegree, Order::MinLoss] {
        let (thinning, ..) = run(order, Options::dense(), 1);
        assert!(thinning.price().unwrap() < 1e-12);
    }
}

#[test]
fn threads_do_not_show() {
    for order in [Order::Random(1), Order::MinLoss] {
        let [one, two] = [1, 2].map(|threads| run(order, Options::default(), threads));
        let prices = |run: &(Thinning, Smoother, Vec<usize>)| {
            run.0.removed.iter().map(|it| it.price.unwrap().to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(prices(&one), prices(&two));
        assert_eq!(one.1.fingerprint(), two.1.fingerprint());
    }
}

/// The first can be composed; those that see the landmark cannot.
#[test]
fn a_refusal_ends_with_what_was_done_before_it() {
    let options = Options::default().with_recovery(Recovery::Composition);
    let rules = rules(Order::Given, options);
    let (mut expected, poses) = world(1);
    Thinning::run(&mut expected, &[poses[5]], &rules, || ()).unwrap();

    let (mut smoother, poses) = world(1);
    let mut done = 0;
    let nodes = [poses[5], poses[30], poses[7]];
    let error = Thinning::run(&mut smoother, &nodes, &rules, || done += 1).unwrap_err();
    let ThinningFailure::Removal(RemovalError::NotComposable { removed, .. }) = &error.failure
    else {
        panic!("{error}");
    };
    assert_eq!(*removed, poses[30]);
    assert_eq!((done, error.done.removed.len()), (1, 1));
    assert_eq!(error.done.removed[0].variable, poses[5]);
    assert_eq!(smoother.fingerprint(), expected.fingerprint());
    // It goes on from there.
    Thinning::run(&mut smoother, &[poses[7]], &rules, || ()).unwrap();
}

#[test]
fn what_makes_no_sense_is_refused() {
    let (mut smoother, poses) = world(1);
    let (other, _) = world(1);
    let strangers: Vec<VariableId> = other.graph().variables().collect();
    let before = smoother.fingerprint();
    let mut refused = |nodes: &[VariableId]| {
        let rules = rules(Order::Given, Options::default());
        match Thinning::run(&mut smoother, nodes, &rules, || ()).unwrap_err().failure {
            ThinningFailure::Removal(error) => error,
            other => panic!("{other}"),
        }
    };
    assert!(matches!(refused(&[]), RemovalError::Nothing));
    assert!(matches!(
        refused(&[poses[3], poses[4], poses[3]]),
        RemovalError::Twice { variable } if variable == poses[3]
    ));
    assert!(matches!(
        refused(&[poses[3], strangers[4]]),
        RemovalError::Graph(GraphError::Foreign { .. } | GraphError::UnknownVariable { .. })
    ));
    assert_eq!(smoother.fingerprint(), before);
}

/// With a limit the order decides who goes: what costs least goes, and costs less than chance does.
#[test]
fn a_limit_leaves_the_rest_to_the_order() {
    let at_most = |order, at_most| {
        let (mut smoother, poses) = world(1);
        let rules = rules(order, Options::default()).with_limit(at_most);
        let mut done = 0;
        let thinning = Thinning::run(&mut smoother, &poses[1..], &rules, || done += 1).unwrap();
        assert_eq!((thinning.removed.len(), done), (at_most, at_most));
        thinning.price().unwrap()
    };
    let least = at_most(Order::MinLoss, 12);
    for seed in 1..6 {
        assert!(least < at_most(Order::Random(seed), 12), "{least}");
    }
    assert_eq!(at_most(Order::Given, 0), 0.0);
}

/// A component keeps one of its nodes; a pose that shared no factor from the beginning has none to keep.
#[test]
fn the_last_node_of_a_component_stays() {
    let (mut smoother, _) = world(1);
    let noise = Noise::isotropic(3, 0.1).unwrap();
    let mut change = smoother.change();
    let at = |k: usize| Pose2::new(k as f64, 50.0, 0.0);
    let island: Vec<_> = (0..3).map(|k| change.add_variable(&at(k))).collect();
    for (k, pose) in island.iter().enumerate() {
        change.add_factor(Prior::new(*pose, at(k), noise.clone()).unwrap());
    }
    for k in 1..3 {
        let z = at(k - 1).between(&at(k));
        change.add_factor(BetweenPose2::new(island[k - 1], island[k], z, noise.clone()).unwrap());
    }
    let lonely = change.add_variable(&at(90));
    change.add_factor(Prior::new(lonely, at(90), noise).unwrap());
    smoother.apply(change).unwrap();
    let nodes: Vec<VariableId> = island.iter().chain([&lonely]).map(|key| key.id()).collect();
    let rules = Rules::default().with_order(Order::Given);
    let thinning = Thinning::run(&mut smoother, &nodes, &rules, || ()).unwrap();
    let removed: Vec<VariableId> = thinning.removed.iter().map(|it| it.variable).collect();
    assert_eq!(removed, [nodes[0], nodes[1], nodes[3]]);
    let [(kept, Needed::Planned(RemovalError::NoBlanket { variable }))] = &thinning.kept[..] else {
        panic!("{:?}", thinning.kept)
    };
    assert_eq!((*kept, *variable), (nodes[2], nodes[2]));
}
