//! What a removal reads: the Markov blanket of the removed nodes and the factors inside it.

use std::collections::{BTreeMap, BTreeSet};

use evergraph_model::{Factor, LinearizedFactor, ValueRef, VariableId, linearize_at};
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
/// that are on those variables only. Fixed variables are given: factors may be on them too, and their columns are left
/// out.
#[derive(Clone, Debug)]
pub(crate) struct Neighborhood {
    /// The removed nodes first, then the blanket by slot.
    pub(crate) members: Vec<Member>,
    /// How many of them are removed.
    pub(crate) removed: usize,
    /// The fixed variables of the factors, by slot.
    pub(crate) fixed: Vec<Member>,
    /// `Z_m`, less what is rejected.
    pub(crate) factors: Vec<Read>,
    /// Factors on the nodes whose robust weight is too low to be absorbed.
    pub(crate) rejected: Vec<Read>,
}

impl Neighborhood {
    /// Reads the neighborhood of `removed`, which are connected to each other or a single node, none of them fixed.
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
        let is_alone = removed.len() == 1 && overlay.is_alone(first);
        if blanket.is_empty() && !is_alone && !overlay.leads_to_kept(removed) {
            return Err(RemovalError::NoBlanket { variable: first });
        }
        overlay.check_last_pose(removed, &blanket)?;
        let dim = overlay.dims(&blanket).iter().sum();
        if dim > options.largest_blanket {
            let largest = options.largest_blanket;
            return Err(RemovalError::LargeBlanket { variable: first, dim, largest });
        }
        let mut places = Places::new(removed, &blanket);
        let on_nodes = on_nodes(overlay, removed, &places);
        let inside = if intra_clique { inside(overlay, &blanket, &places) } else { Vec::new() };
        let fixed = fixed(overlay, on_nodes.iter().chain(&inside).map(|(_, factor)| *factor));
        places.add_fixed(&fixed);
        let ids = [removed, &blanket, &fixed].concat();
        let mut members = overlay.members(&ids, options.linear_within)?;
        let fixed = members.split_off(removed.len() + blanket.len());
        let mut neighborhood = Self {
            members,
            removed: removed.len(),
            fixed,
            factors: Vec::new(),
            rejected: Vec::new(),
        };
        for (source, factor) in on_nodes {
            let read = neighborhood.read(source, factor, &places)?;
            if read.is_light(options) {
                neighborhood.rejected.push(read);
            } else {
                neighborhood.factors.push(read);
            }
        }
        for (source, factor) in inside {
            let read = neighborhood.read(source, factor, &places)?;
            if !read.is_light(options) {
                neighborhood.factors.push(read);
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
        places: &Places,
    ) -> Result<Read, RemovalError> {
        let non_finite = || RemovalError::NonFiniteFactor {
            factor: from.to_string(),
            name: factor.name(),
            variables: factor.keys().to_vec(),
        };
        let mut members: SmallVec<[usize; 4]> = SmallVec::new();
        let mut values: SmallVec<[ValueRef<'_>; 4]> = SmallVec::new();
        for &key in factor.keys() {
            match places.of(key) {
                Some(Place::Member(m)) => {
                    members.push(m);
                    values.push(self.members[m].value.as_ref());
                }
                Some(Place::Fixed(k)) => values.push(self.fixed[k].value.as_ref()),
                None => {}
            }
        }
        let linearized = linearize_at(factor, &values)
            .map_err(|source| RemovalError::Factor { factor: from.to_string(), source })?;
        let mut error = linearized.error();
        let norm: f64 = linearized.unweighted_residual().iter().map(|r| r * r).sum();
        let mut rows = match members.len() == values.len() {
            true => whole(linearized),
            false => of_unknowns(&linearized, factor, places),
        };
        let width = rows.ncols() - 1;
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

/// `[J₁ … Jₖ | r]`.
fn whole(linearized: LinearizedFactor) -> DMatrix<f64> {
    let (count, columns) = (linearized.rows(), linearized.columns());
    let width = columns.last().map_or(0, |&width| width as usize);
    DMatrix::from_vec(count, width + 1, linearized.into_data())
}

/// `[J₁ … Jₖ | r]` without the blocks of fixed variables.
fn of_unknowns(
    linearized: &LinearizedFactor,
    factor: &dyn Factor,
    places: &Places,
) -> DMatrix<f64> {
    let mut data = Vec::with_capacity(linearized.data().len());
    for (position, &key) in factor.keys().iter().enumerate() {
        if matches!(places.of(key), Some(Place::Member(_))) {
            data.extend(linearized.jacobian(position).iter());
        }
    }
    data.extend(linearized.residual().iter());
    let count = linearized.rows();
    DMatrix::from_vec(count, data.len() / count.max(1), data)
}

/// The factors on removed nodes, each once: at the first of its nodes.
fn on_nodes<'o>(
    overlay: &'o Overlay<'_>,
    removed: &[VariableId],
    places: &Places,
) -> Vec<(Source, &'o dyn Factor)> {
    let mut found = Vec::new();
    for (place, &id) in removed.iter().enumerate() {
        for (source, factor) in overlay.factors_of(id) {
            // Every removed variable of the factor comes by; the first one takes it.
            let first = factor.keys().iter().filter_map(|&key| places.removed(key)).min();
            if first == Some(place) {
                found.push((source, factor));
            }
        }
    }
    found
}

/// The factors inside the blanket that are not spared, each once: at the first of its variables that is not fixed.
fn inside<'o>(
    overlay: &'o Overlay<'_>,
    blanket: &[VariableId],
    places: &Places,
) -> Vec<(Source, &'o dyn Factor)> {
    let mut found = Vec::new();
    for &id in blanket {
        for (source, factor) in overlay.factors_of(id) {
            let mut unknowns = factor.keys().iter().filter(|&&key| !overlay.is_fixed(key));
            let is_inside = unknowns.next() == Some(&id)
                && !overlay.is_spared(source)
                && places.in_blanket(id)
                && unknowns.all(|&key| places.in_blanket(key));
            if is_inside {
                found.push((source, factor));
            }
        }
    }
    found
}

/// The fixed variables of some factors, by slot.
fn fixed<'o>(
    overlay: &Overlay<'_>,
    factors: impl Iterator<Item = &'o dyn Factor>,
) -> Vec<VariableId> {
    let all = factors.flat_map(|factor| factor.keys().iter().copied());
    let mut found: Vec<VariableId> = all.filter(|&key| overlay.is_fixed(key)).collect();
    found.sort_unstable_by_key(|&id| overlay.slot(id));
    found.dedup();
    found
}

/// The Markov blanket: the variables that share a factor with the removed ones, by slot. Fixed variables are given, and
/// so are not part of it.
pub(crate) fn blanket(overlay: &Overlay<'_>, removed: &[VariableId]) -> Vec<VariableId> {
    let gone: BTreeSet<VariableId> = removed.iter().copied().collect();
    let mut found: Vec<VariableId> = removed
        .iter()
        .flat_map(|&id| overlay.factors_of(id))
        .flat_map(|(_, factor)| factor.keys().iter().copied())
        .filter(|key| !gone.contains(key) && !overlay.is_fixed(*key))
        .collect();
    found.sort_unstable_by_key(|&id| overlay.slot(id));
    found.dedup();
    found
}

/// The place of a variable in a neighborhood.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// Among the members.
    Member(usize),
    /// Among the fixed variables.
    Fixed(usize),
}

/// The places of all variables of a neighborhood.
struct Places {
    by_id: BTreeMap<VariableId, Place>,
    removed: usize,
}

impl Places {
    fn new(removed: &[VariableId], blanket: &[VariableId]) -> Self {
        let members = removed.iter().chain(blanket).enumerate();
        let by_id = members.map(|(place, &id)| (id, Place::Member(place))).collect();
        Self { by_id, removed: removed.len() }
    }

    fn add_fixed(&mut self, fixed: &[VariableId]) {
        self.by_id.extend(fixed.iter().enumerate().map(|(k, &id)| (id, Place::Fixed(k))));
    }

    fn of(&self, id: VariableId) -> Option<Place> {
        self.by_id.get(&id).copied()
    }

    /// The place of a removed variable.
    fn removed(&self, id: VariableId) -> Option<usize> {
        match self.of(id) {
            Some(Place::Member(place)) if place < self.removed => Some(place),
            _ => None,
        }
    }

    fn in_blanket(&self, id: VariableId) -> bool {
        matches!(self.of(id), Some(Place::Member(place)) if place >= self.removed)
    }
}
