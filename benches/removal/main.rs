//! What removal does to public graphs: `sweep` removes many nodes from each in many ways and looks for
//! errors; `cut` removes in the middle of a replay and goes on, and compares recoveries; `live` removes all
//! along a replay; `window` removes the oldest pose of a window at each step. Writes Markdown.
#![forbid(unsafe_code)]
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "tables are what it is for")]

mod cut;
mod live;
mod sweep;
mod window;

use std::collections::HashMap;
use std::path::Path;
use std::process::ExitCode;

use evergraph::evaluate::{Divergence, Solved};
use evergraph::formats::{Document, ReadOptions};
use evergraph::model::{FactorId, VariableId};
use evergraph::replay::ReplayOptions;
use evergraph::solver::{Settings, Status};
use evergraph::{Replayer, ReplayerError, optimize_to_the_end};

const USAGE: &str = "\
usage: cargo bench -p evergraph-benches --bench removal -- sweep [--quick] FILE...
       cargo bench -p evergraph-benches --bench removal -- cut FILE:POSES...
       cargo bench -p evergraph-benches --bench removal -- live FILE...
       cargo bench -p evergraph-benches --bench removal -- window STEPS";

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> ExitCode {
    // Cargo adds `--bench`.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|it| it != "--bench").collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let all_well = match words.as_slice() {
        // `cargo test --benches` and `cargo bench` of everything have no files to work on.
        [] => Ok(true),
        ["sweep", "--quick", files @ ..] if !files.is_empty() => sweep::run(files, true),
        ["sweep", files @ ..] if !files.is_empty() => sweep::run(files, false),
        ["cut", files @ ..] if !files.is_empty() => cut::run(files),
        ["window", steps] => window::run(steps.parse().unwrap_or(0)),
        ["live", files @ ..] if !files.is_empty() => live::run(files),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match all_well {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The file's name without its folders.
fn short(file: &str) -> String {
    Path::new(file).file_name().map_or_else(|| file.into(), |name| name.to_string_lossy().into())
}

fn read(file: &str) -> Result<Document, Failure> {
    Ok(Document::read(file, &ReadOptions::default())?)
}

/// One thread each; the variants run side by side.
fn settings() -> Settings {
    Settings::default().with_threads(1)
}

fn replayer(document: &Document) -> Result<Replayer, ReplayerError> {
    Replayer::new(document, &ReplayOptions::default(), settings())
}

/// The whole file at its optimum, and whether that was reached. Step by step, because batch steps from
/// some files' vertices end elsewhere.
fn optimum(document: &Document) -> Result<(Replayer, bool), Failure> {
    let mut replayer = replayer(document)?;
    while replayer.step()?.is_some() {}
    let batch = optimize_to_the_end(replayer.smoother_mut())?;
    Ok((replayer, batch.status == Status::Converged))
}

/// What holds the map in its place is no measurement: it stays.
fn gauge(replayer: &Replayer) -> Vec<FactorId> {
    replayer.replay().gauge_priors().iter().map(|prior| prior.factor).collect()
}

/// What a reduced graph has lost of the full one; variables are the same where their ids in the file are.
fn divergence(full: &Replayer, reduced: &Replayer) -> Result<Divergence, Failure> {
    let (was, is) = (full.smoother().estimates()?, reduced.smoother().estimates()?);
    let everyone: HashMap<u64, VariableId> = full.replay().ids().collect();
    let pairs: Vec<(VariableId, VariableId)> = reduced
        .replay()
        .ids()
        .filter(|(_, id)| reduced.graph().check_variable(*id).is_ok())
        .map(|(id, here)| (everyone[&id], here))
        .collect();
    Ok(Divergence::of(
        Solved { graph: full.graph(), estimates: &was },
        Solved { graph: reduced.graph(), estimates: &is },
        &pairs,
        &settings(),
    )?)
}
