//! How well a map fits its measurements, for people.

use std::fmt::Display;

use evergraph::evaluate::{Fit, Verdict, WorstFactor};

use crate::error::Error;
use crate::output::Output;
use crate::table::{Columns, Rows, short};

/// Normalized residuals (standard deviations) beyond which an edge is worth a look, and beyond which it can
/// hardly be right. Of right edges, one in 60,000 is beyond the first in the plane, one in 3,000 in space.
pub(crate) const STRAINED: f64 = 5.0;
pub(crate) const TORN: f64 = 10.0;

/// Ids of a factor on many variables fill a line.
const LONGEST_NAMES: usize = 20;

/// Adds the rows of chi2 per degree of freedom and of the worst edge.
pub(crate) fn show(fit: &Fit, rows: &mut Rows) {
    match fit.chi2_per_dof.zip(fit.expected_95) {
        None => rows.add("chi2 per dof", "none: without degrees of freedom any map fits"),
        Some((ratio, [low, high])) => {
            let verdict = match fit.verdict {
                Verdict::Poor => "poor fit",
                Verdict::Above => "above the range: sigmas are somewhat small",
                Verdict::Below => {
                    "below the range: sigmas exceed the noise, covariances are overstated"
                }
                _ => "as expected",
            };
            let (ratio, dof) = (short(ratio), fit.degrees_of_freedom);
            let range = format!("{} to {} if all weights are right", short(low), short(high));
            rows.add("chi2 per dof", format!("{ratio} over {dof} dof, {verdict}"));
            rows.add("  95 % range", range);
        }
    }
    if let Some(worst) = fit.worst.first() {
        let residual = short(worst.normalized_residual);
        rows.add("worst edge", format!("{residual} sigma, line {} ({})", worst.line, names(worst)));
    }
}

/// The edges that contradict the map, and the kinds: when the fit is poor, an edge is far off, or with
/// `--verbose`.
pub(crate) fn tell(fit: &Fit, verbose: bool, output: Output) -> Result<(), Error> {
    let poor = fit.verdict == Verdict::Poor;
    if poor {
        output.result(&sentence(fit))?;
    }
    let far_off = fit.worst.first().is_some_and(|it| it.normalized_residual > TORN);
    if (poor || far_off || verbose) && !fit.worst.is_empty() {
        output.result(&"Largest normalized residuals (standard deviations, before kernels):")?;
        output.result(&worst(fit))?;
        output.result(&kinds(fit))?;
    }
    Ok(())
}

fn sentence(fit: &Fit) -> String {
    let [low, high] = fit.expected_95.unwrap_or_default();
    let ratio = fit.chi2_per_dof.unwrap_or(f64::NAN);
    format!(
        "Poor fit: chi2 per dof is {}, where right weights give {} to {}.\n\
         Edges are wrong, or sigmas are too small, or this is not the best minimum.\n\
         Edges that a robust kernel has silenced count in full.",
        short(ratio),
        short(low),
        short(high)
    )
}

fn worst(fit: &Fit) -> impl Display {
    let mut table = Columns::new(["line", "ids", "kind", "residual"]);
    for it in &fit.worst {
        let residual = short(it.normalized_residual);
        table.add([it.line.to_string(), names(it), it.kind.clone(), residual]);
    }
    table
}

fn names(factor: &WorstFactor) -> String {
    let all = factor.names.join(" ");
    if all.chars().count() <= LONGEST_NAMES || factor.names.len() < 3 {
        return all;
    }
    format!("{} ... ({})", factor.names[0], factor.names.len())
}

fn kinds(fit: &Fit) -> impl Display {
    let mut table = Columns::new(["kind", "count", "rms", "chi2/dof", "largest"]);
    for (name, kind) in &fit.kinds {
        let ratio = kind.chi2_per_dof.map_or_else(|| "none".into(), short);
        let (count, rms) = (kind.count.to_string(), short(kind.rms));
        table.add([name.clone(), count, rms, ratio, short(kind.largest)]);
    }
    table
}
