//! Choices made once, when a [`crate::Smoother`] is built.

use std::num::NonZeroU32;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How the frontal variables of a clique are eliminated. Both give the same R up to signs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Elimination {
    /// Normal equations per clique. Faster, most of all in 3D; where a pivot has lost its digits,
    /// that subtree is eliminated again by QR.
    #[default]
    Cholesky,
    /// Householder on factor rows, for ill-conditioned graphs.
    Qr,
}

/// Look, every `every` changes, whether an estimate lies further than `threshold` from its
/// linearization point, and relinearize.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct Fluid {
    /// Largest component of δ that is tolerated (m and rad alike). Smaller is more exact and
    /// slower.
    pub threshold: f64,
    /// When one is beyond the threshold, all variables beyond this share of it move with it, so that
    /// they do not follow a few at a time, each time with all that is above them. Between 0 and 1.
    pub share: f64,
    /// Number of changes between checks.
    pub every: NonZeroU32,
}

/// When linearization points move to the estimate: a policy, as data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Relinearization {
    /// The frequent check for what has moved far.
    pub fluid: Option<Fluid>,
    /// The rare check for what has moved at all. After few changes it comes more often: after a
    /// tenth of them, but at least 10.
    pub sweep: Option<Fluid>,
    /// Over how many changes the work of relinearizing what a sweep found is spread, unless it is
    /// next to nothing; 1 does it all in the change that finds it. The estimate is that of the old
    /// linearization points until all is done. Variables beyond twice the threshold of the frequent check
    /// are relinearized at once, whatever this says.
    pub spread: NonZeroU32,
    /// Every so many changes all variables are relinearized and solved until convergence. Exact,
    /// and the slowest step by far; iSAM uses 100, the GLC paper 50.
    pub batch: Option<NonZeroU32>,
    /// The batch step is made on another thread, from a snapshot, and taken over so many changes
    /// later, the changes since applied to it. When the thread is late that step waits, so that
    /// results do not depend on timing. None: within the step. Needs `batch`.
    pub background: Option<NonZeroU32>,
}

const fn interval(n: u32) -> NonZeroU32 {
    match NonZeroU32::new(n) {
        Some(n) => n,
        None => panic!("intervals are at least 1"),
    }
}

impl Fluid {
    /// A check for variables beyond `threshold`, every `every` changes, that moves those beyond
    /// `share` of it.
    #[must_use]
    pub const fn new(threshold: f64, share: f64, every: NonZeroU32) -> Self {
        Self { threshold, share, every }
    }

    /// Sets [`threshold`](Self::threshold).
    #[must_use]
    pub const fn with_threshold(mut self, threshold: f64) -> Self {
        self.threshold = threshold;
        self
    }

    /// Sets [`share`](Self::share).
    #[must_use]
    pub const fn with_share(mut self, share: f64) -> Self {
        self.share = share;
        self
    }

    /// Sets [`every`](Self::every).
    #[must_use]
    pub const fn with_every(mut self, every: NonZeroU32) -> Self {
        self.every = every;
        self
    }

    /// Variables beyond this are relinearized when one is beyond the threshold.
    pub(crate) fn reach(&self) -> f64 {
        self.share * self.threshold
    }

    fn check(&self, threshold: &'static str, share: &'static str) -> Result<(), SettingsError> {
        non_negative(threshold, self.threshold)?;
        if (0.0..=1.0).contains(&self.share) {
            return Ok(());
        }
        let value = self.share.to_string();
        Err(SettingsError { field: share, value, must: "between 0 and 1" })
    }
}

