//! The sparse divergence against plain dense algebra, and what it refuses.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph_evaluate::{
    Comparison, Consistency, Divergence, DivergenceError, Solved, information_nonzeros,
};
use evergraph_factors::{BetweenPose2, Prior, RelativePosition2};
use evergraph_model::{
    Graph, Kernel, LieGroup, Noise, Point2, Pose2, Robust, Value, Values, VariableId,
};
use evergraph_removal::{Options, Order, Removal, Topology};
use evergraph_solver::{BatchSettings, Settings, Smoother, SmootherError};
use nalgebra::{DMatrix, DVector};
use proptest::collection::vec;
use proptest::prelude::*;

/// A loop of poses with closures, landmarks and a robust factor, at its optimum.
fn world(
    poses: usize,
    closures: &[(usize, usize)],
    wiggles: &[f64],
) -> (Smoother, Vec<VariableId>) {
    let mut smoother = Smoother::new(Settings::default()).unwrap();
    let mut change = smoother.change();
    let noise = Noise::from_sigmas(&[0.1, 0.2, 0.05]).unwrap();
    let wiggle = |k: usize| wiggles[k % wiggles.len()];
    let at = |k: usize| Pose2::new(k as f64, wiggle(k), 0.3 * wiggle(k + 1));
    let keys: Vec<_> = (0..poses).map(|k| change.add_variable(&at(k))).collect();
    change.add_factor(Prior::new(keys[0], at(0), Noise::isotropic(3, 0.01).unwrap()).unwrap());
    let edge = |from: usize, to: usize| {
        let seen = at(from).between(&at(to));
        let off = Pose2::new(0.1 * wiggle(to), -0.1 * wiggle(from + 2), 0.05 * wiggle(to + 3));
        BetweenPose2::new(keys[from], keys[to], seen.compose(&off), noise.clone()).unwrap()
    };
    for k in 1..poses {
        change.add_factor(edge(k - 1, k));
    }
    for &(from, to) in closures {
        let (from, to) = (from % poses, to % poses);
        if from != to {
            change.add_factor(Robust::new(edge(from, to), Kernel::huber(0.8).unwrap()));
        }
    }
    let landmark = change.add_variable(&Point2::new(1.0, 2.0));
    for (k, key) in keys.iter().enumerate().take(4) {
        let seen = Point2::new(1.0 - k as f64 + 0.1 * wiggle(k), 2.0 + 0.1 * wiggle(k + 1));
        let noise = Noise::isotropic(2, 0.2).unwrap();
        change.add_factor(RelativePosition2::new(*key, landmark, seen, noise).unwrap());
    }
    smoother.apply(change).unwrap();
    settle(&mut smoother);
    let ids = smoother.graph().variables().collect();
    (smoother, ids)
}

fn settle(smoother: &mut Smoother) {
    let settings = BatchSettings::default().with_relative_decrease(0.0);
    smoother.optimize(&settings).unwrap();
}

/// Takes nodes out and optimizes again.
fn without(full: &Smoother, nodes: &[VariableId], options: Options) -> Smoother {
    let mut reduced = full.clone();
    let plan = Removal::new(full.graph(), &full.estimates().unwrap())
        .with_options(options)
        .plan_many(nodes, Order::Given)
        .unwrap();
    reduced.apply(plan.into_change()).unwrap();
    settle(&mut reduced);
    reduced
}

/// Both comparisons, on one factorization.
fn compared(full: &Smoother, reduced: &Smoother) -> (Divergence, Consistency) {
    let (was, is) = (full.estimates().unwrap(), reduced.estimates().unwrap());
    let kept: Vec<_> = reduced.graph().variables().map(|id| (id, id)).collect();
    let comparison = Comparison::new(
        Solved { graph: full.graph(), estimates: &was },
        Solved { graph: reduced.graph(), estimates: &is },
        &kept,
        &Settings::default(),
    )
    .unwrap();
    (comparison.divergence().unwrap(), comparison.consistency().unwrap())
}

