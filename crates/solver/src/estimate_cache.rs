//! The estimates of all variables, cached between calls: only those that have moved are computed again.

use std::ops::Range;

use evergraph_model::{
    Graph, GraphError, Key, Manifold, ValueRef, Values, VariableId, VariableIndex,
};

use crate::dense::Instructions;
use crate::error::SmootherError;
use crate::index::CliqueIndex;
use crate::solve::{copy_to_front, is_beyond, solve_clique};
use crate::tree::{Clique, Tree};

/// The estimates of all variables, where the smoother keeps them: nothing is copied.
#[derive(Clone, Copy, Debug)]
pub struct Estimates<'a> {
    pub(crate) graph: &'a Graph,
    pub(crate) points: &'a [f64],
}

impl<'a> Estimates<'a> {
    /// The graph that they are of.
    pub fn graph(&self) -> &'a Graph {
        self.graph
    }

    /// The estimate of a variable.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn value(&self, id: impl Into<VariableId>) -> Result<ValueRef<'a>, SmootherError> {
        Ok(self.at(self.graph.variable_index(id.into())?))
    }

    /// The estimate of a variable of known type.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for a key that is removed or foreign, or whose variable has another
    /// type.
    #[allow(clippy::missing_panics_doc, reason = "the type was checked")]
    pub fn get<V: Manifold>(&self, key: Key<V>) -> Result<V, SmootherError> {
        let key = self.graph.key::<V>(key.id())?;
        Ok(self.value(key)?.get().expect("the type was checked"))
    }

    /// All variables with their estimates, in the order of their slots.
    pub fn iter(&self) -> impl Iterator<Item = (VariableId, ValueRef<'a>)> {
        self.graph.variable_indices().map(|v| (self.graph.variable_id(v), self.at(v)))
    }

    /// A copy that lasts.
    pub fn to_values(&self) -> Values {
        Values::from_arena(self.graph, self.points)
    }

    fn at(&self, variable: VariableIndex) -> ValueRef<'a> {
        self.graph.value_ref(variable, &self.points[self.graph.value_range(variable)])
    }
}

/// The estimates behind [`Smoother::cached_estimates`](crate::Smoother::cached_estimates):
/// `points ⊕ δ`, with a δ of its own, so that no later answer depends on earlier calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct EstimateCache {
    /// Laid out as the linearization points.
    pub(crate) estimates: Vec<f64>,
    /// By tangent range.
    delta: Vec<f64>,
    /// By variable slot.
    variables: Vec<Option<Variable>>,
    /// Counts passes.
    clock: u64,
    /// Cliques that were solved no later than this have to be solved again.
    start: u64,
    /// That of the last pass.
    tolerance: f64,
    stack: Vec<CliqueIndex>,
    scratch: Vec<f64>,
}

/// What a pass reads of a variable, close together: passes wait for memory more than anything.
#[derive(Clone, Copy, Debug)]
struct Variable {
    /// Ranges.
    tangent: (u32, u32),
    value: (u32, u32),
    /// When its δ last changed.
    changed: u64,
}

impl Variable {
    fn of(graph: &Graph, variable: VariableIndex, changed: u64) -> Self {
        let (tangent, value) = (graph.tangent_range(variable), graph.value_range(variable));
        let tangent = (tangent.start as u32, tangent.end as u32);
        let value = (value.start as u32, value.end as u32);
        Self { tangent, value, changed }
    }

    fn tangent(&self) -> Range<usize> {
        self.tangent.0 as usize..self.tangent.1 as usize
    }

    fn value(&self) -> Range<usize> {
        self.value.0 as usize..self.value.1 as usize
    }
}

/// What estimates are computed from.
#[derive(Clone, Copy)]
pub(crate) struct Now<'a> {
    pub(crate) instructions: Instructions,
    pub(crate) graph: &'a Graph,
    pub(crate) points: &'a [f64],
}

