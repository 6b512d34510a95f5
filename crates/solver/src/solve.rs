//! Back-substitution: from the factorization to δ, the step from linearization point to estimate.
//!
//! A clique gives `R_ff δ_f = −d − R_fs δ_s`, so δ is found from the roots down. Three ways:
//! [`all`] (exact, everything), [`path`] and [`paths`] (exact, only what one variable or some need) and
//! [`State::refresh`] (only what has changed by more than a tolerance).

use std::collections::HashMap;
use std::hash::{Hash, Hasher};

use evergraph_model::{Graph, GraphError, VariableIndex};
use pulp::{Simd, WithSimd};

use crate::dense::Instructions;
use crate::index::CliqueIndex;
use crate::tree::{Clique, Numeric, Tree};

/// Solves one clique for its frontal scalars from `first` on, which are left in `scratch`; what is
/// before them means nothing. `read` writes a separator variable's δ to the front of a slice, and
/// says how long it is. O(frontal · front).
pub(crate) fn solve_clique(
    instructions: Instructions,
    clique: &Clique,
    first: usize,
    scratch: &mut Vec<f64>,
    read: impl Fn(VariableIndex, &mut [f64]) -> usize,
) {
    let layout = clique.numeric.layout;
    let (n, frontal) = (layout.columns(), layout.frontal());
    scratch.resize(layout.rows(), 0.0);
    let mut at = frontal;
    for &v in &clique.structure.separator {
        at += read(v, &mut scratch[at..]);
    }
    // The right-hand side is the last entry of a row, before the padding: it joins the sum with
    // coefficient 1.
    scratch[n - 1] = 1.0;
    scratch[n..].fill(0.0);
    let op = BackSubstitute { numeric: &clique.numeric, first, solution: scratch };
    instructions.dispatch(layout, op);
    scratch.truncate(frontal);
}

/// Solves `R_ff δ_f = −d − R_fs δ_s`; the solution has δ_s, 1 and zeros behind the frontal part.
struct BackSubstitute<'a> {
    numeric: &'a Numeric,
    first: usize,
    solution: &'a mut [f64],
}

impl WithSimd for BackSubstitute<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { numeric, first, solution } = self;
        let layout = numeric.layout;
        let (own, given) = solution.split_at_mut(layout.frontal());
        let rows = || numeric.panel().chunks_exact(layout.rows()).enumerate().skip(first);
        // First what no row has to wait for another for: this is most of the work.
        for (j, row) in rows() {
            own[j] = dot(simd, &row[layout.frontal()..], given);
        }
        for (j, row) in rows().rev() {
            let sum = own[j] + dot(simd, &row[j + 1..layout.frontal()], &own[j + 1..]);
            own[j] = -sum / row[j];
        }
    }
}

/// The inner product, in two interleaved sums. What is not a whole vector comes first: rows end at
/// whole vectors.
#[inline(always)]
fn dot<S: Simd>(simd: S, x: &[f64], y: &[f64]) -> f64 {
    let rest = x.len() % S::F64_LANES;
    let (x_rest, x) = x.split_at(rest);
    let (y_rest, y) = y.split_at(rest);
    let scalars: f64 = x_rest.iter().zip(y_rest).map(|(x, y)| x * y).sum();
    let (x_pairs, x_last) = S::as_simd_f64s(x).0.as_chunks::<2>();
    let (y_pairs, y_last) = S::as_simd_f64s(y).0.as_chunks::<2>();
    let mut sums = [simd.splat_f64s(0.0); 2];
    for (x, y) in x_pairs.iter().zip(y_pairs) {
        sums[0] = simd.mul_add_e_f64s(x[0], y[0], sums[0]);
        sums[1] = simd.mul_add_e_f64s(x[1], y[1], sums[1]);
    }
    for (x, y) in x_last.iter().zip(y_last) {
        sums[0] = simd.mul_add_e_f64s(*x, *y, sums[0]);
    }
    scalars + simd.reduce_sum_f64s(simd.add_f64s(sums[0], sums[1]))
}

/// Copies `from` to the front of `to`; its length.
pub(crate) fn copy_to_front(from: &[f64], to: &mut [f64]) -> usize {
    to[..from.len()].copy_from_slice(from);
    from.len()
}

