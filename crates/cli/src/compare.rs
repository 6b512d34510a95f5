//! `evergraph compare`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use evergraph::evaluate::{
    GraphSize, ReducedError, Solved, anchor_alike, components_gone, shared_values, shared_variables,
};
use evergraph::formats::Document;
use evergraph::replay::ReplayOptions;
use evergraph::solver::{BatchReport, Relinearization};
use evergraph::{Overview, Replayer, optimize_to_the_end};
use serde_json::{Map, json};

use crate::error::Error;
use crate::files;
use crate::options::{Common, Solving, StartFrom};
use crate::plot::PlotPath;
use crate::reading::Reading;
use crate::reduction::{self, Reduction, gauge_factors, incomparable, warn_of_ends};
use crate::report::{self, SCHEMA};
use crate::table::{Rows, milliseconds};
use crate::warnings::warn_of_landmarks;

const EXAMPLES: &str = "\
Examples:
  evergraph compare manhattan.g2o half.g2o
  evergraph compare manhattan.g2o pruned-by-others.g2o --report out.json
  evergraph compare noisy.g2o noisy-half.g2o --robust

FULL is optimized from its vertices (or odometry), REDUCED from that optimum; the vertices of
REDUCED do not matter. Variables are the same where their ids are. Where REDUCED has its gauge
prior on another pose, that of FULL moves there. Where nothing of a connected component of FULL
is kept there is nothing to compare: how many those are is told, and the figures are of the
others. --robust is for both graphs, but where REDUCED has ROBUST lines, as after `remove
--robust`, those alone are robust in it.";

/// Say what a reduced graph, whoever made it, has lost of the full one.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The full graph: a g2o, TORO, iSAM or PyFactorGraph file
    full: PathBuf,
    /// The reduced graph, of variables that the full one has
    reduced: PathBuf,
    #[command(flatten)]
    solving: Solving,
    /// Draw the reduced graph over the full one; .svg or .png
    #[arg(long, value_name = "FILE", value_parser = PlotPath::parse, help_heading = "Output")]
    plot: Option<PlotPath>,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let begun = Instant::now();
    let common = &arguments.common;
    let output = common.output();
    let plot = arguments.plot.as_ref().map(PlotPath::path);
    let targets = || common.report.as_deref().into_iter().chain(plot);
    files::check_distinct("compare", targets())?;
    for path in targets() {
        let read = [&arguments.full, &arguments.reduced];
        files::check_apart("compare", read.map(PathBuf::as_path), path)?;
        files::check_writable(path)?;
    }
    let settings = arguments.solving.settings(Relinearization::NEVER, common.threads());
    let options = arguments.solving.replay_options(StartFrom::File);
    let prior = arguments.solving.prior.0;

    let full_document = arguments.reading.read(&arguments.full, common)?;
    let mut full = Replayer::new(&full_document, &options, settings)?;
    let first = solve(&mut full).map_err(|error| error.with_gauge(prior, &full_document))?;
    let overview = Overview::of(&full_document);
    let document = arguments.reading.read(&arguments.reduced, common)?;
    let document = document.with_vertices(shared_values(&full, &document)?)?;
    let options = as_the_file_says(&document, options);
    let mut reduced = Replayer::new(&document, &options, settings)?;
    let batch = solve(&mut reduced).map_err(|error| error.with_gauge(prior, &document))?;
    let anchored = anchor_alike(&mut full, &reduced, &overview);
    let priors = anchored.map_err(|error| match error {
        ReducedError::Full(source) => Error::unsolvable(&full, *source),
        other => other.into(),
    })?;
    let gone = components_gone(&full, &reduced, &overview);

    let kept = shared_variables(&full, &reduced)?;
    let estimates = |replayer: &Replayer| {
        let all = replayer.smoother().estimates();
        all.map_err(|source| Error::unsolvable(replayer, source))
    };
    let (was, is) = (estimates(&full)?, estimates(&reduced)?);
    let reduction = Reduction::of(
        [
            GraphSize::of(full.smoother(), &priors),
            GraphSize::of(reduced.smoother(), &gauge_factors(&reduced)),
        ],
        [
            Solved { graph: full.graph(), estimates: &was },
            Solved { graph: reduced.graph(), estimates: &is },
        ],
        &kept,
        &settings,
        &full,
    )
    .map_err(|error| match error {
        evergraph::evaluate::DivergenceError::Full(_) => incomparable(&full, error),
        _ => incomparable(&reduced, error),
    })?;

    if let Some(path) = &arguments.plot {
        let names = [&full, &reduced].map(|it| report::file_name(Path::new(it.name())));
        let title = format!("{} below {}", names[0], names[1]);
        let full = (&full, full.smoother(), &full_document);
        reduction.plot("compare", title, full, (&reduced, reduced.smoother()))?.save(path)?;
    }

    let mut report = Map::new();
    let names = [&arguments.full, &arguments.reduced].map(|path| report::file_name(path));
    let mut settings_json = arguments.solving.json(StartFrom::File, &settings)?;
    settings_json["reading"] = arguments.reading.json();
    for (field, value) in [
        ("schema", json!(SCHEMA)),
        ("command", json!("compare")),
        ("dataset", json!(names[0])),
        ("reduced", json!(names[1])),
        ("settings", settings_json),
        ("removed", json!(reduction.before.variables - reduction.after.variables)),
        ("components_gone", json!(gone)),
    ] {
        report.insert(field.into(), value);
    }
    reduction.add_to(&mut report);
    report.insert("first_optimization".into(), serde_json::to_value(first)?);
    report.insert("optimization".into(), serde_json::to_value(batch)?);
    report.insert("total_s".into(), json!(begun.elapsed().as_secs_f64()));
    report::save(common.report.as_deref(), &report)?;
    warn_of_landmarks(&full, output);
    warn_of_landmarks(&reduced, output);
    warn_of_ends(&[("full", &first), ("reduced", &batch)], output);

    let mut rows = Rows::new("full graph", &names[0]);
    rows.add("reduced graph", &names[1]);
    reduction.show(&mut rows);
    if gone > 0 {
        let of = if gone == 1 { "component" } else { "components" };
        rows.add("not compared", format!("{gone} {of} of which nothing is kept"));
    }
    rows.add("reduced graph, solved", reduction::ended(&batch));
    rows.add("total time", milliseconds(1e3 * begun.elapsed().as_secs_f64()));
    output.result(&rows)
}

/// Everything at once, to the optimum.
fn solve(replayer: &mut Replayer) -> Result<BatchReport, Error> {
    replayer.everything()?;
    let batch = optimize_to_the_end(replayer.smoother_mut());
    batch.map_err(|source| Error::unsolvable(replayer, source))
}

/// A reduced graph with ROBUST lines says itself which of its edges are robust: ordinary edges that stand
/// for removed nodes are not, having the weights of when those went.
fn as_the_file_says(reduced: &Document, options: ReplayOptions) -> ReplayOptions {
    let kernel = options.kernel.filter(|_| reduced.summary().robust == 0);
    options.with_kernel(kernel)
}
