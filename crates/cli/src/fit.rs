//! How well a map fits its measurements, for people.

use std::fmt::Display;

use evergraph::evaluate::{Fit, Verdict};

use crate::error::Error;
use crate::output::Output;
use crate::table::{Columns, Rows, short};

/// Ids of a factor on many variables fill a line.
const LONGEST_NAMES: usize = 24;

/// Adds the row of chi2 per degree of freedom.
pub(crate) fn show(fit: &Fit, rows: &mut Rows) {
    let dof = fit.degrees_of_freedom;
    let Some((ratio, [low, high])) = fit.chi2_per_dof.zip(fit.expected_95) else {
        return rows.add("chi2 per dof", "no degrees of freedom: any map fits");
    };
    let verdict = match fit.verdict {
        Verdict::Poor => "poor fit",
        Verdict::BetterThanExpected => "better than the weights say",
        _ => "as expected",
    };
    let range = format!("95 %: {} to {}", short(low), short(high));
    rows.add("chi2 per dof", format!("{} of {dof}, {verdict} ({range})", short(ratio)));
}

/// The edges that contradict the map, and the kinds: with `--verbose`, or when the fit is poor.
pub(crate) fn tell(fit: &Fit, verbose: bool, output: Output) -> Result<(), Error> {
    let poor = fit.verdict == Verdict::Poor;
    if poor {
        output.result(&sentence(fit))?;
    }
    if (poor || verbose) && !fit.worst.is_empty() {
        output.result(&worst(fit))?;
    }
    if verbose && !fit.kinds.is_empty() {
        output.result(&kinds(fit))?;
    }
    Ok(())
}

fn sentence(fit: &Fit) -> String {
    let [_, high] = fit.expected_95.unwrap_or_default();
    let ratio = fit.chi2_per_dof.unwrap_or(f64::NAN);
    format!(
        "Poor fit: chi2 per degree of freedom is {}, and right weights give {} at most.\n\
         Either edges are wrong, or sigmas are too small, or this is not the best minimum.\n\
         The edges that the map contradicts most, in standard deviations (before kernels):",
        short(ratio),
        short(high)
    )
}

fn worst(fit: &Fit) -> impl Display {
    let mut table = Columns::new(["line", "ids", "kind", "normalized residual"]);
    for it in &fit.worst {
        let mut names = it.names();
        if names.chars().count() > LONGEST_NAMES {
            let some: Vec<&str> = names.split(' ').take(2).collect();
            names = format!("{} ... ({})", some.join(" "), it.ids.len());
        }
        let residual = short(it.normalized_residual);
        table.add([it.line.to_string(), names, it.kind.clone(), residual]);
    }
    table
}

fn kinds(fit: &Fit) -> impl Display {
    let mut table = Columns::new(["kind", "count", "chi2 per dof", "largest residual"]);
    for (name, kind) in &fit.kinds {
        let ratio = kind.chi2_per_dof.map_or_else(|| "none".into(), short);
        table.add([name.clone(), kind.count.to_string(), ratio, short(kind.largest)]);
    }
    table
}
