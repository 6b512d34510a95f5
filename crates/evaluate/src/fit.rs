//! Whether a solved graph agrees with its own measurements.
//!
//! With right weights, `chi2 = Σ ‖r‖²` over whitened residuals at the optimum follows the chi2
//! distribution of
//!
//! ```text
//! degrees of freedom = rows of all factors, gauge priors included - dimensions of the unknowns
//! ```
//!
//! Its quantiles are Wilson and Hilferty's, `k (1 - 2/(9k) + z sqrt(2/(9k)))³` (1931): the upper
//! one to within half a percent from three degrees of freedom on, the lower one to a percent from ten.
//! Residuals are those before robust kernels: an edge that a
//! kernel has silenced is still an edge that the map contradicts.
//!
//! - E. B. Wilson and M. M. Hilferty, "The distribution of chi-square" (1931).

use std::collections::{BTreeMap, HashMap};

use evergraph_formats::{Document, Record, short_id};
use evergraph_model::{FactorId, Graph, GraphError, Values, VariableId};
use evergraph_replay::{Initial, Overview, Replay, ReplayOptions, Replayer};
use evergraph_solver::SmootherError;
use serde::Serialize;

use crate::error::EvaluateError;
use crate::start;

/// How many edges [`Fit::worst`] holds.
const WORST: usize = 10;

/// Of chi2 per degree of freedom: standard deviations that are a tenth too small, squared.
const TOLERATED: f64 = 1.21;

/// Of the standard normal distribution: 95 % lie between minus this and this.
const TWO_SIDED_95: f64 = 1.959_963_984_540_054;

/// A factor of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileFactor {
    /// In the graph.
    pub factor: FactorId,
    /// Its line in the file.
    pub line: usize,
    /// Its kind in words.
    pub kind: String,
    /// The ids of its variables in the file.
    pub ids: Vec<u64>,
}

/// How well a graph fits its measurements.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Fit {
    /// `Σ ‖r‖²` of the file's factors, without robust kernels.
    pub chi2: f64,
    /// Rows of all factors, less the dimensions of the variables that are not fixed.
    pub degrees_of_freedom: usize,
    /// `chi2` over them; `None` where there are none.
    pub chi2_per_dof: Option<f64>,
    /// Where 95 % of such ratios lie if all weights are right; `None` where there are no degrees of
    /// freedom.
    pub expected_95: Option<[f64; 2]>,
    /// What that says.
    pub verdict: Verdict,
    /// By kind of factor.
    pub kinds: BTreeMap<String, KindFit>,
    /// Factors of the largest normalized residuals, the largest first; ten at most.
    pub worst: Vec<WorstFactor>,
    /// The normalized residual of every factor of the file, in its order.
    #[serde(skip)]
    pub residuals: Vec<(FactorId, f64)>,
}

/// chi2 beside its expected range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Verdict {
    /// Within the range.
    Expected,
    /// Above the range, but by less than a tenth of the standard deviations: where there are many
    /// degrees of freedom, the range is narrower than anybody knows weights.
    Above,
    /// Above the range, and by more: measurements contradict each other more than their weights allow.
    Poor,
    /// Below the range: measurements agree better than their weights say.
    Below,
    /// Without degrees of freedom any map fits.
    NoRedundancy,
}

/// The factors of a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct KindFit {
    /// How many there are.
    pub count: usize,
    /// Rows of their residuals.
    pub rows: usize,
    /// `Σ ‖r‖²`.
    pub chi2: f64,
    /// Root mean square of the rows; with right weights somewhat below 1.
    pub rms: f64,
    /// `chi2` over the kind's share of the degrees of freedom, which are shared out by rows; `None`
    /// where there are none.
    pub chi2_per_dof: Option<f64>,
    /// Largest normalized residual.
    pub largest: f64,
}

/// A factor that the map contradicts.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct WorstFactor {
    /// Its line in the file.
    pub line: usize,
    /// Its kind in words.
    pub kind: String,
    /// The ids of its variables in the file.
    pub ids: Vec<u64>,
    /// The same by their names, where they have names (`x12`).
    pub names: Vec<String>,
    /// `‖r‖`, the length of the whitened residual (standard deviations), without robust kernel.
    pub normalized_residual: f64,
    /// In the graph.
    #[serde(skip)]
    pub factor: FactorId,
}

