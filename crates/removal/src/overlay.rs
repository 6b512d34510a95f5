//! The graph as it will be when the steps planned so far are applied.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use evergraph_model::{Factor, FactorId, Graph, GraphError, Value, Values, VariableId};
use nalgebra::DVector;

use crate::error::RemovalError;
use crate::neighborhood::Member;

/// Where estimates come from: a [`Smoother`](evergraph_solver::Smoother), which computes those that
/// are asked for, its [`Estimates`](evergraph_solver::Estimates) of everybody, [`Values`], or a
/// closure.
pub trait Estimates {
    /// The estimate of a variable.
    ///
    /// # Errors
    /// [`GraphError`] when there is none.
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError>;

    /// The estimates of some variables, in their order: where they share work, at once.
    ///
    /// # Errors
    /// [`GraphError`] when there is none for one of them.
    fn estimates_of(&self, variables: &[VariableId]) -> Result<Vec<Value>, GraphError> {
        variables.iter().map(|&variable| self.estimate(variable)).collect()
    }

    /// The estimates of some variables, in their order, as steps from the points that their factors are
    /// linearized at; `None` where such points are not known, as by default. With them a removal near
    /// the linearization points stays in the linear model that is solved
    /// ([`Options::linear_within`](crate::Options::linear_within)).
    ///
    /// # Errors
    /// [`GraphError`] when there is none for one of them.
    fn linearized(&self, variables: &[VariableId]) -> Result<Option<Vec<Linearized>>, GraphError> {
        let _ = variables;
        Ok(None)
    }
}

/// An estimate, as a step from the point that the variable's factors are linearized at.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearized {
    /// The linearization point.
    pub point: Value,
    /// The step δ in the tangent at the point.
    pub delta: Vec<f64>,
}

impl Estimates for Values {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self.value(variable).map(|value| value.to_value())
    }
}

impl<F: Fn(VariableId) -> Result<Value, GraphError>> Estimates for F {
    fn estimate(&self, variable: VariableId) -> Result<Value, GraphError> {
        self(variable)
    }
}

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

/// A graph with its estimates, less what planned steps take out, plus what they put in. Later steps
/// read it as if the earlier ones had been applied.
#[derive(Clone)]
pub(crate) struct Overlay<'a> {
    pub(crate) graph: &'a Graph,
    estimates: &'a dyn Estimates,
    removed: BTreeSet<VariableId>,
    dropped: BTreeSet<FactorId>,
    /// New factors in the order they were planned; `None` once a later step has absorbed them.
    added: Vec<Option<Arc<dyn Factor>>>,
    added_on: BTreeMap<VariableId, Vec<usize>>,
    poses: usize,
    /// Factors that stay while they are on kept variables only.
    spared: &'a [FactorId],
}

impl<'a> Overlay<'a> {
    pub(crate) fn new(
        graph: &'a Graph,
        estimates: &'a dyn Estimates,
        spared: &'a [FactorId],
    ) -> Self {
        Self {
            graph,
            estimates,
            removed: BTreeSet::new(),
            dropped: BTreeSet::new(),
            added: Vec::new(),
            added_on: BTreeMap::new(),
            poses: graph
                .variable_indices()
                .filter(|&v| crate::motion::pose_of(graph.kind_at(v)).is_some())
                .count(),
            spared,
        }
    }

    pub(crate) fn is_spared(&self, source: Source) -> bool {
        matches!(source, Source::Graph(id) if self.spared.contains(&id))
    }

    /// How many poses are left.
    pub(crate) fn poses(&self) -> usize {
        self.poses
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
        let member = |(&id, Linearized { point, delta }): (&VariableId, Linearized)| {
            let value = self.checked(id, point)?;
            if delta.len() != value.dim() {
                let (actual, dim) = (value.kind().name(), delta.len());
                return Err(RemovalError::EstimateMismatch { variable: id, actual, dim });
            }
            if delta.iter().all(|x| x.is_finite() && x.abs() <= linear_within) {
                return Ok(Member { id, value, delta: DVector::from_vec(delta) });
            }
            let mut estimate = value.storage().to_vec();
            value.kind().retract(value.storage(), &delta, &mut estimate);
            let estimate = self.graph.value(id.index(), &estimate);
            Ok(Member::at(id, self.checked(id, estimate)?))
        };
        variables.iter().zip(found).map(member).collect()
    }

    fn checked(&self, variable: VariableId, value: Value) -> Result<Value, RemovalError> {
        let index = variable.index();
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
        let old = self.graph.factors_at(variable.index()).iter().filter_map(|&f| {
            let id = self.graph.factor_id(f as usize);
            let stays = self.dropped.is_empty() || !self.dropped.contains(&id);
            stays.then(|| (Source::Graph(id), self.graph.factor_at(f as usize)))
        });
        let new = self.added_on.get(&variable).into_iter().flatten();
        let new = new.filter_map(|&k| Some((Source::Planned(k), &**self.added[k].as_ref()?)));
        old.chain(new)
    }

    /// Whether a way over factors of the graph, through removed variables, leads from `start` to a
    /// variable that stays.
    pub(crate) fn leads_to_kept(&self, start: &[VariableId]) -> bool {
        let mut seen: BTreeSet<VariableId> = start.iter().copied().collect();
        let mut queue = start.to_vec();
        while let Some(variable) = queue.pop() {
            for &factor in self.graph.factors_at(variable.index()) {
                for &key in self.graph.factor_at(factor as usize).keys() {
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

    /// The factor, unless a step has taken it out.
    pub(crate) fn factor(&self, source: Source) -> Option<&dyn Factor> {
        match source {
            Source::Graph(id) if self.dropped.contains(&id) => None,
            Source::Graph(id) => self.graph.factor(id).ok().map(|factor| &**factor),
            Source::Planned(k) => self.added.get(k)?.as_deref(),
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
                    self.dropped.insert(id);
                }
                Source::Planned(k) => {
                    if let Some(factor) = self.added[k].take() {
                        for key in factor.keys() {
                            if let Some(list) = self.added_on.get_mut(key) {
                                list.retain(|&other| other != k);
                            }
                        }
                    }
                }
            }
        }
        for &variable in removed {
            self.removed.insert(variable);
            self.added_on.remove(&variable);
            let pose = crate::motion::pose_of(self.graph.kind_at(variable.index())).is_some();
            self.poses -= usize::from(pose);
        }
        let first = self.added.len();
        for factor in new {
            for &key in factor.keys() {
                self.added_on.entry(key).or_default().push(self.added.len());
            }
            self.added.push(Some(Arc::clone(factor)));
        }
        first
    }

    /// What is to be dropped from the graph, ascending.
    pub(crate) fn dropped(&self) -> impl Iterator<Item = FactorId> {
        self.dropped.iter().copied()
    }

    /// The new factors that no later step has absorbed, in the order they were planned.
    pub(crate) fn surviving(&self) -> impl Iterator<Item = &Arc<dyn Factor>> {
        self.added.iter().flatten()
    }
}
