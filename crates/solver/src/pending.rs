//! A relinearization that is computed a little in each step and takes effect at once.
//!
//! The linearization points of some variables are to move. Their factors are linearized at the new
//! points, and the cliques that this changes are eliminated again, bottom-up, a slice in each step,
//! while the smoother goes on with the old ones. The next step after the last slice takes the
//! results over. Cliques that updates have rebuilt in the meantime (the top of the tree, mostly) are
//! eliminated then.

use std::hash::{Hash, Hasher};

use evergraph_model::{FactorId, FactorIndex, Graph, GraphError, VariableId, VariableIndex};

use crate::index::{CliqueIndex, PendingIndex};
use crate::linearization::{Blocks, Flaw, Inserted, Overlay};
use crate::pool::Pool;
use crate::solve;
use crate::tree::{Numeric, Tree};

/// A clique of the tree as it was when the work began.
#[derive(Clone, Debug)]
struct Clique {
    index: CliqueIndex,
    /// Tells it from a later one in the same slot.
    birth: u64,
    numeric: Option<Numeric>,
}

/// A relinearization in progress, or finished and waiting to take effect.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pending {
    /// With their ids, which tell them from later ones in the same slots.
    variables: Vec<(VariableIndex, VariableId)>,
    /// Their new points, one behind the other; once swapped, the old ones.
    points: Vec<f64>,
    /// By variable slot: where its point begins in `points`; [`NO_POINT`] for others.
    place_of_variable: Vec<u32>,
    factors: Vec<(FactorIndex, FactorId)>,
    /// Their Jacobians at the new points; once swapped, the old ones.
    blocks: Overlay,
    /// Children before parents.
    cliques: Vec<Clique>,
    /// By clique slot: place in `cliques`.
    place_of_clique: Vec<PendingIndex>,
    linearized: usize,
    eliminated: usize,
    /// Work for one step, in units of about a nanosecond.
    slice: f64,
    /// The prepared results are of no use: all of it is computed when it takes effect.
    direct: bool,
}

/// No place among the new points.
const NO_POINT: u32 = u32::MAX;
/// Steps get at least this much to do, and less than this is not worth spreading ...
pub(crate) const SMALLEST_SLICE: f64 = 1e5;
/// ... and no more than this: the work of large graphs takes more steps.
const LARGEST_SLICE: f64 = 1e6;

impl Pending {
    /// Whether there is work in progress, or done.
    pub(crate) fn is_active(&self) -> bool {
        !self.variables.is_empty()
    }

    /// Whether it can take effect.
    pub(crate) fn is_ready(&self) -> bool {
        let done = self.linearized == self.factors.len() && self.eliminated == self.cliques.len();
        self.is_active() && (self.direct || done)
    }

    /// Begins to move the points of `variables` by their δ. `cliques` are those that this changes,
    /// children before parents, and `cost` is the cost of eliminating them. Returns the work, which
    /// takes about `spread` steps.
    ///
    /// # Errors
    /// A manifold panics or gives a value that is not finite; nothing is pending then.
    pub(crate) fn start(
        &mut self,
        (graph, tree, points): (&Graph, &Tree, &[f64]),
        solution: &solve::State,
        variables: &[VariableIndex],
        (cliques, cost): (&[CliqueIndex], f64),
        spread: u32,
    ) -> Result<f64, GraphError> {
        self.place_of_variable.resize(graph.variable_slots(), NO_POINT);
        for &v in variables {
            let range = graph.value_range(v);
            let start = self.points.len();
            self.points.resize(start + range.len(), 0.0);
            if let Err(error) = solution.moved(graph, v, &points[range], &mut self.points[start..])
            {
                self.forget_variables();
                return Err(error);
            }
            self.variables.push((v, graph.variable_id(v)));
            self.place_of_variable[v.index()] = start as u32;
        }
        let mut work = cost;
        for &v in variables {
            for &f in graph.factors_at(v) {
                if self.blocks.insert(graph, f) == Inserted::New {
                    self.factors.push((f, graph.factor_id(f)));
                    work += linearization_cost(graph, f);
                }
            }
        }
        self.slice = (work / f64::from(spread)).clamp(SMALLEST_SLICE, LARGEST_SLICE);
        self.place_of_clique.resize(tree.slots(), PendingIndex::NONE);
        for &index in cliques {
            self.place_of_clique[index.index()] = PendingIndex::new(self.cliques.len());
            let birth = tree.clique(index).birth;
            self.cliques.push(Clique { index, birth, numeric: None });
        }
        Ok(work)
    }