/// δ of every variable, exact; laid out by tangent ranges.
pub(crate) fn all(instructions: Instructions, graph: &Graph, tree: &Tree) -> Vec<f64> {
    let mut delta = vec![0.0; graph.tangent_len()];
    let mut scratch = Vec::new();
    for index in tree.top_down() {
        let clique = tree.clique(index);
        solve_clique(instructions, clique, 0, &mut scratch, |v, out| {
            copy_to_front(&delta[graph.tangent_range(v)], out)
        });
        let mut at = 0;
        for &v in &clique.structure.frontals {
            let range = graph.tangent_range(v);
            let dim = range.len();
            delta[range].copy_from_slice(&scratch[at..at + dim]);
            at += dim;
        }
    }
    delta
}

/// δ of one variable, exact: solves the cliques between its root and its own. Zero for a fixed one.
pub(crate) fn path(
    instructions: Instructions,
    graph: &Graph,
    tree: &Tree,
    variable: VariableIndex,
) -> Vec<f64> {
    let Some(own) = tree.clique_of(variable).some() else {
        return vec![0.0; graph.dim_at(variable)];
    };
    let mut solved = Solved { instructions, graph, tree, cliques: HashMap::new() };
    for clique in tree.path_to(own) {
        // Of the variable's own clique only what is solved before it: of the newest, itself.
        let first = if clique == own { offset_of(graph, tree.clique(own), variable) } else { 0 };
        solved.solve(clique, first);
    }
    solved.of(variable).to_vec()
}

/// δ of each variable, exact: [`path`], but cliques above several of them are solved once.
pub(crate) fn paths(
    instructions: Instructions,
    graph: &Graph,
    tree: &Tree,
    variables: &[VariableIndex],
) -> Vec<Vec<f64>> {
    let mut solved = Solved { instructions, graph, tree, cliques: HashMap::new() };
    let mut delta = |variable: VariableIndex| {
        let Some(own) = tree.clique_of(variable).some() else {
            return vec![0.0; graph.dim_at(variable)];
        };
        for clique in tree.path_to(own) {
            if !solved.cliques.contains_key(&clique) {
                solved.solve(clique, 0);
            }
        }
        solved.of(variable).to_vec()
    };
    variables.iter().map(|&variable| delta(variable)).collect()
}

/// Some cliques' frontal δ, those of all cliques above them included.
struct Solved<'a> {
    instructions: Instructions,
    graph: &'a Graph,
    tree: &'a Tree,
    cliques: HashMap<CliqueIndex, Vec<f64>>,
}

impl Solved<'_> {
    /// Solves one more clique for its frontal scalars from `first` on, after those above it.
    fn solve(&mut self, index: CliqueIndex, first: usize) {
        let mut scratch = Vec::new();
        let clique = self.tree.clique(index);
        solve_clique(self.instructions, clique, first, &mut scratch, |v, out| {
            copy_to_front(self.of(v), out)
        });
        self.cliques.insert(index, scratch);
    }

    /// δ of a variable that is frontal in one of the cliques.
    fn of(&self, variable: VariableIndex) -> &[f64] {
        let owner = self.tree.clique_of(variable);
        frontal_part(self.graph, self.tree.clique(owner), &self.cliques[&owner], variable)
    }
}

/// The entries of `solution` (of a clique's frontals) that belong to `variable`.
fn frontal_part<'a>(
    graph: &Graph,
    clique: &Clique,
    solution: &'a [f64],
    variable: VariableIndex,
) -> &'a [f64] {
    let start = offset_of(graph, clique, variable);
    &solution[start..start + graph.dim_at(variable)]
}

/// Where a frontal variable's scalars begin among those of its clique.
fn offset_of(graph: &Graph, clique: &Clique, variable: VariableIndex) -> usize {
    let before = clique.structure.frontals.iter().take_while(|&&v| v != variable);
    before.map(|&v| graph.dim_at(v)).sum()
}

