//! The manifests, crate roots and imports hold the lines that ARCHITECTURE.md draws.

mod circles;

use std::fs;
use std::path::{Path, PathBuf};

use evergraph_tests::repository;
use toml::{Table, Value};

/// Which of our crates a crate may use. A new crate is a new line here.
const MAY_USE: [(&str, &[&str]); 12] = [
    ("model", &[]),
    ("factors", &["model"]),
    ("solver", &["model"]),
    ("removal", &["model", "factors"]),
    ("longterm", &["model", "factors", "solver", "removal"]),
    ("initialize", &["model", "factors", "solver"]),
    ("formats", &["model", "factors"]),
    ("replay", &["model", "factors", "solver", "longterm", "initialize", "formats"]),
    ("simulate", &["model", "factors", "formats"]),
    (
        "evaluate",
        &[
            "model",
            "factors",
            "solver",
            "removal",
            "longterm",
            "initialize",
            "formats",
            "replay",
            "simulate",
        ],
    ),
    (
        "evergraph",
        &[
            "model",
            "factors",
            "solver",
            "removal",
            "longterm",
            "initialize",
            "formats",
            "replay",
            "simulate",
            "evaluate",
        ],
    ),
    ("cli", &["evergraph"]),
];

/// Further crates that a crate may use in its tests.
const MAY_TEST_WITH: [(&str, &[&str]); 2] = [("solver", &["factors"]), ("removal", &["solver"])];

/// Crates that are programs: no `lib.rs` of their own.
const PROGRAMS: [&str; 1] = ["cli"];

/// What every crate takes from the workspace.
const INHERITED: [&str; 7] =
    ["version", "edition", "rust-version", "license", "authors", "categories", "keywords"];

