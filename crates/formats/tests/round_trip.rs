//! What is read, written and read again is the same, on every shared graph.

mod common;

use std::collections::BTreeMap;

use evergraph_formats::{Coordinates, Dialect, Document, FormatError, Line, Record, Weight};

/// Everything that a line holds but its number, with numbers as bits.
fn bits(line: &Line) -> (String, Vec<u64>) {
    let mut all: Vec<f64> = Vec::new();
    let mut weigh = |w: &Weight| {
        all.extend(w.entries.iter());
        format!("{:?} {:?}", w.kind, w.order)
    };
    let what = match &line.record {
        Record::Vertex { id, at } => {
            all.extend(at.numbers());
            format!("vertex {id} {:?}", at.kind())
        }
        Record::SensorOffset { id, at } => {
            all.extend(at.numbers());
            format!("offset {id}")
        }
        Record::Fix { id } => format!("fix {id}"),
        Record::Edge { from, to, measurement, weight, parameter } => {
            let weight = weigh(weight);
            all.extend(measurement.numbers());
            format!("edge {from} {to} {parameter:?} {weight}")
        }
        Record::Measurement(m) => {
            let weight = weigh(&m.weight);
            all.extend(&m.numbers);
            format!("{:?} {:?} {:?} {weight}", m.quantity, m.ends, m.parameter)
        }
        Record::Linear(linear) => {
            linear.points.iter().for_each(|(_, at)| all.extend(at.numbers()));
            all.extend(linear.sqrt_information.iter().chain(&linear.offset));
            let ids: Vec<_> = linear.points.iter().map(|(id, at)| (id, at.kind())).collect();
            format!("{ids:?} {:?} {}", linear.root_shift, linear.rows)
        }
        Record::GeodeticOrigin { latitude, longitude, height } => {
            all.extend([latitude, longitude, height]);
            "origin".into()
        }
    };
    all.extend(line.time().iter().chain(&line.kernel().map(|kernel| kernel.threshold())));
    let kernel = line.kernel().map(|kernel| kernel.name());
    (format!("{what} {kernel:?}"), all.into_iter().map(f64::to_bits).collect())
}

fn write(document: &Document, dialect: Dialect) -> Result<Vec<u8>, FormatError> {
    let mut text = Vec::new();
    document.write(&mut text, dialect)?;
    Ok(text)
}

#[test]
fn equal_dialects_give_equal_bits_on_every_graph() {
    let Some(data) = common::data("equal_dialects_give_equal_bits_on_every_graph") else { return };
    for path in common::all_graph_files(&data) {
        let document = common::read(&path);
        let text = write(&document, document.dialect()).unwrap();
        let again = Document::parse("again", text.as_slice(), &common::options(&path)).unwrap();
        assert_eq!(document.dialect(), again.dialect(), "{}", path.display());
        assert_eq!(document.records().len(), again.records().len(), "{}", path.display());
        for (before, after) in document.lines().iter().zip(again.lines()) {
            assert_eq!(bits(before), bits(after), "{}", path.display());
        }
        assert_eq!(text, write(&again, again.dialect()).unwrap(), "{}", path.display());
    }
}

#[test]
fn every_graph_is_what_the_readme_says() {
    let Some(data) = common::data("every_graph_is_what_the_readme_says") else { return };
    // Poses, landmarks, edges between poses, observations of landmarks.
    let expected: BTreeMap<&str, (usize, usize, usize, usize)> = [
        ("pose2d/manhattanOlson3500.txt", (3500, 0, 5598, 0)),
        ("pose2d/city10000.txt", (10000, 0, 20687, 0)),
        ("pose2d/intel_943.g2o", (943, 0, 1837, 0)),
        ("pose2d/killian-small.toro", (1941, 0, 3995, 0)),
        ("pose2d/kitti_00.g2o", (4541, 0, 4677, 0)),
        ("pose2d/w100.graph", (100, 0, 300, 0)),
        ("pose2d/pose2example.txt", (11, 0, 12, 0)),
        ("landmark/victoriaPark.txt", (6969, 151, 6968, 3640)),
        ("landmark/victoria_park_gtsam.txt", (6969, 151, 6968, 3640)),
        ("landmark/victoriaPark-full.g2o", (6969, 151, 6968, 3640)),
        ("landmark/world-2000-full.g2o", (2001, 69, 2000, 3812)),
        ("landmark/world-2000-noassoc.g2o", (2001, 0, 2000, 0)),
        ("landmark/example.graph", (95, 24, 94, 0)),
        ("laser2d/intel-lab_flirt.log", (2672, 0, 3901, 0)),
        ("pose3d/torus2000Points.txt", (1073, 20, 2034, 1039)),
        ("pose3d/sphere_mednoise.graph", (2200, 0, 8647, 0)),
        ("pose3d/parking-garage.g2o", (1661, 0, 6275, 0)),
        ("pose3d/example_with_vertices.g2o", (8, 8, 0, 0)),
        ("range/plaza1.pyfg", (9658, 4, 9657, 0)),
        ("range/mrclam5a.pyfg", (1080, 15, 1075, 1127)),
        ("range/single_drone.pyfg", (1754, 1, 1753, 0)),
        ("pose3d/multirobot/blocks_world_4robots_fullGraph.g2o", (64, 0, 144, 0)),
    ]
    .into();
    for (name, counts) in expected {
        let document = common::read(&data.join(name));
        let s = document.summary();
        assert_eq!((s.poses, s.landmarks, s.pose_edges, s.landmark_edges), counts, "{name}");
        assert_eq!((s.skipped, s.clipped, s.long_quaternions), (0, 0, 0), "{name}");
    }
    let ignored =
        |name: &str, tag: &str| common::read(&data.join(name)).summary().ignored.get(tag).copied();
    assert_eq!(ignored("pose2d/w100.graph", "EQUIV"), Some(40));
    let seen = common::read(&data.join("landmark/example.graph"));
    assert_eq!((seen.summary().measurements, seen.summary().ignored.len()), (422, 0));
    assert_eq!(ignored("landmark/world-2000-noassoc.g2o", "DATA_FEATURE_POINTXY"), Some(3812));
    assert_eq!(ignored("laser2d/intel-lab_flirt.log", "ROBOTLASER1"), Some(2672));
    assert_eq!(ignored("pose2d/killian.g2o", "#"), Some(2));
}

