//! Questions about the state; no answer alters a later one.

use std::hash::{DefaultHasher, Hash, Hasher};

use evergraph_model::{FactorId, Graph, Key, Manifold, Value, Values, VariableId, VariableIndex};

use crate::error::SmootherError;
use crate::estimate_cache::{Estimates, Now};
use crate::factorization::Factorization;
use crate::index::CliqueIndex;
use crate::report::FactorizationSize;
use crate::settings::Settings;
use crate::smoother::Smoother;

impl Smoother {
    /// The graph.
    pub fn graph(&self) -> &Graph {
        &self.factorization.graph
    }

    /// The settings it was built with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// How many changes have been applied.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The estimate of one variable, exact for the current factorization; of a fixed one the value
    /// at which it is fixed. Costs the cliques between the variable and its root: one for the
    /// newest variable.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for a key that is removed or foreign, or whose variable has another
    /// type, and when the code of the variable's type fails.
    #[allow(clippy::missing_panics_doc, reason = "the type was checked")]
    pub fn estimate<V: Manifold>(&self, key: Key<V>) -> Result<V, SmootherError> {
        // A key that was read back may claim any type.
        let key = self.graph().key::<V>(key.id())?;
        let value = self.estimate_value(key)?;
        Ok(value.get().expect("the type was checked"))
    }

    /// [`estimate`](Self::estimate) for a variable of any type.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign, and when the code of the
    /// variable's type fails.
    pub fn estimate_value(&self, variable: impl Into<VariableId>) -> Result<Value, SmootherError> {
        let index = self.graph().variable_index(variable.into())?;
        let delta = self.factorization.deltas(self.engine.instructions, &[index]);
        self.moved(index, &delta[0])
    }

    /// [`estimate_value`](Self::estimate_value) of each, in the order given: the same numbers, but
    /// cliques above several of them are solved once.
    ///
    /// # Errors
    /// As [`estimate_value`](Self::estimate_value).
    pub fn estimate_values(
        &self,
        variables: &[impl Into<VariableId> + Copy],
    ) -> Result<Vec<Value>, SmootherError> {
        let indices = self.indices(variables)?;
        let deltas = self.factorization.deltas(self.engine.instructions, &indices);
        indices.iter().zip(deltas).map(|(&index, delta)| self.moved(index, &delta)).collect()
    }

    /// The steps δ, each in the tangent of its variable (translation first, m and rad), that lead
    /// from [linearization points](Self::linearization_point) to estimates, in the order given.
    /// Zero for fixed variables, and right after [`optimize`](Self::optimize).
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn deltas(
        &self,
        variables: &[impl Into<VariableId> + Copy],
    ) -> Result<Vec<Vec<f64>>, SmootherError> {
        let indices = self.indices(variables)?;
        Ok(self.factorization.deltas(self.engine.instructions, &indices))
    }

    /// The slots of variables.
    pub(crate) fn indices(
        &self,
        variables: &[impl Into<VariableId> + Copy],
    ) -> Result<Vec<VariableIndex>, SmootherError> {
        let index = |&id| Ok(self.graph().variable_index(Into::<VariableId>::into(id))?);
        variables.iter().map(index).collect()
    }

    /// The linearization point of a variable, moved by δ.
    fn moved(&self, index: VariableIndex, delta: &[f64]) -> Result<Value, SmootherError> {
        let graph = self.graph();
        let mut estimate = vec![0.0; graph.value_range(index).len()];
        self.factorization.moved(index, delta, &mut estimate)?;
        Ok(graph.value(index, &estimate))
    }

    /// The estimates of all variables, exact for the current factorization. O(variables).
    ///
    /// # Errors
    /// [`SmootherError::Graph`] when the code of a variable's type fails.
    pub fn estimates(&self) -> Result<Values, SmootherError> {
        Ok(Values::from_arena(self.graph(), &self.estimate_points()?))
    }