/// A crate's folder name, its folder, and its manifest.
struct Crate {
    role: String,
    folder: PathBuf,
    manifest: Table,
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn parse(path: &Path) -> Table {
    read(path).parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// All crates, sorted by name.
fn crates() -> Vec<Crate> {
    let folder = repository().join("crates");
    let entries =
        fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut crates: Vec<Crate> = entries
        .map(|entry| entry.expect("a folder can be listed").path())
        .filter(|path| path.is_dir())
        .map(|folder| Crate {
            role: folder.file_name().expect("an entry has a name").to_string_lossy().into_owned(),
            manifest: parse(&folder.join("Cargo.toml")),
            folder,
        })
        .collect();
    crates.sort_by(|a, b| a.role.cmp(&b.role));
    assert!(!crates.is_empty());
    crates
}

/// Package name of a role, and back.
fn package(role: &str) -> String {
    if role == "evergraph" { role.into() } else { format!("evergraph-{role}") }
}

fn role(package: &str) -> Option<&str> {
    if package == "evergraph" { Some(package) } else { package.strip_prefix("evergraph-") }
}

/// The roles of our crates in one dependency table, under whatever name they are imported.
fn ours(table: Option<&Value>) -> Vec<String> {
    let Some(table) = table.and_then(Value::as_table) else { return Vec::new() };
    table
        .iter()
        .filter_map(|(name, entry)| {
            role(entry.get("package").and_then(Value::as_str).unwrap_or(name))
        })
        .map(str::to_owned)
        .collect()
}

/// Our crates that a manifest names under `kind`, for all platforms.
fn uses(manifest: &Table, kind: &str) -> Vec<String> {
    let mut found = ours(manifest.get(kind));
    if let Some(targets) = manifest.get("target").and_then(Value::as_table) {
        found.extend(targets.values().flat_map(|target| ours(target.get(kind))));
    }
    found
}

/// What is wrong with the directions in which `manifest` points.
fn wrong_directions(role: &str, manifest: &Table) -> Vec<String> {
    let Some((_, allowed)) = MAY_USE.iter().find(|line| line.0 == role) else {
        return vec![format!("{role} has no line in MAY_USE")];
    };
    let in_tests = MAY_TEST_WITH.iter().find(|line| line.0 == role).map_or(&[][..], |line| line.1);
    ["dependencies", "build-dependencies", "dev-dependencies"]
        .into_iter()
        .flat_map(|kind| uses(manifest, kind).into_iter().map(move |used| (kind, used)))
        .filter(|(kind, used)| {
            let used = used.as_str();
            let tested_with = *kind == "dev-dependencies" && in_tests.contains(&used);
            !(allowed.contains(&used) || tested_with)
        })
        .map(|(kind, used)| format!("{role} must not have {used} in its {kind}"))
        .collect()
}

#[test]
fn dependencies_go_one_way() {
    let wrong: Vec<String> =
        crates().iter().flat_map(|it| wrong_directions(&it.role, &it.manifest)).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The table itself has no cycle: each crate uses only crates of lines above its own.
#[test]
fn the_table_is_in_order() {
    for (place, (role, allowed)) in MAY_USE.iter().enumerate() {
        for used in *allowed {
            let found = MAY_USE[..place].iter().any(|line| line.0 == *used);
            assert!(found, "{role} may use {used}, which does not stand above it");
        }
    }
}

#[test]
fn a_wrong_direction_is_found_wherever_it_hides() {
    let wrong = |role, manifest: &str| wrong_directions(role, &manifest.parse().unwrap()).len();
    assert_eq!(wrong("solver", "[dependencies]\nevergraph-model.workspace = true"), 0);
    assert_eq!(wrong("solver", "[dependencies]\nevergraph-factors.workspace = true"), 1);
    assert_eq!(wrong("solver", "[dev-dependencies]\nevergraph-factors.workspace = true"), 0);
    assert_eq!(wrong("solver", "[dev-dependencies]\nevergraph-formats.workspace = true"), 1);
    assert_eq!(wrong("removal", "[dependencies]\nevergraph-solver.workspace = true"), 1);
    assert_eq!(wrong("removal", "[dev-dependencies]\nevergraph-solver.workspace = true"), 0);
    assert_eq!(wrong("formats", "[build-dependencies]\nevergraph-solver.workspace = true"), 1);
    assert_eq!(wrong("model", "[target.'cfg(unix)'.dependencies]\nevergraph-solver = '0.1'"), 1);
    assert_eq!(wrong("model", "[dependencies]\nfast = { package = 'evergraph-solver' }"), 1);
    assert_eq!(wrong("cli", "[dependencies]\nevergraph-solver.workspace = true"), 1);
    assert_eq!(wrong("cli", "[dependencies]\nevergraph.workspace = true\nclap = '4'"), 0);
    assert_eq!(wrong("newcomer", ""), 1);
}

/// The rules of what counts stand in [`circles`].
#[test]
fn files_and_folders_of_a_crate_import_each_other_without_circles() {
    let found: Vec<String> = crates()
        .iter()
        .flat_map(|it| {
            let circles = circles::circles_in(&it.folder.join("src"));
            circles.into_iter().map(|circle| format!("crates/{}/{circle}", it.role))
        })
        .collect();
    assert!(found.is_empty(), "{} circles:\n{}", found.len(), found.join("\n"));
}

#[test]
fn crates_are_named_by_their_role_and_take_the_rest_from_the_workspace() {
    let workspace = |value: Option<&Value>| {
        value.and_then(|value| value.get("workspace")).and_then(Value::as_bool) == Some(true)
    };
    for Crate { role, manifest, .. } in crates() {
        let details = &manifest["package"];
        assert_eq!(details["name"].as_str(), Some(package(&role).as_str()));
        assert!(details.get("description").is_some(), "{role} has no description");
        for key in INHERITED {
            assert!(workspace(details.get(key)), "{role} does not inherit {key}");
        }
        let lints = manifest.get("lints");
        assert!(
            lints.and_then(|lints| lints.get("workspace")).and_then(Value::as_bool) == Some(true),
            "{role} does not inherit the lints"
        );
        for kind in ["dependencies", "build-dependencies", "dev-dependencies"] {
            let Some(table) = manifest.get(kind).and_then(Value::as_table) else { continue };
            for (name, entry) in table {
                assert!(
                    workspace(Some(entry)),
                    "{role}: the version of {name} is not the workspace's"
                );
            }
        }
    }
}

#[test]
fn libraries_forbid_unsafe_code_and_undocumented_items() {
    for Crate { role, folder, .. } in crates() {
        let library = folder.join("src/lib.rs");
        if PROGRAMS.contains(&role.as_str()) {
            assert!(!library.exists(), "{role} is a program and must have no library");
            continue;
        }
        let source = read(&library);
        for attribute in ["#![forbid(unsafe_code)]", "#![deny(missing_docs)]"] {
            let found = source.lines().any(|line| line.trim() == attribute);
            assert!(found, "{} lacks {attribute}", library.display());
        }
    }
}

/// Names of outside dependencies in the text of the root manifest without a comment right above.
fn without_reason(manifest: &str) -> Vec<String> {
    let mut lines = manifest.lines().map(str::trim);
    let mut previous = lines
        .by_ref()
        .find(|line| *line == "[workspace.dependencies]")
        .expect("the root manifest lists the dependencies");
    let mut found = Vec::new();
    for line in lines.take_while(|line| !line.starts_with('[')) {
        if let Some((name, _)) = line.split_once([' ', '=', '.'])
            && !line.starts_with('#')
            && role(name).is_none()
            && !previous.starts_with('#')
        {
            found.push(name.to_owned());
        }
        previous = line;
    }
    found
}

#[test]
fn every_dependency_has_its_reason() {
    let root = repository().join("Cargo.toml");
    assert_eq!(without_reason(&read(&root)), [""; 0], "no reason in the line above");
    let example = "[workspace.dependencies]\nevergraph-model = '0.1'\n# Good.\na = '1'\nb = '1'\n\nc.version = '1'\n[other]\nd = '1'";
    assert_eq!(without_reason(example), ["b", "c"]);
}

#[test]
fn versions_stand_in_the_workspace_and_wildcards_nowhere() {
    let root = parse(&repository().join("Cargo.toml"));
    for (name, entry) in root["workspace"]["dependencies"].as_table().unwrap() {
        let version = entry.as_str().or_else(|| entry.get("version").and_then(Value::as_str));
        let version = version.unwrap_or_else(|| panic!("{name} has no version"));
        assert!(!version.contains('*'), "{name}: {version}");
    }
}
