//! Replaying files in tests.

use std::fs;
use std::path::Path;

use evergraph::formats::{Document, ReadOptions};
use evergraph::replay::ReplayOptions;
use evergraph::{Replayer, Settings};

/// Reads a graph file as the program does by default.
///
/// # Panics
/// When it cannot be read.
pub fn read(path: &Path) -> Document {
    Document::read(path, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// Replays a whole file, calling `visit` with the number of steps done and the replayer after each.
///
/// # Panics
/// When a step fails.
pub fn replay(
    document: &Document,
    settings: Settings,
    mut visit: impl FnMut(usize, &Replayer),
) -> Replayer {
    let options = ReplayOptions::default();
    let mut replayer =
        Replayer::new(document, &options, settings).unwrap_or_else(|error| panic!("{error}"));
    let mut steps = 0;
    while replayer.step().unwrap_or_else(|error| panic!("{error}")).is_some() {
        steps += 1;
        visit(steps, &replayer);
    }
    replayer
}

/// The optimal errors that other solvers found, `references.json`.
pub struct References(serde_json::Value);

impl References {
    /// Reads `references.json` in the folder of the data sets.
    ///
    /// # Panics
    /// When it is not there or no JSON.
    pub fn read(data: &Path) -> Self {
        let path = data.join("references.json");
        let text =
            fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Self(
            serde_json::from_str(&text)
                .unwrap_or_else(|error| panic!("{}: {error}", path.display())),
        )
    }

    /// Names of the files that it speaks of.
    pub fn files(&self) -> Vec<String> {
        let names = self.0.as_object().into_iter().flatten().map(|(name, _)| name);
        names.filter(|name| !name.starts_with('_')).cloned().collect()
    }

    /// The best known error of a file.
    ///
    /// # Panics
    /// When there is none.
    pub fn error(&self, file: &str) -> f64 {
        self.0[file]["error"].as_f64().unwrap_or_else(|| panic!("no reference error for {file}"))
    }
}

impl std::fmt::Debug for References {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "References({} files)", self.files().len())
    }
}
