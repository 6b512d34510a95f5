//! `evergraph remove`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use evergraph::evaluate::{Divergence, Solved};
use evergraph::formats::{Dialect, Document, Line, Record, WriteOptions};
use evergraph::model::VariableId;
use evergraph::removal::{Offset, Options, Order, Recovery, Topology};
use evergraph::solver::{BatchReport, Settings, Smoother};
use evergraph::{Needed, Replayer, Rules, Thinning};
use serde_json::{Map, Value, json};

use crate::convert;
use crate::error::Error;
use crate::files;
use crate::nodes::{Candidates, Choice};
use crate::options::{Common, Policy, Reading, Solving, StartFrom};
use crate::output::Output;
use crate::progress::Progress;
use crate::reduction::{
    self, Reduction, Size, gauge_factors, incomparable, to_the_end, warn_of_ends,
};
use crate::replay::{unsolvable, warn_of_landmarks};
use crate::report::{self, SCHEMA, Spread};
use crate::table::{Rows, milliseconds, number};

const EXAMPLES: &str = "\
Examples:
  evergraph remove manhattan.g2o --fraction 0.5 --output half.g2o
  evergraph remove manhattan.g2o --fraction 0.9 --order min-loss --report out.json
  evergraph remove intel.g2o --keep-every 2 --recovery nonlinear --output intel-half.g2o
  evergraph remove manhattan.g2o --nodes list.txt --topology dense
  evergraph remove manhattan.g2o --fraction 0.5 --mode isam

The graph is optimized, nodes are removed one by one, each planned and then applied as a robot would
between updates, and what is left is optimized again, for the shift. Nodes without which something
would be undetermined stay, and are listed. Generic linear constraints go into g2o files only
(FACTOR_LINEAR lines); --recovery nonlinear makes edges that other formats and readers know.";

/// Which of the blanket's variables the new factors join.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum TopologyName {
    /// All of them: exact, and denser each time
    Dense,
    /// The Chow-Liu tree
    Tree,
}

/// What kind of factors carry the information.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum RecoveryName {
    /// Generic linear constraints
    Glc,
    /// Ordinary edges, which are linearized again as the estimate moves
    Nonlinear,
    /// Edges composed and merged, which counts information twice; for comparison
    Composition,
    /// None: what the node knew of others is lost
    Drop,
}

/// Who goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum OrderName {
    /// At random, by --seed
    Random,
    /// The smallest blanket first
    MinDegree,
    /// What costs least first
    MinLoss,
    /// As the file, or the list, has them
    Given,
}

/// Where new factors have their minimum.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum OffsetName {
    /// Such that the gradient stays and nothing moves
    Gradient,
    /// At the estimate
    Paper,
}

/// Whose rules.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Mode {
    /// Ours
    Default,
    /// The GLC paper's: offset zero, inverse root shift
    Paper,
    /// iSAM 1.7's: offset zero, root shift, ln det (L + I), absolute tolerance
    Isam,
}

/// Remove nodes, keep what they knew, and say what it cost.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    file: PathBuf,
    #[command(flatten)]
    choice: Choice,
    /// Decides what is chosen at random
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Which neighbours the new factors join
    #[arg(long, value_enum, default_value = "tree")]
    topology: TopologyName,
    /// What kind of factors carry the information
    #[arg(long, value_enum, default_value = "glc")]
    recovery: RecoveryName,
    /// Who goes first [default: random; with --nodes: given]
    #[arg(long, value_enum)]
    order: Option<OrderName>,
    /// Where new factors have their minimum [default: gradient; of the modes paper and isam: paper]
    #[arg(long, value_enum)]
    offset: Option<OffsetName>,
    /// Whose rules where they differ
    #[arg(long, value_enum, default_value = "default")]
    mode: Mode,
    /// Nodes whose neighbours have more dimensions than this stay: planning is cubic in them
    #[arg(long, value_name = "N", default_value_t = Options::default().largest_blanket)]
    largest_blanket: usize,
    /// Remove from the file's vertices as they are (or odometry, where it has none), one
    /// Gauss-Newton step on; the cost is measured at the optimum all the same
    #[arg(long)]
    no_optimize: bool,
    /// Leave out the price of each removal, which costs more than the removal
    #[arg(long)]
    no_price: bool,
    #[command(flatten)]
    policy: Policy,
    #[command(flatten)]
    solving: Solving,
    /// Write the reduced graph with its optimum as vertices; .g2o, .graph, .toro, .txt (iSAM) or .pyfg
    #[arg(long, short, value_name = "FILE", help_heading = "Output")]
    output: Option<PathBuf>,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

