//! What can be asked of a smoother; nothing here alters it.

use std::hash::{DefaultHasher, Hash, Hasher};

use evergraph_model::{FactorId, Graph, GraphError, Key, Manifold, Value, Values, VariableId};

use crate::error::SmootherError;
use crate::quadratic::retract_all;
use crate::report::FactorizationSize;
use crate::settings::Settings;
use crate::smoother::Smoother;
use crate::solve;

impl Smoother {
    /// The graph.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// The settings it was built with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// How many changes have been applied.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The estimate of one variable, exact for the current factorization. Costs the cliques
    /// between the variable and its root: one for the newest variable.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for a key that is stale or foreign.
    pub fn estimate<V: Manifold>(&self, key: Key<V>) -> Result<V, SmootherError> {
        // A clone mints ids of its own under the same names, so even a typed key is checked.
        let key = self.graph.key::<V>(key.id())?;
        let value = self.estimate_value(key.id())?;
        Ok(value.get().expect("the type was checked"))
    }

    /// [`estimate`](Self::estimate) for a variable of any type.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is stale or foreign.
    pub fn estimate_value(&self, variable: VariableId) -> Result<Value, SmootherError> {
        if self.at_optimum {
            return self.linearization_point(variable);
        }
        self.graph.check_variable(variable)?;
        let index = variable.index();
        let delta = solve::path(self.scratch.instructions, &self.graph, &self.tree, index as u32);
        Ok(self.moved(index, &delta))
    }

    /// [`estimate_value`](Self::estimate_value) of each, in the order given: the same numbers, but cliques
    /// above several of them are solved once.
    ///
    /// # Errors
    /// [`GraphError`] for an id that is stale or foreign.
    pub fn estimate_values(&self, variables: &[VariableId]) -> Result<Vec<Value>, GraphError> {
        for &variable in variables {
            self.graph.check_variable(variable)?;
        }
        if self.at_optimum {
            let point =
                |index| self.graph.value(index, &self.points[self.graph.value_range(index)]);
            return Ok(variables.iter().map(|id| point(id.index())).collect());
        }
        let deltas = self.solved(variables);
        Ok(variables.iter().zip(deltas).map(|(id, delta)| self.moved(id.index(), &delta)).collect())
    }

    /// The steps δ, each in the tangent of its variable, that lead from
    /// [linearization points](Self::linearization_point) to estimates, in the order given. Zero right
    /// after [`optimize`](Self::optimize).
    ///
    /// # Errors
    /// [`GraphError`] for an id that is stale or foreign.
    pub fn deltas(&self, variables: &[VariableId]) -> Result<Vec<Vec<f64>>, GraphError> {
        for &variable in variables {
            self.graph.check_variable(variable)?;
        }
        if self.at_optimum {
            return Ok(variables
                .iter()
                .map(|id| vec![0.0; self.graph.dim_at(id.index())])
                .collect());
        }
        Ok(self.solved(variables))
    }

    /// δ of the present factorization.
    fn solved(&self, variables: &[VariableId]) -> Vec<Vec<f64>> {
        let indices: Vec<u32> = variables.iter().map(|id| id.index() as u32).collect();
        solve::paths(self.scratch.instructions, &self.graph, &self.tree, &indices)
    }

    /// The linearization point of a variable, moved by δ.
    fn moved(&self, index: usize, delta: &[f64]) -> Value {
        let point = &self.points[self.graph.value_range(index)];
        let mut estimate = vec![0.0; point.len()];
        self.graph.kind_at(index).retract(point, delta, &mut estimate);
        self.graph.value(index, &estimate)
    }

    /// The estimates of all variables, exact for the current factorization.
    pub fn estimates(&self) -> Values {
        Values::from_arena(&self.graph, &self.estimate_points())
    }

    /// The point at which a variable's factors are linearized.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for a key that is stale or foreign.
    pub fn linearization_point(&self, variable: VariableId) -> Result<Value, SmootherError> {
        self.graph.check_variable(variable)?;
        Ok(self
            .graph
            .value(variable.index(), &self.points[self.graph.value_range(variable.index())]))
    }

    /// The objective `½ Σ ‖r‖²` (robust factors: `Σ ρ`) at the estimate, all factors included.
    pub fn error(&self) -> f64 {
        self.graph.error(&self.estimate_points())
    }

    /// The objective over some of the factors, at the estimate.
    pub fn error_of(&self, mut include: impl FnMut(FactorId) -> bool) -> f64 {
        let points = self.estimate_points();
        self.graph
            .factor_indices()
            .filter(|&f| include(self.graph.factor_id(f)))
            .map(|f| self.graph.factor_error(f, &points))
            .sum()
    }

    /// Size of the factorization.
    pub fn size(&self) -> FactorizationSize {
        FactorizationSize {
            cliques: self.tree.len(),
            nonzeros: self.tree.nonzeros(),
            columns: self.graph.dim(),
        }
    }

    /// `ln det JᵀJ = 2 Σ ln |R_jj|` at the linearization points; 0 for an empty graph. O(variables).
    pub fn log_det_information(&self) -> f64 {
        let log_det = |clique: u32| -> f64 {
            let numeric = &self.tree.clique(clique).numeric;
            (0..numeric.layout.frontal()).map(|j| numeric.row(j)[0].abs().ln()).sum()
        };
        // The sum of no terms is -0.
        2.0 * self.tree.top_down().into_iter().map(log_det).sum::<f64>() + 0.0
    }

    /// Smallest pivot over its diagonal entry of JᵀJ in the whole factorization; infinite for an
    /// empty graph.
    pub fn smallest_pivot_ratio(&self) -> f64 {
        self.tree.pivot_ratio()
    }

    /// A hash of every bit of the state: graph with its free slots and versions, linearization
    /// points, Jacobians, the tree with all of its numbers, kept δ and exact δ. Equal states have
    /// equal fingerprints, also in different processes running the same build.
    pub fn fingerprint(&self) -> u64 {
        let mut hash = DefaultHasher::new();
        self.graph.hash_state(&mut hash);
        let mut number = |x: f64| hash.write_u64(x.to_bits());
        let delta = solve::all(self.scratch.instructions, &self.graph, &self.tree);
        for v in self.graph.variable_indices() {
            self.points[self.graph.value_range(v)].iter().for_each(|&x| number(x));
            delta[self.graph.tangent_range(v)].iter().for_each(|&x| number(x));
            self.solution.delta[self.graph.tangent_range(v)].iter().for_each(|&x| number(x));
        }
        for f in self.graph.factor_indices() {
            self.blocks.get(f).iter().for_each(|&x| number(x));
        }
        self.tree.hash_state(&mut hash);
        self.ahead.hash_state(&mut hash);
        self.checked.hash(&mut hash);
        hash.write_u32(self.newest);
        hash.write_u64(self.steps);
        hash.write_u8(u8::from(self.at_optimum));
        hash.finish()
    }

    /// All estimates, exact, laid out as the linearization points.
    pub(crate) fn estimate_points(&self) -> Vec<f64> {
        if self.at_optimum {
            return self.points.clone();
        }
        let delta = solve::all(self.scratch.instructions, &self.graph, &self.tree);
        retract_all(&self.graph, &self.points, &delta)
    }
}
