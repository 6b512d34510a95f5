//! The GLC paper's equations, written down from its text with dense inverses, on targets where
//! those exist.
// Helpers of tests fail the test.
#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use evergraph_factors::{Between, BetweenPose2, BetweenPose3, Linear, Prior};
use evergraph_model::{Factor, LieGroup, Noise, Pose2, Pose3};
use evergraph_removal::{MutualInformation, Offset, Options, Recovery, RootShift, Topology};
use nalgebra::DMatrix;

/// A node, others around it, and an absolute measurement of each, so that Λ_t is regular.
fn regular(space: bool, count: usize, seed: u64) -> Scene {
    let mut draw = Draw::new(seed);
    Scene::of(|change| {
        if space {
            let values: Vec<Pose3> = (0..=count).map(|_| draw.pose3()).collect();
            let keys: Vec<_> = values.iter().map(|x| change.add_variable(x)).collect();
            for k in 1..=count {
                let z = values[0].between(&values[k]);
                change.add_factor(BetweenPose3::new(keys[0], keys[k], z, draw.noise(6)).unwrap());
                change.add_factor(Prior::new(keys[k], values[k], draw.noise(6)).unwrap());
            }
        } else {
            let values: Vec<Pose2> = (0..=count).map(|_| draw.pose2()).collect();
            let keys: Vec<_> = values.iter().map(|x| change.add_variable(x)).collect();
            for k in 1..=count {
                let z = values[0].between(&values[k]).compose(&Pose2::exp(&draw.vector(0.02)));
                change.add_factor(BetweenPose2::new(keys[0], keys[k], z, draw.noise(3)).unwrap());
                change.add_factor(Prior::new(keys[k], values[k], draw.noise(3)).unwrap());
            }
        }
    })
}

fn block(m: &DMatrix<f64>, rows: &[usize], columns: &[usize], dim: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len() * dim, columns.len() * dim, |i, j| {
        m[(rows[i / dim] * dim + i % dim, columns[j / dim] * dim + j % dim)]
    })
}

/// Equations 1 to 4 and 17: the terms of the Chow-Liu tree over a regular Λ_t of `n` variables, each
/// with its members (a parent after its child) and its information.
fn tree_terms(lambda: &DMatrix<f64>, n: usize, dim: usize) -> Vec<(Vec<usize>, DMatrix<f64>)> {
    let sigma = lambda.clone().try_inverse().unwrap();
    // (17), in bits as printed.
    let mutual = |i: usize, j: usize| {
        let (ii, jj) = (block(&sigma, &[i], &[i], dim), block(&sigma, &[j], &[j], dim));
        let ij = block(&sigma, &[i], &[j], dim);
        let given = &ii - &ij * jj.try_inverse().unwrap() * ij.transpose();
        0.5 * (ii.determinant() / given.determinant()).log2()
    };
    // Kruskal.
    let mut pairs: Vec<(usize, usize)> =
        (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).collect();
    pairs.sort_by(|a, b| mutual(b.0, b.1).total_cmp(&mutual(a.0, a.1)));
    let mut part: Vec<usize> = (0..n).collect();
    let mut edges = Vec::new();
    for (i, j) in pairs {
        let (from, to) = (part[i], part[j]);
        if from != to {
            part.iter_mut().filter(|p| **p == from).for_each(|p| *p = to);
            edges.push((i, j));
        }
    }
    // Orient away from the root, variable 0: (1), p(x_1) Π p(x_i | x_p(i)).
    let mut terms = vec![(vec![0], block(&sigma, &[0], &[0], dim).try_inverse().unwrap())];
    let mut reached = vec![0];
    while reached.len() < n {
        for &(a, b) in &edges {
            let (j, i) = match (reached.contains(&a), reached.contains(&b)) {
                (true, false) => (a, b),
                (false, true) => (b, a),
                _ => continue,
            };
            reached.push(i);
            let joint = block(&sigma, &[i, j], &[i, j], dim).try_inverse().unwrap();
            let ii = joint.view((0, 0), (dim, dim)).into_owned();
            // (3): E = [I  Λ_ii⁻¹ Λ_ij], (4): Eᵀ Λ_ii E.
            let mut e = DMatrix::zeros(dim, 2 * dim);
            e.view_mut((0, 0), (dim, dim)).fill_with_identity();
            let gain = ii.clone().try_inverse().unwrap() * joint.view((0, dim), (dim, dim));
            e.view_mut((0, dim), (dim, dim)).copy_from(&gain);
            terms.push((vec![i, j], e.transpose() * ii * e));
        }
    }
    terms
}