/// δ kept between updates, and when each variable's last moved.
///
/// A change of δ is passed down the tree while it is large; small ones add up where they stopped,
/// and a fine pass takes them further.
#[derive(Debug, Default)]
pub(crate) struct State {
    /// By tangent range; within the finer tolerance of the exact solution after a fine pass.
    pub(crate) delta: Vec<f64>,
    /// After an optimization the estimate is the point that it found, which is the linearization
    /// point, and not the point moved by δ: where the optimization did not converge, the next
    /// Gauss-Newton step would lead away from it.
    pub(crate) is_at_points: bool,
    /// δ as of the last time when it changed by more than the coarser tolerance.
    coarse: Vec<f64>,
    /// By variable slot: the times when `delta` and `coarse` last changed.
    changed: Vec<(u64, u64)>,
    clock: u64,
    /// Variables with a component of δ beyond the threshold of the passes so far, perhaps more
    /// than once or no longer; see [`State::moved_beyond`].
    pub(crate) far: Vec<VariableIndex>,
    seen: Vec<bool>,
    stack: Vec<CliqueIndex>,
    scratch: Vec<f64>,
}

/// How far a pass of [`State::refresh`] goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pass {
    /// Changes of δ up to this are not kept.
    pub(crate) fine: f64,
    /// Changes up to this are kept, but not passed on, unless `is_fine`.
    pub(crate) coarse: f64,
    pub(crate) is_fine: bool,
    /// Variables with a component of δ beyond this are remembered.
    pub(crate) threshold: f64,
}

impl Clone for State {
    /// Without the buffers of a pass.
    fn clone(&self) -> Self {
        Self {
            delta: self.delta.clone(),
            is_at_points: self.is_at_points,
            coarse: self.coarse.clone(),
            changed: self.changed.clone(),
            clock: self.clock,
            far: self.far.clone(),
            seen: Vec::new(),
            stack: Vec::new(),
            scratch: Vec::new(),
        }
    }
}

impl State {
    /// Makes room for the graph's variables.
    pub(crate) fn resize(&mut self, graph: &Graph) {
        self.delta.resize(graph.tangent_len(), 0.0);
        self.coarse.resize(graph.tangent_len(), 0.0);
        self.changed.resize(graph.variable_slots(), (0, 0));
    }

    /// Starts a variable at δ = 0.
    pub(crate) fn reset(&mut self, graph: &Graph, variable: VariableIndex) {
        self.delta[graph.tangent_range(variable)].fill(0.0);
        self.coarse[graph.tangent_range(variable)].fill(0.0);
        self.changed[variable.index()] = (self.clock, self.clock);
    }

    /// The distance that a variable in a root has moved since the last refresh; 0 for another variable.
    /// Allocates nothing. O(dim · root).
    pub(crate) fn jump(
        &mut self,
        instructions: Instructions,
        graph: &Graph,
        tree: &Tree,
        variable: VariableIndex,
    ) -> f64 {
        let Some(own) = tree.clique_of(variable).some() else { return 0.0 };
        let clique = tree.clique(own);
        if self.is_at_points || clique.parent.some().is_some() {
            return 0.0;
        }
        let first = offset_of(graph, clique, variable);
        solve_clique(instructions, clique, first, &mut self.scratch, |_, _| 0);
        let known = &self.delta[graph.tangent_range(variable)];
        let moved = self.scratch[first..].iter().zip(known).map(|(new, old)| (new - old).abs());
        moved.fold(0.0, f64::max)
    }

    /// A variable's point moved by its δ as of the last refresh.
    ///
    /// # Errors
    /// The manifold panics or gives a value that is not finite.
    pub(crate) fn moved(
        &self,
        graph: &Graph,
        variable: VariableIndex,
        point: &[f64],
        out: &mut [f64],
    ) -> Result<(), GraphError> {
        graph.retract(variable, point, &self.delta[graph.tangent_range(variable)], out)
    }

    /// Solves cliques that are new, or whose separator has moved since they were last solved; by
    /// running intersection the subtree of any other clique is left alone, unless an earlier pass
    /// stopped there.
    pub(crate) fn refresh(
        &mut self,
        instructions: Instructions,
        graph: &Graph,
        tree: &mut Tree,
        pass: Pass,
    ) {
        self.clock += 1;
        let mut stack = std::mem::take(&mut self.stack);
        stack.clear();
        stack.extend(tree.roots.iter().copied());
        while let Some(index) = stack.pop() {
            let clique = tree.clique(index);
            let (mut fine, mut coarse) = (false, false);
            for &v in &clique.structure.separator {
                let changed = self.changed[v.index()];
                fine |= changed.0 > clique.solved;
                coarse |= changed.1 > clique.solved;
            }
            if clique.solved == 0 || if pass.is_fine { fine } else { coarse } {
                self.solve(instructions, graph, clique, pass);
                tree.clique_mut(index).solved = self.clock;
            } else if !(pass.is_fine && clique.unfinished) {
                // A fine pass has to come this way.
                let parent = clique.parent;
                if fine && let Some(parent) = parent.some() {
                    tree.mark_unfinished(parent);
                }
                continue;
            }
            stack.extend(tree.clique(index).children.iter().copied());
            if pass.is_fine {
                tree.clique_mut(index).unfinished = false;
            }
        }
        self.stack = stack;
    }

