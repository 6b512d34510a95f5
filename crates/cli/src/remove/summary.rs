//! Summary of the removals, for the report and for the table.

use std::collections::HashMap;

use evergraph::formats::spell_id;
use evergraph::model::VariableId;
use evergraph::removal::RemovalError;
use evergraph::{Needed, Replayer, Thinning};
use serde_json::{Map, Value, json};

use crate::report::Spread;
use crate::table::{Rows, number};

/// Counts, prices and times of the removals.
pub(super) struct Summary {
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

impl Summary {
    pub(super) fn of(thinning: &Thinning, replayer: &Replayer) -> Self {
        let ids: HashMap<VariableId, u64> =
            replayer.replay().ids().map(|(id, variable)| (variable, id)).collect();
        let id = |variable: &VariableId| ids.get(variable).copied().unwrap_or(u64::MAX);
        let removed = || thinning.removed.iter();
        let why = |needed: &Needed| match needed {
            Needed::Applied(_) => "singular",
            Needed::Planned(RemovalError::LastPose { .. }) => "last_pose",
            Needed::Planned(RemovalError::NoBlanket { .. }) => "no_blanket",
            Needed::Planned(RemovalError::LargeBlanket { .. }) => "large_blanket",
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

    pub(super) fn add_to(&self, report: &mut Map<String, Value>) {
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

    pub(super) fn show(&self, rows: &mut Rows) {
        const LISTED: usize = 5;
        rows.add("removed", format!("{} nodes", self.ids.len()));
        let mut kept: Vec<String> =
            self.kept.iter().take(LISTED).map(|it| spell_id(it.0)).collect();
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