    /// Linearizes factors at the new points, for a slice of the work or until all are done. Returns
    /// the rest of the slice.
    ///
    /// # Errors
    /// The code of a factor panics: the relinearization cannot be finished.
    pub(crate) fn linearize(
        &mut self,
        graph: &Graph,
        points: &mut [f64],
        blocks: &mut Blocks,
    ) -> Result<f64, GraphError> {
        let mut left = self.slice;
        while left > 0.0 && !self.direct && self.linearized < self.factors.len() {
            left -= self.linearize_next(graph, points, blocks)?;
        }
        Ok(left)
    }

    /// Linearizes a factor at the new points of its variables. Returns the cost.
    fn linearize_next(
        &mut self,
        graph: &Graph,
        points: &mut [f64],
        blocks: &mut Blocks,
    ) -> Result<f64, GraphError> {
        let position = self.linearized;
        self.linearized += 1;
        let Some(factor) = self.living_factor(graph, position) else { return Ok(0.0) };
        for &v in graph.variables_at(factor) {
            self.swap_point(graph, v, points);
        }
        let linearized = self.blocks.linearize(blocks, graph, (factor, position), points);
        for &v in graph.variables_at(factor) {
            self.swap_point(graph, v, points);
        }
        match linearized {
            Ok(()) => {}
            // The step in which it takes effect finds the same, and reports it.
            Err(Flaw::NotFinite) => self.direct = true,
            Err(Flaw::Refused(error)) => return Err(error),
        }
        Ok(linearization_cost(graph, factor))
    }

    /// The factor at a position, unless it was dropped in the meantime.
    fn living_factor(&self, graph: &Graph, position: usize) -> Option<FactorIndex> {
        let (index, id) = self.factors[position];
        (graph.is_factor_at(index) && graph.factor_id(index) == id).then_some(index)
    }

    #[inline]
    fn swap_point(&mut self, graph: &Graph, variable: VariableIndex, points: &mut [f64]) {
        let place = self.place_of_variable.get(variable.index()).copied().unwrap_or(NO_POINT);
        if place != NO_POINT {
            let range = graph.value_range(variable);
            let own = &mut self.points[place as usize..place as usize + range.len()];
            own.swap_with_slice(&mut points[range]);
        }
    }

    /// The next clique to eliminate: its place, and its slot unless the clique is gone. The caller
    /// eliminates it and reports the result to [`set_numeric`](Self::set_numeric).
    pub(crate) fn next_clique(&mut self, tree: &Tree) -> (PendingIndex, Option<CliqueIndex>) {
        let place = PendingIndex::new(self.eliminated);
        self.eliminated += 1;
        let Clique { index, birth, .. } = self.cliques[place.index()];
        (place, tree.is_alive(index, birth).then_some(index))
    }

    /// Sets the new numbers of a clique. Without numbers the rest is left to the step in which the
    /// relinearization takes effect: that one has recourse to QR.
    pub(crate) fn set_numeric(&mut self, place: PendingIndex, numeric: Option<Numeric>) {
        self.direct |= numeric.is_none();
        self.cliques[place.index()].numeric = numeric;
    }

    /// The new numbers of a clique of the tree, if it was eliminated here and is unchanged since.
    pub(crate) fn numeric_of(&self, tree: &Tree, clique: CliqueIndex) -> Option<&Numeric> {
        let place = *self.place_of_clique.get(clique.index())?;
        let own = self.cliques.get(place.index())?;
        own.numeric.as_ref().filter(|_| own.birth == tree.clique(clique).birth)
    }

    /// Jacobians at the new points.
    pub(crate) fn overlay(&self) -> &Overlay {
        &self.blocks
    }

    /// [`overlay`](Self::overlay), for moving its blocks in memory.
    pub(crate) fn overlay_mut(&mut self) -> &mut Overlay {
        &mut self.blocks
    }

