//! The `evergraph` program: it reads the command line, calls the library, and prints and writes results.
//! A file or folder per subcommand; no algorithm.
#![forbid(unsafe_code)]

mod audit;
mod bench;
mod compare;
mod completions;
mod convert;
mod error;
mod evaluate;
mod files;
mod final_batch;
mod fit;
mod info;
mod log;
mod nodes;
mod optimize;
mod options;
mod output;
mod outputs;
mod plot;
mod progress;
mod reading;
mod reduction;
mod remove;
mod replay;
mod report;
mod simulate;
mod stderr;
mod steps;
mod table;
mod temporary;
mod warnings;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};

use crate::options::Common;

/// Incremental smoothing of pose graphs: g2o, TORO and iSAM files.
#[derive(Debug, Parser)]
#[command(name = "evergraph", version, max_term_width = 100, after_help = EXIT_CODES)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 the input or the problem is bad (a message says what and where), 2 usage,
130 interrupted: no file is left half written.
`evergraph <COMMAND> --help` has examples; `evergraph completions --help` says how a shell completes
the options.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Drive a file through the smoother step by step, as the robot recorded it
    Replay(replay::Arguments),
    /// Solve a whole file at once
    Optimize(optimize::Arguments),
    /// Remove nodes, keep what they knew, and say what it cost
    Remove(remove::Arguments),
    /// Say what a reduced graph, whoever made it, has lost of the full one
    Compare(compare::Arguments),
    /// Measure a map by the truth
    Evaluate(evaluate::Arguments),
    /// Replay a file and compare with the batch optimum along the way
    Audit(audit::Arguments),
    /// Measure where the time of a replay or an optimization goes
    Bench(bench::Arguments),
    /// Say what a file holds and what it costs as it stands
    Info(info::Arguments),
    /// Write a file in another format
    Convert(convert::Arguments),
    /// Make a world with known truth
    Simulate(simulate::Arguments),
    /// Print completions for a shell
    Completions(completions::Arguments),
}

impl Command {
    /// What all subcommands take that have anything to say.
    fn common(&self) -> Option<&Common> {
        match self {
            Self::Replay(arguments) => Some(&arguments.common),
            Self::Optimize(arguments) => Some(&arguments.common),
            Self::Remove(arguments) => Some(&arguments.common),
            Self::Compare(arguments) => Some(&arguments.common),
            Self::Evaluate(arguments) => Some(&arguments.common),
            Self::Audit(arguments) => Some(&arguments.common),
            Self::Bench(arguments) => Some(&arguments.common),
            Self::Info(arguments) => Some(&arguments.common),
            Self::Convert(arguments) => Some(&arguments.common),
            Self::Simulate(arguments) => Some(&arguments.common),
            Self::Completions(_) => None,
        }
    }
}

fn main() -> ExitCode {
    if let Some(kernel) = options::detached_kernel(std::env::args_os()) {
        let message = format!("a kernel is joined to its option by `=`: --robust={kernel}");
        Program::command().error(ErrorKind::InvalidValue, message).exit();
    }
    let command = Program::parse().command;
    if let Some(common) = command.common() {
        log::start(common);
    }
    temporary::remove_on_interrupt();
    let result = match command {
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Optimize(arguments) => optimize::run(&arguments),
        Command::Remove(arguments) => remove::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Audit(arguments) => audit::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments, Program::command()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => error.end(Program::command()),
    }
}
