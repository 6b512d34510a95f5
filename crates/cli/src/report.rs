//! What a solving subcommand reports, for people and for programs.

use std::path::Path;
use std::time::Duration;

use evergraph::evaluate::Fit;
use evergraph::formats::{Document, spell_id};
use evergraph::solver::{Reason, Status as BatchStatus};
use evergraph::{Objective, Replayer};
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::error::Error;
use crate::files;
use crate::fit;
use crate::plot::{self, Plot, pictures};
use crate::steps::StepName;
use crate::table::{CONVENTION, Rows, milliseconds, number, short};

/// Version of the JSON reports.
pub(crate) const SCHEMA: u32 = 1;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Status {
    Converged,
    NotConverged,
    Singular,
    TooDense,
    Stopped,
}

/// Why an optimization did not converge, and what may help.
pub(crate) fn why(reason: Reason) -> String {
    match reason {
        Reason::IterationLimit => "the iterations were used up".into(),
        Reason::ErrorWouldRise => {
            "a Gauss-Newton step would raise the error; try --method lm or --method dogleg, or start closer with --init chordal".into()
        }
        Reason::NoDescent => "no step lowers the error any more".into(),
        other => serialized_name(&other),
    }
}

/// A batch optimization's end in words.
pub(crate) fn ended(status: BatchStatus) -> String {
    match status {
        BatchStatus::Converged => "converged to a local minimum".into(),
        BatchStatus::NotConverged(reason) => format!("not converged ({})", why(reason)),
        other => status_name(&other),
    }
}

/// A batch optimization's end in one word, as reports spell it.
pub(crate) fn status_name(status: &BatchStatus) -> String {
    serialized_name(&json!(status)["status"])
}

fn serialized_name(value: &impl Serialize) -> String {
    json!(value).as_str().unwrap_or("unknown").to_string()
}

/// Times of the updates.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Times {
    update_s: f64,
    mean_ms: f64,
    p50_ms: f64,
    p99_ms: f64,
    max_ms: f64,
    total_s: f64,
}

impl Times {
    /// Of all updates; `total` is the wall clock, reading included.
    pub(crate) fn of(updates: &[Duration], total: Duration) -> Self {
        let mut ms: Vec<f64> = updates.iter().map(|it| 1e3 * it.as_secs_f64()).collect();
        ms.sort_by(f64::total_cmp);
        // Not `sum()`, whose empty sum is -0.
        let sum = ms.iter().fold(0.0, |sum, x| sum + x);
        Self {
            update_s: sum / 1e3,
            mean_ms: if ms.is_empty() { 0.0 } else { sum / ms.len() as f64 },
            p50_ms: percentile(&ms, 0.5),
            p99_ms: percentile(&ms, 0.99),
            max_ms: percentile(&ms, 1.0),
            total_s: total.as_secs_f64(),
        }
    }

    /// The medians of each.
    pub(crate) fn median(runs: impl Iterator<Item = Self> + Clone) -> Self {
        let of = |field: fn(&Self) -> f64| median(runs.clone().map(|times| field(&times)));
        Self {
            update_s: of(|it| it.update_s),
            mean_ms: of(|it| it.mean_ms),
            p50_ms: of(|it| it.p50_ms),
            p99_ms: of(|it| it.p99_ms),
            max_ms: of(|it| it.max_ms),
            total_s: of(|it| it.total_s),
        }
    }

    /// All updates together, for people.
    pub(crate) fn update(&self) -> String {
        milliseconds(1e3 * self.update_s)
    }

    /// Those of a step, for people.
    pub(crate) fn steps(&self) -> String {
        let [mean, p50, p99, max] =
            [self.mean_ms, self.p50_ms, self.p99_ms, self.max_ms].map(milliseconds);
        format!("mean {mean}, p50 {p50}, p99 {p99}, max {max}")
    }
}

/// How times of the same thing spread, in milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Spread {
    mean: f64,
    p50: f64,
    p99: f64,
    max: f64,
}

impl Spread {
    pub(crate) fn of(times: impl Iterator<Item = Duration>) -> Self {
        let times: Vec<Duration> = times.collect();
        let Times { mean_ms, p50_ms, p99_ms, max_ms, .. } = Times::of(&times, Duration::ZERO);
        Self { mean: mean_ms, p50: p50_ms, p99: p99_ms, max: max_ms }
    }

