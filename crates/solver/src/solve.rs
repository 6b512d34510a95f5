//! Back-substitution: from the factorization to δ, the step from linearization point to estimate.
//!
//! A clique gives `R_ff δ_f = −d − R_fs δ_s`, so δ is found from the roots down. Three ways:
//! [`all`] (exact, everything), [`path`] (exact, only what one variable needs) and
//! [`State::refresh`] (only what has changed by more than a tolerance).

use evergraph_model::Graph;

use crate::tree::{Clique, Tree};

/// Solves one clique for its frontals, given a way to read the separator's δ.
/// `out` has `frontal_dim` entries. O(frontal · front).
fn solve_clique(
    graph: &Graph,
    clique: &Clique,
    scratch: &mut Vec<f64>,
    read: impl Fn(u32, &mut [f64]),
) {
    let layout = clique.numeric.layout;
    let (n, frontal) = (layout.columns(), layout.frontal());
    scratch.clear();
    scratch.resize(n, 0.0);
    let mut at = frontal;
    for &v in &clique.structure.separator {
        let dim = graph.dim_at(v as usize);
        read(v, &mut scratch[at..at + dim]);
        at += dim;
    }
    // The right-hand side is the last entry of a row: it joins the sum with coefficient 1.
    scratch[n - 1] = 1.0;
    for j in (0..frontal).rev() {
        let row = clique.numeric.row(j);
        scratch[j] = -dot(&row[1..], &scratch[j + 1..]) / row[0];
    }
    scratch.truncate(frontal);
}

/// The inner product in eight interleaved sums, which the compiler turns into vectors.
fn dot(x: &[f64], y: &[f64]) -> f64 {
    let (x_chunks, x_rest) = x.as_chunks::<8>();
    let (y_chunks, y_rest) = y.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (x, y) in x_chunks.iter().zip(y_chunks) {
        for k in 0..8 {
            sums[k] += x[k] * y[k];
        }
    }
    let rest: f64 = x_rest.iter().zip(y_rest).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f64>() + rest
}

/// δ of every variable, exact; laid out by tangent ranges.
pub(crate) fn all(graph: &Graph, tree: &Tree) -> Vec<f64> {
    let mut delta = vec![0.0; graph.tangent_len()];
    let mut scratch = Vec::new();
    for index in tree.top_down() {
        let clique = tree.clique(index);
        solve_clique(graph, clique, &mut scratch, |v, out| {
            out.copy_from_slice(&delta[graph.tangent_range(v as usize)]);
        });
        let mut at = 0;
        for &v in &clique.structure.frontals {
            let range = graph.tangent_range(v as usize);
            let dim = range.len();
            delta[range].copy_from_slice(&scratch[at..at + dim]);
            at += dim;
        }
    }
    delta
}

/// δ of one variable, exact: solves the cliques between its root and its own.
pub(crate) fn path(graph: &Graph, tree: &Tree, variable: u32) -> Vec<f64> {
    let path = tree.path_to(tree.clique_of(variable));
    // Where on the path each clique stands; the newest variable's path is a single clique.
    let mut places: Vec<(u32, usize)> =
        path.iter().enumerate().map(|(place, &c)| (c, place)).collect();
    places.sort_unstable();
    let mut solved: Vec<Vec<f64>> = Vec::with_capacity(path.len());
    for &index in &path {
        let mut scratch = Vec::new();
        solve_clique(graph, tree.clique(index), &mut scratch, |v, out| {
            let owner = tree.clique_of(v);
            let place = places
                .binary_search_by_key(&owner, |p| p.0)
                .expect("separators are frontal further up");
            out.copy_from_slice(frontal_part(
                graph,
                tree.clique(owner),
                &solved[places[place].1],
                v,
            ));
        });
        solved.push(scratch);
    }
    let own = path.len() - 1;
    frontal_part(graph, tree.clique(path[own]), &solved[own], variable).to_vec()
}