impl Relinearization {
    /// Every 10 changes all variables beyond 0.09 if one is beyond 0.25, at once if one is beyond 0.5, and every 100 a
    /// sweep of those beyond 0.02, spread over 10. The default.
    pub const BOTH: Self = Self {
        fluid: Some(Fluid { threshold: 0.25, share: 0.36, every: interval(10) }),
        sweep: Some(Fluid { threshold: 0.02, share: 1.0, every: interval(100) }),
        spread: interval(10),
        batch: None,
        background: None,
    };
    /// Only the frequent check of [`BOTH`](Self::BOTH).
    pub const FLUID: Self = Self { sweep: None, ..Self::BOTH };
    /// A batch step to convergence every 50 changes, in the background, taken over 25 changes
    /// later. Wants a second core.
    pub const BACKGROUND: Self =
        Self { batch: Some(interval(50)), background: Some(interval(25)), ..Self::NEVER };
    /// Linearization points stay at the initial values.
    pub const NEVER: Self = Self { fluid: None, ..Self::FLUID };

    /// Only a batch step to convergence every `n` changes.
    #[must_use]
    pub const fn every(n: NonZeroU32) -> Self {
        Self { batch: Some(n), ..Self::NEVER }
    }

    /// With another frequent check, or none.
    #[must_use]
    pub const fn with_fluid(mut self, fluid: Option<Fluid>) -> Self {
        self.fluid = fluid;
        self
    }

    /// With another rare check, or none.
    #[must_use]
    pub const fn with_sweep(mut self, sweep: Option<Fluid>) -> Self {
        self.sweep = sweep;
        self
    }

    /// With the work of a check spread over so many changes.
    #[must_use]
    pub const fn with_spread(mut self, spread: NonZeroU32) -> Self {
        self.spread = spread;
        self
    }

    /// With a batch step every so many changes, or none.
    #[must_use]
    pub const fn with_batch(mut self, batch: Option<NonZeroU32>) -> Self {
        self.batch = batch;
        self
    }

    /// With the batch step in the background, taken over so many changes later, or not.
    #[must_use]
    pub const fn with_background(mut self, background: Option<NonZeroU32>) -> Self {
        self.background = background;
        self
    }
}

impl Default for Relinearization {
    fn default() -> Self {
        Self::BOTH
    }
}

/// The settings of a smoother.
///
/// Built from the defaults by assigning fields, or in a chain:
///
/// ```
/// use evergraph_solver::{Elimination, Settings};
///
/// let settings = Settings::default().with_elimination(Elimination::Qr).with_threads(2);
/// assert!(settings.check().is_ok());
/// ```
///
/// As data it may be partial; unknown fields are errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Settings {
    /// How cliques are eliminated. Default: Cholesky.
    pub elimination: Elimination,
    /// When linearization points move. Default: [`Relinearization::BOTH`].
    pub relinearization: Relinearization,
    /// Between updates δ is only propagated down the tree where it moved by more than this (m and
    /// rad); between sweeps by more than 0.4 of the check's threshold, so that a check sees roughly
    /// what has moved, and a sweep exactly. It decides what a relinearization check sees; estimates that are asked for are exact, or
    /// to within what [`Smoother::cached_estimates`](crate::Smoother::cached_estimates) is given.
    /// Default 1e-3.
    pub back_substitution_tolerance: f64,
    /// Threads for elimination; 1 never starts another. Results do not depend on it. Default 1.
    pub threads: usize,
    /// Most scalars of a clique (frontals and separator) that an update may eliminate; a larger one is
    /// refused with [`SmootherError::LargeClique`](crate::SmootherError::LargeClique). A clique of n scalars
    /// takes n² numbers and at most n³/3 multiplications in each update that touches it: with 2000, 32 MB and
    /// 0.4 s. Loop closures between random places make such cliques. Batch optimizations are not
    /// bounded. Default: no bound.
    pub largest_clique: Option<usize>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            elimination: Elimination::default(),
            relinearization: Relinearization::default(),
            back_substitution_tolerance: 1e-3,
            threads: 1,
            largest_clique: None,
        }
    }
}

/// A setting that cannot be.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("setting {field} is {value}, but must be {must}")]
#[non_exhaustive]
pub struct SettingsError {
    /// The field's path.
    pub field: &'static str,
    /// What was given.
    pub value: String,
    /// What is allowed.
    pub must: &'static str,
}

