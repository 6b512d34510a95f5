//! The optimum, as far as rounding lets it be told.

use crate::batch::{BatchReport, BatchSettings, Method, Status};
use crate::error::SmootherError;
use crate::smoother::Smoother;

/// Linearizations after which the dogleg method goes on. Where residuals are large, as beside false loop
/// closures, it takes fewer: 96 of Bovisa04_odometry from the file's vertices, where damped steps took 447.
/// But only damping carries over singular points, as there may be near the start.
const DAMPED: u32 = 100;
/// Linearizations after that.
const DOGLEG: u32 = 1000;

/// Optimizes until no step lowers the error by more than rounding, so that what moved is told from where
/// an optimization stopped: the usual 1e-11 of the error can be 1e-4 m of something that is known to a
/// metre. As [`damped_then_dogleg`].
///
/// # Errors
/// [`SmootherError`] as [`Smoother::optimize`]; everything is then what it was before.
pub fn optimize_to_the_end(smoother: &mut Smoother) -> Result<BatchReport, SmootherError> {
    damped_then_dogleg(smoother, 0.0)
}

/// Optimizes by Levenberg-Marquardt, and where that has not converged after 100 linearizations by dogleg, until
/// a step lowers the error by no more than `relative_decrease` of it ([`BatchSettings::relative_decrease`]).
///
/// The report is of both together.
///
/// # Errors
/// [`SmootherError`] as [`Smoother::optimize`]; everything is then what it was before.
pub fn damped_then_dogleg(
    smoother: &mut Smoother,
    relative_decrease: f64,
) -> Result<BatchReport, SmootherError> {
    let damped =
        BatchSettings { relative_decrease, max_iterations: DAMPED, ..BatchSettings::default() };
    let first = smoother.optimize(&damped)?;
    if first.status == Status::Converged {
        return Ok(first);
    }
    let dogleg = BatchSettings { method: Method::Dogleg, max_iterations: DOGLEG, ..damped };
    let second = match smoother.optimize(&dogleg) {
        Ok(second) => second,
        // Where the other method has stopped is a result all the same.
        Err(SmootherError::Singular(_) | SmootherError::NonFinite { .. }) => return Ok(first),
        Err(error) => return Err(error),
    };
    let iterations = first.iterations + second.iterations;
    Ok(BatchReport { initial_error: first.initial_error, iterations, ..second })
}