/// What terms add up to over `n` variables.
fn sum(terms: &[(Vec<usize>, DMatrix<f64>)], n: usize, dim: usize) -> DMatrix<f64> {
    let mut total = DMatrix::zeros(n * dim, n * dim);
    for (members, information) in terms {
        for a in 0..members.len() * dim {
            for b in 0..members.len() * dim {
                let at = |k: usize| members[k / dim] * dim + k % dim;
                total[(at(a), at(b))] += information[(a, b)];
            }
        }
    }
    total
}

#[test]
fn trees_of_generic_linear_constraints_are_the_papers() {
    for (space, count) in [(false, 2), (false, 5), (true, 3), (true, 4)] {
        for seed in 0..8 {
            let scene = regular(space, count, seed);
            let node = scene.ids()[0];
            for root_shift in [RootShift::InverseRoot, RootShift::Root, RootShift::None] {
                let options = Options::paper().with_root_shift(root_shift);
                let plan = scene.plan(node, options);
                let step = &plan.steps()[0];
                assert_eq!(step.topology, Topology::ChowLiu);
                let answer = answer(&scene, &[node], &step.blanket);
                let dim = if space { 6 } else { 3 };
                let expected = sum(&tree_terms(&answer.lambda, count, dim), count, dim);
                let stack = added(&scene, &plan, &step.blanket);
                let information = stack.0.tr_mul(&stack.0);
                assert_close(&information, &expected, &answer.scale, 1e-9, "tree information");
                // The measurement is the linearization point (below equation 7).
                assert!(stack.1.amax() < 1e-13);
            }
        }
    }
}

/// How many numbers of a pose's tangent are translation; they come first.
fn translations(dim: usize) -> usize {
    if dim == 3 { 2 } else { 3 }
}

/// A node and others around it, seen from each other only; with headings that are hardly known, so
/// that little is known sideways.
fn relative<G: LieGroup<N>, const N: usize>(count: usize, seed: u64) -> (Scene, Vec<G>) {
    let mut draw = Draw::new(seed);
    let noise = |draw: &mut Draw| {
        let root = draw.noise(N).sqrt_information().clone();
        let known = |k: usize| if k < translations(N) { 1.0 } else { 3e-2 };
        let weak = DMatrix::from_fn(N, N, |row, column| root[(row, column)] * known(column));
        Noise::from_sqrt_information(&weak).unwrap()
    };
    let values: Vec<G> = (0..=count)
        .map(|_| {
            let mut d = draw.vector::<N>(6.0);
            (translations(N)..N).for_each(|k| d[k] *= 0.2);
            G::exp(&d)
        })
        .collect();
    // Up or down the order of keys from the first neighbour, so that trees grow both ways.
    let at = |k: usize| if k < 2 || seed.is_multiple_of(2) { k } else { count + 2 - k };
    let scene = Scene::of(|change| {
        let keys: Vec<_> = values.iter().map(|x| change.add_variable(x)).collect();
        for j in 1..=count {
            for (i, j) in [(0, at(j)), (at(j / 2), at(j))] {
                let z = values[i].between(&values[j]).compose(&G::exp(&draw.vector(0.02)));
                let edge = Between::<G, N>::new(keys[i], keys[j], z, noise(&mut draw));
                change.add_factor(edge.unwrap());
            }
        }
    });
    (scene, values)
}

