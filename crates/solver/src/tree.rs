//! The square-root information matrix R, stored as a tree of cliques.
//!
//! A clique eliminates its *frontal* variables given its *separator*; the separator's variables
//! are frontal further up. Factors belong to the clique of their first-eliminated variable.

use std::collections::BTreeSet;
use std::hash::{Hash, Hasher};

use smallvec::SmallVec;

/// "No clique": of variables outside the tree, and the parent of roots.
pub(crate) const NONE: u32 = u32::MAX;

/// What a clique is made of. Variables and factors are slots of the graph.
#[derive(Clone, Debug, Default)]
pub(crate) struct Structure {
    /// In the order of elimination.
    pub(crate) frontals: SmallVec<[u32; 4]>,
    /// In the order of elimination at the time the clique was built.
    pub(crate) separator: SmallVec<[u32; 8]>,
    /// Factors whose first-eliminated variable is a frontal of this clique.
    pub(crate) factors: SmallVec<[u32; 8]>,
    /// Scalars of the frontals.
    pub(crate) frontal_dim: usize,
    /// Scalars of the separator.
    pub(crate) separator_dim: usize,
}

impl Structure {
    /// Columns of the front: frontals, separator, right-hand side.
    pub(crate) fn front_dim(&self) -> usize {
        self.frontal_dim + self.separator_dim + 1
    }

    pub(crate) fn variables(&self) -> impl Iterator<Item = u32> {
        self.frontals.iter().chain(&self.separator).copied()
    }
}

/// The numbers of an eliminated clique.
#[derive(Clone, Debug)]
pub(crate) struct Numeric {
    /// `[R_ff R_fs d]ᵀ`: column-major, `front_dim` rows, one column per frontal scalar. The upper
    /// triangle of the first rows is zero.
    pub(crate) panel: Vec<f64>,
    /// What is left for the parent.
    pub(crate) contribution: Contribution,
    /// For each separator scalar, the sum of squares of its Jacobian column over all factors of
    /// the subtree; complete once it reaches the clique where the scalar is frontal, where it is
    /// the measure of a pivot.
    pub(crate) diagonal: Vec<f64>,
    /// Smallest pivot over its diagonal entry of JᵀJ.
    pub(crate) pivot_ratio: f64,
    /// Smallest pivot ratio of the whole subtree: what its contribution has lost.
    pub(crate) weakest: f64,
}

/// The information that a subtree passes on about its separator and right-hand side.
#[derive(Clone, Debug)]
pub(crate) enum Contribution {
    /// Schur complement: lower triangle of order `separator_dim + 1`, packed by columns.
    Information(Vec<f64>),
    /// A square root of it: `rows` × (`separator_dim + 1`), upper trapezoidal, column-major.
    Root { rows: usize, data: Vec<f64> },
}

impl Contribution {
    pub(crate) fn is_root(&self) -> bool {
        matches!(self, Self::Root { .. })
    }
}

/// A node of the tree.
#[derive(Clone, Debug)]
pub(crate) struct Clique {
    pub(crate) structure: Structure,
    pub(crate) numeric: Numeric,
    pub(crate) parent: u32,
    pub(crate) children: SmallVec<[u32; 4]>,
    /// When its frontals were last solved for; 0 is never. See [`crate::solve`].
    pub(crate) solved: u64,
}

/// The cliques, and which of them eliminates each variable.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    cliques: Vec<Option<Clique>>,
    free: Vec<u32>,
    /// By variable slot.
    clique_of: Vec<u32>,
    pub(crate) roots: BTreeSet<u32>,
}

impl Tree {
    pub(crate) fn clique(&self, index: u32) -> &Clique {
        self.cliques[index as usize].as_ref().expect("links of the tree lead to living cliques")
    }

    pub(crate) fn clique_mut(&mut self, index: u32) -> &mut Clique {
        self.cliques[index as usize].as_mut().expect("links of the tree lead to living cliques")
    }

    /// The clique that eliminates a variable, or [`NONE`].
    pub(crate) fn clique_of(&self, variable: u32) -> u32 {
        self.clique_of.get(variable as usize).copied().unwrap_or(NONE)
    }

    /// Length of the clique array, living or not.
    pub(crate) fn slots(&self) -> usize {
        self.cliques.len()
    }

    pub(crate) fn len(&self) -> usize {
        self.cliques.len() - self.free.len()
    }

    pub(crate) fn insert(&mut self, clique: Clique) -> u32 {
        let index = match self.free.pop() {
            Some(index) => index,
            None => {
                self.cliques.push(None);
                (self.cliques.len() - 1) as u32
            }
        };
        for &v in &clique.structure.frontals {
            if self.clique_of.len() <= v as usize {
                self.clique_of.resize(v as usize + 1, NONE);
            }
            self.clique_of[v as usize] = index;
        }
        self.cliques[index as usize] = Some(clique);
        index
    }

    pub(crate) fn remove(&mut self, index: u32) -> Option<Clique> {
        let clique = self.cliques[index as usize].take()?;
        self.free.push(index);
        self.roots.remove(&index);
        for &v in &clique.structure.frontals {
            self.clique_of[v as usize] = NONE;
        }
        Some(clique)
    }

    /// All cliques, parents before children, roots in their order.
    pub(crate) fn top_down(&self) -> Vec<u32> {
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
    pub(crate) fn path_to(&self, index: u32) -> Vec<u32> {
        let mut path = vec![index];
        let mut current = self.clique(index).parent;
        while current != NONE {
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
                let (f, s) = (c.structure.frontal_dim, c.structure.separator_dim);
                f * (f + 1) / 2 + f * s
            })
            .sum()
    }

    /// Feeds structure and numbers to a hash.
    pub(crate) fn hash_state(&self, hash: &mut impl Hasher) {
        (&self.free, &self.roots, &self.clique_of).hash(hash);
        for (index, clique) in self.cliques.iter().enumerate() {
            let Some(clique) = clique else { continue };
            (index, clique.parent, clique.solved, clique.children.as_slice()).hash(hash);
            let Structure { frontals, separator, factors, .. } = &clique.structure;
            (frontals.as_slice(), separator.as_slice(), factors.as_slice()).hash(hash);
            let numeric = &clique.numeric;
            let (Contribution::Information(data) | Contribution::Root { data, .. }) =
                &numeric.contribution;
            for x in numeric.panel.iter().chain(data).chain(&numeric.diagonal) {
                hash.write_u64(x.to_bits());
            }
        }
    }

    /// Smallest pivot ratio of the whole factorization; infinite for an empty tree.
    pub(crate) fn pivot_ratio(&self) -> f64 {
        self.cliques.iter().flatten().map(|c| c.numeric.pivot_ratio).fold(f64::INFINITY, f64::min)
    }
}