impl Settings {
    /// With another way to eliminate cliques.
    #[must_use]
    pub const fn with_elimination(mut self, elimination: Elimination) -> Self {
        self.elimination = elimination;
        self
    }

    /// With another policy for linearization points.
    #[must_use]
    pub const fn with_relinearization(mut self, relinearization: Relinearization) -> Self {
        self.relinearization = relinearization;
        self
    }

    /// With another [tolerance](Self::back_substitution_tolerance) (m and rad).
    #[must_use]
    pub const fn with_back_substitution_tolerance(mut self, tolerance: f64) -> Self {
        self.back_substitution_tolerance = tolerance;
        self
    }

    /// With so many threads for elimination.
    #[must_use]
    pub const fn with_threads(mut self, threads: usize) -> Self {
        self.threads = threads;
        self
    }

    /// With a bound on the [scalars of a clique](Self::largest_clique).
    #[must_use]
    pub const fn with_largest_clique(mut self, scalars: Option<usize>) -> Self {
        self.largest_clique = scalars;
        self
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`SettingsError`] names the first field that is out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        non_negative("back_substitution_tolerance", self.back_substitution_tolerance)?;
        if let Some(fluid) = self.relinearization.fluid {
            fluid.check("relinearization.fluid.threshold", "relinearization.fluid.share")?;
        }
        if let Some(sweep) = self.relinearization.sweep {
            sweep.check("relinearization.sweep.threshold", "relinearization.sweep.share")?;
        }
        if self.relinearization.background.is_some() && self.relinearization.batch.is_none() {
            return Err(SettingsError {
                field: "relinearization.background",
                value: "set".into(),
                must: "unset, or used with `batch`, which says how often there is a batch step",
            });
        }
        if self.largest_clique == Some(0) {
            return Err(SettingsError {
                field: "largest_clique",
                value: "0".into(),
                must: "positive, or none",
            });
        }
        if self.threads == 0 || self.threads > 1024 {
            return Err(SettingsError {
                field: "threads",
                value: self.threads.to_string(),
                must: "between 1 and 1024",
            });
        }
        Ok(())
    }
}

fn non_negative(field: &'static str, value: f64) -> Result<(), SettingsError> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    let value = value.to_string();
    Err(SettingsError { field, value, must: "a finite number, at least 0" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_from_partial_data() {
        let read = |text| serde_json::from_str::<Settings>(text);
        assert_eq!(read("{}").unwrap(), Settings::default());
        let some = r#"{"threads": 2, "relinearization": {"sweep": null}}"#;
        let expected =
            Settings::default().with_threads(2).with_relinearization(Relinearization::FLUID);
        assert_eq!(read(some).unwrap(), expected);
        for typo in [r#"{"thread": 2}"#, r#"{"relinearization": {"sweeps": null}}"#] {
            assert!(read(typo).unwrap_err().to_string().contains("unknown field"), "{typo}");
        }
    }

    #[test]
    fn bad_settings_are_named() {
        assert!(Settings::default().check().is_ok());
        let nan = Settings { back_substitution_tolerance: f64::NAN, ..Settings::default() };
        assert_eq!(nan.check().unwrap_err().field, "back_substitution_tolerance");
        let none = Settings { threads: 0, ..Settings::default() };
        assert!(none.check().unwrap_err().to_string().contains("threads is 0"));
        let mut idle = Settings::default();
        idle.relinearization.background = Some(interval(5));
        assert_eq!(idle.check().unwrap_err().field, "relinearization.background");
        let mut negative = Settings::default();
        negative.relinearization.fluid =
            Some(Fluid { threshold: -1.0, share: 1.0, every: interval(1) });
        assert_eq!(negative.check().unwrap_err().field, "relinearization.fluid.threshold");
        let mut wide = Settings::default();
        wide.relinearization.sweep =
            Some(Fluid { threshold: 1.0, share: f64::NAN, every: interval(1) });
        assert_eq!(wide.check().unwrap_err().field, "relinearization.sweep.share");
    }
}