    /// For people.
    pub(crate) fn describe(&self) -> String {
        let [mean, p50, p99, max] = [self.mean, self.p50, self.p99, self.max].map(milliseconds);
        format!("mean {mean}, p50 {p50}, p99 {p99}, max {max}")
    }
}

/// The median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    percentile(&sorted, 0.5)
}

/// By linear interpolation between the closest ranks; 0 for nothing.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = share * last as f64;
    let (low, high) = (at.floor() as usize, at.ceil() as usize);
    sorted[low] + (at - low as f64) * (sorted[high] - sorted[low])
}

/// The priors that hold the gauge, which are none of the file's factors.
#[derive(Clone, Debug, Serialize)]
struct Gauge {
    /// The first of them, by its id in the file.
    variable: u64,
    sigmas: Vec<f64>,
    /// How many directions of it are held; fewer than sigmas where measurements of the world hold
    /// the rest.
    directions: usize,
    /// Of all of them.
    error: f64,
    /// One for each connected component that needs one.
    variables: Vec<u64>,
}

/// What `replay` and `optimize` report.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Report {
    schema: u32,
    command: &'static str,
    dataset: String,
    steps: usize,
    variables: usize,
    factors: usize,
    settings: Value,
    convention: &'static str,
    error: f64,
    chi2: f64,
    /// How well the file's factors agree.
    pub(crate) fit: Fit,
    gauge_prior: Option<Gauge>,
    /// Variables that FIX lines hold.
    fixed: usize,
    time: Times,
    relinearizations: usize,
    factor_nnz: usize,
    fill_percent: f64,
    peak_rss_mb: Option<f64>,
    /// Landmarks left out because what was measured does not place them.
    held_back: usize,
    pub(crate) status: Status,
    /// What only this subcommand has.
    #[serde(flatten)]
    pub(crate) extra: Map<String, Value>,
}

/// What the replayer does not know of a run.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    pub command: &'static str,
    pub dataset: String,
    pub settings: Value,
    pub time: Times,
    pub relinearizations: usize,
    pub status: Status,
    /// Taken before anything is done for the report's own sake.
    pub peak_rss_mb: Option<f64>,
}

impl Report {
    pub(crate) fn new(replayer: &Replayer, document: &Document, run: Run) -> Result<Self, Error> {
        let unsolvable = |source| Error::unsolvable(replayer, source);
        let Objective { error, chi2, .. } = replayer.objective().map_err(unsolvable)?;
        let gauge_error = replayer.gauge_error().map_err(unsolvable)?;
        let fit = Fit::of_replayer(replayer, document).map_err(unsolvable)?;
        let size = replayer.smoother().size();
        let graph = replayer.graph();
        // A refused step is none of what is in the graph.
        let priors: Vec<_> = replayer
            .replay()
            .gauge_priors()
            .iter()
            .filter(|prior| graph.check_factor(prior.factor).is_ok())
            .collect();
        let gauge_prior = priors.first().map(|first| Gauge {
            variable: first.id,
            sigmas: vec![first.sigma; first.dim],
            directions: first.directions,
            error: gauge_error,
            variables: priors.iter().map(|prior| prior.id).collect(),
        });
        let in_graph = |variable| graph.check_variable(variable).is_ok();
        let replay = replayer.replay();
        Ok(Self {
            schema: SCHEMA,
            command: run.command,
            dataset: run.dataset,
            steps: replay
                .ids()
                .filter(|(id, v)| replay.pose(*id) == Some(*v) && in_graph(*v))
                .count(),
            variables: graph.variable_count(),
            factors: graph.factor_count() - priors.len(),
            settings: run.settings,
            convention: CONVENTION,
            error,
            chi2,
            fit,
            gauge_prior,
            fixed: replay.fixed().count(),
            time: run.time,
            relinearizations: run.relinearizations,
            factor_nnz: size.nonzeros,
            fill_percent: size.fill_percent(),
            peak_rss_mb: run.peak_rss_mb,
            held_back: replay.held_back(),
            status: run.status,
            extra: Map::new(),
        })
    }

    pub(crate) fn add(&mut self, field: &str, value: impl Into<Value>) {
        self.extra.insert(field.into(), value.into());
    }

    /// Whether the error is a number, which a report can hold.
    pub(crate) fn check(&self, replayer: &Replayer) -> Result<(), Error> {
        if self.error.is_finite() && self.chi2.is_finite() {
            return Ok(());
        }
        let line = replayer.costliest_line().unwrap_or_default();
        Err(Error::Overflow { file: replayer.name().into(), line })
    }

