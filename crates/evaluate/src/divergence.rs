//! What a reduced graph has lost of the full one.
//!
//! The full graph says of the kept variables what is left of it when the others are marginalized
//! out: at its optimum a Gaussian of covariance `P` and information `Λ_t = P⁻¹`. A reduced graph,
//! whoever made it, says something else, `Λ` at the same point, and has its optimum elsewhere, by `d`.
//! Over n kept dimensions the Kullback-Leibler divergence `D(full ‖ reduced)` is, in nats,
//!
//! ```text
//! D = ½ (tr(Λ P) - n - ln det Λ + ln det Λ_t)  +  ½ dᵀ Λ d
//!              of the covariance                 of the mean
//! ```
//!
//! (equation 14 of Kretzschmar, Stachniss and Grisetti, "Efficient information-theoretic graph pruning
//! for graph-based SLAM with laser range finders", IROS 2011, for Gaussians).
//! Nothing dense is formed:
//!
//! - `tr(Λ P) = Σ tr(J_f P_ff J_fᵀ)` over the reduced graph's factors, each with the joint covariance
//!   of its own variables in the full graph.
//! - `ln det Λ_t = ln det Λ_full - ln det Λ_rr`, the Schur complement's determinant, `Λ_rr` being the
//!   information of the removed variables with the kept ones held.
//! - `dᵀ Λ d = Σ ‖J_f d_f‖²`.
//!
//! Everything is Gauss-Newton at the full graph's optimum, with the weights that robust kernels have
//! there. What anchors the graphs (a gauge prior) has to be in both.

use evergraph_model::VariableId;
use evergraph_solver::Settings;
use serde::Serialize;

use crate::comparison::Comparison;
use crate::factorized::Factorized;
use crate::solved::{DivergenceError, Solved};

/// What a reduced graph has lost, in nats, and by how much it moved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Divergence {
    /// Kept variables.
    pub variables: usize,
    /// Their dimensions, n.
    pub degrees_of_freedom: usize,
    /// Divergence of the covariance: 0 where nothing was lost, but for rounding, which can make it
    /// negative.
    pub covariance: f64,
    /// Divergence of the mean.
    pub mean: f64,
    /// Both together.
    pub total: f64,
    /// `ln det Λ_t - ln det Λ`, the logarithm of the ratio of the determinants of the covariances: positive where the
    /// reduced graph knows less as a whole (conservative), negative where it claims more.
    pub log_det_ratio: f64,
    /// How far kept poses and points moved, on average, metres.
    pub mean_shift_m: f64,
    /// Root mean square of it, metres.
    pub rms_shift_m: f64,
    /// The furthest, metres.
    pub max_shift_m: f64,
}

impl Divergence {
    /// The divergence of `reduced` from `full`: see [`Comparison::new`] and [`Comparison::divergence`].
    ///
    /// # Errors
    /// [`DivergenceError`].
    pub fn of(
        full: Solved<'_>,
        reduced: Solved<'_>,
        kept: &[(VariableId, VariableId)],
        settings: &Settings,
    ) -> Result<Self, DivergenceError> {
        Comparison::new(full, reduced, kept, settings)?.divergence()
    }

    /// The loss of a kept dimension: the covariance's part over n.
    pub fn per_degree_of_freedom(&self) -> f64 {
        self.covariance / self.degrees_of_freedom as f64
    }
}

impl Comparison<'_> {
    /// The divergence of the reduced graph from the full one.
    ///
    /// Costs a sparse factorization over the removed variables, and a joint covariance for each factor of the reduced
    /// graph.
    ///
    /// # Errors
    /// [`DivergenceError`].
    pub fn divergence(&self) -> Result<Divergence, DivergenceError> {
        let full = self.pairs.full;
        let is_removed = |id| !self.pairs.is_kept(id);
        let removed = Factorized::of(full.graph, full.estimates, is_removed, &self.settings)
            .map_err(DivergenceError::Full)?;
        let log_det_ratio = self.all.smoother.log_det_information()
            - removed.smoother.log_det_information()
            - self.here.smoother.log_det_information();

        let shifts = self.pairs.shifts()?;
        let (trace, mean) = self.pairs.sums(&self.all)?;
        let n = shifts.degrees_of_freedom;
        let covariance = 0.5 * (trace - n as f64 + log_det_ratio);
        let mean = 0.5 * mean;
        for (quantity, x) in [
            ("divergence of the covariance", covariance),
            ("divergence of the mean", mean),
            ("shift", shifts.max),
        ] {
            if !x.is_finite() {
                return Err(DivergenceError::NotFinite { quantity });
            }
        }
        Ok(Divergence {
            variables: self.pairs.count(),
            degrees_of_freedom: n,
            covariance,
            mean,
            total: covariance + mean,
            log_det_ratio,
            mean_shift_m: shifts.mean,
            rms_shift_m: shifts.rms,
            max_shift_m: shifts.max,
        })
    }
}