    /// The estimates of all variables to within a tolerance, cached between calls: each computes
    /// again only what has moved since the last, where [`estimates`](Self::estimates) computes and
    /// copies everything.
    ///
    /// An estimate changes once one of its components (m or rad, in the tangent space) is off by
    /// more than `tolerance`, given the estimates of the variables that it is computed from. Those
    /// may be off themselves, and an angle moves what is far away by more, so that the difference
    /// from the exact estimate can be some tolerances: up to 14 have been seen. Small changes are
    /// not lost: they add up until they exceed the tolerance. With 0 (and anything that is no
    /// positive number) nothing is off. A smaller tolerance than that of the last call computes
    /// everything again.
    ///
    /// The call alters nothing else: later steps give the same bits.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] when the code of a variable's type fails.
    pub fn cached_estimates(&mut self, tolerance: f64) -> Result<Estimates<'_>, SmootherError> {
        let Self { factorization, estimate_cache: cache, engine, .. } = self;
        let Factorization { graph, points, tree, solution, .. } = factorization;
        if solution.is_at_points {
            // The next change finds a tree whose cliques are all new.
            cache.estimates.clone_from(points);
        } else {
            let now = Now { instructions: engine.instructions, graph, points };
            cache.refresh(now, tree, tolerance.max(0.0))?;
        }
        Ok(Estimates { graph, points: &cache.estimates })
    }

    /// The point at which a variable's factors are linearized.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] for an id that is removed or foreign.
    pub fn linearization_point(
        &self,
        variable: impl Into<VariableId>,
    ) -> Result<Value, SmootherError> {
        let graph = self.graph();
        let index = graph.variable_index(variable.into())?;
        Ok(graph.value(index, &self.factorization.points[graph.value_range(index)]))
    }

    /// The objective `½ Σ ‖r‖²` (robust factors: `Σ ρ`) at the estimate, all factors included.
    /// O(graph).
    ///
    /// # Errors
    /// [`SmootherError::Graph`] when the code of a factor or a variable's type fails.
    pub fn error(&self) -> Result<f64, SmootherError> {
        Ok(self.graph().error(&self.estimate_points()?)?)
    }

    /// The objective over some of the factors, at the estimate. O(graph); see
    /// [`error_of_factor`](Self::error_of_factor) for a single one.
    ///
    /// # Errors
    /// [`SmootherError::Graph`] when the code of a factor or a variable's type fails.
    pub fn error_of(
        &self,
        mut include: impl FnMut(FactorId) -> bool,
    ) -> Result<f64, SmootherError> {
        let (graph, points) = (self.graph(), self.estimate_points()?);
        let included = graph.factor_indices().filter(|&f| include(graph.factor_id(f)));
        let errors: Result<Vec<f64>, _> =
            included.map(|f| graph.factor_error(f, &points)).collect();
        Ok(errors?.into_iter().sum())
    }

    /// Size of the factorization.
    pub fn size(&self) -> FactorizationSize {
        FactorizationSize {
            cliques: self.factorization.tree.len(),
            nonzeros: self.factorization.tree.nonzeros(),
            columns: self.graph().dim(),
        }
    }

    /// `ln det JᵀJ = 2 Σ ln |R_jj|` at the linearization points; 0 without unknowns. O(variables).
    pub fn log_det_information(&self) -> f64 {
        let tree = &self.factorization.tree;
        let log_det = |clique: CliqueIndex| -> f64 {
            let numeric = &tree.clique(clique).numeric;
            (0..numeric.layout.frontal()).map(|j| numeric.row(j)[0].abs().ln()).sum()
        };
        // The sum of no terms is -0.
        2.0 * tree.top_down().into_iter().map(log_det).sum::<f64>() + 0.0
    }

    /// Smallest pivot over its diagonal entry of JᵀJ in the whole factorization; infinite without
    /// unknowns.
    pub fn smallest_pivot_ratio(&self) -> f64 {
        self.factorization.tree.pivot_ratio()
    }

    /// Bytes of memory that the smoother holds beside its graph: linear system, factorization,
    /// solution, cached estimates, and the buffers whose size follows them. Bounded by a multiple of
    /// the factors and cliques in use. O(1).
    pub fn memory_bytes(&self) -> usize {
        self.factorization.memory_bytes()
            + self.estimate_cache.memory_bytes()
            + self.engine.memory_bytes()
    }

    /// A hash of every bit of the state that later answers depend on: graph with its free slots and
    /// versions, linearization points, Jacobians, the tree with all of its numbers and pivot ratios,
    /// δ as last propagated, the pending relinearization with its factors and cliques, the last
    /// checks, and the batch step in the background (the step in which it ends and the number of
    /// changes since). States that are equal have equal fingerprints, also in different processes
    /// running the same build.
    ///
    /// Not in it, because no later answer depends on it: the cache of estimates, the places of
    /// blocks in memory, buffers, the number of threads, the times of the profile. Ids count by the
    /// slots of what they name: their own numbers differ between equal graphs. The contents of
    /// factors, and the settings, never change.
    pub fn fingerprint(&self) -> u64 {
        let Self { settings: _, factorization, pending, checked, background, steps, .. } = self;
        let mut hash = DefaultHasher::new();
        factorization.hash_state(&mut hash);
        pending.hash_state(&factorization.graph, &factorization.blocks, &mut hash);
        checked.hash(&mut hash);
        hash.write_u8(u8::from(background.is_some()));
        background.iter().for_each(|background| background.hash_state(&mut hash));
        hash.write_u64(*steps);
        hash.finish()
    }

    /// All estimates, exact, laid out as the linearization points.
    pub(crate) fn estimate_points(&self) -> Result<Vec<f64>, SmootherError> {
        Ok(self.factorization.estimate_points(self.engine.instructions)?)
    }
}
