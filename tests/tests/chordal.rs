//! Chordal initialization on public graphs: from it, Levenberg-Marquardt reaches the optimum that other
//! solvers found, and in few steps.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and says what it saw"
)]

use evergraph::replay::{Initial, ReplayOptions};
use evergraph::solver::{BatchSettings, Relinearization, Status};
use evergraph::{Replayer, Settings, chordal};
use evergraph_tests::{References, data_dir, read};

/// Best known errors that references.json does not have, as found by this solver from every start.
const OTHERS: [(&str, f64); 2] =
    [("torus2000Points.txt", 4698.25505), ("sphere_mednoise.graph", 192.198663)];

#[test]
fn optimization_from_it_reaches_the_optimum() {
    let Some(data) = data_dir("optimization_from_it_reaches_the_optimum") else { return };
    let references = References::read(&data);
    let settings = Settings::default().with_relinearization(Relinearization::NEVER);
    for (path, most_iterations) in [
        ("pose3d/sphere2500.g2o", 6),
        ("pose3d/torus2000Points.txt", 5),
        ("pose3d/parking-garage.g2o", 5),
        ("pose3d/smallGrid3D.g2o", 9),
        // From odometry this takes 18 iterations.
        ("pose3d/sphere_mednoise.graph", 8),
        ("pose2d/manhattan.g2o", 5),
        ("pose2d/manhattanOlson3500.txt", 6),
        ("pose2d/ringCity.g2o", 10),
        // From odometry this ends at 385.1.
        ("pose2d/MIT.g2o", 25),
    ] {
        let name = path.rsplit('/').next().unwrap();
        let document = read(&data.join(path));
        let start = document.with_vertices(chordal(&document, &settings).unwrap()).unwrap();
        let options = ReplayOptions::default().with_initial(Initial::FromFile);
        let mut replayer = Replayer::new(&start, &options, settings).unwrap();
        replayer.everything().unwrap();
        let batch = replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
        let error = replayer.error().unwrap();
        println!("{name}: {} to {error} in {} iterations", batch.initial_error, batch.iterations);
        assert_eq!(batch.status, Status::Converged, "{name}");
        assert!(batch.iterations <= most_iterations, "{name}: {} iterations", batch.iterations);
        let other = OTHERS.iter().find(|other| other.0 == name).map(|other| other.1);
        let reference = other.unwrap_or_else(|| references.error(name));
        let excess = (error - reference) / reference;
        assert!(excess.abs() < 1e-6, "{name}: ends at {error}, the optimum is {reference}");
    }
}
