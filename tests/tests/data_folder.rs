//! `EVERGRAPH_DATA` unset skips, set wrongly fails. Each case runs in a process of its own, because
//! the environment of this one is shared by its tests.

use std::path::Path;
use std::process::{Command, Output};

use evergraph_tests::{DATA_VARIABLE, data_dir, data_file};

/// Runs the test `name` of this file with the variable set to `value`.
fn run(name: &str, value: Option<&Path>) -> Output {
    let program = std::env::current_exe().expect("a test program has a path");
    let mut command = Command::new(program);
    command.args(["--exact", name]).env_remove(DATA_VARIABLE);
    if let Some(value) = value {
        command.env(DATA_VARIABLE, value);
    }
    command.output().expect("the test program runs")
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    format!("{out}{err}")
}

/// The subject of the tests below.
#[test]
fn subject_wants_the_folder() {
    if let Some(dir) = data_dir("subject_wants_the_folder") {
        assert!(dir.is_dir());
    }
}

/// The subject of the tests below.
#[test]
fn subject_wants_a_file() {
    if let Some(file) = data_file("subject_wants_a_file", "README.md") {
        assert!(file.is_file());
    }
}

#[test]
fn without_the_variable_a_test_passes_and_says_that_it_was_skipped() {
    for name in ["subject_wants_the_folder", "subject_wants_a_file"] {
        let output = run(name, None);
        let text = text(&output);
        assert!(output.status.success(), "{text}");
        assert!(text.contains(&format!("SKIPPED {name}: EVERGRAPH_DATA is not set")), "{text}");
    }
}

#[test]
fn with_a_folder_nothing_is_skipped() {
    let output = run("subject_wants_the_folder", Some(evergraph_tests::repository()));
    let text = text(&output);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
    assert!(!text.contains("SKIPPED"), "{text}");
}

#[test]
fn a_wrong_folder_fails_and_says_so() {
    let output = run("subject_wants_the_folder", Some(Path::new("/there/is/no/such/folder")));
    let text = text(&output);
    assert!(!output.status.success(), "{text}");
    assert!(text.contains("/there/is/no/such/folder, which is not a folder"), "{text}");
}

#[test]
fn a_folder_without_the_file_fails_and_names_it() {
    let crates = evergraph_tests::repository().join("crates");
    let output = run("subject_wants_a_file", Some(&crates));
    let text = text(&output);
    assert!(!output.status.success(), "{text}");
    assert!(text.contains("README.md, which EVERGRAPH_DATA does not have"), "{text}");
}