fn compare(full: &Smoother, reduced: &Smoother) -> Result<Divergence, DivergenceError> {
    let (was, is) = (full.estimates().unwrap(), reduced.estimates().unwrap());
    let kept: Vec<_> = reduced.graph().variables().map(|id| (id, id)).collect();
    Divergence::of(
        Solved { graph: full.graph(), estimates: &was },
        Solved { graph: reduced.graph(), estimates: &is },
        &kept,
        &Settings::default(),
    )
}

/// `JᵀJ` at values, over `order`.
fn information(graph: &Graph, values: &Values, order: &[VariableId]) -> DMatrix<f64> {
    let mut points = vec![0.0; graph.value_len()];
    let mut starts = vec![0; graph.variable_slots()];
    let mut n = 0;
    for &id in order {
        points[graph.value_range(graph.variable_index(id).unwrap())]
            .copy_from_slice(values.value(id).unwrap().storage());
        starts[graph.variable_index(id).unwrap().index()] = n;
        n += graph.dim_at(graph.variable_index(id).unwrap());
    }
    let mut sum = DMatrix::zeros(n, n);
    for f in graph.factor_indices() {
        let rows = graph.rows_at(f);
        let mut block = vec![0.0; graph.linearization_len(f)];
        graph.linearize(f, &points, &mut block).unwrap();
        let mut wide = DMatrix::zeros(rows, n);
        let scalars = graph.variables_at(f).iter().flat_map(|&v| {
            let slot = v.index();
            starts[slot]..starts[slot] + graph.dim_at(v)
        });
        for (scalar, column) in scalars.zip(block.chunks_exact(rows)) {
            wide.set_column(scalar, &DVector::from_column_slice(column));
        }
        sum += wide.tr_mul(&wide);
    }
    sum
}

fn log_det(m: &DMatrix<f64>) -> f64 {
    2.0 * m.clone().cholesky().unwrap().l().diagonal().iter().map(|x| x.ln()).sum::<f64>()
}

/// Covariance P of the full graph and information Λ of the reduced one, and the step between their optima: straight from
/// the definition, by inverting.
fn dense(full: &Smoother, reduced: &Smoother) -> (DMatrix<f64>, DMatrix<f64>, DVector<f64>) {
    let kept: Vec<VariableId> = reduced.graph().variables().collect();
    let gone = full.graph().variables().filter(|id| !kept.contains(id));
    let order: Vec<VariableId> = kept.iter().copied().chain(gone).collect();
    let n = reduced.graph().dim();
    let (was, is) = (full.estimates().unwrap(), reduced.estimates().unwrap());
    let all = information(full.graph(), &was, &order).try_inverse().unwrap();
    let p = all.view((0, 0), (n, n)).into_owned();
    let l = information(reduced.graph(), &was, &kept);
    let mut d = Vec::new();
    for &id in &kept {
        let (was, is) = (was.value(id).unwrap(), is.value(id).unwrap());
        let mut moved = vec![0.0; was.dim()];
        was.kind().local(was.storage(), is.storage(), &mut moved);
        d.extend(moved);
    }
    (p, l, DVector::from_vec(d))
}

