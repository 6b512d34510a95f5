//! `evergraph info`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use evergraph::formats::{Document, short_id};
use evergraph::replay::Initial;
use evergraph::{Overview, Start};
use serde_json::{Value, json};

use crate::error::Error;
use crate::options::Common;
use crate::reading::Reading;
use crate::report::{self, SCHEMA};
use crate::table::{CONVENTION, Rows, number};

const EXAMPLES: &str = "\
Examples:
  evergraph info manhattan.g2o
  evergraph info sphere2500.g2o --convention g2o
  evergraph info strange.graph --lenient --verbose

Conventions:
  ours  error = 1/2 sum |r|^2, chi2 = sum |r|^2, r = whitened Log(z^-1 xi^-1 xj)
  g2o   chi2 = sum e^T I e, e = translation and angle (2D), translation and the quaternion's vector
        part (3D) of z^-1 xi^-1 xj, with the matrices as they stand in the file";

/// How errors are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Convention {
    /// The logarithm of SE(2) and SE(3)
    Ours,
    /// g2o's as well
    G2o,
}

/// Say what a file holds and what it costs as it stands.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    file: PathBuf,
    /// How errors are measured
    #[arg(long, value_enum, default_value = "ours")]
    convention: Convention,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Components that are listed without `--verbose`.
const LISTED: usize = 8;

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let common = &arguments.common;
    let output = common.output();
    let document = arguments.reading.read(&arguments.file, common)?;
    let overview = Overview::of(&document);
    let mut rows = Rows::new("data set", &report::file_name(&arguments.file));
    let mut json = describe(&document, &overview, common.verbose > 0, &mut rows);
    json["schema"] = json!(SCHEMA);
    json["command"] = json!("info");
    json["dataset"] = json!(report::file_name(&arguments.file));
    json["convention"] = json!(CONVENTION);

    let summary = document.summary();
    let has_edges = summary.pose_edges + summary.landmark_edges > 0;
    let starts = [
        ("vertices", "the file's vertices", Initial::FromFile, summary.vertices > 0),
        ("odometry", "odometry", Initial::FromOdometry, summary.poses > 0),
    ];
    if has_edges {
        rows.add("convention", CONVENTION);
    }
    let mut warnings = summary.warnings();
    for (field, words, initial, there) in starts {
        if !(there && has_edges) {
            json[format!("at_{field}")] = Value::Null;
            continue;
        }
        let start = Start::of(&document, initial)?;
        let objective = start.objective()?;
        let g2o_chi2 = (arguments.convention == Convention::G2o)
            .then(|| start.g2o_chi2(arguments.reading.g2o_rotation))
            .transpose()?;
        if !(objective.error.is_finite() && g2o_chi2.is_none_or(f64::is_finite)) {
            let warning = format!(
                "at {words}, the error is not finite: a residual or a weight is so large that its \
                 square does not fit a 64-bit number"
            );
            output.warn(&format!("{}: {warning}", document.name()));
            warnings.push(warning);
            rows.add(&format!("at {words}"), "not finite");
            json[format!("at_{field}")] = Value::Null;
            continue;
        }
        let mut at = json!({ "error": objective.error, "chi2": objective.chi2 });
        let text = format!("error {}, chi2 {}", number(objective.error), number(objective.chi2));
        rows.add(&format!("at {words}"), text);
        if let Some(chi2) = g2o_chi2 {
            at["g2o_chi2"] = json!(chi2);
            rows.add("  in g2o's convention", format!("chi2 {}", number(chi2)));
        }
        json[format!("at_{field}")] = at;
    }
    json["warnings"] = json!(warnings);
    report::save(common.report.as_deref(), &json)?;
    output.result(&rows)
}

/// What is there, counted: into the rows, and as JSON.
fn describe(document: &Document, overview: &Overview, all: bool, rows: &mut Rows) -> Value {
    let summary = document.summary();
    rows.add("format", document.dialect());
    rows.add("lines", summary.lines);
    rows.add("poses", with_range(summary.poses, overview.pose_ids));
    rows.add("landmarks", with_range(summary.landmarks, overview.landmark_ids));
    for (name, count) in &overview.records {
        rows.add(name, count);
    }
    let (pairs, edges) = (overview.repeated_pairs, overview.repeated_edges);
    rows.add("repeated pairs", format!("{pairs} ({edges} edges beyond the first)"));
    rows.add("components", overview.components.len());
    if overview.components.len() > 1 {
        let listed = if all { usize::MAX } else { LISTED };
        for component in overview.components.iter().take(listed) {
            let (poses, landmarks) = (component.poses, component.landmarks);
            rows.add(
                &format!("  from {}", short_id(component.first)),
                format!("{poses} poses, {landmarks} landmarks"),
            );
        }
        if overview.components.len() > listed {
            rows.add(
                "  ...",
                format!("{} more; --verbose lists them", overview.components.len() - listed),
            );
        }
    }
    for (tag, count) in &summary.ignored {
        rows.add(&format!("{tag} (passed over)"), count);
    }
    if summary.skipped > 0 {
        rows.add("bad lines (skipped)", summary.skipped);
    }
    json!({
        "format": document.dialect().to_string(),
        "lines": summary.lines,
        "poses": summary.poses,
        "landmarks": summary.landmarks,
        "pose_edges": summary.pose_edges,
        "landmark_edges": summary.landmark_edges,
        "vertices": summary.vertices,
        "fixed": summary.fixed,
        "records": overview.records,
        "pose_ids": overview.pose_ids,
        "landmark_ids": overview.landmark_ids,
        "repeated_pairs": pairs,
        "repeated_edges": edges,
        "components": overview.components.iter().map(|it| json!({
            "first": it.first, "poses": it.poses, "landmarks": it.landmarks,
        })).collect::<Vec<_>>(),
        "ignored": summary.ignored,
        "skipped": summary.skipped,
    })
}

fn with_range(count: usize, range: Option<(u64, u64)>) -> String {
    range.map_or_else(
        || count.to_string(),
        |(low, high)| format!("{count}, ids {} to {}", short_id(low), short_id(high)),
    )
}
