//! The estimates of all variables, cached between calls: only those that have moved are computed again.

use std::ops::Range;

use evergraph_model::{
    Graph, GraphError, Key, Manifold, ValueRef, Values, VariableId, VariableType,
};

use crate::dense::Instructions;
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
    /// [`GraphError`] for an id that is stale or foreign.
    pub fn value(&self, id: VariableId) -> Result<ValueRef<'a>, GraphError> {
        self.graph.check_variable(id)?;
        Ok(self.at(id))
    }

    /// The estimate of a variable of known type.
    ///
    /// # Errors
    /// [`GraphError`] for a key that is stale or foreign.
    pub fn get<V: Manifold>(&self, key: Key<V>) -> Result<V, GraphError> {
        let key = self.graph.key::<V>(key.id())?;
        Ok(self.at(key.id()).get().expect("the type was checked"))
    }

    /// All variables with their estimates, in the order of their slots.
    pub fn iter(&self) -> impl Iterator<Item = (VariableId, ValueRef<'a>)> {
        self.graph.variables().map(|id| (id, self.at(id)))
    }

    /// A copy that lasts.
    pub fn to_values(&self) -> Values {
        Values::from_arena(self.graph, self.points)
    }

    fn at(&self, id: VariableId) -> ValueRef<'a> {
        self.graph.value_ref(id.index(), &self.points[self.graph.value_range(id.index())])
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

/// What a pass asks about a variable, close together: passes wait for memory more than anything.
#[derive(Clone, Copy, Debug)]
struct Variable {
    kind: &'static VariableType,
    /// Ranges.
    tangent: (u32, u32),
    value: (u32, u32),
    /// When its δ last changed.
    changed: u64,
}

impl Variable {
    fn of(graph: &Graph, variable: u32, changed: u64) -> Self {
        let kind = graph.kind_at(variable as usize);
        let (tangent, value) =
            (graph.tangent_range(variable as usize), graph.value_range(variable as usize));
        let tangent = (tangent.start as u32, tangent.end as u32);
        let value = (value.start as u32, value.end as u32);
        Self { kind, tangent, value, changed }
    }

    fn tangent(&self) -> Range<usize> {
        self.tangent.0 as usize..self.tangent.1 as usize
    }

    fn value(&self) -> Range<usize> {
        self.value.0 as usize..self.value.1 as usize
    }
}

impl EstimateCache {
    /// Solves the cliques that are new, have new numbers, or whose separator has changed since they
    /// were last solved; by running intersection the subtree of any other clique is as it was.
    ///
    /// Afterwards the kept δ of every clique's frontals is within `tolerance` of what its equations
    /// give for the kept δ of its separator.
    pub(crate) fn refresh(
        &mut self,
        instructions: Instructions,
        graph: &Graph,
        tree: &mut Tree,
        points: &[f64],
        tolerance: f64,
    ) {
        if tolerance < self.tolerance {
            // What was good enough is no longer.
            self.start = self.clock;
        }
        self.tolerance = tolerance;
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
                self.solve(instructions, graph, clique, points, is_new);
            }
        }
    }

    /// Whether any of these variables has changed since `then`.
    fn has_changed(&self, variables: &[u32], then: u64) -> bool {
        variables.iter().any(|&v| self.variable(v).changed > then)
    }

    /// A variable whose clique has been solved.
    fn variable(&self, variable: u32) -> &Variable {
        self.variables[variable as usize].as_ref().expect("parents are solved first")
    }

    fn solve(
        &mut self,
        instructions: Instructions,
        graph: &Graph,
        clique: &Clique,
        points: &[f64],
        is_new: bool,
    ) {
        let mut scratch = std::mem::take(&mut self.scratch);
        solve_clique(instructions, clique, 0, &mut scratch, |v, out| {
            copy_to_front(&self.delta[self.variable(v).tangent()], out)
        });
        let mut rest = scratch.as_slice();
        for &v in &clique.structure.frontals {
            let slot = &mut self.variables[v as usize];
            if is_new {
                // The slot may have been that of a variable which is gone.
                *slot = Some(Variable::of(graph, v, slot.map_or(0, |before| before.changed)));
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
                variable.kind.retract(&points[at.clone()], delta, &mut self.estimates[at]);
            }
        }
        self.scratch = scratch;
    }
}