#[test]
fn edges_to_poses_of_other_robots_are_named() {
    let Some(data) = common::data("edges_to_poses_of_other_robots_are_named") else { return };
    for path in
        common::all_graph_files(&data).iter().filter(|path| common::names_foreign_poses(path))
    {
        let strict = evergraph_formats::ReadOptions::default();
        let error = Document::read(path, &strict).unwrap_err();
        assert!(matches!(error, FormatError::MissingVertex { .. }), "{error}");
        let lenient = common::read(path);
        assert_eq!(
            lenient.summary().skipped + lenient.summary().pose_edges,
            44,
            "{}",
            path.display()
        );
        assert_eq!(lenient.skipped().len(), lenient.summary().skipped);
    }
}

#[test]
fn graphs_survive_a_detour_through_another_dialect() {
    let Some(data) = common::data("graphs_survive_a_detour_through_another_dialect") else {
        return;
    };
    for path in common::all_graph_files(&data) {
        let document = common::read(&path);
        if path.ends_with("victoria_park_gtsam.txt") {
            continue; // Covariances come back as square roots, iSAM's own kind.
        }
        for detour in [Dialect::G2o, Dialect::Toro, Dialect::Isam, Dialect::Pyfg] {
            let text = match write(&document, detour) {
                Ok(text) => text,
                Err(FormatError::Unsupported { dialect, .. }) => {
                    assert_eq!(dialect, detour);
                    continue;
                }
                Err(FormatError::NoVertices { .. }) => {
                    assert!(document.needs_vertices(detour));
                    continue;
                }
                Err(FormatError::NothingToWrite { .. }) => {
                    assert_eq!(document.summary().pose_edges, 0);
                    continue;
                }
                Err(error) => panic!("{error}"),
            };
            let options = common::options(&path);
            let away = match Document::parse("detour", text.as_slice(), &options) {
                Ok(away) => away,
                Err(error) => panic!("{}: {error}", path.display()),
            };
            // iSAM has no vertices for TORO to be known by.
            let away = match away.needs_vertices(document.dialect()) {
                true => common::with_poses(&away),
                false => away,
            };
            let back = write(&away, document.dialect()).unwrap();
            let back = Document::parse("back", back.as_slice(), &common::options(&path)).unwrap();
            let edges = |d: &Document| {
                d.records()
                    .filter(|r| matches!(r, Record::Edge { .. }))
                    .cloned()
                    .collect::<Vec<_>>()
            };
            let (before, after) = (edges(&document), edges(&back));
            assert_eq!(before.len(), after.len(), "{}", path.display());
            for (a, b) in before.iter().zip(&after) {
                assert_close(a, b, &format!("{} through {detour}", path.display()));
            }
        }
    }
}

/// Equal but for rounding, and for the names of angles and quaternions.
fn assert_close(a: &Record, b: &Record, what: &str) {
    let (
        Record::Edge { from, to, measurement, weight, .. },
        Record::Edge { from: f, to: t, measurement: m, weight: w, .. },
    ) = (a, b)
    else {
        panic!("{what}: {a:?} {b:?}");
    };
    // A detour through names puts a letter into the top byte.
    let index = |id: u64| id & (u64::MAX >> 8);
    assert_eq!((index(*from), measurement.kind()), (index(*f), m.kind()), "{what}");
    if measurement.kind().is_pose() {
        assert_eq!(index(*to), index(*t), "{what}"); // Landmarks of the torus are numbered anew in g2o.
    }
    // Inverting twice loses what is between the largest and the smallest eigenvalue.
    let loss = if what.ends_with("PyFactorGraph") { 1e-6 } else { 1e-9 };
    let scale = weight.entries.iter().fold(0.0_f64, |s, x| s.max(x.abs()));
    for (x, y) in weight.entries.iter().zip(&w.entries) {
        assert!((x - y).abs() <= loss * scale, "{what}: {a:?} {b:?}");
    }
    let (x, y) = (measurement.numbers(), m.numbers());
    let near = |x: &[f64], y: &[f64]| {
        x.iter().zip(y).all(|(x, y)| (x - y).abs() <= 1e-9 * (1.0 + x.abs()))
    };
    let same = match measurement {
        // The file's quaternion need not have unit length, and q is -q.
        Coordinates::Pose3Quaternion(_) => {
            let dot =
                |x: &[f64], y: &[f64]| x[3..].iter().zip(&y[3..]).map(|(p, q)| p * q).sum::<f64>();
            let cosine = dot(x, y) / (dot(x, x) * dot(y, y)).sqrt();
            near(&x[..3], &y[..3]) && cosine.abs() > 1.0 - 1e-12
        }
        Coordinates::Pose3Euler(_) => {
            near(&x[..3], &y[..3]) && (3..6).all(|i| (x[i] - y[i]).sin().abs() < 1e-6)
        }
        _ => near(x, y),
    };
    assert!(same, "{what}: {a:?} {b:?}");
}
