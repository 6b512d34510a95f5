//! Relinearization ahead of time: a little in each step, on the side, and taken over at once.
//!
//! The linearization points of some variables are to move. Their factors are linearized at the new
//! points, and the cliques that this changes eliminated again, bottom-up, a slice in each step,
//! while the smoother goes on with the old ones. When all is done the next step takes it over.
//! What updates have rebuilt in the meantime (the top of the tree, mostly) is eliminated then.

use std::hash::{Hash, Hasher};

use evergraph_model::{FactorId, Graph, VariableId};
use smallvec::SmallVec;

use crate::eliminate::{self, System, Workspace};
use crate::linearization::{Blocks, Overlay};
use crate::pool::Pool;
use crate::solve;
use crate::tree::{NONE, Numeric, Structure, Tree};

/// A clique of the tree as it was when the work began.
#[derive(Clone, Debug)]
struct Clique {
    index: u32,
    /// Tells it from a later one in the same slot.
    birth: u64,
    numeric: Option<Numeric>,
}

/// Work in progress, or done and waiting to be taken over.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ahead {
    variables: Vec<VariableId>,
    /// Their new points, one behind the other; once taken over, the old ones.
    points: Vec<f64>,
    /// By variable slot: where its point begins in `points`; [`NONE`] for others.
    place_of_variable: Vec<u32>,
    factors: Vec<FactorId>,
    /// Their Jacobians at the new points; once taken over, the old ones.
    blocks: Overlay,
    /// Children before parents.
    cliques: Vec<Clique>,
    /// By clique slot: place in `cliques`; [`NONE`] for others.
    place_of_clique: Vec<u32>,
    linearized: usize,
    eliminated: usize,
    /// Work for one step, in units of about a nanosecond.
    slice: f64,
    /// Something came in between: it is done at once, when it is taken over.
    direct: bool,
}

/// Steps get at least this much to do, and less than this is not worth spreading ...
pub(super) const SMALLEST_SLICE: f64 = 1e5;
/// ... and no more than this: the work of large graphs takes more steps.
const LARGEST_SLICE: f64 = 1e6;

impl Ahead {
    /// Whether there is work in progress, or done.
    pub(crate) fn is_active(&self) -> bool {
        !self.variables.is_empty()
    }

    /// Whether it can be taken over.
    pub(crate) fn is_ready(&self) -> bool {
        let done = self.linearized == self.factors.len() && self.eliminated == self.cliques.len();
        self.is_active() && (self.direct || done)
    }

    /// Begins to move the points of `variables` by their δ. `cliques` are those that this changes,
    /// children before parents, and `cost` what they cost. Returns the work, which takes about
    /// `spread` steps.
    pub(crate) fn start(
        &mut self,
        (graph, tree, points): (&Graph, &Tree, &[f64]),
        solution: &solve::State,
        variables: &[u32],
        (cliques, cost): (&[u32], f64),
        spread: u32,
    ) -> f64 {
        self.place_of_variable.resize(graph.variable_slots(), NONE);
        for &v in variables {
            self.variables.push(graph.variable_id(v as usize));
            self.place_of_variable[v as usize] = self.points.len() as u32;
            let range = graph.value_range(v as usize);
            let start = self.points.len();
            self.points.resize(start + range.len(), 0.0);
            solution.moved(graph, v as usize, &points[range], &mut self.points[start..]);
        }
        let mut work = cost;
        for &v in variables {
            for &f in graph.factors_at(v as usize) {
                if self.blocks.insert(graph, f as usize) {
                    self.factors.push(graph.factor_id(f as usize));
                    work += linearization_cost(graph, f as usize);
                }
            }
        }
        self.slice = (work / f64::from(spread)).clamp(SMALLEST_SLICE, LARGEST_SLICE);
        self.place_of_clique.resize(tree.slots(), NONE);
        for &index in cliques {
            self.place_of_clique[index as usize] = self.cliques.len() as u32;
            let birth = tree.clique(index).birth;
            self.cliques.push(Clique { index, birth, numeric: None });
        }
        work
    }

    /// Linearizes factors at the new points, for a slice of the work or until all are done; what is
    /// left of the slice.
    pub(crate) fn linearize(
        &mut self,
        graph: &Graph,
        points: &mut [f64],
        blocks: &mut Blocks,
    ) -> f64 {
        let mut left = self.slice;
        while left > 0.0 && !self.direct && self.linearized < self.factors.len() {
            left -= self.linearize_next(graph, points, blocks);
        }
        left
    }

    /// Eliminates cliques with the new Jacobians, for what is left of a slice.
    pub(crate) fn eliminate(
        &mut self,
        mut left: f64,
        system: &System<'_>,
        workspace: &mut Workspace,
    ) {
        while left > 0.0 && !self.is_ready() {
            left -= self.eliminate_next(system, workspace);
        }
    }

    /// Linearizes a factor at the new points of its variables; what that cost.
    fn linearize_next(&mut self, graph: &Graph, points: &mut [f64], blocks: &mut Blocks) -> f64 {
        let id = self.factors[self.linearized];
        self.linearized += 1;
        if graph.check_factor(id).is_err() {
            return 0.0;
        }
        let factor = id.index();
        for &v in graph.variables_at(factor) {
            self.swap_point(graph, v, points);
        }
        if !self.blocks.linearize(blocks, graph, factor, points) {
            self.direct = true;
        }
        for &v in graph.variables_at(factor) {
            self.swap_point(graph, v, points);
        }
        linearization_cost(graph, factor)
    }

