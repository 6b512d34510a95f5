//! Positions on the earth against published numbers, and there and back.

use std::f64::consts::{FRAC_PI_2, PI};

use evergraph_factors::{Geodetic, GeodeticError, LocalFrame};
use evergraph_model::Point3;
use proptest::prelude::*;

fn degrees(degrees: f64, minutes: f64, seconds: f64) -> f64 {
    degrees + minutes / 60.0 + seconds / 3600.0
}

fn frame(latitude: f64, longitude: f64, height: f64) -> LocalFrame {
    LocalFrame::new(Geodetic::from_degrees(latitude, longitude, height)).expect("a position")
}

/// EPSG Guidance Note 7-2, examples of methods 9602 (geocentric) and 9837 (topocentric).
#[test]
fn the_examples_of_epsg_come_out() {
    let point =
        Geodetic::from_degrees(degrees(53.0, 48.0, 33.820), degrees(2.0, 7.0, 46.380), 73.0);
    let topocentric = frame(55.0, 5.0, 200.0).to_local(point);
    let expected = Point3::new(-189_013.869, -128_642.040, -4_220.171);
    assert!((topocentric.vector() - expected.vector()).amax() < 6e-4, "{topocentric:?}");
    // A frame at the equator and the prime meridian has earth-centred axes: up x, east y, north z.
    let local = frame(0.0, 0.0, 0.0).to_local(point);
    let centred = [local.z() + 6_378_137.0, local.x(), local.y()];
    for (actual, expected) in centred.iter().zip([3_771_793.968, 140_253.342, 5_124_304.349]) {
        assert!((actual - expected).abs() < 6e-4, "{centred:?}");
    }
}

#[test]
fn poles_and_equator_are_where_the_ellipsoid_ends() {
    let equator = frame(0.0, 0.0, 0.0);
    for (latitude, north) in [(90.0, 6_356_752.314_245), (-90.0, -6_356_752.314_245)] {
        let pole = equator.to_local(Geodetic::from_degrees(latitude, 0.0, 0.0));
        assert!((pole.y() - north).abs() < 1e-6 && (pole.z() + 6_378_137.0).abs() < 1e-6);
    }
    let antipode = equator.to_local(Geodetic::from_degrees(0.0, 180.0, 0.0));
    assert!((antipode.z() + 2.0 * 6_378_137.0).abs() < 1e-8);
}

#[test]
fn axes_point_east_north_and_up() {
    for (latitude, longitude) in [(0.0, 0.0), (47.0, 8.0), (-33.0, 151.0), (64.0, -180.0)] {
        let frame = frame(latitude, longitude, 500.0);
        let at = |dlat: f64, dlon: f64, up: f64| {
            let moved = Geodetic::from_degrees(latitude + dlat, longitude + dlon, 500.0 + up);
            frame.to_local(moved)
        };
        let (east, north, up) = (at(0.0, 1e-4, 0.0), at(1e-4, 0.0, 0.0), at(0.0, 0.0, 10.0));
        assert!(east.x() > 4.0 && east.y().abs() < 1e-3 && east.z().abs() < 1e-3, "{east:?}");
        assert!(north.y() > 11.0 && north.x().abs() < 1e-3 && north.z().abs() < 1e-3);
        assert!((up.z() - 10.0).abs() < 1e-8 && up.x().abs() < 1e-8 && up.y().abs() < 1e-8);
    }
}

#[test]
fn what_is_no_position_is_refused() {
    let good = Geodetic::from_degrees(90.0, 360.0, -1e4);
    let frame = LocalFrame::new(good).unwrap();
    for (bad, what) in [
        (Geodetic { latitude: FRAC_PI_2 + 1e-12, ..good }, "latitude"),
        (Geodetic { latitude: -2.0, ..good }, "latitude"),
        (Geodetic { longitude: 7.0, ..good }, "longitude"),
    ] {
        let error = LocalFrame::new(bad).unwrap_err();
        assert!(
            matches!(&error, GeodeticError::OutOfRange { what: found, .. } if *found == what),
            "{error}"
        );
        assert!(frame.to_local(bad).vector().iter().all(|x| x.is_nan()));
    }
    for bad in [f64::NAN, f64::INFINITY] {
        for bad in [
            Geodetic { latitude: bad, ..good },
            Geodetic { longitude: bad, ..good },
            Geodetic { height: bad, ..good },
        ] {
            let error = LocalFrame::new(bad).unwrap_err();
            assert!(matches!(error, GeodeticError::NotFinite { .. }), "{error}");
            assert!(frame.to_local(bad).vector().iter().all(|x| x.is_nan()));
        }
    }
    assert!(frame.to_geodetic(Point3::new(f64::NAN, 0.0, 0.0)).check().is_err());
}

