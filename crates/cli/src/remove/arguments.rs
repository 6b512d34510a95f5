//! What is asked for.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use evergraph::formats::{Dialect, Document, WriteOptions};
use evergraph::removal::{Consistency, Offset, Options, Order, Recovery, Topology};
use evergraph::solver::Settings;
use serde_json::{Value, json};

use crate::error::Error;
use crate::files;
use crate::nodes::Choice;
use crate::options::{Common, Policy, Solving, StartFrom};
use crate::plot::PlotPath;
use crate::reading::Reading;

const EXAMPLES: &str = "\
Examples:
  evergraph remove manhattan.g2o --fraction 0.5 --output half.g2o
  evergraph remove manhattan.g2o --fraction 0.9 --order min-loss --report out.json
  evergraph remove intel.g2o --keep-every 2 --recovery nonlinear --output intel-half.g2o
  evergraph remove manhattan.g2o --nodes list.txt --topology dense
  evergraph remove manhattan.g2o --fraction 0.5 --mode isam

The graph is optimized, nodes are removed one by one, each planned and then applied as a robot
would between updates, and what is left is optimized again, for the shift. Nodes without which
something would be undetermined stay, and are listed. Generic linear constraints go into g2o
files only (FACTOR_LINEAR lines); --recovery nonlinear makes edges that other formats and readers
know. With --robust edges that stay keep their kernel (ROBUST lines), and what stands for nodes
has none: it has the weights of when they went. Ordinary edges do not show that; leave --robust
out to replay them.";

/// Which of the blanket's variables the new factors join.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum TopologyName {
    /// All of them where the tree would lose more than that is worth
    Auto,
    /// All of them: exact, and denser each time
    Dense,
    /// The Chow-Liu tree
    Tree,
}

/// Bounds on the information of new factors.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ConsistencyName {
    /// No bound: least divergence
    None,
    /// Never more than was known in any direction
    Conservative,
    /// The same bound by one common factor; for comparison
    Scaled,
}

impl From<ConsistencyName> for Consistency {
    fn from(name: ConsistencyName) -> Self {
        match name {
            ConsistencyName::None => Self::None,
            ConsistencyName::Conservative => Self::Conservative,
            ConsistencyName::Scaled => Self::Scaled,
        }
    }
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
    /// The GLC paper's: offset zero, inverse root shift, trees undamped
    Paper,
    /// iSAM 1.7's: offset zero, root shift, ln det (L + I), absolute tolerance
    Isam,
}

/// Remove nodes, keep what they knew, and say what it cost.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    pub(super) file: PathBuf,
    #[command(flatten)]
    pub(super) choice: Choice,
    /// Decides what is chosen at random
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Which neighbours the new factors join [default: auto; of the modes paper and isam: tree]
    #[arg(long, value_enum)]
    topology: Option<TopologyName>,
    /// With --topology auto, the most neighbours that one dense factor joins
    #[arg(long, value_name = "N", default_value_t = Options::default().dense_up_to)]
    dense_up_to: usize,
    /// Whether new factors may claim more than was known
    #[arg(long, value_enum, default_value = "none")]
    consistency: ConsistencyName,
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
    /// Nodes whose neighbours have more dimensions than this stay, and are counted: planning is cubic in
    /// them
    #[arg(long, value_name = "N", default_value_t = Options::default().largest_blanket)]
    pub(super) largest_blanket: usize,
    /// Remove from the file's vertices as they are (or odometry, where it has none), one
    /// Gauss-Newton step on; the cost is measured at the optimum all the same
    #[arg(long)]
    pub(super) no_optimize: bool,
    /// Leave out the price of each removal, which costs more than the removal
    #[arg(long)]
    pub(super) no_price: bool,
    #[command(flatten)]
    pub(super) policy: Policy,
    #[command(flatten)]
    pub(super) solving: Solving,
    /// Write the reduced graph with its optimum as vertices; .g2o, .graph, .toro, .txt (iSAM) or .pyfg
    #[arg(long, short, value_name = "FILE", help_heading = "Output")]
    pub(super) output: Option<PathBuf>,
    /// Draw what is left over the full graph, the removed nodes, and how far the others moved; .svg or .png
    #[arg(long, value_name = "FILE", value_parser = PlotPath::parse, help_heading = "Output")]
    pub(super) plot: Option<PlotPath>,
    #[command(flatten)]
    pub(super) reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

