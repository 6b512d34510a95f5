//! Batch optimization as data: the method, when to stop, and the outcome.

use serde::{Deserialize, Serialize};

/// How steps are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Method {
    /// Undamped steps; stops, honestly, when one would raise the error.
    GaussNewton,
    /// Adds `λ diag(JᵀJ)` to the information matrix (Marquardt's scaling, so that units do not
    /// matter). Starts undamped: λ appears only when a step fails.
    #[default]
    LevenbergMarquardt,
    /// Steps between steepest descent and Gauss-Newton within a trust region, measured in the
    /// norm of `diag(JᵀJ)`; one factorization per accepted step.
    Dogleg,
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct BatchSettings {
    /// How steps are chosen.
    pub method: Method,
    /// Most linearizations. Default 100.
    pub max_iterations: u32,
    /// Converged when a step lowers, or the linear model promises to lower, the error by less than
    /// this share of it or by nothing beyond rounding, or the step is lost in the rounding of what it
    /// moves, or (but for dogleg) it raises the error by rounding. Default 1e-11.
    pub relative_decrease: f64,
}

impl Default for BatchSettings {
    fn default() -> Self {
        Self { method: Method::default(), max_iterations: 100, relative_decrease: 1e-11 }
    }
}

impl BatchSettings {
    /// With another method.
    #[must_use]
    pub const fn with_method(mut self, method: Method) -> Self {
        self.method = method;
        self
    }

    /// With at most so many linearizations.
    #[must_use]
    pub const fn with_max_iterations(mut self, max_iterations: u32) -> Self {
        self.max_iterations = max_iterations;
        self
    }

    /// With another [share](Self::relative_decrease) of the error as the end.
    #[must_use]
    pub const fn with_relative_decrease(mut self, relative_decrease: f64) -> Self {
        self.relative_decrease = relative_decrease;
        self
    }

    /// For the batch steps within a replay: to convergence as far as the next measurement can
    /// tell.
    pub(crate) fn periodic() -> Self {
        Self { max_iterations: 25, relative_decrease: 1e-7, ..Self::default() }
    }
}

/// How a batch optimization ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "status", content = "why")]
#[non_exhaustive]
pub enum Status {
    /// No step lowers the error any more.
    Converged,
    /// It stopped before that.
    NotConverged(Reason),
}

/// Why an optimization stopped before it converged. The estimate is the best point found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Reason {
    /// `max_iterations` were used up.
    IterationLimit,
    /// The Gauss-Newton step raises the error: start closer, or use another method.
    ErrorWouldRise,
    /// No damping or trust region, however small the step, lowered the error.
    NoDescent,
}

/// What a batch optimization did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BatchReport {
    /// How it ended.
    #[serde(flatten)]
    pub status: Status,
    /// Linearizations (accepted steps).
    pub iterations: u32,
    /// Objective at the start.
    pub initial_error: f64,
    /// Objective at the end; never above the start.
    pub error: f64,
    /// Largest component of `Jᵀr` at the end.
    pub gradient_norm: f64,
}
