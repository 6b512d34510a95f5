//! The graph as it will be when the steps planned so far are applied.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use evergraph_model::belief::{Estimates, LinearizedEstimate};
use evergraph_model::{
    Factor, FactorId, FactorIndex, Graph, GraphError, Value, VariableId, VariableIndex,
};
use nalgebra::DVector;

use crate::error::RemovalError;
use crate::member::Member;
use crate::motion::pose_of;

/// A factor of the graph, or one that an earlier step of the same plan adds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// A factor of the graph.
    Graph(FactorId),
    /// The factor of this number among all that the plan's steps make, from 0.
    Planned(usize),
}

impl std::fmt::Display for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Graph(id) => id.fmt(f),
            Self::Planned(number) => write!(f, "planned {number}"),
        }
    }
}

/// A factor that a step has planned.
#[derive(Clone, Debug)]
pub(crate) struct Added {
    pub(crate) factor: Arc<dyn Factor>,
    /// Whether a later step has replaced it.
    pub(crate) is_absorbed: bool,
}

/// A graph with its estimates, less what planned steps take out, plus what they put in. Later steps
/// read it as if the earlier ones had been applied.
#[derive(Clone)]
pub(crate) struct Overlay<'a> {
    pub(crate) graph: &'a Graph,
    estimates: &'a dyn Estimates,
    removed: BTreeSet<VariableId>,
    /// Slots of the graph's factors that are absorbed.
    dropped: BTreeSet<FactorIndex>,
    /// New factors in the order in which they were planned.
    added: Vec<Added>,
    added_on: BTreeMap<VariableId, Vec<usize>>,
    /// Factors that stay while they are on kept variables only.
    spared: BTreeSet<FactorId>,
}

impl<'a> Overlay<'a> {
    pub(crate) fn new(graph: &'a Graph, estimates: &'a dyn Estimates, spared: &[FactorId]) -> Self {
        Self {
            graph,
            estimates,
            removed: BTreeSet::new(),
            dropped: BTreeSet::new(),
            added: Vec::new(),
            added_on: BTreeMap::new(),
            spared: spared.iter().copied().collect(),
        }
    }

    pub(crate) fn is_spared(&self, source: Source) -> bool {
        matches!(source, Source::Graph(id) if self.spared.contains(&id))
    }

    /// The slot of a variable: orders that decide arithmetic are by slot, whatever the ids are.
    pub(crate) fn slot(&self, variable: VariableId) -> usize {
        self.index(variable).index()
    }

    fn index(&self, variable: VariableId) -> VariableIndex {
        let index = self.graph.variable_index(variable);
        index.expect("nodes are checked, and keys of living factors live")
    }

    /// Whether a variable is fixed: given, so that it is neither marginalized nor in new factors.
    pub(crate) fn is_fixed(&self, variable: VariableId) -> bool {
        self.graph.is_fixed_at(self.index(variable))
    }

    /// Tangent dimensions of some variables.
    pub(crate) fn dims(&self, variables: &[VariableId]) -> Vec<usize> {
        variables.iter().map(|&id| self.graph.dim_at(self.index(id))).collect()
    }

    fn is_pose(&self, variable: VariableId) -> bool {
        pose_of(self.graph.kind_at(self.index(variable))).is_some()
    }

    /// Refuses to take the last poses of a graph out. A pose of `blanket`, the variables beside the removed ones, is
    /// proof enough; only without one are other poses looked for in the whole graph.
    pub(crate) fn check_last_pose(
        &self,
        removed: &[VariableId],
        blanket: &[VariableId],
    ) -> Result<(), RemovalError> {
        let Some(&variable) = removed.iter().find(|&&id| self.is_pose(id)) else { return Ok(()) };
        let stays = |id: VariableId| {
            self.is_pose(id) && !self.removed.contains(&id) && !removed.contains(&id)
        };
        if blanket.iter().any(|&id| stays(id)) || self.graph.variables().any(stays) {
            return Ok(());
        }
        Err(RemovalError::LastPose { variable })
    }

    pub(crate) fn check(&self, variable: VariableId) -> Result<(), RemovalError> {
        self.graph.check_variable(variable)?;
        if self.removed.contains(&variable) {
            return Err(GraphError::UnknownVariable { variable }.into());
        }
        Ok(())
    }

    /// Where the removal sees each of some variables: at its linearization point, if that is known and
    /// no component of the step from there to the estimate is beyond `linear_within`, else at the
    /// estimate. All is checked.
    pub(crate) fn members(
        &self,
        variables: &[VariableId],
        linear_within: f64,
    ) -> Result<Vec<Member>, RemovalError> {
        let count = |actual| {
            let expected = variables.len();
            if actual == expected {
                Ok(())
            } else {
                Err(RemovalError::EstimateCount { expected, actual })
            }
        };
        let Some(found) = self.estimates.linearized(variables)? else {
            let values = self.estimates.estimates_of(variables)?;
            count(values.len())?;
            let member = |(&id, value)| Ok(Member::at(id, self.checked(id, value)?));
            return variables.iter().zip(values).map(member).collect();
        };
        count(found.len())?;
        let member =
            |(&id, LinearizedEstimate { point, delta }): (&VariableId, LinearizedEstimate)| {
                let value = self.checked(id, point)?;
                if delta.len() != value.dim() {
                    let (actual, dim) = (value.kind().name(), delta.len());
                    return Err(RemovalError::EstimateMismatch { variable: id, actual, dim });
                }
                if delta.iter().all(|x| x.is_finite() && x.abs() <= linear_within) {
                    return Ok(Member { id, value, delta: DVector::from_vec(delta) });
                }
                let (index, mut estimate) = (self.index(id), value.storage().to_vec());
                match self.graph.retract(index, value.storage(), &delta, &mut estimate) {
                    // `checked` reports the numbers.
                    Ok(()) | Err(GraphError::NonFiniteRetraction { .. }) => {}
                    Err(error) => return Err(error.into()),
                }
                Ok(Member::at(id, self.checked(id, value.with_storage(&estimate))?))
            };
        variables.iter().zip(found).map(member).collect()
    }