impl Fit {
    /// Measures the fit of a graph at `values`. All factors that are not in `file` are gauge priors:
    /// they count for the degrees of freedom alone.
    ///
    /// Linear in the factors.
    ///
    /// # Errors
    /// [`GraphError`] where a factor or value is not of the graph, or a factor panics.
    pub fn of(
        graph: &Graph,
        values: &Values,
        file: impl IntoIterator<Item = FileFactor>,
    ) -> Result<Self, GraphError> {
        let mut points = vec![0.0; graph.value_len()];
        for (variable, value) in values.iter() {
            let range = graph.value_range(graph.variable_index(variable)?);
            points[range].copy_from_slice(value.to_value().storage());
        }
        Self::at(graph, &points, file)
    }

    /// The fit of what has come in of a document that is replayed, at the estimate.
    ///
    /// # Errors
    /// [`SmootherError`] where there is no estimate, or a factor panics.
    pub fn of_replayer(replayer: &Replayer, document: &Document) -> Result<Self, SmootherError> {
        let (graph, estimates) = (replayer.graph(), replayer.smoother().estimates()?);
        Ok(Self::of(graph, &estimates, file_factors(replayer.replay(), graph, document))?)
    }

    /// The fit of a document at its vertices; `None` where it has no vertices or no factors.
    ///
    /// # Errors
    /// As [`Start::of`](crate::Start::of).
    pub fn of_vertices(document: &Document) -> Result<Option<Self>, EvaluateError> {
        let has_factors = document.records().any(Record::is_factor);
        if document.summary().vertices == 0 || !has_factors {
            return Ok(None);
        }
        let options = ReplayOptions::default().with_initial(Initial::FromFile);
        let (replay, graph, points) = start::everything(document, &options)?;
        Ok(Some(Self::at(&graph, &points, file_factors(&replay, &graph, document))?))
    }

    fn at(
        graph: &Graph,
        points: &[f64],
        file: impl IntoIterator<Item = FileFactor>,
    ) -> Result<Self, GraphError> {
        let rows: usize = graph.factor_indices().map(|factor| graph.rows_at(factor)).sum();
        let unknowns: usize = graph.unknown_indices().map(|index| graph.dim_at(index)).sum();
        let degrees_of_freedom = rows.saturating_sub(unknowns);
        let share = degrees_of_freedom as f64 / rows.max(1) as f64;

        let (mut kinds, mut worst) = (BTreeMap::<String, KindFit>::new(), Worst::default());
        let (mut chi2, mut residuals, mut residual) = (0.0, Vec::new(), Vec::new());
        for file_factor in file {
            let index = graph.factor_index(file_factor.factor)?;
            residual.clear();
            residual.resize(graph.rows_at(index), 0.0);
            graph.residual(index, points, &mut residual)?;
            let squared: f64 = residual.iter().fold(0.0, |sum, r| sum + r * r);
            let normalized = squared.sqrt();
            chi2 += squared;
            if !kinds.contains_key(&file_factor.kind) {
                kinds.insert(file_factor.kind.clone(), KindFit::default());
            }
            if let Some(of_kind) = kinds.get_mut(&file_factor.kind) {
                of_kind.count += 1;
                of_kind.rows += residual.len();
                of_kind.chi2 += squared;
                of_kind.largest = of_kind.largest.max(normalized);
            }
            residuals.push((file_factor.factor, normalized));
            worst.push(file_factor, normalized);
        }
        for kind in kinds.values_mut() {
            kind.rms = (kind.chi2 / kind.rows.max(1) as f64).sqrt();
            kind.chi2_per_dof = ratio(kind.chi2, share * kind.rows as f64);
        }
        let worst = worst.finish();
        let dof = degrees_of_freedom as f64;
        let chi2_per_dof = ratio(chi2, dof);
        let expected_95 = (degrees_of_freedom > 0)
            .then(|| [-TWO_SIDED_95, TWO_SIDED_95].map(|z| chi2_quantile(dof, z) / dof));
        let verdict = match chi2_per_dof.zip(expected_95) {
            None => Verdict::NoRedundancy,
            Some((ratio, [low, _])) if ratio < low => Verdict::Below,
            Some((ratio, [_, high])) if ratio <= high => Verdict::Expected,
            Some((ratio, _)) if ratio <= TOLERATED => Verdict::Above,
            // A number that is none is no good fit.
            Some(_) => Verdict::Poor,
        };
        Ok(Self {
            chi2,
            degrees_of_freedom,
            chi2_per_dof,
            expected_95,
            verdict,
            kinds,
            worst,
            residuals,
        })
    }
}

