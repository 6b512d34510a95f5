//! During replays the tree is, at every 100th step, the factorization of its linear system and its
//! solution that of a fresh batch QR.

use std::num::NonZeroU32;

use evergraph::Settings;
use evergraph::solver::{Elimination, Relinearization};
use evergraph_tests::{check_against_batch, data_file, read, replay};

fn check_replay(test: &str, file: &str, settings: Settings) {
    let Some(path) = data_file(test, file) else { return };
    let document = read(&path);
    let mut checked = 0;
    let replayer = replay(&document, settings, |steps, replayer| {
        if steps % 100 == 0 {
            check_against_batch(replayer.smoother(), &format!("{file}, step {steps}"));
            checked += 1;
        }
    });
    check_against_batch(replayer.smoother(), file);
    assert!(checked >= 1, "{file} is too short for this test");
}

fn settings(elimination: Elimination, relinearization: Relinearization) -> Settings {
    Settings::default().with_elimination(elimination).with_relinearization(relinearization)
}

macro_rules! replays {
    ($($name:ident: $file:literal, $elimination:expr, $relinearization:expr;)*) => {$(
        #[test]
        fn $name() {
            check_replay(stringify!($name), $file, settings($elimination, $relinearization));
        }
    )*};
}

const EVERY_100: Relinearization = Relinearization::every(match NonZeroU32::new(100) {
    Some(n) => n,
    None => unreachable!(),
});

replays! {
    manhattan_default: "pose2d/manhattanOlson3500.txt", Elimination::Cholesky, Relinearization::BOTH;
    manhattan_qr: "pose2d/manhattanOlson3500.txt", Elimination::Qr, Relinearization::FLUID;
    manhattan_never: "pose2d/manhattanOlson3500.txt", Elimination::Cholesky, Relinearization::NEVER;
    intel_every: "pose2d/intel.g2o", Elimination::Cholesky, EVERY_100;
    ill_conditioned_intel: "pose2d/input_INTEL_g2o.g2o", Elimination::Cholesky, Relinearization::BOTH;
    ill_conditioned_intel_qr: "pose2d/input_INTEL_g2o.g2o", Elimination::Qr, Relinearization::BOTH;
    mit: "pose2d/MIT.g2o", Elimination::Cholesky, Relinearization::BOTH;
    garage: "pose3d/parking-garage.g2o", Elimination::Cholesky, Relinearization::BOTH;
    sphere_qr: "pose3d/sphere400.txt", Elimination::Qr, Relinearization::BOTH;
    sphere: "pose3d/sphere2500.g2o", Elimination::Cholesky, Relinearization::BOTH;
    victoria: "landmark/victoriaPark.txt", Elimination::Cholesky, Relinearization::BOTH;
    torus_points: "pose3d/torus2000Points.txt", Elimination::Cholesky, Relinearization::BOTH;
}
