//! What `remove` and `compare` say of two graphs.

use evergraph::evaluate::{
    Comparison, Consistency, Divergence, DivergenceError, GraphSize, Solved,
};
use evergraph::formats::{Document, spell_id};
use evergraph::model::{FactorId, VariableId};
use evergraph::solver::{BatchReport, Settings, Status as BatchStatus};
use evergraph::{Replayer, Smoother};
use serde_json::{Map, Value, json};

use crate::error::Error;
use crate::output::Output;
use crate::plot::{self, Places, Plot, pictures};
use crate::report;
use crate::table::{Rows, number};

/// What the figures are, printed beside them.
pub(crate) const CONVENTION: &str = "nats; 1/2 (tr(L P) - n - ln det L + ln det L_true) and 1/2 d^T L d over the n kept dimensions: P, \
     L_true of the full graph's marginal, L of the reduced graph, both at the full graph's optimum, d \
     from there to the reduced graph's";

/// The factors that hold the gauge.
pub(crate) fn gauge_factors(replayer: &Replayer) -> Vec<FactorId> {
    replayer.replay().gauge_priors().iter().map(|prior| prior.factor).collect()
}

/// Two graphs and what is between them.
#[derive(Clone, Debug)]
pub(crate) struct Reduction {
    pub before: GraphSize,
    pub after: GraphSize,
    pub divergence: Divergence,
    pub consistency: Consistency,
    /// The id of the variable whose marginal is worst, as the file spells it.
    pub worst: String,
}

