//! Shared graph files for tests.
#![allow(dead_code, reason = "each test program uses its own part")]
#![allow(clippy::print_stdout, reason = "a test says what it skipped or saw")]

pub mod lines;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use evergraph_formats::{Document, Kind, ReadOptions, Record, WeightKind};
use evergraph_model::{LieGroup, Pose2, Pose3, Value};

/// The folder of shared graphs, or `None` (said aloud) when `EVERGRAPH_DATA` is not set.
///
/// # Panics
/// When it is set and there is no such folder: a test that cannot find its data has failed.
pub fn data(test: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("EVERGRAPH_DATA") else {
        println!("SKIPPED {test}: EVERGRAPH_DATA is not set");
        return None;
    };
    let folder = PathBuf::from(folder);
    assert!(folder.is_dir(), "EVERGRAPH_DATA is {}, which is no folder", folder.display());
    Some(folder)
}

/// Graphs of the folders `pose2d`, `pose3d`, `landmark` and `laser2d`, sorted.
pub fn graph_files(data: &Path) -> Vec<PathBuf> {
    files_of(data, &["pose2d", "pose3d", "landmark", "laser2d"])
}

/// Those, and the PyFactorGraph files of the folder `range`.
pub fn all_graph_files(data: &Path) -> Vec<PathBuf> {
    files_of(data, &["pose2d", "pose3d", "landmark", "laser2d", "range"])
}

fn files_of(data: &Path, names: &[&str]) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders: Vec<PathBuf> = names.iter().map(|name| data.join(name)).collect();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("the data folder can be listed") {
            let path = entry.expect("the data folder can be listed").path();
            if path.is_dir() {
                folders.push(path);
            } else if is_graph(&path) {
                files.push(path);
            }
        }
    }
    files.sort();
    assert!(files.len() > 40, "only {} graph files in {}", files.len(), data.display());
    files
}

fn is_graph(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    match extension {
        "g2o" | "graph" | "toro" | "outliers" | "pyfg" => true,
        "log" => name.contains("flirt"),
        // Of the folder of ranges only the PyFactorGraph files are graphs.
        "txt" if path.components().any(|part| part.as_os_str() == "range") => false,
        "txt" => !name.starts_with("dlr_") && !name.contains("timestamps"),
        _ => false,
    }
}

/// The robots' own files of the blocks world name each other's poses, which have no VERTEX there.
pub fn names_foreign_poses(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    name.starts_with("blocks_world_4robots_") && !name.contains("full")
}

/// How a file has to be read.
pub fn options(path: &Path) -> ReadOptions {
    let covariance = path.ends_with("victoria_park_gtsam.txt");
    ReadOptions::default().with_lenient(names_foreign_poses(path)).with_isam_matrix(if covariance {
        WeightKind::Covariance
    } else {
        WeightKind::SquareRoot
    })
}

/// Reads a file that is good.
pub fn read(path: &Path) -> Document {
    Document::read(path, &options(path)).unwrap_or_else(|error| panic!("{error}"))
}

/// The document with its poses at the identity: for dialects that want vertices.
pub fn with_poses(document: &Document) -> Document {
    let mut poses = BTreeMap::new();
    for record in document.records() {
        if let Record::Edge { from, to, measurement, .. } = record {
            let value = match measurement.kind() {
                Kind::Pose2 => Value::new(&Pose2::identity()),
                _ => Value::new(&Pose3::identity()),
            };
            poses.insert(*from, value.clone());
            poses.insert(*to, value);
        }
    }
    document.with_vertices(poses).unwrap_or_else(|error| panic!("{error}"))
}
