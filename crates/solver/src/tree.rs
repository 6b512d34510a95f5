//! The square-root information matrix R, stored as a tree of cliques.
//!
//! A clique eliminates its *frontal* variables given its *separator*; the separator's variables
//! are frontal further up. Factors belong to the clique of their first-eliminated variable.

use std::collections::BTreeSet;
use std::hash::{Hash, Hasher};

use evergraph_model::{FactorIndex, Graph, VariableIndex};
use smallvec::SmallVec;

use crate::dense::FrontLayout;
use crate::index::CliqueIndex;
use crate::pool::Pool;

/// The variables and factors of a clique. Fixed variables are in none, and factors without unknowns
/// neither.
#[derive(Clone, Debug, Default)]
pub(crate) struct Structure {
    /// In the order of elimination.
    pub(crate) frontals: SmallVec<[VariableIndex; 4]>,
    /// In the order of elimination at the time the clique was built.
    pub(crate) separator: SmallVec<[VariableIndex; 8]>,
    /// Factors whose first-eliminated variable is a frontal of this clique.
    pub(crate) factors: SmallVec<[FactorIndex; 8]>,
    /// Scalars of the frontals.
    pub(crate) frontal_dim: u32,
    /// Scalars of the separator.
    pub(crate) separator_dim: u32,
}

impl Structure {
    /// A clique that owns no factors yet.
    pub(crate) fn new(
        graph: &Graph,
        frontals: SmallVec<[VariableIndex; 4]>,
        separator: SmallVec<[VariableIndex; 8]>,
    ) -> Self {
        let dim =
            |variables: &[VariableIndex]| variables.iter().map(|&v| graph.dim_at(v) as u32).sum();
        let (frontal_dim, separator_dim) = (dim(&frontals), dim(&separator));
        Self { frontals, separator, factors: SmallVec::new(), frontal_dim, separator_dim }
    }

    /// The front: frontals, separator, right-hand side.
    #[inline(always)]
    pub(crate) fn layout(&self) -> FrontLayout {
        FrontLayout::new(self.frontal_dim as usize, self.separator_dim as usize + 1)
    }

    /// What it costs to eliminate the clique, in units of about a nanosecond: arithmetic, traffic
    /// of the front, and what any clique costs. A rough guide for budgets.
    pub(crate) fn cost(&self) -> f64 {
        let (f, n) = (f64::from(self.frontal_dim), self.layout().columns() as f64);
        0.06 * f * n * n + n * n + 400.0
    }

    pub(crate) fn variables(&self) -> impl Iterator<Item = VariableIndex> {
        self.frontals.iter().chain(&self.separator).copied()
    }
}

/// The numbers of an eliminated clique, in one buffer:
///
/// - the panel `[R_ff R_fs d]ᵀ`, the frontal columns of a front ([`FrontLayout`]);
/// - the contribution, what is left for the parent, as [`Form`] says;
/// - for each separator scalar, the sum of squares of its Jacobian column over all factors of the
///   subtree; complete once it reaches the clique where the scalar is frontal, where it is the
///   measure of a pivot;
/// - for a square root, as many numbers again: an error that stands for the rounding in each separator
///   scalar's column, in units of ε (see `eliminate/rows.rs`).
#[derive(Clone, Debug)]
pub(crate) struct Numeric {
    pub(crate) layout: FrontLayout,
    pub(crate) form: Form,
    pub(crate) data: Vec<f64>,
    /// Smallest pivot over its diagonal entry of JᵀJ.
    pub(crate) pivot_ratio: f64,
    /// Smallest pivot ratio of the whole subtree: what its contribution has lost.
    pub(crate) weakest: f64,
}

/// How a contribution, the information that a subtree passes on about its separator and right-hand
/// side, is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Form {
    /// Schur complement: the triangle of a front.
    Information,
    /// A square root of it: `rows` × `order`, upper trapezoidal, column-major.
    Root { rows: u32 },
}

impl Form {
    pub(crate) fn is_root(self) -> bool {
        matches!(self, Self::Root { .. })
    }