/// The largest eigenvalue of the reduced information, and the number of variables whose covariance is too small.
fn dense_consistency(p: &DMatrix<f64>, l: &DMatrix<f64>, dims: &[usize]) -> (f64, usize) {
    let root = p.clone().cholesky().unwrap().l();
    let largest = (root.transpose() * l * &root).symmetric_eigenvalues().max();
    let claimed = l.clone().try_inverse().unwrap();
    let (mut start, mut count) = (0, 0);
    for &dim in dims {
        let [right, claimed] =
            [p, &claimed].map(|m| m.view((start, start), (dim, dim)).into_owned());
        let root = right.cholesky().unwrap().l().try_inverse().unwrap();
        let ratios = (&root * claimed * root.transpose()).symmetric_eigenvalues();
        count += usize::from(ratios.min() < 1.0 - 1e-6);
        start += dim;
    }
    (largest, count)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn sparse_is_dense(
        closures in vec((0_usize..14, 0_usize..14), 0..12),
        wiggles in vec(-1.0..1.0, 5..9),
        gone in vec(1_usize..14, 1..9),
        tree in any::<bool>(),
        paper in any::<bool>(),
    ) {
        let (full, ids) = world(14, &closures, &wiggles);
        let mut gone: Vec<VariableId> = gone.into_iter().map(|k| ids[k]).collect();
        gone.sort_unstable();
        gone.dedup();
        let options = (if paper { Options::paper() } else { Options::default() }).with_topology(if tree { Topology::ChowLiu } else { Topology::Dense });
        let reduced = without(&full, &gone, options);
        let (found, consistency) = compared(&full, &reduced);
        let (p, l, d) = dense(&full, &reduced);
        let n = p.nrows() as f64;
        let graph = reduced.graph();
        let dims: Vec<usize> = graph.variables().map(|id| graph.dim_at(graph.variable_index(id).unwrap())).collect();
        let ratio = -log_det(&l) - log_det(&p);
        let covariance = 0.5 * ((&l * &p).trace() - n + ratio);
        let mean = 0.5 * d.dot(&(&l * &d));
        prop_assert!((found.log_det_ratio - ratio).abs() < 1e-7 * (1.0 + ratio.abs()), "{found:?} {ratio}");
        let (largest, overconfident) = dense_consistency(&p, &l, &dims);
        prop_assert!((consistency.largest_eigenvalue - largest).abs() < 1e-6 * largest, "{consistency:?} {largest}");
        prop_assert_eq!(consistency.overconfident, overconfident, "{:?}", consistency);
        prop_assert_eq!(consistency.is_conservative(), largest < 1.0 + 1e-6, "{:?}", consistency);
        prop_assert!((found.covariance - covariance).abs() < 1e-7 * (1.0 + covariance), "{found:?} {covariance}");
        prop_assert!((found.mean - mean).abs() < 1e-9 * (1.0 + mean), "{found:?} {mean}");
        prop_assert!(found.covariance > -1e-8);
        prop_assert_eq!(found.degrees_of_freedom, reduced.graph().dim());
        if !tree {
            prop_assert!(found.covariance < 1e-7, "{found:?}");
        }
        if !paper {
            prop_assert!(found.max_shift_m < 1e-6, "{found:?}");
        }
    }
}

#[test]
fn a_graph_has_lost_nothing_of_itself() {
    let (full, ids) = world(10, &[(0, 6), (2, 9)], &[0.3, -0.2, 0.7]);
    let found = compare(&full, &full).unwrap();
    assert!(found.covariance.abs() < 1e-10 && found.log_det_ratio == 0.0, "{found:?}");
    assert_eq!((found.variables, found.mean, found.max_shift_m), (ids.len(), 0.0, 0.0));
}

#[test]
fn what_is_moved_is_measured() {
    let (full, ids) = world(6, &[], &[0.2, -0.1]);
    let (was, mut points) = (full.estimates().unwrap(), vec![0.0; full.graph().value_len()]);
    for (id, value) in was.iter() {
        let mut value = value.to_value();
        if id == ids[3] {
            let pose = value.get::<Pose2>().unwrap();
            value = Value::new(&Pose2::new(pose.x() + 3.0, pose.y() - 4.0, pose.theta()));
        }
        points[full.graph().value_range(full.graph().variable_index(id).unwrap())]
            .copy_from_slice(value.storage());
    }
    let is = Values::from_arena(full.graph(), &points);
    let kept: Vec<_> = ids.iter().map(|id| (*id, *id)).collect();
    let solved = |estimates| Solved { graph: full.graph(), estimates };
    let found = Divergence::of(solved(&was), solved(&is), &kept, &Settings::default()).unwrap();
    assert!((found.max_shift_m - 5.0).abs() < 1e-12, "{found:?}");
    assert!((found.mean_shift_m - 5.0 / 7.0).abs() < 1e-12, "{found:?}");
    assert!((found.rms_shift_m - 5.0 / 7.0_f64.sqrt()).abs() < 1e-12, "{found:?}");
    assert!(found.mean > 100.0 && found.total == found.covariance + found.mean);
}

