//! What ranges, bearings, planar motion and differences do not see.

mod common;

use std::f64::consts::PI;

use common::{key, keys, level, linearize, residual, unit, values};
use evergraph_factors::{
    Bearing2, Bearing3, BearingRange2, BearingRange3, DepthDifference, HeadingDifference,
    PlanarMotion, Positioned, Range, TranslationDifference3,
};
use evergraph_model::{Factor, LieGroup, Point3, Pose2, Pose3, Rot3, Value, geometry::wrap_angle};
use nalgebra::{SVector, Vector3, Vector6};
use proptest::prelude::*;

prop_compose! {
    fn pose3()(t in [-50.0..50.0, -50.0..50.0, -50.0..50.0], r in [-1.7..1.7, -1.7..1.7, -1.7..1.7]) -> Pose3 {
        Pose3::exp(&Vector6::new(t[0], t[1], t[2], r[0], r[1], r[2]))
    }
}

prop_compose! {
    fn pose2()(x in -50.0..50.0, y in -50.0..50.0, theta in -PI..PI) -> Pose2 {
        Pose2::new(x, y, theta)
    }
}

prop_compose! {
    fn point3()(p in [-50.0..50.0, -50.0..50.0, -50.0..50.0]) -> Point3 {
        Point3::from(p)
    }
}

/// Residuals at two places, as far from each other as rounding makes them.
fn same(factor: &dyn Factor, one: &[Value], other: &[Value]) -> Result<(), TestCaseError> {
    for (a, b) in residual(factor, one).iter().zip(residual(factor, other)) {
        prop_assert!((a - b).abs() < 1e-10, "{}: {a} {b}", factor.name());
    }
    Ok(())
}

fn distance<const D: usize>(a: &impl Positioned<D>, b: &impl Positioned<D>) -> f64 {
    let way: SVector<f64, D> = b.position() - a.position();
    way.norm()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn ranges_and_bearings_in_space_move_with_the_world(
        (pose, target, world) in (pose3(), point3(), pose3()),
        (bearing, range) in ([-1.0..1.0, -1.0..1.0, 0.1..1.0], 0.0..100.0),
    ) {
        // Towards a target nearby a bearing magnifies rounding.
        prop_assume!(distance(&pose, &target) > 0.1);
        let (a, b) = keys(&pose, &target);
        let direction = Vector3::from(bearing);
        let (one, other) = (values(&pose, &target), values(&(world * pose), &(world * target)));
        same(&Range::new(a, b, range, unit(1)).unwrap(), &one, &other)?;
        let bearing = Bearing3::new(a, b, direction, unit(2)).unwrap();
        let error = residual(&bearing, &one);
        // Half a turn off the direction to take is any.
        prop_assume!(error[0].hypot(error[1]) < 3.1);
        same(&bearing, &one, &other)?;
        same(&BearingRange3::new(a, b, direction, range, unit(3)).unwrap(), &one, &other)?;
    }

    #[test]
    fn ranges_and_bearings_in_the_plane_move_with_the_world(
        (pose, target, world) in (pose2(), pose2(), pose2()),
        (bearing, range) in (-PI..PI, 0.0..100.0),
    ) {
        prop_assume!(distance(&pose, &target) > 0.1);
        let (a, b) = keys(&pose, &target);
        let (one, other) = (values(&pose, &target), values(&(world * pose), &(world * target)));
        same(&Range::new(a, b, range, unit(1)).unwrap(), &one, &other)?;
        let factor = Bearing2::new(a, b, bearing, unit(1)).unwrap();
        let difference = residual(&factor, &one)[0] - residual(&factor, &other)[0];
        prop_assert!(wrap_angle(difference).abs() < 1e-10);
        // What is seen at bearing and range is where it is.
        let place = pose.inverse_transform_point(&target.translation());
        let seen = BearingRange2::new(a, b, place.y().atan2(place.x()), place.vector().norm(), unit(2)).unwrap();
        for error in residual(&seen, &other) {
            prop_assert!(error.abs() < 1e-10);
        }
    }

    #[test]
    fn ranges_do_not_see_rotations_in_place_nor_which_end_is_first(
        (a, b, turn) in (pose3(), pose3(), [-1.7..1.7, -1.7..1.7, -1.7..1.7]),
    ) {
        let (from, to) = keys(&a, &b);
        let turned = a * Pose3::new(Rot3::exp(&Vector3::from(turn)), Vector3::zeros());
        let factor = Range::new(from, to, 3.0, unit(1)).unwrap();
        same(&factor, &values(&a, &b), &values(&turned, &b))?;
        same(&factor, &values(&a, &b), &values(&b, &a))?;
    }

    #[test]
    fn planar_motion_does_not_see_moves_in_the_plane(
        (pose, x, y, yaw) in (pose3(), -50.0..50.0, -50.0..50.0, -PI..PI),
    ) {
        let factor = PlanarMotion::new(key(&pose), 2.0, unit(3)).unwrap();
        let at = [Value::new(&pose)];
        let error = residual(&factor, &at);
        prop_assume!(error[1].hypot(error[2]) < 3.1);
        same(&factor, &at, &[Value::new(&(level(x, y, 0.0, yaw) * pose))])?;
        // Nor does its Jacobian: the moves as right perturbations are in its null space.
        let (jacobian, _) = linearize(&factor, &at);
        let adjoint = pose.inverse().adjoint();
        for component in [0, 1, 5] {
            prop_assert!((&jacobian * adjoint.column(component)).amax() < 1e-12);
        }
    }

    #[test]
    fn differences_do_not_see_where_in_the_world_they_are(
        (i, j, shift, yaw) in (pose3(), pose3(), point3(), -PI..PI),
    ) {
        let (a, b) = keys(&i, &j);
        let one = values(&i, &j);
        let moved = |world: Pose3| values(&(world * i), &(world * j));
        let shifted = moved(Pose3::new(Rot3::identity(), shift));
        let depth = DepthDifference::new(a, b, 1.0, unit(1)).unwrap();
        let heading = HeadingDifference::new(a, b, 1.0, unit(1)).unwrap();
        let translation = TranslationDifference3::new(a, b, shift, unit(3)).unwrap();
        same(&depth, &one, &shifted)?;
        same(&heading, &one, &shifted)?;
        same(&translation, &one, &shifted)?;
        let turned = moved(level(shift.x(), shift.y(), shift.z(), yaw));
        same(&depth, &one, &turned)?;
        let difference = residual(&heading, &one)[0] - residual(&heading, &turned)[0];
        prop_assert!(wrap_angle(difference).abs() < 1e-10);
    }

    #[test]
    fn differences_along_a_way_add_up((i, j, k) in (pose3(), pose3(), pose3())) {
        let error = |from: &Pose3, to: &Pose3| {
            let (a, b) = keys(from, to);
            let zero = Point3::identity();
            let at = values(from, to);
            let mut all = residual(&TranslationDifference3::new(a, b, zero, unit(3)).unwrap(), &at);
            all.extend(residual(&DepthDifference::new(a, b, 0.0, unit(1)).unwrap(), &at));
            all.extend(residual(&HeadingDifference::new(a, b, 0.0, unit(1)).unwrap(), &at));
            all
        };
        let (first, second, both) = (error(&i, &j), error(&j, &k), error(&i, &k));
        for row in 0..5 {
            let excess = first[row] + second[row] - both[row];
            let excess = if row == 4 { wrap_angle(excess) } else { excess };
            prop_assert!(excess.abs() < 1e-10, "row {row}: {excess}");
        }
    }
}
