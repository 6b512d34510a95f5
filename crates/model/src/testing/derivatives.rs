//! Factors against numerical derivatives.

use thiserror::Error;

use super::central;
use crate::arguments::Arguments;
use crate::evaluate::{EvaluationError, LinearizedFactor, linearize_at};
use crate::factor::Factor;
use crate::value::{Value, ValueRef};

/// Relative deviation from a numerical derivative that counts as truncation and rounding.
const DERIVATIVE: f64 = 1e-6;

/// Entries of a row that are smaller than this part of its largest entry are compared on that
/// scale: below it a numerical derivative is mostly the rounding of the large ones.
const ROW_FLOOR: f64 = 1e-4;

/// Steps tried in turn. The longest has the least rounding; a shorter one is needed where the
/// residual bends sharply or an angle wraps within the step.
const STEPS: [f64; 4] = [1e-3, 1e-4, 1e-5, 1e-6];

/// What [`check_jacobian`] found.
#[derive(Clone, Debug)]
pub struct JacobianCheck {
    /// Entries compared.
    pub entries: usize,
    /// The largest deviation, relative to the entry or to 1e-4 of the largest entry of its row.
    pub largest_deviation: f64,
}

/// How a factor's linearization differs from its residual.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum JacobianError {
    /// Values that do not fit the factor, or a panic in its code.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    /// `linearize` and `residual` disagree about the residual.
    #[error("{factor}: row {row} of the residual is {residual} but linearize wrote {linearized}")]
    Residual {
        /// The factor's name.
        factor: String,
        /// From 0.
        row: usize,
        /// From `residual`.
        residual: f64,
        /// From `linearize`.
        linearized: f64,
    },
    /// An entry is not the derivative of its row.
    #[error(
        "{factor}: block {position} ({kind}), row {row}, column {column} ({component}): \
         the Jacobian has {analytic}, central differences give {numeric}"
    )]
    Entry {
        /// The factor's name.
        factor: String,
        /// Place of the variable among the factor's keys, from 0.
        position: usize,
        /// The variable's type.
        kind: String,
        /// From 0.
        row: usize,
        /// From 0, within the block.
        column: usize,
        /// Name of the tangent component of that column.
        component: String,
        /// From `linearize`.
        analytic: f64,
        /// From central differences.
        numeric: f64,
    },
    /// The gradient is not that of the error.
    #[error(
        "{factor}: component {column} of block {position} of the gradient Jᵀr is {analytic}, \
         central differences of the error give {numeric}"
    )]
    Gradient {
        /// The factor's name.
        factor: String,
        /// Place of the variable among the factor's keys, from 0.
        position: usize,
        /// From 0, within the block.
        column: usize,
        /// From `linearize`.
        analytic: f64,
        /// From central differences.
        numeric: f64,
    },
}

/// Compares the Jacobian blocks of `factor` at `values` with central differences of its residual
/// (five points, right perturbations), to 1e-6 of each entry or of 1e-4 of the largest entry of
/// its row.
///
/// For a factor under a robust kernel check the inner factor, and [`check_gradient`].
///
/// # Errors
/// The first entry that deviates, with its block, row and column.
pub fn check_jacobian(
    factor: &dyn Factor,
    values: &[Value],
) -> Result<JacobianCheck, JacobianError> {
    let linearized = linearized(factor, values)?;
    let rows = linearized.rows();
    // Unlike the residual of the linearization, it shows rows that the factor does not write.
    let mut residual = vec![f64::NAN; rows];
    evaluate(factor, values, &mut residual);
    for (row, (&residual, &other)) in residual.iter().zip(&linearized.residual()).enumerate() {
        if residual.is_nan() || (residual - other).abs() > 1e-12 * (1.0 + residual.abs()) {
            return Err(JacobianError::Residual {
                factor: factor.name(),
                row,
                residual,
                linearized: other,
            });
        }
    }
    let row_sizes: Vec<f64> = (0..rows)
        .map(|row| {
            let blocks = (0..values.len()).map(|position| linearized.jacobian(position));
            blocks.map(|block| block.row(row).amax()).fold(0.0, f64::max)
        })
        .collect();
    let mut check = JacobianCheck { entries: 0, largest_deviation: 0.0 };
    for (position, value) in values.iter().enumerate() {
        for column in 0..value.dim() {
            // The best of the steps for each row.
            let mut best: Vec<(f64, f64)> = vec![(f64::INFINITY, f64::NAN); rows];
            for step in STEPS {
                let numeric =
                    central(step, |step| perturbed(factor, values, position, column, step));
                for row in 0..rows {
                    let analytic = linearized.jacobian(position)[(row, column)];
                    let scale =
                        analytic.abs().max(numeric[row].abs()).max(ROW_FLOOR * row_sizes[row]);
                    let deviation =
                        if scale == 0.0 { 0.0 } else { (analytic - numeric[row]).abs() / scale };
                    if deviation < best[row].0 {
                        best[row] = (deviation, numeric[row]);
                    }
                }
                if best.iter().all(|(deviation, _)| *deviation <= DERIVATIVE) {
                    break;
                }
            }
            for (row, &(deviation, numeric)) in best.iter().enumerate() {
                // NaN never became the best and is infinite here.
                if deviation > DERIVATIVE {
                    return Err(JacobianError::Entry {
                        factor: factor.name(),
                        position,
                        kind: value.kind().name().into(),
                        row,
                        column,
                        component: value.kind().component(column),
                        analytic: linearized.jacobian(position)[(row, column)],
                        numeric,
                    });
                }
                check.entries += 1;
                check.largest_deviation = check.largest_deviation.max(deviation);
            }
        }
    }
    Ok(check)
}

