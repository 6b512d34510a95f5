//! What a removal reads: the Markov blanket of the removed nodes and the factors inside it.

use evergraph_model::{Factor, ValueRef, VariableId, linearize_at};
use nalgebra::DMatrix;
use smallvec::SmallVec;

use crate::error::RemovalError;
use crate::member::Member;
use crate::options::Options;
use crate::overlay::{Overlay, Source};

/// A factor of the linear model at the estimate: the rows `[J₁ … Jₖ | b]` with `b = -(r + Jδ)`.
#[derive(Clone, Debug)]
pub(crate) struct Read {
    pub(crate) source: Source,
    /// Places of its variables among the members.
    pub(crate) members: SmallVec<[usize; 4]>,
    pub(crate) rows: DMatrix<f64>,
    /// Its term of the objective.
    pub(crate) error: f64,
    /// What a robust kernel leaves of its information; 1 without one.
    pub(crate) weight: f64,
}

/// Weights are quotients of two sums of squares, so that a factor without a kernel may come out
/// just below 1.
const WEIGHT_ROUNDING: f64 = 1e-9;

impl Read {
    /// Whether its weight is below the least that is absorbed.
    fn is_light(&self, options: &Options) -> bool {
        self.weight < options.least_weight * (1.0 - WEIGHT_ROUNDING)
    }
}

/// `X_m` and `Z_m` of the paper (section II-A): the removed nodes, their blanket, and the factors
/// that are on those variables only.
#[derive(Clone, Debug)]
pub(crate) struct Neighborhood {
    /// The removed nodes first, then the blanket by id.
    pub(crate) members: Vec<Member>,
    /// How many of them are removed.
    pub(crate) removed: usize,
    /// `Z_m`, less what is rejected.
    pub(crate) factors: Vec<Read>,
    /// Factors on the nodes whose robust weight is too low to be absorbed.
    pub(crate) rejected: Vec<Read>,
}

impl Neighborhood {
    /// Reads the neighborhood of `removed`, which are connected to each other or a single node.
    ///
    /// O(size of the neighborhood, and the number of factors on its variables).
    pub(crate) fn of(
        overlay: &Overlay<'_>,
        removed: &[VariableId],
        options: &Options,
        intra_clique: bool,
    ) -> Result<Self, RemovalError> {
        for &variable in removed {
            overlay.check(variable)?;
        }
        let blanket = blanket(overlay, removed);
        let Some(&first) = removed.first() else { return Err(RemovalError::Nothing) };
        // Earlier steps may have found that nothing is known between it and the rest.
        if blanket.is_empty() && !overlay.leads_to_kept(removed) {
            return Err(RemovalError::NoBlanket { variable: first });
        }
        overlay.check_last_pose(removed, &blanket)?;
        let dim = blanket.iter().map(|id| overlay.graph.dim_at(id.index())).sum();
        if dim > options.largest_blanket {
            let largest = options.largest_blanket;
            return Err(RemovalError::LargeBlanket { variable: first, dim, largest });
        }
        let ids = [removed, blanket.as_slice()].concat();
        let members = overlay.members(&ids, options.linear_within)?;
        let mut neighborhood =
            Self { members, removed: removed.len(), factors: Vec::new(), rejected: Vec::new() };
        let places = Places::new(removed, &blanket);
        for &id in removed {
            for (source, factor) in overlay.factors_of(id) {
                // Every removed variable of the factor comes by; the first one takes it.
                let first = factor.keys().iter().filter_map(|&key| places.removed(key)).min();
                if first == places.removed(id) {
                    let read = neighborhood.read(source, factor, &places)?;
                    if read.is_light(options) {
                        neighborhood.rejected.push(read);
                    } else {
                        neighborhood.factors.push(read);
                    }
                }
            }
        }
        if intra_clique {
            for &id in &blanket {
                for (source, factor) in overlay.factors_of(id) {
                    let inside = factor.keys().first() == Some(&id)
                        && !overlay.is_spared(source)
                        && factor.keys().iter().all(|&key| places.blanket(key).is_some());
                    if inside {
                        let read = neighborhood.read(source, factor, &places)?;
                        if !read.is_light(options) {
                            neighborhood.factors.push(read);
                        }
                    }
                }
            }
        }
        Ok(neighborhood)
    }

