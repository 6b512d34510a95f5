//! `--verbose`: what happens inside, on standard error.

use std::env;
use std::io;

use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt;
use tracing_subscriber::prelude::*;

use crate::options::Common;

/// The environment variable with directives such as `evergraph_solver=debug`; goes before
/// `--verbose`.
const VARIABLE: &str = "RUST_LOG";

/// Prints events from here on, if any were asked for.
pub(crate) fn start(common: &Common) {
    let asked = match common.verbose {
        _ if common.quiet => return,
        0 => None,
        // All of our crates: targets are told by how they begin.
        1 => Some(Targets::new().with_target("evergraph", Level::INFO)),
        2 => Some(Targets::new().with_target("evergraph", Level::DEBUG)),
        _ => Some(Targets::new().with_target("evergraph", Level::TRACE)),
    };
    let directives = env::var(VARIABLE).ok().filter(|text| !text.is_empty());
    let filter = match directives.map(|text| text.parse::<Targets>()) {
        Some(Ok(filter)) => Some(filter),
        Some(Err(error)) => {
            common.output().warn(&format!("{VARIABLE} is passed over: {error}"));
            asked
        }
        None => asked,
    };
    let Some(filter) = filter else { return };
    let lines = fmt::layer()
        .compact()
        .without_time()
        .with_target(false)
        .with_ansi(false)
        .with_writer(io::stderr);
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
}