    /// The picture of a run.
    pub(crate) fn plot(
        &self,
        replayer: &Replayer,
        document: &Document,
        times: Option<Vec<(StepName, f64)>>,
    ) -> Result<Plot, Error> {
        let (error, chi2) = (number(self.error), number(self.chi2));
        let map = plot::Map::of(replayer.replay(), replayer.smoother(), document);
        let map = map.map_err(|source| Error::unsolvable(replayer, source))?;
        let map = pictures::of_fit(&map, &self.fit);
        let each = self
            .fit
            .chi2_per_dof
            .map_or_else(String::new, |ratio| format!(", {} per degree of freedom", short(ratio)));
        Ok(Plot {
            title: self.dataset.clone(),
            subtitle: [
                format!("evergraph {}: error {error}, chi2 {chi2}{each}", self.command),
                CONVENTION.into(),
            ],
            map,
            times,
        })
    }

    pub(crate) fn save(&self, path: Option<&Path>) -> Result<(), Error> {
        save(path, self)
    }

    /// The rows that all solving subcommands show; `status` in words.
    pub(crate) fn table(&self, status: &str) -> Rows {
        let mut rows = Rows::new("data set", &self.dataset);
        rows.add("steps (poses)", self.steps);
        rows.add("variables", self.variables);
        rows.add("factors", format!("{} (the file's)", self.factors));
        rows.add("error", number(self.error));
        rows.add("chi2", number(self.chi2));
        fit::show(&self.fit, &mut rows);
        rows.add("convention", format!("{CONVENTION}, the file's factors only"));
        match &self.gauge_prior {
            Some(gauge) => rows.add("gauge prior", gauge.describe()),
            None => rows.add("gauge prior", "none"),
        }
        if self.fixed > 0 {
            rows.add("fixed (FIX)", self.fixed);
        }
        let time = self.time;
        rows.add("update time", time.update());
        if self.command == "replay" {
            rows.add("  a step", time.steps());
        }
        rows.add("total time", milliseconds(1e3 * time.total_s));
        rows.add("relinearizations", format!("{} variables", self.relinearizations));
        rows.add(
            "factor (R)",
            format!("{} scalars, fill {:.3} %", self.factor_nnz, self.fill_percent),
        );
        if let Some(mb) = self.peak_rss_mb {
            rows.add("peak memory", format!("{mb:.1} MB"));
        }
        rows.add("status", status);
        rows
    }
}

impl Gauge {
    fn describe(&self) -> String {
        let on = match self.variables.as_slice() {
            [one] => format!("pose {}", spell_id(*one)),
            many => format!("{} poses, pose {} first", many.len(), spell_id(self.variable)),
        };
        let (sigma, error) = (number(self.sigmas[0]), number(self.error));
        let part = match self.directions {
            free if free < self.sigmas.len() => format!(", {free} free directions of it"),
            _ => String::new(),
        };
        format!("on {on}{part}, sigma {sigma} m and rad, error {error} (not in the above)")
    }
}

/// Writes a report, if one is asked for.
pub(crate) fn save(path: Option<&Path>, report: &impl Serialize) -> Result<(), Error> {
    let Some(path) = path else { return Ok(()) };
    let mut text = serde_json::to_string_pretty(report)?;
    text.push('\n');
    files::write_text(path, &text)
}

/// The name of a file without its folder.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Most memory that the process has had (MB of 2^20 bytes), where the system says so.
pub(crate) fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kb: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kb / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_interpolate() {
        let sorted: Vec<f64> = (0..101).map(f64::from).collect();
        assert_eq!(percentile(&sorted, 0.99), 99.0);
        assert_eq!(percentile(&[1.0, 2.0], 0.5), 1.5);
        assert_eq!(percentile(&[7.0], 0.99), 7.0);
        assert_eq!(percentile(&[], 0.99), 0.0);
    }

    #[test]
    fn times_of_nothing_are_zero() {
        assert_eq!(Times::of(&[], Duration::ZERO).mean_ms, 0.0);
    }

    #[test]
    fn medians_are_of_each_field() {
        let of = |ms: u64| Times::of(&[Duration::from_millis(ms)], Duration::from_secs(9 - ms));
        let times = Times::median([1, 5, 3].map(of).into_iter());
        assert_eq!((times.max_ms, times.total_s), (3.0, 6.0));
    }
}