    /// Numbers in a contribution.
    fn len(self, layout: FrontLayout) -> usize {
        match self {
            Self::Information => layout.triangle_len(),
            Self::Root { rows } => rows as usize * layout.order(),
        }
    }

    /// Numbers after a contribution: the diagonal of JᵀJ, and the rounding of a square root.
    #[inline(always)]
    fn tail(self, layout: FrontLayout) -> usize {
        let separator = layout.order() - 1;
        if self.is_root() { 2 * separator } else { separator }
    }
}

impl Numeric {
    /// Numbers in the buffer of a clique.
    pub(crate) fn len(layout: FrontLayout, form: Form) -> usize {
        layout.panel_len() + form.len(layout) + form.tail(layout)
    }

    /// The frontal columns: `layout.rows()` each.
    pub(crate) fn panel(&self) -> &[f64] {
        &self.data[..self.layout.panel_len()]
    }

    /// Whether the right-hand side is finite; anything else that is not reaches a pivot on the way
    /// up.
    pub(crate) fn has_finite_rhs(&self) -> bool {
        let last = self.layout.columns() - 1;
        self.is_without_panel()
            || self.panel().chunks_exact(self.layout.rows()).all(|row| row[last].is_finite())
    }

    /// Row `j` of `[R_ff R_fs d]`, from the diagonal on.
    pub(crate) fn row(&self, j: usize) -> &[f64] {
        let start = j * self.layout.rows();
        &self.data[start + j..start + self.layout.columns()]
    }

    /// The contribution. There need not be a panel before it.
    #[inline(always)]
    pub(crate) fn contribution(&self) -> &[f64] {
        let end = self.data.len() - self.form.tail(self.layout);
        &self.data[end - self.form.len(self.layout)..end]
    }

    /// Whether the panel is left out, because it is that of a clique which is shortened.
    pub(crate) fn is_without_panel(&self) -> bool {
        self.data.len() < Self::len(self.layout, self.form)
    }

    /// The diagonal of JᵀJ for the separator.
    #[inline(always)]
    pub(crate) fn diagonal(&self) -> &[f64] {
        let start = self.data.len() - self.form.tail(self.layout);
        &self.data[start..start + self.layout.order() - 1]
    }

    /// Errors that stand for rounding in the separator's columns of a square root, in units of ε.
    pub(crate) fn rounding(&self) -> &[f64] {
        debug_assert!(self.form.is_root());
        &self.data[self.data.len() - (self.layout.order() - 1)..]
    }

    /// Feeds all numbers to a hash.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        let Self { layout, form, data, pivot_ratio, weakest } = self;
        (layout, form, pivot_ratio.to_bits(), weakest.to_bits()).hash(hash);
        data.iter().for_each(|x| hash.write_u64(x.to_bits()));
    }

    /// Makes the numbers of a clique those of its first frontals alone, given these without their
    /// panel.
    pub(crate) fn shorten(&mut self, first: &Self) {
        debug_assert_eq!(first.layout.columns(), self.layout.columns());
        self.data.truncate(first.layout.panel_len());
        self.data.extend_from_slice(&first.data);
        self.layout = first.layout;
        (self.pivot_ratio, self.weakest) = (first.pivot_ratio, first.weakest);
    }
}

/// A node of the tree.
#[derive(Clone, Debug)]
pub(crate) struct Clique {
    pub(crate) structure: Structure,
    pub(crate) numeric: Numeric,
    pub(crate) parent: CliqueIndex,
    pub(crate) children: SmallVec<[CliqueIndex; 4]>,
    /// When its frontals were last solved for; 0 is never. See [`crate::solve`].
    pub(crate) solved: u64,
    /// When the estimates of its frontals were last brought up to date in the cache; 0 is never. See
    /// [`crate::estimate_cache`].
    pub(crate) cached: u64,
    /// Whether a pass of back-substitution stopped at a child, or somewhere below.
    pub(crate) unfinished: bool,
    /// Number of this clique among all that the tree ever had.
    pub(crate) birth: u64,
}