/// The factors of a document that are in the graph of its replay.
fn file_factors(
    replay: &Replay,
    graph: &Graph,
    document: &Document,
) -> impl Iterator<Item = FileFactor> {
    let names: HashMap<VariableId, u64> =
        replay.ids().map(|(id, variable)| (variable, id)).collect();
    let records: HashMap<usize, &Record> =
        document.lines().iter().map(|line| (line.number, &line.record)).collect();
    replay.factors().iter().filter_map(move |&(factor, line)| {
        // A step that was refused is not in the graph.
        let known = graph.factor(factor).ok()?;
        let ids = known.keys().iter().filter_map(|key| names.get(key).copied()).collect();
        let record = records.get(&line);
        let kind = record.map_or_else(|| known.name(), |record| Overview::kind_of(record));
        Some(FileFactor { factor, line, kind, ids })
    })
}

/// The factors of the largest residuals so far, and a few more.
#[derive(Default)]
struct Worst(Vec<(f64, FileFactor)>);

impl Worst {
    fn push(&mut self, factor: FileFactor, normalized: f64) {
        self.0.push((normalized, factor));
        if self.0.len() >= 64 * WORST {
            self.keep();
        }
    }

    fn keep(&mut self) {
        self.0.sort_by(|(a, one), (b, other)| b.total_cmp(a).then(one.line.cmp(&other.line)));
        self.0.truncate(WORST);
    }

    fn finish(mut self) -> Vec<WorstFactor> {
        self.keep();
        let worst = self.0.into_iter().map(|(normalized_residual, it)| {
            let names = it.ids.iter().map(|id| short_id(*id)).collect();
            let FileFactor { factor, line, kind, ids } = it;
            WorstFactor { line, kind, ids, names, normalized_residual, factor }
        });
        worst.collect()
    }
}

fn ratio(chi2: f64, degrees_of_freedom: f64) -> Option<f64> {
    (degrees_of_freedom > 0.0).then(|| chi2 / degrees_of_freedom)
}

/// Of the chi2 distribution of `k` degrees of freedom, at the probability at which the standard normal
/// distribution has its quantile `z`.
fn chi2_quantile(k: f64, z: f64) -> f64 {
    let variance = 2.0 / (9.0 * k);
    k * (1.0 - variance + z * variance.sqrt()).max(0.0).powi(3)
}

#[cfg(test)]
mod tests {
    use evergraph_formats::ReadOptions;
    use evergraph_replay::ReplayOptions;
    use evergraph_solver::Settings;

    use super::*;

    fn fit(text: &str) -> Fit {
        let document = Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap();
        let options = ReplayOptions::default();
        let mut replayer = Replayer::new(&document, &options, Settings::default()).unwrap();
        replayer.everything().unwrap();
        replayer.final_batch().unwrap();
        Fit::of_replayer(&replayer, &document).unwrap()
    }

    /// Tables of the distribution: 2.5 % and 97.5 %.
    #[test]
    fn quantiles_are_those_of_tables() {
        for (k, low, high) in
            [(3.0, 0.2158, 9.348), (10.0, 3.247, 20.483), (100.0, 74.222, 129.561)]
        {
            let tolerance = if k < 10.0 { 0.2 } else { 0.01 };
            assert!((chi2_quantile(k, -TWO_SIDED_95) / low - 1.0).abs() < tolerance, "{k}");
            assert!((chi2_quantile(k, TWO_SIDED_95) / high - 1.0).abs() < 0.005, "{k}");
        }
        assert_eq!(chi2_quantile(1.0, -TWO_SIDED_95), 0.0);
    }