    fn swap_point(&mut self, graph: &Graph, variable: u32, points: &mut [f64]) {
        let place = self.place_of_variable.get(variable as usize).copied().unwrap_or(NONE);
        if place != NONE {
            let range = graph.value_range(variable as usize);
            let own = &mut self.points[place as usize..place as usize + range.len()];
            own.swap_with_slice(&mut points[range]);
        }
    }

    /// Eliminates a clique with the new Jacobians; what that cost.
    fn eliminate_next(&mut self, system: &System<'_>, workspace: &mut Workspace) -> f64 {
        let Clique { index, birth, .. } = self.cliques[self.eliminated];
        let tree = system.tree;
        let place = self.eliminated;
        self.eliminated += 1;
        // Roots are hardly ever the same when the work is taken over.
        if !tree.is_alive(index, birth) || tree.clique(index).parent == NONE {
            return 0.0;
        }
        let clique = tree.clique(index);
        let children: SmallVec<[(&Structure, &Numeric); 4]> = clique
            .children
            .iter()
            .map(|&child| {
                let live = tree.clique(child);
                let own = self.place_of_clique.get(child as usize).copied().unwrap_or(NONE);
                let own = self.cliques.get(own as usize).filter(|c| c.birth == live.birth);
                (&live.structure, own.and_then(|c| c.numeric.as_ref()).unwrap_or(&live.numeric))
            })
            .collect();
        let system = System { overlay: Some(&self.blocks), ..*system };
        let numeric = eliminate::eliminate_one(&system, &clique.structure, &children, workspace);
        drop(children);
        // What Cholesky cannot do is done with all means when it is taken over.
        self.direct |= numeric.is_none();
        self.cliques[place].numeric = numeric;
        clique.structure.cost()
    }

    /// The variables that still exist.
    pub(crate) fn variables<'a>(&'a self, graph: &'a Graph) -> impl Iterator<Item = u32> + 'a {
        let alive = self.variables.iter().filter(|id| graph.check_variable(**id).is_ok());
        alive.map(|id| id.index() as u32)
    }

    /// Cliques that are unchanged and done: places and indices.
    pub(crate) fn done<'a>(&'a self, tree: &'a Tree) -> impl Iterator<Item = (u32, u32)> + 'a {
        let cliques = self.cliques.iter().enumerate();
        cliques
            .filter(|(_, c)| !self.direct && c.numeric.is_some())
            .filter(|(_, c)| tree.is_alive(c.index, c.birth))
            .map(|(place, c)| (place as u32, c.index))
    }

    /// The clique at a place, and its new numbers.
    pub(crate) fn clique(&self, place: u32) -> (u32, &Numeric) {
        let clique = &self.cliques[place as usize];
        (clique.index, clique.numeric.as_ref().expect("only what is done is taken over"))
    }

    /// Moves the new numbers of a clique out.
    pub(crate) fn take(&mut self, place: u32) -> Option<Numeric> {
        self.cliques[place as usize].numeric.take()
    }

    /// Whether a factor has been linearized here.
    pub(crate) fn has(&self, graph: &Graph, factor: u32) -> bool {
        let position = self.blocks.position(factor as usize);
        !self.direct
            && position.is_some_and(|at| self.factors[at] == graph.factor_id(factor as usize))
    }

    /// Exchanges old and new points and Jacobians; twice is nothing.
    pub(crate) fn swap(&mut self, graph: &Graph, points: &mut [f64], blocks: &mut Blocks) {
        for at in 0..self.variables.len() {
            if graph.check_variable(self.variables[at]).is_ok() {
                self.swap_point(graph, self.variables[at].index() as u32, points);
            }
        }
        if self.direct {
            return;
        }
        for (at, id) in self.factors.iter().enumerate() {
            // One that was dropped in the meantime has no block here.
            if graph.check_factor(*id).is_ok() {
                self.blocks.swap(blocks, id.index(), at);
            }
        }
    }

    /// What cannot be taken over as it is, is done at once in the next step.
    pub(crate) fn make_direct(&mut self) {
        self.direct = true;
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self, blocks: &mut Blocks, pool: &mut Pool) {
        for id in self.variables.drain(..) {
            self.place_of_variable[id.index()] = NONE;
        }
        self.points.clear();
        self.factors.drain(..).for_each(|id| self.blocks.forget(id.index()));
        self.blocks.clear(blocks);
        for clique in self.cliques.drain(..) {
            self.place_of_clique[clique.index as usize] = NONE;
            clique.numeric.into_iter().for_each(|numeric| pool.give(numeric.data));
        }
        (self.linearized, self.eliminated, self.direct) = (0, 0, false);
    }

    /// Feeds what the next steps depend on to a hash.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        let variables = self.variables.iter().map(|id| id.index());
        variables.for_each(|v| v.hash(hash));
        (self.linearized, self.eliminated, self.direct, self.slice.to_bits()).hash(hash);
        let done = self.cliques.iter().filter_map(|c| c.numeric.as_ref());
        let numbers = self.points.iter().chain(done.flat_map(|numeric| &numeric.data));
        numbers.for_each(|x| hash.write_u64(x.to_bits()));
    }
}

/// What a linearization costs, in units of about a nanosecond.
fn linearization_cost(graph: &Graph, factor: usize) -> f64 {
    60.0 + 5.0 * graph.linearization_len(factor) as f64
}
