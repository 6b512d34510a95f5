//! What the tests across crates share.
//!
//! Most of them replay real graphs, which are too large for the repository. `EVERGRAPH_DATA` says
//! where they are; without it those tests say `SKIPPED` and pass. A test starts with
//!
//! ```
//! # fn a_test() {
//! let Some(path) = evergraph_tests::data_file("a_test", "pose2d/manhattan.g2o") else { return };
//! # }
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod double;
mod oracle;
mod replay;
mod stack;
pub mod world;

pub use oracle::check_against_batch;
pub use replay::{References, read, replay};
pub use stack::{dim_of, stack};

use std::env;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// The environment variable that says where the data sets are.
pub const DATA_VARIABLE: &str = "EVERGRAPH_DATA";

/// The folder of the data sets, or `None` when `EVERGRAPH_DATA` is not set; then `test` is
/// reported as skipped.
///
/// # Panics
/// When the variable is set and is no folder: a typing error must not pass as success.
pub fn data_dir(test: &str) -> Option<PathBuf> {
    let Some(value) = env::var_os(DATA_VARIABLE) else {
        // Past the capture of `println!`, which would hide the line of a test that passes. Nothing
        // depends on the line being written, so a closed stream is no failure.
        let _ = writeln!(io::stderr(), "SKIPPED {test}: {DATA_VARIABLE} is not set");
        return None;
    };
    let dir = PathBuf::from(value);
    assert!(
        dir.is_dir(),
        "{DATA_VARIABLE} is set to {}, which is not a folder; set it to the folder of the data \
         sets, or unset it to skip {test}",
        dir.display()
    );
    Some(dir)
}

/// The file at `relative` below [`data_dir`].
///
/// # Panics
/// As [`data_dir`], and when the folder does not have the file.
pub fn data_file(test: &str, relative: &str) -> Option<PathBuf> {
    let path = data_dir(test)?.join(relative);
    assert!(path.is_file(), "{test} needs {}, which {DATA_VARIABLE} does not have", path.display());
    Some(path)
}

/// The root of the repository.
pub fn repository() -> &'static Path {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().unwrap_or(tests)
}
