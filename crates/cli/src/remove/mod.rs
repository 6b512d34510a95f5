//! `evergraph remove`.

mod arguments;
mod summary;

use std::time::Instant;

pub(crate) use arguments::Arguments;
use evergraph::evaluate::{GraphSize, Solved};
use evergraph::formats::WriteOptions;
use evergraph::solver::BatchReport;
use evergraph::{Replayer, Rules, Smoother, Thinning, optimize_to_the_end};
use serde_json::{Map, json};

use self::summary::Summary;
use crate::convert;
use crate::error::Error;
use crate::files;
use crate::nodes::Candidates;
use crate::options::StartFrom;
use crate::progress::Progress;
use crate::reduction::{self, Reduction, gauge_factors, incomparable, warn_of_ends};
use crate::report::{self, SCHEMA};
use crate::table::{Rows, milliseconds};
use crate::warnings::warn_of_landmarks;

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let begun = Instant::now();
    let common = &arguments.common;
    let output = common.output();
    let settings =
        arguments.solving.settings(arguments.policy.relinearization("remove")?, common.threads());
    let document = arguments.reading.read(&arguments.file, common)?;
    arguments.check_targets(&document)?;
    let options = arguments.solving.replay_options(StartFrom::File);
    let mut replayer = Replayer::new(&document, &options, settings)?;
    let (nodes, first) = start(&mut replayer, arguments)
        .map_err(|error| error.with_gauge(arguments.solving.prior.0, &document))?;

    // Whatever fails from here on may be due to that.
    first.iter().for_each(|first| warn_of_ends(&[("full", first)], output));

    let mut full = replayer.smoother().clone();
    let progress = Progress::new(nodes.count, output.is_interactive());
    let thinning = thin(&mut replayer, &nodes, arguments, progress)?;
    let first = match first {
        Some(first) => first,
        None => {
            let first =
                optimize_to_the_end(&mut full).map_err(|e| Error::unsolvable(&replayer, e))?;
            warn_of_ends(&[("full", &first)], output);
            first
        }
    };
    let mut reduced = replayer.smoother().clone();
    let batch = optimize_to_the_end(&mut reduced).map_err(|source| Error::Unsolvable {
        file: replayer.name().into(),
        message: format!("the reduced graph cannot be solved: {}", replayer.explain(&source)),
        source: Box::new(source),
    })?;
    // Before the long work of the metrics.
    if let Some(path) = &arguments.output {
        let name = path.display().to_string();
        let document = replayer.reduced_document(&name, &reduced, &document)?;
        let written = files::write_document(path, &document, WriteOptions::default())?;
        convert::tell(&written, path, output);
    }
    let priors = gauge_factors(&replayer);
    let estimates = |smoother: &Smoother| {
        let all = smoother.estimates();
        all.map_err(|source| Error::unsolvable(&replayer, source))
    };
    let (was, is) = (estimates(&full)?, estimates(&reduced)?);
    let reduction = Reduction::of(
        [&full, &reduced].map(|smoother| GraphSize::of(smoother, &priors)),
        [
            Solved { graph: full.graph(), estimates: &was },
            Solved { graph: reduced.graph(), estimates: &is },
        ],
        &reduction::same(&reduced),
        &settings,
        &replayer,
    )
    .map_err(|error| incomparable(&replayer, error))?;

    if let Some(path) = &arguments.plot {
        let title = report::file_name(&arguments.file);
        let (full, reduced) = ((&replayer, &full, &document), (&replayer, &reduced));
        reduction.plot("remove", title, full, reduced)?.save(path)?;
    }

    let summary = Summary::of(&thinning, &replayer);
    let mut report = Map::new();
    let dataset = report::file_name(&arguments.file);
    report.insert("schema".into(), json!(SCHEMA));
    report.insert("command".into(), json!("remove"));
    report.insert("dataset".into(), json!(dataset));
    report.insert("settings".into(), arguments.json(&settings)?);
    summary.add_to(&mut report);
    reduction.add_to(&mut report);
    report.insert("first_optimization".into(), serde_json::to_value(first)?);
    report.insert("optimization".into(), serde_json::to_value(batch)?);
    report.insert("peak_rss_mb".into(), json!(report::peak_rss_mb()));
    report.insert("total_s".into(), json!(begun.elapsed().as_secs_f64()));
    report::save(common.report.as_deref(), &report)?;
    warn_of_landmarks(&replayer, output);
    warn_of_ends(&[("reduced", &batch)], output);

    let mut rows = Rows::new("data set", &dataset);
    summary.show(&mut rows, arguments.largest_blanket);
    reduction.show(&mut rows);
    rows.add("optimized again", reduction::ended(&batch));
    rows.add("total time", milliseconds(1e3 * begun.elapsed().as_secs_f64()));
    output.result(&rows)
}

/// Brings everything in, solves it, and chooses.
fn start(
    replayer: &mut Replayer,
    arguments: &Arguments,
) -> Result<(Candidates, Option<BatchReport>), Error> {
    replayer.everything()?;
    // A list that makes no sense is summary before the work.
    let nodes = arguments.choice.candidates(replayer)?;
    if arguments.no_optimize {
        return Ok((nodes, None));
    }
    let batch = optimize_to_the_end(replayer.smoother_mut());
    Ok((nodes, Some(batch.map_err(|source| Error::unsolvable(replayer, source))?)))
}

fn thin(
    replayer: &mut Replayer,
    nodes: &Candidates,
    arguments: &Arguments,
    progress: Progress,
) -> Result<Thinning, Error> {
    let spared = gauge_factors(replayer);
    let rules = Rules::default()
        .with_order(arguments.order())
        .with_limit(nodes.count)
        .with_options(arguments.options())
        .sparing(&spared)
        .with_prices(!arguments.no_price);
    let thinning = Thinning::run(replayer.smoother_mut(), &nodes.nodes, &rules, || progress.tick());
    progress.finish();
    thinning.map_err(|source| Error::Removal {
        file: replayer.name().into(),
        message: replayer.explain_thinning(&source),
        source: Box::new(source),
    })
}
