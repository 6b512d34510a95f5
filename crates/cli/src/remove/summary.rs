//! Summary of the removals, for the report and for the table.

use std::collections::HashMap;

use evergraph::formats::spell_id;
use evergraph::model::VariableId;
use evergraph::removal::{Certificate, RemovalError, Topology};
use evergraph::{Needed, Replayer, Thinning};
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::report::Spread;
use crate::table::{Rows, number};

/// Why a node stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reason {
    /// A direction of the map would be free.
    Rank,
    /// It shares no factor with a node that stays.
    NoBlanket,
    /// Its neighbours have more dimensions than `--largest-blanket`.
    LargeBlanket,
    /// A graph keeps a pose.
    LastPose,
    /// The factor in its place cannot be made.
    NotRepresentable,
}

impl Reason {
    const ALL: [Self; 5] =
        [Self::Rank, Self::LargeBlanket, Self::NoBlanket, Self::LastPose, Self::NotRepresentable];

    fn of(needed: &Needed) -> Self {
        match needed {
            Needed::Applied(_) => Self::Rank,
            Needed::Planned(RemovalError::LastPose { .. }) => Self::LastPose,
            Needed::Planned(RemovalError::NoBlanket { .. }) => Self::NoBlanket,
            Needed::Planned(RemovalError::LargeBlanket { .. }) => Self::LargeBlanket,
            _ => Self::NotRepresentable,
        }
    }

    /// In the report.
    fn name(self) -> &'static str {
        match self {
            Self::Rank => "rank",
            Self::NoBlanket => "no_blanket",
            Self::LargeBlanket => "large_blanket",
            Self::LastPose => "last_pose",
            Self::NotRepresentable => "not_representable",
        }
    }

    /// In the table; `largest` is the value of `--largest-blanket`.
    fn describe(self, largest: usize) -> String {
        match self {
            Self::Rank => "kept for rank".into(),
            Self::NoBlanket => "kept, without neighbours".into(),
            Self::LargeBlanket => format!("kept, neighbours beyond --largest-blanket {largest}"),
            Self::LastPose => "kept, the last pose".into(),
            Self::NotRepresentable => "kept, no factor can replace it (--recovery)".into(),
        }
    }
}

/// A node that stays.
struct Kept {
    id: u64,
    reason: Reason,
    message: String,
}

/// Counts, prices and times of the removals.
pub(super) struct Summary {
    ids: Vec<u64>,
    kept: Vec<Kept>,
    fallbacks: usize,
    dense: usize,
    /// Over all removals that have one: the largest eigenvalue, and the sums.
    certificate: Option<Certificates>,
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
        Self {
            ids: removed().map(|it| id(&it.variable)).collect(),
            kept: thinning
                .kept
                .iter()
                .map(|(variable, needed)| Kept {
                    id: id(variable),
                    reason: Reason::of(needed),
                    message: replayer.explain_needed(needed),
                })
                .collect(),
            fallbacks: removed().filter(|it| it.fallback.is_some()).count(),
            dense: removed().filter(|it| it.blanket > 2 && it.topology == Topology::Dense).count(),
            certificate: Certificates::of(thinning),
            largest_blanket: removed().map(|it| it.blanket).max().unwrap_or(0),
            price: thinning.price(),
            constant: removed().map(|it| it.constant).fold(0.0, |sum, x| sum + x),
            plan: Spread::of(removed().map(|it| it.plan)),
            apply: Spread::of(removed().map(|it| it.apply)),
            both: Spread::of(removed().map(|it| it.plan + it.apply)),
        }
    }

    pub(super) fn add_to(&self, report: &mut Map<String, Value>) {
        let kept = self.kept.iter().map(|Kept { id, reason, message }| {
            json!({ "variable": id, "reason": reason.name(), "message": message })
        });
        let counts = Reason::ALL.map(|reason| {
            let count = self.kept.iter().filter(|kept| kept.reason == reason).count();
            (reason.name().to_string(), json!(count))
        });
        for (field, value) in [
            ("removed", json!(self.ids.len())),
            ("removed_ids", json!(self.ids)),
            ("kept", kept.collect()),
            ("kept_counts", counts.into_iter().collect::<Map<_, _>>().into()),
            ("fallbacks", json!(self.fallbacks)),
            ("dense_factors", json!(self.dense)),
            ("certificates", json!(self.certificate)),
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

    /// `largest` is the value of `--largest-blanket`.
    pub(super) fn show(&self, rows: &mut Rows, largest: usize) {
        rows.add("removed", format!("{} nodes", self.ids.len()));
        for reason in Reason::ALL {
            let kept: Vec<u64> =
                self.kept.iter().filter(|it| it.reason == reason).map(|it| it.id).collect();
            // Zero is worth saying of what the map would lose, not of what does not happen.
            if !kept.is_empty() || reason == Reason::Rank {
                rows.add(&reason.describe(largest), listed(&kept));
            }
        }
        rows.add("largest blanket", self.largest_blanket);
        rows.add("dense factors", format!("{} on three or more neighbours", self.dense));
        rows.add("fallbacks", self.fallbacks);
        if let Some(certificate) = &self.certificate {
            let Certificates { trees, conservative, largest_eigenvalue, .. } = certificate;
            let largest = number(*largest_eigenvalue);
            rows.add(
                "trees",
                format!("{trees}, {conservative} conservative, eigenvalue {largest} at most"),
            );
        }
        rows.add("a node", self.both.describe());
        rows.add("  to plan", self.plan.describe());
        rows.add("  to apply", self.apply.describe());
        let price = self.price.map_or_else(|| "none".into(), |it| number(it) + " nats");
        rows.add("sum of prices", price);
    }
}

/// How the trees compare to what they replace.
#[derive(Serialize)]
struct Certificates {
    trees: usize,
    /// Of these, the ones that claim no more in any direction.
    conservative: usize,
    largest_eigenvalue: f64,
    /// Sums, in nats.
    divergence: f64,
    log_det_ratio: f64,
    /// The largest.
    gap: Option<f64>,
}

impl Certificates {
    /// `None` when no removal has a certificate.
    fn of(thinning: &Thinning) -> Option<Self> {
        /// An eigenvalue of 1 is off by as much.
        const ROUNDING: f64 = 1e-9;
        let all: Vec<_> = thinning.removed.iter().filter_map(|it| it.certificate).collect();
        let conservative = |it: &&Certificate| it.largest_eigenvalue <= 1.0 + ROUNDING;
        (!all.is_empty()).then(|| Self {
            trees: all.len(),
            conservative: all.iter().filter(conservative).count(),
            largest_eigenvalue: all.iter().map(|it| it.largest_eigenvalue).fold(0.0, f64::max),
            divergence: all.iter().map(|it| it.divergence).sum(),
            log_det_ratio: all.iter().map(|it| it.log_det_ratio).sum(),
            gap: all.iter().filter_map(|it| it.gap).reduce(f64::max),
        })
    }
}

/// How many, and the first of them.
fn listed(ids: &[u64]) -> String {
    const LISTED: usize = 5;
    let mut list: Vec<String> = ids.iter().take(LISTED).map(|id| spell_id(*id)).collect();
    if ids.len() > LISTED {
        list.push("...".into());
    }
    if list.is_empty() { "0".into() } else { format!("{}: {}", ids.len(), list.join(", ")) }
}
