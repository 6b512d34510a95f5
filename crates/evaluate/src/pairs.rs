//! The kept variables of a reduced graph, in both graphs.

use std::collections::BTreeMap;

use evergraph_model::{Point2, Point3, Pose2, Pose3, ValueRef, Values, VariableId};
use nalgebra::{DMatrix, DMatrixView, DVector, Vector3};

use crate::factorized::Factorized;
use crate::solved::{DivergenceError, Solved};

/// Distances of kept variables from where they were.
pub(crate) struct Shifts {
    pub(crate) degrees_of_freedom: usize,
    pub(crate) mean: f64,
    pub(crate) rms: f64,
    pub(crate) max: f64,
}

/// The kept variables in both graphs.
#[derive(Debug)]
pub(crate) struct Pairs<'a> {
    pub(crate) full: Solved<'a>,
    pub(crate) reduced: Solved<'a>,
    /// From the reduced graph to the full one.
    pub(crate) to_full: BTreeMap<VariableId, VariableId>,
    kept: Vec<VariableId>,
    /// The full graph's optimum, laid out as the reduced graph has it.
    pub(crate) points: Vec<f64>,
    /// `Local(full's optimum, reduced's optimum)`, likewise.
    moved: Vec<f64>,
}

impl<'a> Pairs<'a> {
    pub(crate) fn new(
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

    /// Number of kept variables.
    pub(crate) fn count(&self) -> usize {
        self.kept.len()
    }

    pub(crate) fn is_kept(&self, in_full: VariableId) -> bool {
        self.kept.binary_search(&in_full).is_ok()
    }

    pub(crate) fn points(&self) -> Values {
        Values::from_arena(self.reduced.graph, &self.points)
    }

    pub(crate) fn shifts(&self) -> Result<Shifts, DivergenceError> {
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
    pub(crate) fn sums(&self, all: &Factorized) -> Result<(f64, f64), DivergenceError> {
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

/// The position of a pose or a point; `None` for anything else.
fn position(value: ValueRef<'_>) -> Option<Vector3<f64>> {
    let plane = |x, y| Vector3::new(x, y, 0.0);
    let pose2 = value.get::<Pose2>().map(|it| plane(it.x(), it.y()));
    let pose3 = || value.get::<Pose3>().map(|it| Vector3::new(it.x(), it.y(), it.z()));
    let point2 = || value.get::<Point2>().map(|it| plane(it.x(), it.y()));
    let point3 = || value.get::<Point3>().map(|it| Vector3::new(it.x(), it.y(), it.z()));
    pose2.or_else(pose3).or_else(point2).or_else(point3)
}