    const WAY: &str =
        "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 100\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 100\n";

    #[test]
    fn without_redundancy_nothing_is_said() {
        let fit = fit(WAY);
        assert_eq!((fit.degrees_of_freedom, fit.verdict), (0, Verdict::NoRedundancy));
        assert_eq!((fit.chi2_per_dof, fit.expected_95), (None, None));
        assert_eq!(fit.worst.len(), 2);
    }

    #[test]
    fn a_contradiction_is_a_poor_fit_whose_worst_edge_is_named() {
        // The closure is 3 m too long, and only it is weak enough to give way.
        let fit =
            fit(&format!("{WAY}EDGE_SE2 0 2 5 0 0 4 0 0 4 0 4\nEDGE_SE2 0 2 2 0 0 1 0 0 1 0 1\n"));
        assert_eq!((fit.degrees_of_freedom, fit.verdict), (6, Verdict::Poor));
        let worst = &fit.worst[0];
        assert_eq!((worst.line, worst.names.join(" ").as_str()), (3, "0 2"));
        let [low, high] = fit.expected_95.unwrap();
        assert!((0.2..0.22).contains(&low) && (2.39..2.42).contains(&high), "{low} {high}");
        let kind = fit.kinds["edges to a 2D pose"];
        assert_eq!((kind.count, kind.rows, kind.largest), (4, 12, worst.normalized_residual));
        assert!((kind.chi2_per_dof.unwrap() - fit.chi2_per_dof.unwrap()).abs() > 1e-3);
        let squares: f64 = fit.worst.iter().map(|it| it.normalized_residual.powi(2)).sum();
        assert!((squares - fit.chi2).abs() < 1e-9 * fit.chi2);
    }

    /// A thousand edges too long and a thousand too short: the range is narrow.
    #[test]
    fn a_little_above_the_range_is_not_poor() {
        let of = |ratio: f64| {
            let off = (3.0 * ratio).sqrt();
            let edge = |at: f64| format!("EDGE_SE2 0 1 {at} 0 0 1 0 0 1 0 1\n");
            fit(&(edge(9.0 + off) + &edge(9.0 - off)).repeat(1000))
        };
        for (ratio, verdict) in [
            (0.9, Verdict::Below),
            (1.0, Verdict::Expected),
            (1.1, Verdict::Above),
            (1.3, Verdict::Poor),
        ] {
            let fit = of(ratio);
            assert_eq!((fit.degrees_of_freedom, fit.verdict), (5997, verdict), "{ratio}");
            assert!((fit.chi2_per_dof.unwrap() - ratio).abs() < 1e-3, "{ratio}");
            assert!((fit.kinds["edges to a 2D pose"].rms - ratio.sqrt()).abs() < 1e-9);
        }
    }

    #[test]
    fn fixed_variables_are_no_unknowns() {
        let vertices = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\nFIX 0 2\n";
        let fit = fit(&format!("{vertices}{WAY}"));
        assert_eq!((fit.degrees_of_freedom, fit.verdict), (3, Verdict::Below));
    }

    #[test]
    fn robust_kernels_do_not_hide_a_wrong_edge() {
        let text = format!("{WAY}EDGE_SE2 0 2 5 0 0 100 0 0 100 0 100\n");
        let document = Document::parse("test", text.as_bytes(), &ReadOptions::default()).unwrap();
        let kernel = evergraph_model::Kernel::huber(1.0).unwrap();
        let options = ReplayOptions::default().with_kernel(Some(kernel));
        let mut replayer = Replayer::new(&document, &options, Settings::default()).unwrap();
        replayer.everything().unwrap();
        replayer.final_batch().unwrap();
        let fit = Fit::of_replayer(&replayer, &document).unwrap();
        assert_eq!((fit.worst[0].line, fit.verdict), (3, Verdict::Poor));
        let chi2 = replayer.objective().unwrap().chi2;
        assert!((fit.chi2 - chi2).abs() <= 1e-9 * chi2, "{} {chi2}", fit.chi2);
    }
}