/// [`check_jacobian`] as an assertion.
///
/// # Panics
/// With the message of the [`JacobianError`] and the values.
#[track_caller]
pub fn assert_jacobian(factor: &dyn Factor, values: &[Value]) {
    if let Err(error) = check_jacobian(factor, values) {
        panic!("{error}\nat {values:?}\nof {factor:?}");
    }
}

/// Compares `Jᵀr` of the linearization of `factor` at `values` with central differences of its
/// error: what a factor under a robust kernel has to satisfy.
///
/// # Errors
/// The first component that deviates by more than 1e-6 of the largest.
pub fn check_gradient(factor: &dyn Factor, values: &[Value]) -> Result<(), JacobianError> {
    let linearized = linearized(factor, values)?;
    let gradient = |position: usize, column: usize| -> f64 {
        let residual = linearized.residual();
        (0..linearized.rows())
            .map(|row| linearized.jacobian(position)[(row, column)] * residual[row])
            .sum()
    };
    let all = values.iter().enumerate().flat_map(|(p, v)| (0..v.dim()).map(move |c| (p, c)));
    let largest = all.clone().map(|(p, c)| gradient(p, c).abs()).fold(0.0, f64::max);
    for (position, column) in all {
        let analytic = gradient(position, column);
        let (mut numeric, mut agrees) = (f64::NAN, false);
        for step in STEPS {
            numeric = central(step, |step| {
                vec![factor.error(&perturbed(factor, values, position, column, step))]
            })[0];
            agrees = (analytic - numeric).abs() <= DERIVATIVE * largest;
            if agrees {
                break;
            }
        }
        if !agrees {
            return Err(JacobianError::Gradient {
                factor: factor.name(),
                position,
                column,
                analytic,
                numeric,
            });
        }
    }
    Ok(())
}

fn linearized(factor: &dyn Factor, values: &[Value]) -> Result<LinearizedFactor, EvaluationError> {
    let values: Vec<ValueRef<'_>> = values.iter().map(Value::as_ref).collect();
    linearize_at(factor, &values)
}

fn evaluate(factor: &dyn Factor, values: &[Value], out: &mut [f64]) {
    let storages: Vec<&[f64]> = values.iter().map(Value::storage).collect();
    factor.residual(&Arguments::new(&storages), out);
}

/// The residual with one tangent component of one variable moved.
fn perturbed(
    factor: &dyn Factor,
    values: &[Value],
    position: usize,
    column: usize,
    step: f64,
) -> Vec<f64> {
    let value = &values[position];
    let mut delta = vec![0.0; value.dim()];
    delta[column] = step;
    let mut moved = vec![f64::NAN; value.storage().len()];
    value.kind().retract(value.storage(), &delta, &mut moved);
    let mut storages: Vec<&[f64]> = values.iter().map(Value::storage).collect();
    storages[position] = &moved;
    let mut out = vec![f64::NAN; factor.residual_dim()];
    factor.residual(&Arguments::new(&storages), &mut out);
    out
}
