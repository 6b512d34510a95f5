//! `evergraph evaluate`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use evergraph::evaluate::{
    AbsoluteError, Alignment, Ambiguity, Association, EvaluateError, Fit, LandmarkError, PosePairs,
    RelativeError, RelativePairs, Statistics,
};
use evergraph::formats::Stamps;
use serde_json::{Value, json};

use crate::error::Error;
use crate::files;
use crate::fit;
use crate::options::Common;
use crate::plot::{Plot, PlotPath, pictures};
use crate::reading::Reading;
use crate::report::{self, SCHEMA};
use crate::table::{Rows, number};

const EXAMPLES: &str = "\
Examples:
  evergraph evaluate map.g2o --truth truth.g2o
  evergraph evaluate map.tum --truth groundtruth.tum --max-difference 0.02 --delta 10
  evergraph evaluate map.g2o --times times.csv --truth groundtruth.tum --align first

A graph's fit to its own edges is told too, at its vertices as they are. Maps are g2o, TORO, iSAM or PyFactorGraph files with vertices (or noise-free edges), TUM or KITTI
trajectories, told by their content. Poses are paired by id where both sides have ids, else by
time, or an id in place of whole seconds. Maps of the plane are not compared with poses in space.
Where positions determine no rotation (a robot in one place, a straight line), orientations do. As evo does:
  absolute error (ATE)  E_k = y_k^-1 (S x_k), x estimated, y true, S the alignment
  relative error (RPE)  E_k = (y_k^-1 y_k+D)^-1 (x_k^-1 x_k+D)";

/// How the estimate is laid over the truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Align {
    /// As it is
    None,
    /// By the rigid motion that brings the positions closest
    Rigid,
    /// First pose on first pose
    First,
    /// Rigid with a scale
    Scale,
}

impl Align {
    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Rigid => "rigid",
            Self::First => "first",
            Self::Scale => "scale",
        }
    }

    fn alignment(self) -> Alignment {
        match self {
            Self::None => Alignment::None,
            Self::Rigid => Alignment::Rigid,
            Self::First => Alignment::FirstPose,
            Self::Scale => Alignment::Similarity,
        }
    }
}

