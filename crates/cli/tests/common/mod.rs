//! Runs the program and looks at what it says.

#![allow(dead_code, reason = "each test program uses its own part")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

/// A short loop in a file: four poses around a square.
pub const SQUARE: &str = "\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0 1.5
VERTEX_SE2 2 1.1 1.1 3
VERTEX_SE2 3 0.1 1.1 -1.6
EDGE_SE2 0 1 1 0 1.5708 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5708 100 0 0 100 0 400
EDGE_SE2 2 3 1 0 1.5708 100 0 0 100 0 400
EDGE_SE2 3 0 1.05 0 1.56 100 0 0 100 0 400
";

/// Two chains that nothing ties together.
pub const TWO_PARTS: &str = "\
EDGE_SE2 10 11 1 0 0 1 0 0 1 0 1
EDGE_SE2 11 12 1 0 0 1 0 0 1 0 1
EDGE_SE2 20 21 1 0 0 1 0 0 1 0 1
";

/// What a run left.
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Ran {
    fn of(output: &Output) -> Self {
        let text =
            |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("the program writes text");
        Self { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) }
    }

    /// The run, which has to have succeeded.
    #[track_caller]
    pub fn done(self) -> Self {
        assert_eq!(self.code, Some(0), "{}\n{}", self.out, self.err);
        self
    }

    /// The run, which has to have failed with this code, no result, and a message with these parts.
    #[track_caller]
    pub fn failed(self, code: i32, parts: &[&str]) -> Self {
        assert_eq!(self.code, Some(code), "{}\n{}", self.out, self.err);
        assert_eq!(self.out, "");
        for part in parts {
            assert!(self.err.contains(part), "`{part}` is not in: {}", self.err);
        }
        assert!(!self.err.contains("panicked"), "{}", self.err);
        self
    }
}

/// A scratch folder to run the program in.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a scratch folder can be made"))
    }

    /// With a file in it.
    pub fn with(name: &str, text: &str) -> Self {
        let folder = Self::new();
        folder.write(name, text);
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).expect("a scratch file can be written");
    }

    #[track_caller]
    pub fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).expect("the program wrote the file")
    }

    #[track_caller]
    pub fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.read(name)).expect("reports are JSON")
    }

    /// Names of the files in it.
    pub fn list(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0.path()).expect("a scratch folder can be listed");
        let name = |entry: std::io::Result<fs::DirEntry>| {
            entry.expect("an entry has a name").file_name().to_string_lossy().into_owned()
        };
        let mut names: Vec<String> = entries.map(name).collect();
        names.sort();
        names
    }

    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_evergraph"));
        command.args(line.split_whitespace()).current_dir(self.0.path()).stdin(Stdio::null());
        command
    }

    /// Runs the program with the words of `line`.
    pub fn run(&self, line: &str) -> Ran {
        Ran::of(&self.command(line).output().expect("the program starts"))
    }
}

/// The path of a small graph with a known answer.
pub fn case(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases").join(name).display().to_string()
}

/// A file of the samples folder.
pub fn sample(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data");
    folder.join(name).display().to_string()
}

#[track_caller]
pub fn number(report: &Value, field: &str) -> f64 {
    report[field].as_f64().unwrap_or_else(|| panic!("`{field}` is no number in {report}"))
}

/// Every field that a report of `remove` or `compare` has to have, and what any removal at the optimum
/// obeys.
#[track_caller]
pub fn check_reduction(report: &Value) {
    for field in [
        "removed",
        "variables_before",
        "variables_after",
        "factors_before",
        "factors_after",
        "nnz_before",
        "nnz_after",
        "factor_nnz_before",
        "factor_nnz_after",
        "kld_covariance",
        "kld_covariance_per_dof",
        "kld_mean",
        "kld_total",
        "log_det_ratio",
        "mean_shift_m",
        "rms_shift_m",
        "max_shift_m",
        "degrees_of_freedom",
    ] {
        assert!(number(report, field).is_finite());
    }
    let [before, after, removed] =
        ["variables_before", "variables_after", "removed"].map(|field| number(report, field));
    assert_eq!(before - after, removed);
    assert!(number(report, "kld_covariance") > -1e-8, "{report}");
    assert!(number(report, "kld_mean") >= 0.0);
    assert!(number(report, "mean_shift_m") <= number(report, "rms_shift_m"));
    assert!(number(report, "rms_shift_m") <= number(report, "max_shift_m"));
}
