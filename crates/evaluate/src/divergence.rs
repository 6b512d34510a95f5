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

use std::collections::BTreeMap;

use evergraph_model::{
    Graph, GraphError, Point2, Point3, Pose2, Pose3, ValueRef, Values, VariableId,
};
use evergraph_solver::{Relinearization, Settings, SmootherError};
use nalgebra::{DMatrix, DMatrixView, DVector, Vector3};
use serde::Serialize;
use thiserror::Error;

use crate::factorized::Factorized;

/// A graph with its estimates.
#[derive(Clone, Copy, Debug)]
pub struct Solved<'a> {
    /// The graph.
    pub graph: &'a Graph,
    /// A value for every variable.
    pub estimates: &'a Values,
}

/// Why two graphs cannot be compared.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum DivergenceError {
    /// An id that is stale or foreign, or without an estimate.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// There is no variable that both graphs have.
    #[error("the graphs have no variable in common, so nothing can be compared")]
    NothingKept,
    /// A variable of the reduced graph that is paired with none of the full one.
    #[error(
        "variable {variable} of the reduced graph has no counterpart in the full one; a reduced graph \
         has variables of the full graph only"
    )]
    Unpaired {
        /// The variable.
        variable: VariableId,
    },
    /// A variable that is fixed in one of the graphs only.
    #[error(
        "variable {variable} of the full graph is fixed in one of the graphs and free in the other; what is \
         fixed has no covariance to compare. Fix it in both or in none"
    )]
    Fixed {
        /// The variable.
        variable: VariableId,
    },
    /// A variable in two pairs.
    #[error("variable {variable} is paired twice; pair each variable once")]
    Twice {
        /// The variable.
        variable: VariableId,
    },
    /// The two variables of a pair are of different kinds.
    #[error(
        "variable {reduced} is a {reduced_kind} where {full} of the full graph is a {full_kind}; \
         check that both graphs number their variables alike"
    )]
    WrongKind {
        /// In the full graph.
        full: VariableId,
        /// What it is there.
        full_kind: &'static str,
        /// In the reduced graph.
        reduced: VariableId,
        /// What it is there.
        reduced_kind: &'static str,
    },
    /// The full graph's information cannot be factorized at its optimum.
    #[error("the full graph has no covariance: {0}")]
    Full(#[source] SmootherError),
    /// The reduced graph's information cannot be: a direction has become free, and the divergence is
    /// infinite.
    #[error("the reduced graph does not determine what the full graph does: {0}")]
    Reduced(#[source] SmootherError),
    /// The numbers left the range of `f64`.
    #[error(
        "the {quantity} is not finite: weights are too large or too far apart for 64-bit numbers"
    )]
    NotFinite {
        /// Which.
        quantity: &'static str,
    },
}

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
    /// `ln det Λ - ln det Λ_t`: above 0 where the reduced graph is too sure of itself as a whole.
    pub log_det_ratio: f64,
    /// How far kept poses and points moved, on average, metres.
    pub mean_shift_m: f64,
    /// Root mean square of it, metres.
    pub rms_shift_m: f64,
    /// The furthest, metres.
    pub max_shift_m: f64,
}

