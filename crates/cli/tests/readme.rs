//! The commands of the README run from top to bottom.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::path::Path;

use common::Folder;

/// The lines of the README's shell blocks that call the program, without comments.
fn commands() -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../README.md");
    let text = std::fs::read_to_string(path).unwrap();
    let mut inside = false;
    let mut commands = Vec::new();
    for line in text.lines() {
        if line.starts_with("```") {
            inside = line == "```sh";
        } else if inside && let Some(command) = line.strip_prefix("evergraph ") {
            let command = command.split('#').next().unwrap_or_default();
            commands.push(command.trim().to_string());
        }
    }
    commands
}

/// A folder with files of the names that the README uses, small worlds all of them.
fn folder() -> Folder {
    let folder = Folder::new();
    let make = |line: &str| drop(folder.run(line).done());
    make("simulate manhattan --poses 120 --seed 3 --output manhattan.g2o --truth truth.g2o");
    make("simulate sphere --poses 60 --seed 3 --output sphere.g2o");
    make("convert manhattan.g2o killian.toro");
    folder.write("list.txt", "5\n6\n17\n");
    make("remove manhattan.g2o --keep-every 3 --output pruned-by-others.g2o");
    folder
}

#[test]
fn the_commands_of_the_readme_run_from_top_to_bottom() {
    let (folder, commands) = (folder(), commands());
    assert!(commands.len() >= 12, "{commands:?}");
    for command in commands {
        // A world of full size would only take longer.
        let command = command.replace("--poses 10000", "--poses 200");
        let ran = folder.run(&command);
        assert_eq!(ran.code, Some(0), "evergraph {command}\n{}", ran.err);
        assert!(!ran.out.is_empty(), "evergraph {command}");
    }
}