impl Arguments {
    /// What comes in the place of a node.
    pub(super) fn options(&self) -> Options {
        let rules = match self.mode {
            Mode::Default => Options::default(),
            Mode::Paper => Options::paper(),
            Mode::Isam => Options::isam(),
        };
        rules
            .with_topology(match self.topology {
                Some(TopologyName::Auto) => Topology::Auto,
                Some(TopologyName::Dense) => Topology::Dense,
                Some(TopologyName::Tree) => Topology::ChowLiu,
                None => rules.topology,
            })
            .with_dense_up_to(self.dense_up_to)
            .with_consistency(self.consistency.into())
            .with_recovery(match self.recovery {
                RecoveryName::Glc => Recovery::Glc,
                RecoveryName::Nonlinear => Recovery::Nonlinear,
                RecoveryName::Composition => Recovery::Composition,
                RecoveryName::Drop => Recovery::Drop,
            })
            .with_offset(match self.offset {
                Some(OffsetName::Gradient) => Offset::KeepGradient,
                Some(OffsetName::Paper) => Offset::Zero,
                None => rules.offset,
            })
            .with_largest_blanket(self.largest_blanket)
    }

    pub(super) fn order(&self) -> Order {
        let default =
            if self.choice.nodes.is_some() { OrderName::Given } else { OrderName::Random };
        match self.order.unwrap_or(default) {
            OrderName::Random => Order::Random(self.seed),
            OrderName::MinDegree => Order::MinDegree,
            OrderName::MinLoss => Order::MinLoss,
            OrderName::Given => Order::Given,
        }
    }

    /// Whether everything can be written, as far as that can be known before the work.
    pub(super) fn check_targets(&self, document: &Document) -> Result<(), Error> {
        let plot = self.plot.as_ref().map(PlotPath::path);
        let besides = || self.common.report.as_deref().into_iter().chain(plot);
        let targets = || self.output.as_deref().into_iter().chain(besides());
        files::check_distinct("remove", targets())?;
        let read = [Some(&self.file), self.choice.nodes.as_ref()];
        for target in targets() {
            files::check_apart("remove", read.into_iter().flatten().map(PathBuf::as_path), target)?;
        }
        if let Some(path) = &self.output {
            let is_linear = matches!(self.recovery, RecoveryName::Glc);
            if is_linear && files::dialect_of(path)? != Dialect::G2o {
                let message = format!(
                    "generic linear constraints go into .g2o files only, not into {}; name one, or give \
                     --recovery nonlinear",
                    path.display()
                );
                return Err(Error::Usage { command: "remove", message });
            }
            files::check_output(path, document, WriteOptions::default())?;
        }
        besides().try_for_each(files::check_writable)
    }

    /// For the report.
    pub(super) fn json(&self, settings: &Settings) -> Result<Value, Error> {
        let mut value = self.solving.json(StartFrom::File, settings)?;
        value["reading"] = self.reading.json();
        value["removal"] = serde_json::to_value(self.options())?;
        value["order"] = serde_json::to_value(self.order())?;
        value["seed"] = json!(self.seed);
        value["fraction"] = json!(self.choice.fraction);
        value["keep_every"] = json!(self.choice.keep_every);
        value["nodes"] = json!(self.choice.nodes.as_ref().map(|it| it.display().to_string()));
        value["optimized_first"] = json!(!self.no_optimize);
        Ok(value)
    }
}