#[test]
fn pairs_have_to_fit() {
    let (full, ids) = world(6, &[(0, 4)], &[0.2, -0.1]);
    let reduced = without(&full, &ids[2..3], Options::default());
    let (was, is) = (full.estimates().unwrap(), reduced.estimates().unwrap());
    let refused = |kept: &[(VariableId, VariableId)]| {
        Divergence::of(
            Solved { graph: full.graph(), estimates: &was },
            Solved { graph: reduced.graph(), estimates: &is },
            kept,
            &Settings::default(),
        )
        .unwrap_err()
    };
    let good: Vec<_> = reduced.graph().variables().map(|id| (id, id)).collect();
    assert_eq!(refused(&[]), DivergenceError::NothingKept);
    let last = good[good.len() - 1].0;
    assert_eq!(refused(&good[..good.len() - 1]), DivergenceError::Unpaired { variable: last });
    let twice = [&good[..], &good[..1]].concat();
    assert_eq!(refused(&twice), DivergenceError::Twice { variable: ids[0] });
    // Variable 2 is not in the reduced graph, a pose is no landmark.
    assert!(matches!(refused(&[(ids[2], ids[2])]), DivergenceError::Graph(_)));
    let crossed = [(ids[0], last)];
    assert!(matches!(refused(&crossed), DivergenceError::WrongKind { .. }));
}

#[test]
fn a_free_direction_is_told() {
    let (full, ids) = world(6, &[], &[0.2, -0.1]);
    // Without the odometry in its middle the chain falls apart.
    let mut graph = full.graph().clone();
    let cut = full.graph().factors().find(|(_, f)| f.keys() == &ids[4..6]).unwrap().0;
    let mut change = graph.change();
    change.drop_factor(cut);
    let staged = graph.stage(&change).unwrap();
    graph.commit(staged);
    let (was, kept) =
        (full.estimates().unwrap(), ids.iter().map(|id| (*id, *id)).collect::<Vec<_>>());
    let whole = Solved { graph: full.graph(), estimates: &was };
    let broken = Solved { graph: &graph, estimates: &was };
    let free = |error: &SmootherError| error.to_string().contains(&ids[5].to_string());
    let error = Divergence::of(whole, broken, &kept, &Settings::default()).unwrap_err();
    assert!(matches!(&error, DivergenceError::Reduced(source) if free(source)), "{error}");
    let error = Divergence::of(broken, whole, &kept, &Settings::default()).unwrap_err();
    assert!(matches!(&error, DivergenceError::Full(source) if free(source)), "{error}");
}

#[test]
fn values_that_are_no_numbers_are_refused() {
    let (full, ids) = world(6, &[], &[0.2, -0.1]);
    let was = full.estimates().unwrap();
    let mut points = vec![0.0; full.graph().value_len()];
    for (id, value) in was.iter() {
        points[full.graph().value_range(full.graph().variable_index(id).unwrap())]
            .copy_from_slice(value.storage());
    }
    points[full.graph().value_range(full.graph().variable_index(ids[2]).unwrap())][0] = f64::NAN;
    let bad = Values::from_arena(full.graph(), &points);
    let kept: Vec<_> = ids.iter().map(|id| (*id, *id)).collect();
    let solved = |estimates| Solved { graph: full.graph(), estimates };
    let settings = Settings::default();
    let error = Divergence::of(solved(&bad), solved(&was), &kept, &settings).unwrap_err();
    assert!(error.to_string().contains("finite"), "{error}");
    let error = Divergence::of(solved(&was), solved(&bad), &kept, &settings).unwrap_err();
    assert!(matches!(error, DivergenceError::NotFinite { .. }), "{error}");
}

#[test]
fn nonzeros_are_counted_by_blocks() {
    // Six poses in a chain with one closure that is seen twice, and a landmark seen by four.
    let (full, _) = world(6, &[(0, 4), (4, 0)], &[0.2, -0.1]);
    let expected = 6 * 6 + 3 + (5 + 1) * 9 + 4 * 6;
    assert_eq!(information_nonzeros(full.graph()), expected);
    let order: Vec<_> = full.graph().variables().collect();
    let dense = information(full.graph(), &full.estimates().unwrap(), &order);
    let upper = (0..dense.nrows()).flat_map(|i| (i..dense.ncols()).map(move |j| (i, j)));
    assert!(upper.filter(|at| dense[*at] != 0.0).count() <= expected);
}