#[test]
fn frames_are_saved_as_their_origin() {
    let frame = frame(42.0, -83.0, 270.0);
    let saved = serde_json::to_string(&frame).unwrap();
    assert_eq!(saved, serde_json::to_string(&frame.origin()).unwrap());
    assert_eq!(serde_json::from_str::<LocalFrame>(&saved).unwrap(), frame);
    let bad = r#"{"latitude": 42.0, "longitude": 0.0, "height": 0.0}"#;
    assert!(serde_json::from_str::<LocalFrame>(bad).is_err());
}

#[test]
fn longitudes_come_back_in_the_half_open_interval() {
    let frame = frame(10.0, 180.0, 0.0);
    let back = |degrees: f64| {
        frame.to_geodetic(frame.to_local(Geodetic::from_degrees(10.0, degrees, 0.0))).longitude
    };
    assert!((back(180.0).abs() - PI).abs() < 1e-15 && back(180.0) > -PI);
    assert!((back(-179.9).to_degrees() + 179.9).abs() < 1e-9);
    assert!((back(190.0).to_degrees() + 170.0).abs() < 1e-9);
    assert!((back(359.0).to_degrees() + 1.0).abs() < 1e-9);
}

fn latitude() -> impl Strategy<Value = f64> {
    prop_oneof![
        -90.0..=90.0,
        Just(90.0),
        Just(-90.0),
        Just(0.0),
        (1e-12..1e-3).prop_map(|from_pole: f64| 90.0 - from_pole),
        (-1e-3..1e-3),
    ]
}

fn longitude() -> impl Strategy<Value = f64> {
    prop_oneof![-180.0..=180.0, Just(180.0), Just(-180.0), 179.999..180.0]
}

#[test]
fn far_above_and_far_below_the_iteration_still_ends() {
    let frame = frame(-20.0, 70.0, 0.0);
    for height in [-5e6, -1e6, 1e7, 4e7, 1e9] {
        for latitude in [-90.0, -89.999_999, -45.0, -1e-6, 0.0, 30.0, 60.0, 90.0] {
            let place = Geodetic::from_degrees(latitude, -120.0, height);
            let back = frame.to_geodetic(frame.to_local(place));
            let size = 1e7 + height.abs();
            assert!((back.height - height).abs() < 1e-15 * size, "{height} {latitude}");
            assert!((back.latitude - place.latitude).abs() < 1e-14, "{height} {latitude}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn there_and_back_is_the_same_place(
        origin in (latitude(), longitude(), -1e4..1e6),
        position in (latitude(), longitude(), -1e4..1e6),
    ) {
        let frame = frame(origin.0, origin.1, origin.2);
        let position = Geodetic::from_degrees(position.0, position.1, position.2);
        let local = frame.to_local(position);
        let back = frame.to_geodetic(local);
        let metres = (frame.to_local(back).vector() - local.vector()).norm();
        prop_assert!(metres < 2e-8, "{metres:e}");
        prop_assert!((back.height - position.height).abs() < 2e-8, "{:e}", back.height - position.height);
        prop_assert!((back.latitude - position.latitude).abs() < 5e-15, "{:e}", back.latitude - position.latitude);
        prop_assert!(back.check().is_ok());
    }

    #[test]
    fn distances_are_those_of_any_other_frame(
        a in (latitude(), longitude(), -1e4..1e6),
        b in (latitude(), longitude(), -1e4..1e6),
    ) {
        let (a, b) = (Geodetic::from_degrees(a.0, a.1, a.2), Geodetic::from_degrees(b.0, b.1, b.2));
        let from = |frame: LocalFrame| (frame.to_local(a).vector() - frame.to_local(b).vector()).norm();
        let (one, other) = (from(frame(0.0, 0.0, 0.0)), from(frame(-71.0, 123.0, 4000.0)));
        prop_assert!((one - other).abs() < 2e-8, "{one} {other}");
    }
}