/// The entries of `solution` (of a clique's frontals) that belong to `variable`.
fn frontal_part<'a>(
    graph: &Graph,
    clique: &Clique,
    solution: &'a [f64],
    variable: u32,
) -> &'a [f64] {
    let mut at = 0;
    for &v in &clique.structure.frontals {
        let dim = graph.dim_at(v as usize);
        if v == variable {
            return &solution[at..at + dim];
        }
        at += dim;
    }
    unreachable!("the clique eliminates the variable")
}

/// δ kept between updates, and when each variable's last moved.
#[derive(Clone, Debug, Default)]
pub(crate) struct State {
    /// By tangent range; within the tolerance of the exact solution after a refresh.
    pub(crate) delta: Vec<f64>,
    /// By variable slot: the time when δ last changed by more than the tolerance.
    changed: Vec<u64>,
    clock: u64,
    /// Variables with a component of δ beyond the threshold of the last refreshes, perhaps more
    /// than once or no longer; see [`State::moved_beyond`].
    far: Vec<u32>,
    scratch: Vec<f64>,
}

impl State {
    /// Makes room for the graph's variables.
    pub(crate) fn resize(&mut self, graph: &Graph) {
        self.delta.resize(graph.tangent_len(), 0.0);
        self.changed.resize(graph.variable_slots(), 0);
    }

    /// Starts a variable at δ = 0.
    pub(crate) fn reset(&mut self, graph: &Graph, variable: usize) {
        self.delta[graph.tangent_range(variable)].fill(0.0);
        self.changed[variable] = self.clock;
    }

    /// Solves cliques that are new, or whose separator has moved by more than `tolerance` since
    /// they were last solved; by running intersection the subtree of any other clique is left
    /// alone. Remembers what lies beyond `threshold`.
    pub(crate) fn refresh(
        &mut self,
        graph: &Graph,
        tree: &mut Tree,
        tolerance: f64,
        threshold: f64,
    ) {
        self.clock += 1;
        let mut stack: Vec<u32> = tree.roots.iter().copied().collect();
        while let Some(index) = stack.pop() {
            let clique = tree.clique(index);
            let separator = &clique.structure.separator;
            let dirty = clique.solved == 0
                || separator.iter().any(|&v| self.changed[v as usize] > clique.solved);
            if !dirty {
                continue;
            }
            let mut scratch = std::mem::take(&mut self.scratch);
            solve_clique(graph, clique, &mut scratch, |v, out| {
                out.copy_from_slice(&self.delta[graph.tangent_range(v as usize)]);
            });
            let mut at = 0;
            for &v in &clique.structure.frontals {
                let range = graph.tangent_range(v as usize);
                let new = &scratch[at..at + range.len()];
                at += range.len();
                let old = &mut self.delta[range];
                let moved =
                    new.iter().zip(old.iter()).any(|(new, old)| (new - old).abs() > tolerance);
                if moved {
                    old.copy_from_slice(new);
                    self.changed[v as usize] = self.clock;
                    if new.iter().any(|x| x.abs() > threshold) {
                        self.far.push(v);
                    }
                }
            }
            self.scratch = scratch;
            stack.extend(clique.children.iter().copied());
            tree.clique_mut(index).solved = self.clock;
        }
    }

    /// Variables whose δ has a component beyond `threshold`, ascending; `smallest` is the threshold
    /// that every refresh was given. Costs what has moved, not the whole graph.
    pub(crate) fn moved_beyond(
        &mut self,
        graph: &Graph,
        threshold: f64,
        smallest: f64,
    ) -> Vec<u32> {
        let delta = &self.delta;
        let beyond = |v: u32, limit: f64| {
            graph.is_variable_at(v as usize)
                && delta[graph.tangent_range(v as usize)].iter().any(|d| d.abs() > limit)
        };
        self.far.sort_unstable();
        self.far.dedup();
        self.far.retain(|&v| beyond(v, smallest));
        self.far.iter().copied().filter(|&v| beyond(v, threshold)).collect()
    }
}
