//! The main job on every public graph with a known optimum: replay, a batch step every 100 poses,
//! a last one at the end.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test fails by panicking, and says what it saw"
)]

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use evergraph::Settings;
use evergraph::solver::{BatchSettings, Elimination, Relinearization, Status};
use evergraph_tests::{References, data_dir, read, replay};

/// Finds a file by name in the folders of the data sets.
fn find(data: &Path, name: &str) -> PathBuf {
    let folders = ["pose2d", "pose3d", "landmark"];
    let path =
        folders.iter().map(|folder| data.join(folder).join(name)).find(|path| path.is_file());
    path.unwrap_or_else(|| panic!("{name} of references.json is in none of {folders:?}"))
}

fn every_file_ends_at_its_optimum(test: &str, elimination: Elimination) {
    let Some(data) = data_dir(test) else { return };
    let references = References::read(&data);
    assert!(references.files().len() >= 24, "references.json has lost files");
    let mut relinearization = Relinearization::BOTH;
    relinearization.batch = NonZeroU32::new(100);
    let settings = Settings::default()
        .with_elimination(elimination)
        .with_relinearization(relinearization)
        .with_threads(2);
    for file in references.files() {
        let document = read(&find(&data, &file));
        let mut replayer = replay(&document, settings, |_, _| ());
        let batch = replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
        assert_eq!(batch.status, Status::Converged, "{file}");
        let (error, reference) = (replayer.error().unwrap(), references.error(&file));
        println!("{file}: error {error:.9}, reference {reference:.9}");
        assert!(
            error <= reference * (1.0 + 1e-6),
            "{file}: ends at {error}, the optimum is {reference}"
        );
    }
}

#[test]
fn cholesky_reaches_every_reference() {
    every_file_ends_at_its_optimum("cholesky_reaches_every_reference", Elimination::Cholesky);
}

#[test]
fn qr_reaches_every_reference() {
    every_file_ends_at_its_optimum("qr_reaches_every_reference", Elimination::Qr);
}