    fn checked(&self, variable: VariableId, value: Value) -> Result<Value, RemovalError> {
        let index = self.index(variable);
        let fits = value.kind() == self.graph.kind_at(index)
            && value.dim() == self.graph.dim_at(index)
            && value.storage().len() == self.graph.value_range(index).len();
        if !fits {
            let (actual, dim) = (value.kind().name(), value.dim());
            return Err(RemovalError::EstimateMismatch { variable, actual, dim });
        }
        if value.storage().iter().any(|x| !x.is_finite()) {
            let numbers = value.storage().to_vec();
            return Err(RemovalError::NonFiniteEstimate { variable, numbers });
        }
        Ok(value)
    }

    /// The factors on a variable: the graph's in the order they came, then planned ones.
    pub(crate) fn factors_of(
        &self,
        variable: VariableId,
    ) -> impl Iterator<Item = (Source, &dyn Factor)> {
        let old = self.graph.factors_at(self.index(variable)).iter().filter_map(|&f| {
            let stays = !self.dropped.contains(&f);
            stays.then(|| (Source::Graph(self.graph.factor_id(f)), self.graph.factor_at(f)))
        });
        let new = self.added_on.get(&variable).into_iter().flatten();
        old.chain(new.map(|&k| (Source::Planned(k), &*self.added[k].factor)))
    }

    /// Whether a way over factors of the graph, through removed variables, leads from `start` to a
    /// variable that stays.
    pub(crate) fn leads_to_kept(&self, start: &[VariableId]) -> bool {
        let mut seen: BTreeSet<VariableId> = start.iter().copied().collect();
        let mut queue = start.to_vec();
        while let Some(variable) = queue.pop() {
            for &factor in self.graph.factors_at(self.index(variable)) {
                for &key in self.graph.factor_at(factor).keys() {
                    if seen.insert(key) {
                        if !self.removed.contains(&key) {
                            return true;
                        }
                        queue.push(key);
                    }
                }
            }
        }
        false
    }

    /// True if no factor of the graph ties a variable to another: nothing of others is lost with it.
    pub(crate) fn is_alone(&self, variable: VariableId) -> bool {
        let mut factors = self.graph.factors_at(self.index(variable)).iter();
        factors.all(|&factor| self.graph.factor_at(factor).keys().iter().all(|k| *k == variable))
    }

    /// [`factor`](Self::factor), shared.
    pub(crate) fn shared_factor(&self, source: Source) -> Option<Arc<dyn Factor>> {
        self.factor(source)?;
        match source {
            Source::Graph(id) => self.graph.factor(id).ok().cloned(),
            Source::Planned(k) => self.added.get(k).map(|added| Arc::clone(&added.factor)),
        }
    }

    /// The factor, unless a step has taken it out.
    pub(crate) fn factor(&self, source: Source) -> Option<&dyn Factor> {
        match source {
            Source::Graph(id) => {
                let index = self.graph.factor_index(id).ok()?;
                (!self.dropped.contains(&index)).then(|| self.graph.factor_at(index))
            }
            Source::Planned(k) => {
                self.added.get(k).filter(|added| !added.is_absorbed).map(|added| &*added.factor)
            }
        }
    }

    /// Applies a step: takes variables and factors out and puts factors in; returns the number of
    /// the first of those.
    pub(crate) fn apply(
        &mut self,
        removed: &[VariableId],
        dropped: impl Iterator<Item = Source>,
        new: &[Arc<dyn Factor>],
    ) -> usize {
        for source in dropped {
            match source {
                Source::Graph(id) => {
                    self.dropped.extend(self.graph.factor_index(id));
                }
                Source::Planned(k) => {
                    self.added[k].is_absorbed = true;
                    for key in self.added[k].factor.keys() {
                        if let Some(list) = self.added_on.get_mut(key) {
                            list.retain(|&other| other != k);
                        }
                    }
                }
            }
        }
        for &variable in removed {
            self.removed.insert(variable);
            self.added_on.remove(&variable);
        }
        let first = self.added.len();
        for factor in new {
            for &key in factor.keys() {
                self.added_on.entry(key).or_default().push(self.added.len());
            }
            self.added.push(Added { factor: Arc::clone(factor), is_absorbed: false });
        }
        first
    }

    /// The graph's factors that are absorbed, by slot.
    pub(crate) fn dropped(&self) -> impl Iterator<Item = FactorId> {
        self.dropped.iter().map(|&factor| self.graph.factor_id(factor))
    }

    /// All factors that steps have planned, in that order.
    pub(crate) fn into_added(self) -> Vec<Added> {
        self.added
    }
}
