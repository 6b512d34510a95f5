//! Types of a user's own: removed, root-shifted and recovered like those of the library.
#![allow(clippy::unwrap_used)]

mod common;
mod users;

use common::*;
use evergraph_factors::{BetweenPose2, Linear, RelativePosition2};
use evergraph_model::testing::{assert_jacobian, check_lie_group, check_motion, check_pose};
use evergraph_model::*;
use evergraph_removal::{Options, Recovery, RootShift, Topology};
use nalgebra::{DMatrix, Vector2};
use users::{Car, Lamp, Mark, Place, Sight};

fn place(x: f64, y: f64, heading: f64) -> Place {
    Place { x, y, heading }
}

fn lamp(x: f64, y: f64, height: f64) -> Lamp {
    Lamp { place: Point2::new(x, y), height }
}

#[test]
fn they_move_as_they_say() {
    let frames = [Pose2::new(3.0, -2.0, 0.8), Pose2::new(-1.0, 0.5, -0.4)];
    check_pose(&[place(-1.0, 4.0, 1.5), place(2.0, 0.0, -0.2)], &frames).unwrap();
    check_motion(&[lamp(-1.0, 4.0, 2.0), lamp(0.0, 0.0, 0.0)], &frames).unwrap();
    let cars = [Car { scale: 1.3, shift: -2.0 }, Car { scale: 0.8, shift: 0.5 }];
    check_lie_group(&cars, &[Vector2::new(0.3, -0.2), Vector2::new(0.1, 1e-5)]).unwrap();
    check_pose(&cars, &cars).unwrap();
    check_motion(&[Mark(1.0), Mark(-3.0)], &cars).unwrap();
}

/// The first variable sees or is seen by all others, which know of each other too; nothing is held in the plane.
fn plane() -> Scene {
    Scene::of(|change| {
        let node = change.add_variable(&place(1.0, 0.4, 0.3));
        let poses = [Pose2::new(0.0, 0.0, 0.0), Pose2::new(2.0, 1.0, 0.6)];
        let [a, b] = poses.map(|pose| change.add_variable(&pose));
        let other = change.add_variable(&place(3.0, -1.0, -0.9));
        let light = change.add_variable(&lamp(1.5, 2.0, 0.8));
        let corner = change.add_variable(&Point2::new(-0.5, 1.0));
        let noise = || Noise::from_sigmas(&[0.1, 0.2, 0.05]).unwrap();
        change.add_factor(BetweenPose2::new(a, b, Pose2::new(2.1, 0.9, 0.65), noise()).unwrap());
        let noise = Noise::from_sigmas(&[0.1, 0.3]).unwrap();
        let seen = Point2::new(-0.4, 1.05);
        change.add_factor(RelativePosition2::new(a, corner, seen, noise).unwrap());
        let from_a = place(1.05, 0.35, 0.32);
        change.add_factor(Sight::<Pose2, _, Pose2, 3>::new(a, node, from_a, 0.1));
        change.add_factor(Sight::<Pose2, _, Pose2, 3>::new(b, node, place(-1.0, 0.1, -0.3), 0.2));
        change.add_factor(Sight::<Place, _, Pose2, 3>::new(
            node,
            other,
            place(1.5, -1.9, -1.2),
            0.1,
        ));
        change.add_factor(Sight::<Place, _, Pose2, 3>::new(node, light, lamp(1.0, 1.4, 0.9), 0.3));
        change.add_factor(Sight::<Place, _, Pose2, 3>::new(
            other,
            light,
            lamp(-3.2, 0.7, 0.7),
            0.2,
        ));
    })
}

/// Cars and marks on a track: nothing is held, neither its shift nor its scale.
fn track() -> Scene {
    Scene::of(|change| {
        let cars = [(1.1, 1.0), (0.9, -1.0), (1.4, 2.5), (0.7, 0.3)];
        let [node, a, b, c] = cars.map(|(scale, shift)| change.add_variable(&Car { scale, shift }));
        let mark = change.add_variable(&Mark(1.7));
        let far = change.add_variable(&Mark(-2.0));
        let car = |scale, shift| Car { scale, shift };
        change.add_factor(Sight::<Car, _, Car, 2>::new(a, node, car(1.25, 2.2), 0.1));
        change.add_factor(Sight::<Car, _, Car, 2>::new(node, b, car(1.3, 1.4), 0.2));
        change.add_factor(Sight::<Car, _, Car, 2>::new(c, node, car(1.5, 1.1), 0.1));
        change.add_factor(Sight::<Car, _, Car, 2>::new(node, mark, Mark(0.6), 0.3));
        change.add_factor(Sight::<Car, _, Car, 2>::new(b, mark, Mark(-0.6), 0.1));
        change.add_factor(Sight::<Car, _, Car, 2>::new(node, far, Mark(-2.8), 0.2));
        change.add_factor(Sight::<Car, _, Car, 2>::new(a, far, Mark(-1.0), 0.2));
    })
}