impl Arguments {
    fn options(&self) -> Options {
        let rules = match self.mode {
            Mode::Default => Options::default(),
            Mode::Paper => Options::paper(),
            Mode::Isam => Options::isam(),
        };
        Options {
            topology: match self.topology {
                TopologyName::Dense => Topology::Dense,
                TopologyName::Tree => Topology::ChowLiu,
            },
            recovery: match self.recovery {
                RecoveryName::Glc => Recovery::Glc,
                RecoveryName::Nonlinear => Recovery::Nonlinear,
                RecoveryName::Composition => Recovery::Composition,
                RecoveryName::Drop => Recovery::Drop,
            },
            offset: match self.offset {
                Some(OffsetName::Gradient) => Offset::KeepGradient,
                Some(OffsetName::Paper) => Offset::Zero,
                None => rules.offset,
            },
            largest_blanket: self.largest_blanket,
            ..rules
        }
    }

    fn order(&self) -> Order {
        let default =
            if self.choice.nodes.is_some() { OrderName::Given } else { OrderName::Random };
        match self.order.unwrap_or(default) {
            OrderName::Random => Order::Random(self.seed),
            OrderName::MinDegree => Order::MinDegree,
            OrderName::MinLoss => Order::MinLoss,
            OrderName::Given => Order::Given,
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let begun = Instant::now();
    let common = &arguments.common;
    let output = Output::new(common);
    let settings =
        arguments.solving.settings(arguments.policy.relinearization("remove")?, common.threads());
    let document = arguments.reading.read(&arguments.file, common)?;
    check_targets(arguments, &document)?;
    let options = arguments.solving.replay_options(StartFrom::File);
    let mut replayer = Replayer::new(&document, &options, settings)?;
    let (nodes, first) = start(&mut replayer, arguments)
        .map_err(|error| error.with_gauge(arguments.solving.prior.0, &document))?;

    let mut full = replayer.smoother().clone();
    let progress = Progress::new(nodes.count, output.is_interactive());
    let thinning = thin(&mut replayer, &nodes, arguments, progress)?;
    let explain = |source| unsolvable(&replayer, source);
    let first = match first {
        Some(first) => first,
        None => full.optimize(&to_the_end()).map_err(explain)?,
    };
    let mut reduced = replayer.smoother().clone();
    let batch = reduced.optimize(&to_the_end()).map_err(explain)?;
    // Before the long work of the metrics.
    if let Some(path) = &arguments.output {
        let name = path.display().to_string();
        let document = reduced_document(&name, &replayer, &reduced, &document)?;
        let written = files::write_document(path, &document, WriteOptions { plain: false })?;
        convert::tell(&written, path, output);
    }
    let priors = gauge_factors(&replayer);
    let (was, is) = (full.estimates(), reduced.estimates());
    let divergence = Divergence::of(
        Solved { graph: full.graph(), estimates: &was },
        Solved { graph: reduced.graph(), estimates: &is },
        &reduction::same(&reduced),
        &settings,
    );
    let reduction = Reduction {
        before: Size::of(&full, &priors),
        after: Size::of(&reduced, &priors),
        divergence: divergence.map_err(|error| incomparable(&replayer, error))?,
    };

    let told = Told::of(&thinning, &replayer);
    let mut report = Map::new();
    let dataset = report::file_name(&arguments.file);
    report.insert("schema".into(), json!(SCHEMA));
    report.insert("command".into(), json!("remove"));
    report.insert("dataset".into(), json!(dataset));
    report.insert("settings".into(), settings_json(arguments, &settings)?);
    told.add_to(&mut report);
    reduction.add_to(&mut report);
    report.insert("first_optimization".into(), serde_json::to_value(first)?);
    report.insert("optimization".into(), serde_json::to_value(batch)?);
    report.insert("peak_rss_mb".into(), json!(report::peak_rss_mb()));
    report.insert("total_s".into(), json!(begun.elapsed().as_secs_f64()));
    report::save(common.report.as_deref(), &report)?;
    warn_of_landmarks(&replayer, output);
    warn_of_ends(&[("full", &first), ("reduced", &batch)], output);

    let mut rows = Rows::new("data set", &dataset);
    told.show(&mut rows);
    reduction.show(&mut rows);
    rows.add("optimized again", reduction::ended(&batch));
    rows.add("total time", milliseconds(1e3 * begun.elapsed().as_secs_f64()));
    output.result(&rows)
}

/// Whether everything can be written, as far as that can be known before the work.
fn check_targets(arguments: &Arguments, document: &Document) -> Result<(), Error> {
    let targets = || [&arguments.output, &arguments.common.report].into_iter().flatten();
    files::check_distinct("remove", targets().map(PathBuf::as_path))?;
    let read = [Some(&arguments.file), arguments.choice.nodes.as_ref()];
    for target in targets() {
        files::check_apart("remove", read.into_iter().flatten().map(PathBuf::as_path), target)?;
    }
    if let Some(path) = &arguments.output {
        let is_linear = matches!(arguments.recovery, RecoveryName::Glc);
        if is_linear && files::dialect_of(path)? != Dialect::G2o {
            let message = format!(
                "generic linear constraints go into .g2o files only, not into {}; name one, or give \
                 --recovery nonlinear",
                path.display()
            );
            return Err(Error::Usage { command: "remove", message });
        }
        files::check_output(path, document, WriteOptions { plain: false })?;
    }
    arguments.common.report.as_deref().map_or(Ok(()), |path: &Path| files::check_writable(path))
}

/// Brings everything in, solves it, and chooses.
fn start(
    replayer: &mut Replayer,
    arguments: &Arguments,
) -> Result<(Candidates, Option<BatchReport>), Error> {
    replayer.everything()?;
    // A list that makes no sense is told before the work.
    let nodes = arguments.choice.candidates(replayer)?;
    if arguments.no_optimize {
        return Ok((nodes, None));
    }
    let batch = replayer.smoother_mut().optimize(&to_the_end());
    Ok((nodes, Some(batch.map_err(|source| unsolvable(replayer, source))?)))
}

fn thin(
    replayer: &mut Replayer,
    nodes: &Candidates,
    arguments: &Arguments,
    progress: Progress,
) -> Result<Thinning, Error> {
    let rules = Rules {
        order: arguments.order(),
        at_most: nodes.count,
        options: arguments.options(),
        spared: &gauge_factors(replayer),
        prices: !arguments.no_price,
    };
    let thinning = Thinning::run(replayer.smoother_mut(), &nodes.nodes, &rules, || progress.tick());
    progress.finish();
    thinning.map_err(|source| Error::Removal {
        file: replayer.name().into(),
        message: replayer.explain_thinning(&source),
        source: Box::new(source),
    })
}

/// The reduced graph at its optimum, in the ids of the file. Gauge priors are none of it, as they are
/// none of the file's; whoever reads it puts them where they were.
fn reduced_document(
    name: &str,
    replayer: &Replayer,
    reduced: &Smoother,
    original: &Document,
) -> Result<Document, Error> {
    let mut graph = reduced.graph().clone();
    let mut change = graph.change();
    let mut fixed = Vec::new();
    for prior in replayer.replay().gauge_priors() {
        if graph.check_factor(prior.factor).is_ok() {
            change.drop_factor(prior.factor);
            fixed.extend(prior.fixed.then_some(Line::from(Record::Fix { id: prior.id })));
        }
    }
    let staged = graph.stage(&change).map_err(evergraph::evaluate::EvaluateError::Graph)?;
    graph.commit(staged);
    let ids: std::collections::HashMap<VariableId, u64> =
        replayer.replay().ids().map(|(id, variable)| (variable, id)).collect();
    let estimates = reduced.estimates();
    let document = Document::from_graph_with(
        name,
        &graph,
        |variable| ids.get(&variable).copied(),
        |variable| Some(estimates.value(variable).ok()?.to_value()),
    )?;
    let origins = original.lines().iter();
    let origins = origins.filter(|line| matches!(line.record, Record::GeodeticOrigin { .. }));
    let lines = origins.cloned().chain(document.lines().iter().cloned()).chain(fixed);
    Ok(Document::from_records(name, document.dialect(), lines)?)
}

fn settings_json(arguments: &Arguments, settings: &Settings) -> Result<Value, Error> {
    let mut value = arguments.solving.json(StartFrom::File, settings)?;
    value["reading"] = arguments.reading.json();
    value["removal"] = serde_json::to_value(arguments.options())?;
    value["order"] = serde_json::to_value(arguments.order())?;
    value["seed"] = json!(arguments.seed);
    value["fraction"] = json!(arguments.choice.fraction);
    value["keep_every"] = json!(arguments.choice.keep_every);
    value["nodes"] = json!(arguments.choice.nodes.as_ref().map(|it| it.display().to_string()));
    value["optimized_first"] = json!(!arguments.no_optimize);
    Ok(value)
}

/// What the removals were.
struct Told {
    ids: Vec<u64>,
    kept: Vec<(u64, &'static str, String)>,
    fallbacks: usize,
    largest_blanket: usize,
    price: Option<f64>,
    constant: f64,
    plan: Spread,
    apply: Spread,
    both: Spread,
}

impl Told {
    fn of(thinning: &Thinning, replayer: &Replayer) -> Self {
        let ids: std::collections::HashMap<VariableId, u64> =
            replayer.replay().ids().map(|(id, variable)| (variable, id)).collect();
        let id = |variable: &VariableId| ids.get(variable).copied().unwrap_or(u64::MAX);
        let removed = || thinning.removed.iter();
        let why = |needed: &Needed| match needed {
            Needed::Applied(_) => "singular",
            Needed::Planned(evergraph::removal::RemovalError::LastPose { .. }) => "last_pose",
            Needed::Planned(evergraph::removal::RemovalError::NoBlanket { .. }) => "no_blanket",
            Needed::Planned(evergraph::removal::RemovalError::LargeBlanket { .. }) => {
                "large_blanket"
            }
            _ => "not_representable",
        };
        Self {
            ids: removed().map(|it| id(&it.variable)).collect(),
            kept: thinning
                .kept
                .iter()
                .map(|(variable, needed)| {
                    (id(variable), why(needed), replayer.explain_needed(needed))
                })
                .collect(),
            fallbacks: removed().filter(|it| it.fallback.is_some()).count(),
            largest_blanket: removed().map(|it| it.blanket).max().unwrap_or(0),
            price: thinning.price(),
            constant: removed().map(|it| it.constant).fold(0.0, |sum, x| sum + x),
            plan: Spread::of(removed().map(|it| it.plan)),
            apply: Spread::of(removed().map(|it| it.apply)),
            both: Spread::of(removed().map(|it| it.plan + it.apply)),
        }
    }

    fn add_to(&self, report: &mut Map<String, Value>) {
        let kept = self.kept.iter().map(
            |(id, reason, message)| json!({ "variable": id, "reason": reason, "message": message }),
        );
        for (field, value) in [
            ("removed", json!(self.ids.len())),
            ("removed_ids", json!(self.ids)),
            ("kept_for_rank", kept.collect()),
            ("fallbacks", json!(self.fallbacks)),
            ("largest_blanket", json!(self.largest_blanket)),
            ("price_sum", json!(self.price)),
            ("error_constant", json!(self.constant)),
            ("time_per_node_ms", json!(self.both)),
            ("plan_ms", json!(self.plan)),
            ("apply_ms", json!(self.apply)),
        ] {
            report.insert(field.into(), value);
        }
    }

    fn show(&self, rows: &mut Rows) {
        const LISTED: usize = 5;
        rows.add("removed", format!("{} nodes", self.ids.len()));
        let mut kept: Vec<String> =
            self.kept.iter().take(LISTED).map(|it| evergraph::formats::spell_id(it.0)).collect();
        if self.kept.len() > LISTED {
            kept.push("...".into());
        }
        let list = if kept.is_empty() { String::new() } else { format!(": {}", kept.join(", ")) };
        rows.add("kept for rank", format!("{}{list}", self.kept.len()));
        rows.add("largest blanket", self.largest_blanket);
        rows.add("fallbacks", self.fallbacks);
        rows.add("a node", self.both.describe());
        rows.add("  to plan", self.plan.describe());
        rows.add("  to apply", self.apply.describe());
        let price = self.price.map_or_else(|| "none".into(), |it| number(it) + " nats");
        rows.add("sum of prices", price);
    }
}