/// Measure a map by the truth.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The map: a graph with estimates as vertices, or a trajectory
    estimate: PathBuf,
    /// Where everything really was
    #[arg(long, value_name = "FILE")]
    truth: PathBuf,
    /// How the estimate is laid over the truth
    #[arg(long, value_enum, default_value = "rigid")]
    align: Align,
    /// Relative errors between poses this many apart [default: 1]
    #[arg(long, value_name = "K")]
    delta: Option<NonZeroUsize>,
    /// Relative errors of all pairs that far apart, not only of those that follow each other
    #[arg(long)]
    all_pairs: bool,
    /// Pair by time, to this many seconds [default: by id, or by time to 0.01]
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = seconds)]
    max_difference: Option<f64>,
    /// Times of the estimate's poses, lines of `id,timestamp`
    #[arg(long, value_name = "FILE.csv")]
    times: Option<PathBuf>,
    /// Draw the estimate over the truth; .svg or .png
    #[arg(long, value_name = "FILE", value_parser = PlotPath::parse, help_heading = "Output")]
    plot: Option<PlotPath>,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x >= 0.0 && x.is_finite() => Ok(x),
        _ => Err("give a number of seconds, at least 0".into()),
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let common = &arguments.common;
    let plot = arguments.plot.as_ref().map(PlotPath::path);
    let targets = || common.report.as_deref().into_iter().chain(plot);
    files::check_distinct("evaluate", targets())?;
    let read = [&arguments.estimate, &arguments.truth].map(PathBuf::as_path);
    for path in targets() {
        let times = arguments.times.as_deref();
        files::check_apart("evaluate", read.into_iter().chain(times), path)?;
        files::check_writable(path)?;
    }
    let (mut estimate, document) = arguments.reading.read_map(&arguments.estimate, common)?;
    if let Some(path) = &arguments.times {
        estimate = estimate.with_stamps(&Stamps::read(path)?)?;
    }
    let (truth, _) = arguments.reading.read_map(&arguments.truth, common)?;
    let fit = document.as_ref().map(Fit::of_vertices).transpose()?.flatten();
    let association = match arguments.max_difference {
        Some(max_difference) => Association::Time { max_difference },
        None => Association::of(&estimate.trajectory, &truth.trajectory),
    };
    let pairs = PosePairs::new(&estimate.trajectory, &truth.trajectory, association)?;
    let aligned = pairs.align(arguments.align.alignment())?;
    let absolute = AbsoluteError::of(&pairs, &aligned.similarity)?;
    let relative = relative(&pairs, arguments)?;
    let landmarks = LandmarkError::of(&estimate.landmarks, &truth.landmarks, &aligned.similarity)?;

    let dataset = report::file_name(&arguments.estimate);
    let matched = pairs.pairs().len();
    let report = json!({
        "schema": SCHEMA,
        "command": "evaluate",
        "dataset": dataset,
        "truth": report::file_name(&arguments.truth),
        "poses": { "matched": matched, "estimate": estimate.trajectory.len(), "truth": truth.trajectory.len() },
        "settings": {
            "align": arguments.align.name(),
            "association": association.to_string(),
            "delta": arguments.delta.map_or(1, NonZeroUsize::get),
            "all_pairs": arguments.all_pairs,
            "reading": arguments.reading.json(),
        },
        "alignment": { "scale": aligned.similarity.scale, "undetermined": aligned.ambiguity.map(undetermined) },
        "ate": { "translation": absolute.translation, "rotation": absolute.rotation },
        "rpe": relative.map_or(Value::Null, |it| json!(it)),
        "landmarks": landmarks.map_or(Value::Null, |it| json!(it)),
        "fit": fit,
    });
    if let Some(path) = &arguments.plot {
        let furthest = absolute.translation.max;
        let map = pictures::of_truth([&estimate, &truth], &pairs, &aligned.similarity, furthest);
        let rmse = number(absolute.translation.rmse);
        let (truth, align) = (report::file_name(&arguments.truth), arguments.align.name());
        let subtitle = [
            format!("evergraph evaluate: ATE {rmse} m (rmse) by {truth}"),
            format!("{matched} pairs by {association}, alignment {align}"),
        ];
        Plot { title: dataset.clone(), subtitle, map, times: None }.save(path)?;
    }
    report::save(common.report.as_deref(), &report)?;

    let output = common.output();
    if let Some(ambiguity) = aligned.ambiguity {
        let scale = if arguments.align == Align::Scale { " and no scale" } else { "" };
        output.warn(&match ambiguity {
            Ambiguity::Line => String::from(
                "the positions of one side lie on a line, about which they determine no rotation; it is \
                 taken from the orientations"
            ),
            _ => format!(
                "the positions determine no rotation{scale}: those of one side stay in one place, or both are no \
                 more alike than noise; the rotation is taken from the orientations"
            ),
        });
    }
    let mut rows = Rows::new("map", &dataset);
    rows.add("truth", report::file_name(&arguments.truth));
    let (of, with) = (estimate.trajectory.len(), truth.trajectory.len());
    rows.add("poses", format!("{matched} of {of} matched with {with} by {association}"));
    let scale = match arguments.align {
        Align::Scale => format!(", {}", number(aligned.similarity.scale)),
        _ => String::new(),
    };
    rows.add("alignment", format!("{}{scale}", arguments.align.name()));
    add(&mut rows, "absolute (ATE) [m]", &absolute.translation);
    add(&mut rows, "  rotation [rad]", &absolute.rotation);
    if let Some(relative) = &relative {
        add(&mut rows, "relative (RPE) [m]", &relative.translation);
        add(&mut rows, "  rotation [rad]", &relative.rotation);
    }
    if let Some(landmarks) = &landmarks {
        add(&mut rows, "landmarks [m]", &landmarks.distance);
        let (unknown, missing) = (landmarks.unknown, landmarks.missing);
        rows.add("", format!("{unknown} that the truth does not know, {missing} missing"));
    }
    let Some(fit) = fit else { return output.result(&rows) };
    fit::show(&fit, &mut rows);
    output.result(&rows)?;
    fit::tell(&fit, common.verbose > 0, output)
}

/// What the positions leave open, in a word.
fn undetermined(ambiguity: Ambiguity) -> &'static str {
    match ambiguity {
        Ambiguity::Line => "rotation_about_line",
        _ => "rotation_and_scale",
    }
}

/// The relative error; a single pose has none, which is no failure unless a distance was asked for.
fn relative(pairs: &PosePairs, arguments: &Arguments) -> Result<Option<RelativeError>, Error> {
    let delta = arguments.delta.unwrap_or(NonZeroUsize::MIN);
    match RelativeError::of(
        pairs,
        RelativePairs::default().with_delta(delta).with_all(arguments.all_pairs),
    ) {
        Ok(error) => Ok(Some(error)),
        Err(EvaluateError::NoPair { .. }) if arguments.delta.is_none() => Ok(None),
        Err(error) => Err(error.into()),
    }
}

fn add(rows: &mut Rows, name: &str, statistics: &Statistics) {
    let Statistics { count, rmse, mean, median, std, min, max, .. } = *statistics;
    let [rmse, mean, median, std, min, max] = [rmse, mean, median, std, min, max].map(number);
    rows.add(name, format!("rmse {rmse}, mean {mean}, median {median}, std {std},"));
    rows.add("", format!("min {min}, max {max} of {count}"));
}