/// The motions of a world in the tangents of some variables: the gauge.
fn gauge(scene: &Scene, ids: &[VariableId]) -> DMatrix<f64> {
    let values = scene.values();
    let blocks: Vec<DMatrix<f64>> = ids
        .iter()
        .map(|&id| {
            let value = values.value(id).unwrap();
            let motion = value.kind().motion().unwrap();
            let mut lever = DMatrix::zeros(value.dim(), motion.world().dim());
            motion.lever(value.storage(), lever.as_mut_slice());
            lever
        })
        .collect();
    let rows = blocks.iter().map(DMatrix::nrows).sum();
    let mut all = DMatrix::zeros(rows, blocks[0].ncols());
    let mut top = 0;
    for block in blocks {
        all.rows_mut(top, block.nrows()).copy_from(&block);
        top += block.nrows();
    }
    all
}

fn ways() -> Vec<Options> {
    let mut ways = Vec::new();
    for topology in [Topology::Dense, Topology::ChowLiu] {
        for recovery in [Recovery::Glc, Recovery::Nonlinear] {
            for shift in [RootShift::None, RootShift::Root, RootShift::InverseRoot] {
                let options = Options::default().with_topology(topology);
                ways.push(options.with_recovery(recovery).with_root_shift(shift));
            }
        }
    }
    ways
}

/// Every variable of both worlds as the node, by every way.
#[test]
fn they_are_removed_with_the_gauge_kept() {
    for scene in [plane(), track()] {
        for node in scene.ids() {
            for options in ways() {
                let plan = scene.plan(node, options);
                let step = &plan.steps()[0];
                let what = format!("{node} {options:?}");
                let answer = answer(&scene, &[node], &step.blanket);
                let new = added(&scene, &plan, &step.blanket);
                let (lambda, eta) = normal(&new);
                if step.topology == Topology::Dense {
                    assert_close(&lambda, &answer.lambda, &answer.scale, 1e-8, &what);
                }
                assert_same_gradient(&eta, &answer.eta, &answer, 1e-8);
                assert_eq!(step.fallback, None, "{what}");
                // What is free of the target is free of the new factors, and the other way round.
                let gauge = gauge(&scene, &step.blanket);
                let stiffness = (&new.0 * &gauge).norm();
                let size = new.0.norm() * gauge.norm();
                assert!(stiffness <= 1e-12 * size, "{what}: {stiffness:e}");
                assert_eq!(rank(&new.0), step.rank, "{what}");
                assert_eq!(step.rank, rank_of(&answer), "{what}");
            }
        }
    }
}

/// Rank of a target that comes as information.
fn rank_of(answer: &Answer) -> usize {
    let n = answer.lambda.nrows();
    let scaled =
        DMatrix::from_fn(n, n, |i, j| answer.lambda[(i, j)] / answer.scale[i] / answer.scale[j]);
    scaled.symmetric_eigenvalues().iter().filter(|x| **x > 1e-10).count()
}

/// Away from the linearization point too, a new factor is the derivative of itself, and with a root shift it knows
/// relative coordinates only: a motion of the world changes no residual.
#[test]
fn their_new_factors_do_not_feel_a_motion_of_the_world() {
    let motion = Pose2::new(40.0, -70.0, 2.0);
    for shift in [RootShift::Root, RootShift::InverseRoot] {
        for options in [Options::dense(), Options::default()] {
            let scene = plane();
            let plan = scene.plan(scene.ids()[0], options.with_root_shift(shift));
            let mut turned = 0;
            for (_, factor) in plan.change().new_factors() {
                let values: Vec<Value> = (factor.keys().iter().enumerate())
                    .map(|(k, &id)| {
                        let value = scene.values().value(id).unwrap().to_value();
                        let step: Vec<f64> =
                            (0..value.dim()).map(|i| 0.1 * ((3 * k + i) as f64).sin()).collect();
                        value.retract(&step).unwrap()
                    })
                    .collect();
                assert_jacobian(&**factor, &values);
                let (linear, _) = factor.downcast::<Linear>().unwrap();
                if linear.root_shift() == RootShift::Root {
                    let mut frame = [0.0; 4];
                    motion.inverse().store(&mut frame);
                    let moved = values.iter().map(|value| {
                        let mut out = value.storage().to_vec();
                        let motion = value.kind().motion().unwrap();
                        motion.seen_from(value.storage(), &frame, &mut out);
                        value.with_storage(&out)
                    });
                    let moved: Vec<Value> = moved.collect();
                    let residual = |values: &[Value]| {
                        let refs: Vec<ValueRef<'_>> = values.iter().map(Value::as_ref).collect();
                        linearize_at(&**factor, &refs).unwrap().residual().into_owned()
                    };
                    let change = (residual(&values) - residual(&moved)).amax();
                    assert!(change < 1e-9, "{change:e} of {factor:?}");
                    turned += 1;
                }
            }
            assert_eq!(turned > 0, shift == RootShift::Root);
        }
    }
}