/// The clique array is shortened when it has more slots than this ...
const FEW_SLOTS: usize = 1024;
/// ... and than this many times the living cliques.
const SLOT_SHARE: usize = 4;

/// The cliques, and which of them eliminates each variable.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    cliques: Vec<Option<Clique>>,
    free: Vec<CliqueIndex>,
    /// By variable slot.
    clique_of: Vec<CliqueIndex>,
    pub(crate) roots: BTreeSet<CliqueIndex>,
    births: u64,
    /// Numbers in the buffers of all cliques.
    numbers: usize,
}

impl Clone for Tree {
    /// With buffers of just the size of their contents.
    fn clone(&self) -> Self {
        let cliques = self.cliques.clone();
        let numbers = cliques.iter().flatten().map(|clique| clique.numeric.data.capacity()).sum();
        Self {
            cliques,
            free: self.free.clone(),
            clique_of: self.clique_of.clone(),
            roots: self.roots.clone(),
            births: self.births,
            numbers,
        }
    }
}

impl Tree {
    pub(crate) fn clique(&self, index: CliqueIndex) -> &Clique {
        self.cliques[index.index()].as_ref().expect("links of the tree lead to living cliques")
    }

    pub(crate) fn clique_mut(&mut self, index: CliqueIndex) -> &mut Clique {
        self.cliques[index.index()].as_mut().expect("links of the tree lead to living cliques")
    }

    /// The parent of a clique, unless it is a root.
    pub(crate) fn parent_of(&self, index: CliqueIndex) -> Option<CliqueIndex> {
        self.clique(index).parent.some()
    }

    /// The clique that eliminates a variable; [`NONE`](CliqueIndex::NONE) for fixed variables.
    #[inline]
    pub(crate) fn clique_of(&self, variable: VariableIndex) -> CliqueIndex {
        self.clique_of.get(variable.index()).copied().unwrap_or(CliqueIndex::NONE)
    }

    /// Length of the clique array, living or not.
    pub(crate) fn slots(&self) -> usize {
        self.cliques.len()
    }

    pub(crate) fn len(&self) -> usize {
        self.cliques.len() - self.free.len()
    }

    /// The living cliques, by slot.
    pub(crate) fn indices(&self) -> impl Iterator<Item = CliqueIndex> {
        let living = self.cliques.iter().enumerate().filter(|(_, clique)| clique.is_some());
        living.map(|(index, _)| CliqueIndex::new(index))
    }

    /// Whether a clique is still there, unchanged but for its numbers.
    pub(crate) fn is_alive(&self, index: CliqueIndex, birth: u64) -> bool {
        let clique = self.cliques.get(index.index()).and_then(Option::as_ref);
        clique.is_some_and(|clique| clique.birth == birth)
    }

    pub(crate) fn insert(&mut self, mut clique: Clique) -> CliqueIndex {
        self.births += 1;
        self.numbers += clique.numeric.data.capacity();
        clique.birth = self.births;
        let index = match self.free.pop() {
            Some(index) => index,
            None => {
                self.cliques.push(None);
                CliqueIndex::new(self.cliques.len() - 1)
            }
        };
        for &v in &clique.structure.frontals {
            if self.clique_of.len() <= v.index() {
                self.clique_of.resize(v.index() + 1, CliqueIndex::NONE);
            }
            self.clique_of[v.index()] = index;
        }
        self.cliques[index.index()] = Some(clique);
        index
    }

    pub(crate) fn remove(&mut self, index: CliqueIndex) -> Option<Clique> {
        let clique = self.cliques[index.index()].take()?;
        self.free.push(index);
        self.numbers -= clique.numeric.data.capacity();
        self.roots.remove(&index);
        for &v in &clique.structure.frontals {
            self.clique_of[v.index()] = CliqueIndex::NONE;
        }
        Some(clique)
    }

    /// Gives a clique new numbers.
    pub(crate) fn replace_numeric(
        &mut self,
        index: CliqueIndex,
        numeric: Numeric,
        pool: &mut Pool,
    ) {
        let new = numeric.data.capacity();
        let clique = self.clique_mut(index);
        let old = std::mem::replace(&mut clique.numeric, numeric).data;
        (clique.solved, clique.cached) = (0, 0);
        self.numbers = self.numbers + new - old.capacity();
        pool.give(old);
    }