impl Divergence {
    /// Compares `reduced` with `full`, both at their optima; `kept` pairs variables of the full graph
    /// with those of the reduced graph, all of which are named. `settings` say how to factorize.
    ///
    /// Costs three sparse factorizations and a joint covariance for each factor of the reduced graph.
    ///
    /// # Errors
    /// [`DivergenceError`].
    pub fn of(
        full: Solved<'_>,
        reduced: Solved<'_>,
        kept: &[(VariableId, VariableId)],
        settings: &Settings,
    ) -> Result<Self, DivergenceError> {
        // What is factorized is looked at where it is.
        let settings = settings.with_relinearization(Relinearization::NEVER);
        let pairs = Pairs::new(full, reduced, kept)?;
        let all = Factorized::of(full.graph, full.estimates, |_| true, &settings)
            .map_err(DivergenceError::Full)?;
        let removed =
            Factorized::of(full.graph, full.estimates, |id| !pairs.is_kept(id), &settings)
                .map_err(DivergenceError::Full)?;
        let here = Factorized::of(reduced.graph, &pairs.points(), |_| true, &settings)
            .map_err(DivergenceError::Reduced)?;
        let log_det_ratio = here.smoother.log_det_information()
            - (all.smoother.log_det_information() - removed.smoother.log_det_information());
        drop((removed, here));

        let shifts = pairs.shifts()?;
        let (trace, mean) = pairs.sums(&all)?;
        let n = shifts.degrees_of_freedom;
        let covariance = 0.5 * (trace - n as f64 - log_det_ratio);
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
        Ok(Self {
            variables: kept.len(),
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

    /// What a kept dimension has lost: the covariance's part over n.
    pub fn per_degree_of_freedom(&self) -> f64 {
        self.covariance / self.degrees_of_freedom as f64
    }
}

/// How far kept variables are from where they were.
struct Shifts {
    degrees_of_freedom: usize,
    mean: f64,
    rms: f64,
    max: f64,
}

/// The kept variables in both graphs.
struct Pairs<'a> {
    full: Solved<'a>,
    reduced: Solved<'a>,
    /// From the reduced graph to the full one.
    to_full: BTreeMap<VariableId, VariableId>,
    kept: Vec<VariableId>,
    /// The full graph's optimum, laid out as the reduced graph has it.
    points: Vec<f64>,
    /// `Local(full's optimum, reduced's optimum)`, likewise.
    moved: Vec<f64>,
}

impl<'a> Pairs<'a> {
    fn new(
        full: Solved<'a>,
        reduced: Solved<'a>,
        kept: &[(VariableId, VariableId)],
    ) -> Result<Self, DivergenceError> {
        if kept.is_empty() {
            return Err(DivergenceError::NothingKept);
        }
        let mut pairs = Self {
            full,
            reduced,
            to_full: BTreeMap::new(),
            kept: kept.iter().map(|pair| pair.0).collect(),
            points: vec![0.0; reduced.graph.value_len()],
            moved: vec![0.0; reduced.graph.tangent_len()],
        };
        pairs.kept.sort_unstable();
        if let Some(pair) = pairs.kept.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(DivergenceError::Twice { variable: pair[0] });
        }
        for &(in_full, in_reduced) in kept {
            full.graph.check_variable(in_full)?;
            reduced.graph.check_variable(in_reduced)?;
            if pairs.to_full.insert(in_reduced, in_full).is_some() {
                return Err(DivergenceError::Twice { variable: in_reduced });
            }
            let (was, is) = (full.estimates.value(in_full)?, reduced.estimates.value(in_reduced)?);
            let (index, kind) = (reduced.graph.variable_index(in_reduced)?, was.kind());
            if full.graph.is_fixed(in_full)? != reduced.graph.is_fixed_at(index) {
                return Err(DivergenceError::Fixed { variable: in_full });
            }
            if !std::ptr::eq(kind, reduced.graph.kind_at(index))
                || was.dim() != reduced.graph.dim_at(index)
            {
                return Err(DivergenceError::WrongKind {
                    full: in_full,
                    full_kind: kind.name(),
                    reduced: in_reduced,
                    reduced_kind: reduced.graph.kind_at(index).name(),
                });
            }
            pairs.points[reduced.graph.value_range(index)].copy_from_slice(was.storage());
            let moved = &mut pairs.moved[reduced.graph.tangent_range(index)];
            kind.local(was.storage(), is.storage(), moved);
        }
        match reduced.graph.variables().find(|id| !pairs.to_full.contains_key(id)) {
            Some(variable) => Err(DivergenceError::Unpaired { variable }),
            None => Ok(pairs),
        }
    }

    fn is_kept(&self, in_full: VariableId) -> bool {
        self.kept.binary_search(&in_full).is_ok()
    }

    fn points(&self) -> Values {
        Values::from_arena(self.reduced.graph, &self.points)
    }

    fn shifts(&self) -> Result<Shifts, DivergenceError> {
        let (mut count, mut sum, mut squares, mut max) = (0_usize, 0.0, 0.0, 0.0_f64);
        for (&in_reduced, &in_full) in &self.to_full {
            let was = position(self.full.estimates.value(in_full)?);
            let is = position(self.reduced.estimates.value(in_reduced)?);
            if let (Some(was), Some(is)) = (was, is) {
                let shift = (is - was).norm();
                count += 1;
                sum += shift;
                squares += shift * shift;
                // Unlike `max`, this keeps a NaN.
                max = if shift <= max { max } else { shift };
            }
        }
        let count = count.max(1) as f64;
        let degrees_of_freedom = self.reduced.graph.dim();
        Ok(Shifts { degrees_of_freedom, mean: sum / count, rms: (squares / count).sqrt(), max })
    }

    /// `tr(Λ P)` and `dᵀ Λ d`.
    fn sums(&self, all: &Factorized) -> Result<(f64, f64), DivergenceError> {
        let graph = self.reduced.graph;
        let mut covariances = all.smoother.covariances();
        let (mut trace, mut mean) = (0.0, 0.0);
        for f in graph.factor_indices() {
            let mut block = vec![0.0; graph.linearization_len(f)];
            graph.linearize(f, &self.points, &mut block)?;
            let rows = graph.rows_at(f);
            let jacobian = &block[..block.len() - rows];
            let jacobian = DMatrixView::from_slice(jacobian, rows, jacobian.len() / rows.max(1));
            let mut ids = Vec::new();
            let mut moved = Vec::new();
            for &index in graph.unknowns_at(f) {
                let variable = graph.variable_id(index);
                let in_full = self.to_full.get(&variable).and_then(|id| all.variable(*id));
                ids.push(in_full.ok_or(DivergenceError::Unpaired { variable })?);
                moved.extend_from_slice(&self.moved[graph.tangent_range(index)]);
            }
            let sigma = covariances.joint(&ids).map_err(DivergenceError::Full)?;
            trace += traced(&jacobian, &sigma);
            mean += (jacobian * DVector::from_vec(moved)).norm_squared();
        }
        Ok((trace, mean))
    }
}

/// `tr(J Σ Jᵀ)`.
fn traced(jacobian: &DMatrixView<'_, f64>, sigma: &DMatrix<f64>) -> f64 {
    (jacobian * sigma).iter().zip(jacobian.iter()).map(|(a, b)| a * b).sum()
}

/// Where a variable is, if it is anywhere: poses and points are.
fn position(value: ValueRef<'_>) -> Option<Vector3<f64>> {
    let plane = |x, y| Vector3::new(x, y, 0.0);
    let pose2 = value.get::<Pose2>().map(|it| plane(it.x(), it.y()));
    let pose3 = || value.get::<Pose3>().map(|it| Vector3::new(it.x(), it.y(), it.z()));
    let point2 = || value.get::<Point2>().map(|it| plane(it.x(), it.y()));
    let point3 = || value.get::<Point3>().map(|it| Vector3::new(it.x(), it.y(), it.z()));
    pose2.or_else(pose3).or_else(point2).or_else(point3)
}