impl EstimateCache {
    /// Solves the cliques that are new, have new numbers, or whose separator has changed since they
    /// were last solved; by running intersection the subtree of any other clique is as it was.
    ///
    /// Afterwards the cached δ of every clique's frontals is within `tolerance` of what its equations
    /// give for the cached δ of its separator.
    ///
    /// # Errors
    /// A manifold panics or gives a value that is not finite. The next call computes everything
    /// again.
    pub(crate) fn refresh(
        &mut self,
        now: Now<'_>,
        tree: &mut Tree,
        tolerance: f64,
    ) -> Result<(), GraphError> {
        if tolerance < self.tolerance {
            // What was good enough is no longer.
            self.start = self.clock;
        }
        self.tolerance = tolerance;
        let graph = now.graph;
        if self.clock == 0 {
            self.estimates.resize(graph.value_len(), 0.0);
            let fixed = graph.variable_indices().filter(|&v| graph.is_fixed_at(v));
            fixed.for_each(|v| self.copy_point(graph, now.points, v));
        }
        self.clock += 1;
        self.estimates.resize(graph.value_len(), 0.0);
        self.delta.resize(graph.tangent_len(), 0.0);
        self.variables.resize(graph.variable_slots(), None);
        self.stack.clear();
        self.stack.extend(&tree.roots);
        while let Some(index) = self.stack.pop() {
            let clique = tree.clique_mut(index);
            let is_new = clique.cached <= self.start;
            if is_new || self.has_changed(&clique.structure.separator, clique.cached) {
                clique.cached = self.clock;
                self.stack.extend(&clique.children);
                if let Err(error) = self.solve(now, clique, is_new) {
                    self.start = self.clock;
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    /// Takes over the points of those of the variables that are fixed. They are in no clique.
    pub(crate) fn set_fixed(
        &mut self,
        graph: &Graph,
        points: &[f64],
        variables: impl Iterator<Item = VariableIndex>,
    ) {
        // The first call to `refresh` copies all of them.
        if self.clock > 0 {
            self.estimates.resize(graph.value_len(), 0.0);
            let fixed = variables.filter(|&v| graph.is_fixed_at(v));
            fixed.for_each(|v| self.copy_point(graph, points, v));
        }
    }

    fn copy_point(&mut self, graph: &Graph, points: &[f64], variable: VariableIndex) {
        let range = graph.value_range(variable);
        self.estimates[range.clone()].copy_from_slice(&points[range]);
    }

    /// Bytes of the cache.
    pub(crate) fn memory_bytes(&self) -> usize {
        8 * (self.estimates.capacity() + self.delta.capacity())
            + size_of::<Option<Variable>>() * self.variables.capacity()
    }

    /// Whether any of these variables has changed since `then`.
    fn has_changed(&self, variables: &[VariableIndex], then: u64) -> bool {
        variables.iter().any(|&v| self.variable(v).changed > then)
    }

    /// A variable whose clique has been solved.
    fn variable(&self, variable: VariableIndex) -> &Variable {
        self.variables[variable.index()].as_ref().expect("parents are solved first")
    }

    fn solve(&mut self, now: Now<'_>, clique: &Clique, is_new: bool) -> Result<(), GraphError> {
        let mut scratch = std::mem::take(&mut self.scratch);
        solve_clique(now.instructions, clique, 0, &mut scratch, |v, out| {
            copy_to_front(&self.delta[self.variable(v).tangent()], out)
        });
        let result = self.take_in(now, clique, is_new, &scratch);
        self.scratch = scratch;
        result
    }

    /// Takes in what was solved for a clique's frontals.
    fn take_in(
        &mut self,
        now: Now<'_>,
        clique: &Clique,
        is_new: bool,
        solved: &[f64],
    ) -> Result<(), GraphError> {
        let mut rest = solved;
        for &v in &clique.structure.frontals {
            let slot = &mut self.variables[v.index()];
            if is_new {
                // The slot may have been that of a variable which is gone.
                *slot = Some(Variable::of(now.graph, v, slot.map_or(0, |before| before.changed)));
            }
            let variable = slot.as_mut().expect("it is written when the clique is new");
            let (new, others) = rest.split_at(variable.tangent().len());
            rest = others;
            let delta = &mut self.delta[variable.tangent()];
            let has_changed = is_beyond(new, delta, self.tolerance);
            if has_changed {
                delta.copy_from_slice(new);
                variable.changed = self.clock;
            }
            // With new numbers the linearization point may be another.
            if has_changed || is_new {
                let at = variable.value();
                let out = &mut self.estimates[at.clone()];
                now.graph.retract(v, &now.points[at], delta, out)?;
            }
        }
        Ok(())
    }
}
