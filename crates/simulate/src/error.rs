//! Parameters that describe no world.

use evergraph_formats::FormatError;

/// Why a world cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WorldError {
    /// A measurement needs two poses.
    #[error("{poses} poses hold no measurement: a world needs at least 2")]
    TooFewPoses {
        /// How many were asked for.
        poses: u32,
    },
    /// A length, a density or a count below what has a meaning.
    #[error("`{parameter}` is {value}: it must be finite and at least {least}")]
    TooSmall {
        /// The field.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// The smallest value that it may have.
        least: f64,
    },
    /// A length or an angle that must be positive.
    #[error("`{parameter}` is {value}: it must be finite and positive")]
    NotPositive {
        /// The field.
        parameter: &'static str,
        /// Its value.
        value: f64,
    },
    /// A probability outside of 0 to 1.
    #[error("`{parameter}` is {value}: a probability lies between 0 and 1")]
    NotAProbability {
        /// The field.
        parameter: &'static str,
        /// Its value.
        value: f64,
    },
    /// A standard deviation whose information `1/σ²` is no positive finite number.
    #[error(
        "`{parameter}[{component}]` is {value}: a standard deviation is positive, and 1/sigma^2 finite"
    )]
    BadSigma {
        /// The field.
        parameter: &'static str,
        /// Which tangent component.
        component: usize,
        /// Its value.
        value: f64,
    },
    /// More landmarks than ids of 32 bits.
    #[error("{count} landmarks are more than {limit}: lower `landmarks.density` or the size")]
    TooManyLandmarks {
        /// How many the density asks for.
        count: f64,
        /// How many there may be.
        limit: u32,
    },
    /// The parameters are each in range, and yet the numbers of the world leave that of `f64`.
    #[error("the world cannot be written down: its lengths or deviations are too extreme")]
    Unwritable(#[from] FormatError),
}

pub(crate) fn check_poses(poses: u32) -> Result<(), WorldError> {
    if poses < 2 { Err(WorldError::TooFewPoses { poses }) } else { Ok(()) }
}

pub(crate) fn check_at_least(
    parameter: &'static str,
    value: f64,
    least: f64,
) -> Result<(), WorldError> {
    if value.is_finite() && value >= least {
        Ok(())
    } else {
        Err(WorldError::TooSmall { parameter, value, least })
    }
}

pub(crate) fn check_positive(parameter: &'static str, value: f64) -> Result<(), WorldError> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(WorldError::NotPositive { parameter, value })
    }
}

pub(crate) fn check_probability(parameter: &'static str, value: f64) -> Result<(), WorldError> {
    if (0.0..=1.0).contains(&value) {
        Ok(())
    } else {
        Err(WorldError::NotAProbability { parameter, value })
    }
}

pub(crate) fn check_sigmas(parameter: &'static str, sigmas: &[f64]) -> Result<(), WorldError> {
    for (component, &value) in sigmas.iter().enumerate() {
        let information = 1.0 / (value * value);
        if !(value > 0.0 && information.is_finite() && information > 0.0) {
            return Err(WorldError::BadSigma { parameter, component, value });
        }
    }
    Ok(())
}