    /// The variables that still exist.
    pub(crate) fn variables<'a>(
        &'a self,
        graph: &'a Graph,
    ) -> impl Iterator<Item = VariableIndex> + 'a {
        self.variables.iter().filter(|(v, id)| is_variable(graph, *v, *id)).map(|(v, _)| *v)
    }

    /// Cliques that are unchanged and done: places and indices.
    pub(crate) fn done<'a>(
        &'a self,
        tree: &'a Tree,
    ) -> impl Iterator<Item = (PendingIndex, CliqueIndex)> + 'a {
        let cliques = self.cliques.iter().enumerate();
        cliques
            .filter(|(_, c)| !self.direct && c.numeric.is_some())
            .filter(|(_, c)| tree.is_alive(c.index, c.birth))
            .map(|(place, c)| (PendingIndex::new(place), c.index))
    }

    /// The clique at a place, and its new numbers.
    pub(crate) fn clique(&self, place: PendingIndex) -> (CliqueIndex, &Numeric) {
        let clique = &self.cliques[place.index()];
        (clique.index, clique.numeric.as_ref().expect("only finished cliques take effect"))
    }

    /// Moves the new numbers of a clique out.
    pub(crate) fn take(&mut self, place: PendingIndex) -> Option<Numeric> {
        self.cliques[place.index()].numeric.take()
    }

    /// Whether a factor has been linearized here.
    pub(crate) fn has(&self, graph: &Graph, factor: FactorIndex) -> bool {
        let position = self.blocks.position(factor);
        !self.direct && position.is_some_and(|at| self.factors[at].1 == graph.factor_id(factor))
    }

    /// Exchanges old and new points and Jacobians; twice is nothing.
    pub(crate) fn swap(&mut self, graph: &Graph, points: &mut [f64], blocks: &mut Blocks) {
        for at in 0..self.variables.len() {
            let (variable, id) = self.variables[at];
            if is_variable(graph, variable, id) {
                self.swap_point(graph, variable, points);
            }
        }
        if self.direct {
            return;
        }
        for position in 0..self.factors.len() {
            // One that was dropped in the meantime has no block here.
            if let Some(factor) = self.living_factor(graph, position) {
                self.blocks.swap(blocks, factor, position);
            }
        }
    }

    /// Discards the prepared results: the next step computes all of it.
    pub(crate) fn make_direct(&mut self) {
        self.direct = true;
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self, blocks: &mut Blocks, pool: &mut Pool) {
        self.forget_variables();
        self.factors.drain(..).for_each(|(factor, _)| self.blocks.forget(factor));
        self.blocks.clear(blocks);
        for clique in self.cliques.drain(..) {
            self.place_of_clique[clique.index.index()] = PendingIndex::NONE;
            clique.numeric.into_iter().for_each(|numeric| pool.give(numeric.data));
        }
        (self.linearized, self.eliminated, self.direct) = (0, 0, false);
    }

    fn forget_variables(&mut self) {
        for (variable, _) in self.variables.drain(..) {
            self.place_of_variable[variable.index()] = NO_POINT;
        }
        self.points.clear();
    }

    /// Feeds everything that later steps depend on to a hash. Ids count by their slots and by
    /// whether they are alive. `place_of_variable` and `place_of_clique` follow from the lists.
    pub(crate) fn hash_state(&self, graph: &Graph, blocks: &Blocks, hash: &mut impl Hasher) {
        let Self { variables, points, place_of_variable: _, factors, blocks: overlay, .. } = self;
        let Self { cliques, place_of_clique: _, linearized, eliminated, slice, direct, .. } = self;
        (variables.len(), factors.len(), cliques.len()).hash(hash);
        (linearized, eliminated, direct).hash(hash);
        if self.is_active() {
            slice.to_bits().hash(hash);
        }
        variables.iter().for_each(|&(v, id)| (v, is_variable(graph, v, id)).hash(hash));
        points.iter().for_each(|x| hash.write_u64(x.to_bits()));
        for (position, (index, _)) in factors.iter().enumerate() {
            (index, self.living_factor(graph, position).is_some()).hash(hash);
            overlay.at(blocks, position).iter().for_each(|x| hash.write_u64(x.to_bits()));
        }
        for Clique { index, birth, numeric } in cliques {
            (index, birth, numeric.is_some()).hash(hash);
            numeric.iter().for_each(|numeric| numeric.hash_state(hash));
        }
    }
}

/// Whether a slot still holds the variable with an id.
#[inline]
fn is_variable(graph: &Graph, index: VariableIndex, id: VariableId) -> bool {
    graph.is_variable_at(index) && graph.variable_id(index) == id
}

/// The cost of a linearization, in units of about a nanosecond.
fn linearization_cost(graph: &Graph, factor: FactorIndex) -> f64 {
    60.0 + 5.0 * graph.linearization_len(factor) as f64
}