    /// Solves a clique, and notes what that changes.
    fn solve(&mut self, instructions: Instructions, graph: &Graph, clique: &Clique, pass: Pass) {
        let mut scratch = std::mem::take(&mut self.scratch);
        solve_clique(instructions, clique, 0, &mut scratch, |v, out| {
            copy_to_front(&self.delta[graph.tangent_range(v)], out)
        });
        let mut at = 0;
        for &v in &clique.structure.frontals {
            let range = graph.tangent_range(v);
            let new = &scratch[at..at + range.len()];
            at += range.len();
            if is_beyond(new, &self.delta[range.clone()], pass.fine) {
                self.delta[range.clone()].copy_from_slice(new);
                self.changed[v.index()].0 = self.clock;
                if is_beyond(new, &self.coarse[range.clone()], pass.coarse) {
                    self.coarse[range].copy_from_slice(new);
                    self.changed[v.index()].1 = self.clock;
                }
                if new.iter().any(|x| x.abs() > pass.threshold) {
                    self.far.push(v);
                }
            }
        }
        self.scratch = scratch;
    }

    /// Bytes of δ and the times of its changes.
    pub(crate) fn memory_bytes(&self) -> usize {
        8 * (self.delta.capacity() + self.coarse.capacity())
            + size_of::<(u64, u64)>() * self.changed.capacity()
    }

    /// Feeds all of it but buffers to a hash; of variables, those that exist.
    pub(crate) fn hash_state(&self, graph: &Graph, hash: &mut impl Hasher) {
        let Self {
            delta,
            is_at_points,
            coarse,
            changed,
            clock,
            far,
            seen: _,
            stack: _,
            scratch: _,
        } = self;
        (is_at_points, clock, far).hash(hash);
        for v in graph.variable_indices() {
            let range = graph.tangent_range(v);
            let numbers = delta[range.clone()].iter().chain(&coarse[range]);
            numbers.for_each(|x| hash.write_u64(x.to_bits()));
            changed[v.index()].hash(hash);
        }
    }

    /// If δ has a component beyond `threshold` anywhere: the variables with one beyond `reach`, in
    /// the order in which they were solved for. `smallest` is the threshold that every pass was
    /// given. Costs what has moved, not the whole graph.
    pub(crate) fn moved_beyond(
        &mut self,
        graph: &Graph,
        threshold: f64,
        reach: f64,
        smallest: f64,
    ) -> Moved {
        let Self { far, seen, delta, .. } = self;
        seen.resize(graph.variable_slots(), false);
        let beyond = |v: VariableIndex, limit: f64| {
            delta[graph.tangent_range(v)].iter().any(|d| d.abs() > limit)
        };
        far.retain(|&v| {
            graph.is_variable_at(v)
                && beyond(v, smallest)
                && !std::mem::replace(&mut seen[v.index()], true)
        });
        let mut largest = 0.0;
        for &v in far.iter() {
            seen[v.index()] = false;
            for d in &delta[graph.tangent_range(v)] {
                if d.abs() > largest {
                    largest = d.abs();
                }
            }
        }
        let variables = match largest > threshold {
            true => far.iter().copied().filter(|&v| beyond(v, reach)).collect(),
            false => Vec::new(),
        };
        Moved { variables, largest }
    }
}

/// The result of [`State::moved_beyond`].
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moved {
    /// The variables to relinearize.
    pub(crate) variables: Vec<VariableIndex>,
    /// Largest component of δ among those beyond the smallest threshold; 0 without any.
    pub(crate) largest: f64,
}

/// Whether two vectors differ by more than `tolerance` anywhere.
pub(crate) fn is_beyond(x: &[f64], y: &[f64], tolerance: f64) -> bool {
    x.iter().zip(y).any(|(x, y)| (x - y).abs() > tolerance)
}
