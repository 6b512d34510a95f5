//! Every graph, many nodes, all orders: nothing may end in an error or free a direction.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use evergraph::formats::spell_id;
use evergraph::model::{FactorId, VariableId};
use evergraph::removal::{Options, Order, RemovalError, Topology, shuffled};
use evergraph::{Needed, Rules, Smoother, Thinning, optimize_to_the_end};
use rayon::prelude::*;

use crate::{Failure, gauge, optimum, read, short};

/// One way to remove nodes.
#[derive(Clone, Copy)]
struct Variant {
    topology: Topology,
    percent: usize,
    order: Order,
    seed: u64,
}

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { topology, percent, order, seed } = self;
        write!(f, "{topology:?} {percent} % {order:?} {seed}")
    }
}

/// Trees at 33, 67 and 95 % in three orders with three seeds and at 95 % with twenty; dense at 10 and
/// 50 %. The order chooses the nodes, where it is not random among some that the seed chooses.
fn variants(quick: bool) -> Vec<Variant> {
    let (seeds, random_seeds) = if quick { (1, 2) } else { (3, 20) };
    let orders = |seed| [Order::Random(seed), Order::MinDegree, Order::MinLoss];
    let tree = |percent, order, seed| Variant { topology: Topology::ChowLiu, percent, order, seed };
    let mut variants = Vec::new();
    for percent in [33, 67, 95] {
        for seed in 1..=seeds {
            variants.extend(orders(seed).map(|order| tree(percent, order, seed)));
        }
    }
    variants.extend((seeds + 1..=random_seeds).map(|seed| tree(95, Order::Random(seed), seed)));
    for percent in [10, 50] {
        let order = Order::Random(1);
        variants.push(Variant { topology: Topology::Dense, percent, order, seed: 1 });
    }
    variants
}

/// Dense removals leave blankets larger than this, in scalars, as they are: each later step near a
/// clique is cubic in it, and a landmark that all of a map sees makes the map one clique.
const LARGEST_DENSE: usize = 300;

/// An error that falls by more than this share is told of each variant.
const FAR: f64 = 1e-6;

/// What came of it.
struct Outcome {
    /// Nodes without which something would be undetermined.
    needed: Vec<VariableId>,
    /// Nodes whose blanket was too large.
    large: usize,
    fallbacks: usize,
    /// The share of the error by which that of the reduced graph with its constants is off the full one's.
    off: f64,
    /// By what share the error fell when the reduced graph was optimized again.
    fell: f64,
    seconds: f64,
    failure: Option<String>,
}

/// Sweeps each file; says whether all went well.
pub fn run(files: &[&str], quick: bool) -> Result<bool, Failure> {
    println!(
        "| graph | variables | removals | kept for rank | large blankets | fallbacks | error off by | error fell by | seconds | \
         failures |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut all_well = true;
    for file in files {
        let (replayer, is_optimal) = optimum(&read(file)?)?;
        let spared = gauge(&replayer);
        let held = |id| replayer.replay().gauge_priors().iter().any(|prior| prior.variable == id);
        let nodes: Vec<VariableId> = replayer.graph().variables().filter(|id| !held(*id)).collect();
        if nodes.is_empty() {
            println!("| {} | every variable holds a gauge: nothing can go |||||||||", short(file));
            continue;
        }
        let names: BTreeMap<VariableId, String> =
            replayer.replay().ids().map(|(id, variable)| (variable, spell_id(id))).collect();
        let smoother = replayer.into_smoother();
        let variants = variants(quick);
        let outcomes: Vec<Outcome> = variants
            .par_iter()
            .map(|variant| try_one(&smoother, &nodes, &spared, variant))
            .collect();
        let failures: Vec<String> = outcomes.iter().filter_map(|it| it.failure.clone()).collect();
        let needed: BTreeSet<&str> = outcomes
            .iter()
            .flat_map(|it| &it.needed)
            .filter_map(|id| names.get(id).map(String::as_str))
            .collect();
        for (variant, outcome) in variants.iter().zip(&outcomes).filter(|(_, it)| it.fell > FAR) {
            let Outcome { fell, fallbacks, large, .. } = outcome;
            eprintln!(
                "{}, {variant}: error fell by {fell:.0e}, {fallbacks} fallbacks, {large} large",
                short(file)
            );
        }
        // From anywhere else than an optimum both may be anything.
        let largest = |of: fn(&Outcome) -> f64| match is_optimal {
            true => format!("{:.0e}", outcomes.iter().map(of).fold(0.0, f64::max)),
            false => "-".into(),
        };
        println!(
            "| {}{} | {} | {} | {} | {} | {} | {} | {} | {:.1} | {} |",
            short(file),
            if is_optimal { "" } else { " (no optimum)" },
            smoother.graph().variable_count(),
            variants.len(),
            if needed.is_empty() { "none".into() } else { Vec::from_iter(needed).join(" ") },
            outcomes.iter().map(|it| it.large).sum::<usize>(),
            outcomes.iter().map(|it| it.fallbacks).sum::<usize>(),
            largest(|it| it.off),
            largest(|it| it.fell),
            outcomes.iter().map(|it| it.seconds).sum::<f64>(),
            if failures.is_empty() { "none".into() } else { failures.join("; ") },
        );
        all_well &= failures.is_empty();
    }
    Ok(all_well)
}

fn try_one(
    full: &Smoother,
    nodes: &[VariableId],
    spared: &[FactorId],
    variant: &Variant,
) -> Outcome {
    let begun = Instant::now();
    let count = nodes.len() * variant.percent / 100;
    let pool = match variant.order {
        Order::Random(_) => nodes.len(),
        _ => usize::midpoint(count, nodes.len()),
    };
    let candidates = &shuffled(nodes, variant.seed)[..pool];
    let options = match variant.topology {
        Topology::Dense => Options::dense().with_largest_blanket(LARGEST_DENSE),
        _ => Options::tree(),
    };
    let rules = Rules::default()
        .with_order(variant.order)
        .with_limit(count)
        .with_options(options)
        .sparing(spared);
    let mut smoother = full.clone();
    let mut outcome = Outcome {
        needed: Vec::new(),
        large: 0,
        fallbacks: 0,
        off: 0.0,
        fell: 0.0,
        seconds: 0.0,
        failure: None,
    };
    let failed = |error: String| Some(format!("{variant}: {error}"));
    match Thinning::run(&mut smoother, candidates, &rules, || ()) {
        Ok(thinning) => {
            for (node, why) in &thinning.kept {
                match why {
                    Needed::Planned(RemovalError::LargeBlanket { .. }) => outcome.large += 1,
                    _ => outcome.needed.push(*node),
                }
            }
            outcome.fallbacks = thinning.removed.iter().filter(|it| it.fallback.is_some()).count();
            // A direction that came free would make this singular, and a lost gradient would move it.
            let before = smoother.error().unwrap_or(f64::NAN);
            let constants: f64 = thinning.removed.iter().map(|it| it.constant).sum();
            let error = full.error().unwrap_or(f64::NAN);
            outcome.off = (error - before - constants).abs() / (1.0 + error);
            match optimize_to_the_end(&mut smoother) {
                Err(error) => outcome.failure = failed(error.to_string()),
                Ok(_) => {
                    outcome.fell =
                        (before - smoother.error().unwrap_or(f64::NAN)).max(0.0) / (1.0 + before)
                }
            }
        }
        Err(error) => outcome.failure = failed(error.to_string()),
    }
    outcome.seconds = begun.elapsed().as_secs_f64();
    outcome
}