impl Reduction {
    /// Compares a reduced graph with the full one, whose variables have the ids of `replayer`.
    pub(crate) fn of(
        [before, after]: [GraphSize; 2],
        [full, reduced]: [Solved<'_>; 2],
        kept: &[(VariableId, VariableId)],
        settings: &Settings,
        replayer: &Replayer,
    ) -> Result<Self, DivergenceError> {
        let comparison = Comparison::new(full, reduced, kept, settings)?;
        let (divergence, consistency) = (comparison.divergence()?, comparison.consistency()?);
        let mut ids = replayer.replay().ids();
        let worst = ids.find(|(_, variable)| *variable == consistency.worst.variable);
        let worst =
            worst.map_or_else(|| consistency.worst.variable.to_string(), |it| spell_id(it.0));
        Ok(Self { before, after, divergence, consistency, worst })
    }

    /// Adds the fields that both subcommands have.
    pub(crate) fn add_to(&self, report: &mut Map<String, Value>) {
        let Self { before, after, divergence, .. } = self;
        for (field, pair) in [
            ("variables", [before.variables, after.variables]),
            ("factors", [before.factors, after.factors]),
            ("nnz", [before.nonzeros, after.nonzeros]),
            ("factor_nnz", [before.factor_nonzeros, after.factor_nonzeros]),
        ] {
            report.insert(format!("{field}_before"), json!(pair[0]));
            report.insert(format!("{field}_after"), json!(pair[1]));
        }
        for (field, value) in [
            ("convention", json!(CONVENTION)),
            ("degrees_of_freedom", json!(divergence.degrees_of_freedom)),
            ("kld_covariance", json!(divergence.covariance)),
            ("kld_covariance_per_dof", json!(divergence.per_degree_of_freedom())),
            ("kld_mean", json!(divergence.mean)),
            ("kld_total", json!(divergence.total)),
            ("log_det_ratio", json!(divergence.log_det_ratio)),
            ("is_conservative", json!(self.consistency.is_conservative())),
            ("consistency", json!(self.consistency)),
            ("worst_variable", json!(self.worst)),
            ("mean_shift_m", json!(divergence.mean_shift_m)),
            ("rms_shift_m", json!(divergence.rms_shift_m)),
            ("max_shift_m", json!(divergence.max_shift_m)),
        ] {
            report.insert(field.into(), value);
        }
    }

    /// The picture of both graphs at their estimates: the full one with its document, the reduced one.
    pub(crate) fn plot(
        &self,
        command: &str,
        title: String,
        (full, smoother, document): (&Replayer, &Smoother, &Document),
        (reduced, kept): (&Replayer, &Smoother),
    ) -> Result<Plot, Error> {
        let map = plot::Map::of(full.replay(), smoother, document);
        let map = map.map_err(|source| Error::unsolvable(full, source))?;
        let places = Places::of(reduced.replay(), kept);
        let places = places.map_err(|source| Error::unsolvable(reduced, source))?;
        let Self { before, after, divergence, .. } = self;
        let [rms, total] = [divergence.rms_shift_m, divergence.total].map(number);
        let (from, to) = (before.variables, after.variables);
        let subtitle = [
            format!("evergraph {command}: {from} to {to} variables, KLD {total} nats"),
            format!("shift {rms} m (rms)"),
        ];
        let map = pictures::of_reduction(&map, &places, divergence.max_shift_m);
        Ok(Plot { title, subtitle, map, times: None })
    }

    /// A sentence on where the reduced graph claims too much, if it does.
    fn describe_consistency(&self) -> String {
        let Consistency { largest_eigenvalue, variables, overconfident, ref worst, .. } =
            self.consistency;
        if self.consistency.is_conservative() {
            return "yes, in every direction".into();
        }
        let percent = |share: f64| number(100.0 * share);
        if overconfident == 0 {
            let claimed = percent(1.0 - largest_eigenvalue.sqrt().recip());
            return format!("no: marginals are, but a joint deviation is {claimed} % too small");
        }
        let direction: Vec<String> = worst.direction.iter().map(|x| format!("{x:.2}")).collect();
        format!(
            "no: {overconfident} of {variables} marginals are too small, that of {} most: its deviation \
             along ({}) by {} %",
            self.worst,
            direction.join(", "),
            percent(1.0 - worst.deviation_ratio)
        )
    }

    /// Adds the rows that both subcommands show: sizes, then figures.
    pub(crate) fn show(&self, rows: &mut Rows) {
        let Self { before, after, divergence, .. } = self;
        let change = |from: usize, to: usize| format!("{from} to {to}");
        rows.add("variables", change(before.variables, after.variables));
        rows.add("factors", change(before.factors, after.factors));
        rows.add("information", format!("{} scalars", change(before.nonzeros, after.nonzeros)));
        rows.add("factor (R)", change(before.factor_nonzeros, after.factor_nonzeros) + " scalars");
        let Divergence { covariance, mean, total, log_det_ratio, .. } = *divergence;
        let n = divergence.degrees_of_freedom;
        let each = number(divergence.per_degree_of_freedom());
        rows.add("KLD, covariance", format!("{} nats, {each} for each of {n}", number(covariance)));
        rows.add("KLD, mean", format!("{} nats", number(mean)));
        rows.add("KLD", format!("{} nats", number(total)));
        rows.add("ln det ratio", number(log_det_ratio) + ", positive: less is known");
        rows.add("conservative", self.describe_consistency());
        let Divergence { mean_shift_m, rms_shift_m, max_shift_m, .. } = *divergence;
        let [mean, rms, max] = [mean_shift_m, rms_shift_m, max_shift_m].map(number);
        rows.add("shift [m]", format!("mean {mean}, rms {rms}, max {max}"));
        rows.add(
            "convention",
            "KLD of the reduced graph from the full graph's marginal on what is kept: \
             1/2 (tr(L P) - n - ln det L + ln det L_true), 1/2 d^T L d",
        );
    }
}

/// An error of the metrics in the ids of the file.
pub(crate) fn incomparable(replayer: &Replayer, error: DivergenceError) -> Error {
    let file = replayer.name().to_string();
    let message = match &error {
        DivergenceError::Full(source) => {
            format!("the full graph has no covariance: {}", replayer.explain(source))
        }
        DivergenceError::Reduced(source) => format!(
            "the reduced graph does not determine what the full graph does: {}",
            replayer.explain(source)
        ),
        other => other.to_string(),
    };
    Error::Incomparable { file, message, source: Box::new(error) }
}

/// How an optimization ended, in words.
pub(crate) fn ended(batch: &BatchReport) -> String {
    let words = report::ended(batch.status);
    match batch.status {
        BatchStatus::Converged => format!("{words} after {} iterations", batch.iterations),
        _ => words,
    }
}

/// Warns where an optimum was not reached, of which shifts and the mean's divergence are.
pub(crate) fn warn_of_ends(ends: &[(&str, &BatchReport)], output: Output) {
    for (graph, batch) in ends {
        if batch.status != BatchStatus::Converged {
            output.warn(&format!(
                "the {graph} graph has {}; what is said of the mean and of shifts is of where it \
                 stopped. Start closer: `evergraph replay FILE --final-batch --output MAP.g2o` first, or \
                 `evergraph optimize FILE --init chordal --output MAP.g2o`",
                ended(batch)
            ));
        }
    }
}

/// The same variables in both graphs.
pub(crate) fn same(smoother: &Smoother) -> Vec<(VariableId, VariableId)> {
    smoother.graph().variables().map(|id| (id, id)).collect()
}