    /// Tells the children of a new clique that it is their parent.
    pub(crate) fn adopt(&mut self, index: CliqueIndex) {
        for at in 0..self.clique(index).children.len() {
            let child = self.clique(index).children[at];
            self.clique_mut(child).parent = index;
            self.clique_mut(index).unfinished |= self.clique(child).unfinished;
        }
    }

    /// Remembers, in a clique and all above it, that a pass of back-substitution stopped there.
    pub(crate) fn mark_unfinished(&mut self, mut index: CliqueIndex) {
        while index != CliqueIndex::NONE && !self.clique(index).unfinished {
            let clique = self.clique_mut(index);
            clique.unfinished = true;
            index = clique.parent;
        }
    }

    /// All cliques, parents before children, roots in their order.
    pub(crate) fn top_down(&self) -> Vec<CliqueIndex> {
        let mut order = Vec::with_capacity(self.len());
        order.extend(self.roots.iter().copied());
        let mut next = 0;
        while next < order.len() {
            order.extend(self.clique(order[next]).children.iter().copied());
            next += 1;
        }
        order
    }

    /// The path from a root down to `index`, both included.
    pub(crate) fn path_to(&self, index: CliqueIndex) -> Vec<CliqueIndex> {
        let mut path = vec![index];
        let mut current = self.clique(index).parent;
        while current != CliqueIndex::NONE {
            path.push(current);
            current = self.clique(current).parent;
        }
        path.reverse();
        path
    }

    /// Scalars in the upper triangle of R.
    pub(crate) fn nonzeros(&self) -> usize {
        self.cliques
            .iter()
            .flatten()
            .map(|c| {
                let (f, s) = (c.structure.frontal_dim as usize, c.structure.separator_dim as usize);
                f * (f + 1) / 2 + f * s
            })
            .sum()
    }

    /// Feeds structure and numbers to a hash; not when estimates were cached, on which no later
    /// answer depends.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        let Self { cliques, free, clique_of, roots, births, numbers: _ } = self;
        (free, roots, clique_of, births).hash(hash);
        for (index, clique) in cliques.iter().enumerate() {
            let Some(clique) = clique else { continue };
            let Clique {
                structure,
                numeric,
                parent,
                children,
                solved,
                cached: _,
                unfinished,
                birth,
            } = clique;
            (index, parent, children.as_slice(), solved, unfinished, birth).hash(hash);
            // The dimensions follow from the frontals and the separator.
            let Structure { frontals, separator, factors, frontal_dim: _, separator_dim: _ } =
                structure;
            (frontals.as_slice(), separator.as_slice(), factors.as_slice()).hash(hash);
            numeric.hash_state(hash);
        }
    }

    /// Numbers in the buffers of all cliques.
    pub(crate) fn numbers(&self) -> usize {
        self.numbers
    }

    /// Frees slots at the end of the clique array when most are empty.
    pub(crate) fn trim(&mut self) {
        if self.cliques.len() <= FEW_SLOTS + SLOT_SHARE * self.len() {
            return;
        }
        while self.cliques.pop_if(|clique| clique.is_none()).is_some() {}
        let end = self.cliques.len();
        self.free.retain(|index| index.index() < end);
        self.cliques.shrink_to(2 * end);
        self.free.shrink_to(2 * end);
    }

    /// Bytes of structure and numbers.
    pub(crate) fn memory_bytes(&self) -> usize {
        let slots = size_of::<Option<Clique>>() * self.cliques.capacity();
        let lists = size_of::<CliqueIndex>() * (self.free.capacity() + self.clique_of.capacity());
        slots + lists + 8 * self.numbers
    }

    /// Smallest pivot ratio of the whole factorization; infinite for an empty tree.
    pub(crate) fn pivot_ratio(&self) -> f64 {
        self.cliques.iter().flatten().map(|c| c.numeric.pivot_ratio).fold(f64::INFINITY, f64::min)
    }
}