    /// Linearizes a factor on members that is not in the graph.
    pub(crate) fn read_new(&self, factor: &dyn Factor) -> Result<Read, RemovalError> {
        let ids: Vec<VariableId> = self.members.iter().map(|m| m.id).collect();
        let (removed, blanket) = ids.split_at(self.removed);
        self.read(Source::Planned(0), factor, &Places::new(removed, blanket))
    }

    /// Linearizes a factor. A robust factor writes rows scaled by the root of its weight, so the
    /// weight is frozen by taking them as they are.
    fn read(
        &self,
        from: Source,
        factor: &dyn Factor,
        places: &Places<'_>,
    ) -> Result<Read, RemovalError> {
        let non_finite = || RemovalError::NonFiniteFactor {
            factor: from.to_string(),
            name: factor.name(),
            variables: factor.keys().to_vec(),
        };
        let members: SmallVec<[usize; 4]> =
            factor.keys().iter().filter_map(|&key| places.of(key)).collect();
        let values: SmallVec<[ValueRef<'_>; 4]> =
            members.iter().map(|&m| self.members[m].value.as_ref()).collect();
        let linearized = linearize_at(factor, &values)
            .map_err(|source| RemovalError::Factor { factor: from.to_string(), source })?;
        let mut error = linearized.error();
        let norm: f64 = linearized.unweighted_residual().iter().map(|r| r * r).sum();
        let (count, width) = (linearized.rows(), linearized.columns()[members.len()] as usize);
        let mut rows = DMatrix::from_vec(count, width + 1, linearized.into_data());
        rows.column_mut(width).neg_mut();
        let is_finite = |rows: &DMatrix<f64>, error: f64| {
            error.is_finite() && rows.iter().all(|x| x.is_finite())
        };
        if !is_finite(&rows, error) {
            return Err(non_finite());
        }
        let weighted = rows.column(width).norm_squared();
        let weight = if norm.is_normal() { weighted / norm } else { 1.0 };
        if members.iter().any(|&m| self.members[m].is_off()) {
            self.carry_to_estimate(&members, &mut rows);
            error += 0.5 * (rows.column(width).norm_squared() - weighted);
            if !is_finite(&rows, error) {
                return Err(non_finite());
            }
        }
        Ok(Read { source: from, members, rows, error, weight })
    }

    /// From where the members are seen to the estimate: `b - Jδ`.
    fn carry_to_estimate(&self, members: &[usize], rows: &mut DMatrix<f64>) {
        let (jacobian, mut b) = rows.columns_range_pair_mut(0..rows.ncols() - 1, rows.ncols() - 1);
        let mut column = 0;
        for &m in members {
            let delta = &self.members[m].delta;
            b.gemv(-1.0, &jacobian.columns(column, delta.len()), delta, 1.0);
            column += delta.len();
        }
    }
}

/// The variables that share a factor with the removed ones, by id: the Markov blanket.
pub(crate) fn blanket(overlay: &Overlay<'_>, removed: &[VariableId]) -> Vec<VariableId> {
    let mut sorted = removed.to_vec();
    sorted.sort_unstable();
    let mut found: Vec<VariableId> = removed
        .iter()
        .flat_map(|&id| overlay.factors_of(id))
        .flat_map(|(_, factor)| factor.keys().iter().copied())
        .filter(|key| sorted.binary_search(key).is_err())
        .collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// Where each variable stands among the members.
struct Places<'a> {
    /// Removed variables by id, with their places.
    removed: Vec<(VariableId, usize)>,
    blanket: &'a [VariableId],
}

impl<'a> Places<'a> {
    fn new(removed: &[VariableId], blanket: &'a [VariableId]) -> Self {
        let mut removed: Vec<_> = removed.iter().enumerate().map(|(k, &id)| (id, k)).collect();
        removed.sort_unstable();
        Self { removed, blanket }
    }

    fn removed(&self, id: VariableId) -> Option<usize> {
        let found = self.removed.binary_search_by_key(&id, |entry| entry.0).ok();
        found.map(|k| self.removed[k].1)
    }

    fn blanket(&self, id: VariableId) -> Option<usize> {
        self.blanket.binary_search(&id).ok().map(|k| self.removed.len() + k)
    }

    fn of(&self, id: VariableId) -> Option<usize> {
        self.removed(id).or_else(|| self.blanket(id))
    }
}