/// The limit of equations 1 to 4 and 17 for a target that knows nothing of the world, under a prior
/// on one variable that vanishes: Σ with that variable held; trees by `-½ ln |Σ_rel|`; an edge is
/// `[-A I]ᵀ Σ_rel⁻¹ [-A I]` with `x_rel = x_j - A x_i` and A the adjoint of `x_j⁻¹ x_i`.
///
/// Damped, trees are by `½ ln |Σ_rel⁻¹ + 1e-4 D|` of the first of two as the second sees it, D the mean
/// of the diagonal over translation and over rotation.
fn relative_tree_information<G: LieGroup<N>, const N: usize>(
    lambda: &DMatrix<f64>,
    values: &[G],
    rule: MutualInformation,
) -> DMatrix<f64> {
    let n = values.len();
    let held: Vec<usize> = (1..n).collect();
    let inverse = block(lambda, &held, &held, N).try_inverse().unwrap();
    let mut sigma = DMatrix::zeros(n * N, n * N);
    sigma.view_mut((N, N), inverse.shape()).copy_from(&inverse);
    let seen = |i: usize, j: usize| {
        let a = values[j].between(&values[i]).adjoint();
        let mut e = DMatrix::<f64>::zeros(N, 2 * N);
        e.view_mut((0, 0), (N, N)).copy_from(&-a);
        e.view_mut((0, N), (N, N)).fill_with_identity();
        let covariance = &e * block(&sigma, &[i, j], &[i, j], N) * e.transpose();
        (e, covariance)
    };
    let mut outside: Vec<usize> = (1..n).collect();
    let mut terms = Vec::new();
    while !outside.is_empty() {
        let pairs = (0..n)
            .filter(|i| !outside.contains(i))
            .flat_map(|i| outside.iter().map(move |&j| (i, j)));
        let weight = |&(i, j): &(usize, usize)| match rule {
            MutualInformation::Damped => {
                let mut known = seen(i.max(j), i.min(j)).1.try_inverse().unwrap();
                let diagonal = known.diagonal();
                for part in [0..translations(N), translations(N)..N] {
                    let mean = diagonal.rows_range(part.clone()).mean();
                    part.for_each(|k| known[(k, k)] += 1e-4 * mean);
                }
                0.5 * known.determinant().ln()
            }
            _ => -0.5 * seen(i, j).1.determinant().ln(),
        };
        let (i, j) = pairs.max_by(|a, b| weight(a).total_cmp(&weight(b))).unwrap();
        outside.retain(|&k| k != j);
        let (e, covariance) = seen(i, j);
        terms.push((vec![i, j], e.transpose() * covariance.try_inverse().unwrap() * e));
    }
    sum(&terms, n, N)
}

/// The information of the tree by each rule, the limit first.
fn relative_trees<G: LieGroup<N>, const N: usize>(count: usize, seed: u64) -> [DMatrix<f64>; 2] {
    let (scene, values) = relative::<G, N>(count, seed);
    let node = scene.ids()[0];
    [MutualInformation::Limit, MutualInformation::Damped].map(|mutual_information| {
        let mut expected = DMatrix::zeros(0, 0);
        for (root_shift, recovery) in [
            (RootShift::InverseRoot, Recovery::Glc),
            (RootShift::Root, Recovery::Glc),
            (RootShift::None, Recovery::Glc),
            (RootShift::Root, Recovery::Nonlinear),
        ] {
            let rules = match mutual_information {
                MutualInformation::Limit => Options::paper(),
                _ => tree(),
            };
            let options = rules.with_root_shift(root_shift).with_recovery(recovery);
            let plan = scene.plan(node, options);
            let step = &plan.steps()[0];
            assert_eq!((step.topology, step.rank), (Topology::ChowLiu, N * (count - 1)));
            let answer = answer(&scene, &[node], &step.blanket);
            expected = relative_tree_information(&answer.lambda, &values[1..], mutual_information);
            let information = normal(&added(&scene, &plan, &step.blanket)).0;
            assert_close(&information, &expected, &answer.scale, 1e-9, "tree information");
        }
        expected
    })
}

#[test]
fn trees_of_what_is_relative_are_the_limit_of_the_papers_or_damped() {
    let mut others = 0;
    for seed in 0..8 {
        let trees = [
            relative_trees::<Pose2, 3>(3, seed),
            relative_trees::<Pose2, 3>(6, seed),
            relative_trees::<Pose2, 3>(12, seed),
            relative_trees::<Pose3, 6>(4, seed),
        ];
        others += trees.iter().filter(|[limit, damped]| limit != damped).count();
    }
    // The rules differ where little is known sideways, so each is told from the other here.
    assert!((1..30).contains(&others), "{others} of 32");
}

/// Equations 5 to 9: each factor holds `Λ' = R⁻ᵀ Λ R⁻¹` of its own term, R the Jacobian of
/// `(x_1⁻¹, x_1⁻¹ x_2)` at the linearization point.
#[test]
fn factors_hold_their_terms_in_root_shifted_coordinates() {
    for seed in 0..8 {
        let scene = regular(false, 4, seed);
        let node = scene.ids()[0];
        let plan = scene.plan(node, Options::paper());
        let blanket = &plan.steps()[0].blanket;
        let terms = tree_terms(&answer(&scene, &[node], blanket).lambda, 4, 3);
        assert_eq!(terms.len(), plan.change().new_factors().len());
        for (_, factor) in plan.change().new_factors() {
            let (linear, _) = factor.downcast::<Linear>().unwrap();
            let place = |id| blanket.iter().position(|other| other == id).unwrap();
            let own: Vec<usize> = linear.keys().iter().map(place).collect();
            let same = |members: &[usize]| {
                members.len() == own.len() && own.iter().all(|k| members.contains(k))
            };
            let (members, information) = terms.iter().find(|(m, _)| same(m)).unwrap();
            // In the order of the factor's variables, the root first.
            let order: Vec<usize> =
                own.iter().map(|k| members.iter().position(|m| m == k).unwrap()).collect();
            let information = block(information, &order, &order, 3);
            let mut shift = DMatrix::<f64>::identity(information.nrows(), information.nrows());
            if let [first, second] = linear.linearization_points() {
                let [x, y] = [first, second].map(|value| value.get::<Pose2>().unwrap());
                // (x Exp(ξ))⁻¹ = x⁻¹ Exp(-Ad(x) ξ); (x Exp(ξ))⁻¹ y = x⁻¹y Exp(-Ad(y⁻¹x) ξ).
                shift.view_mut((0, 0), (3, 3)).copy_from(&-x.adjoint());
                shift.view_mut((3, 0), (3, 3)).copy_from(&-y.between(&x).adjoint());
            }
            let inverse = shift.try_inverse().unwrap();
            let expected = inverse.transpose() * information * inverse;
            let g = linear.sqrt_information();
            let scale: Vec<f64> = expected.diagonal().iter().map(|x| x.sqrt()).collect();
            assert_close(&g.tr_mul(g), &expected, &scale, 1e-9, "(6)");
            assert_eq!(g.nrows(), rank(g), "(9): as many rows as the rank");
            assert_eq!(linear.offset().amax(), 0.0, "the measurement is the linearization point");
        }
    }
}

#[test]
fn keeping_the_gradient_changes_the_offset_only() {
    let scene = regular(false, 4, 3);
    let node = scene.ids()[0];
    let paper = scene.plan(node, Options::paper());
    let kept = scene.plan(node, Options::paper().with_offset(Offset::KeepGradient));
    let blanket = &paper.steps()[0].blanket;
    let (a, b) = (added(&scene, &paper, blanket), added(&scene, &kept, blanket));
    assert_eq!(a.0, b.0);
    assert!(b.1.norm() > 1e-3);
}

#[test]
fn isam_is_the_paper_where_no_tolerance_bites() {
    // With two others there is one tree, whatever the weights.
    for seed in 0..4 {
        let scene = regular(false, 2, seed);
        let node = scene.ids()[0];
        let (isam, paper) = (scene.plan(node, Options::isam()), scene.plan(node, Options::paper()));
        let blanket = &paper.steps()[0].blanket;
        let answer = answer(&scene, &[node], blanket);
        let [a, b] = [&isam, &paper].map(|plan| normal(&added(&scene, plan, blanket)).0);
        assert_close(&a, &b, &answer.scale, 1e-9, "information");
    }
    let scene = regular(false, 5, 9);
    let plan = scene.plan(scene.ids()[0], Options::isam());
    assert_eq!(plan.steps()[0].added.len(), 5, "a root and four edges");
}
