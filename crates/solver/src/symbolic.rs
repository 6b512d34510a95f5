//! From an elimination order to cliques.

use smallvec::SmallVec;

use crate::ordering::Elimination;

/// A clique of the elimination tree before it has numbers; variables are local.
#[derive(Debug)]
pub(crate) struct SymbolicClique {
    /// The last eliminated first.
    pub(crate) frontals: SmallVec<[u32; 6]>,
    /// The separator is what is adjacent to this one, the last frontal, when it is eliminated.
    pub(crate) last: u32,
    pub(crate) parent: Option<u32>,
}

/// A clique takes in a variable that does not share its whole structure while it has fewer
/// frontals than this ...
const SMALL_CLIQUE: usize = 4;
/// ... and the variable's column gets at most so many blocks of zeros by it. Both are absolute: a
/// rule relative to the size of the front compounds over thousands of updates.
const EXTRA_BLOCKS: usize = 2;

/// The cliques of an elimination.
#[derive(Debug, Default)]
pub(crate) struct Cliques {
    /// Parents before children.
    pub(crate) cliques: Vec<SymbolicClique>,
    /// By local variable.
    pub(crate) clique_of: Vec<u32>,
    /// Children before parents, every subtree contiguous.
    pub(crate) postorder: Vec<u32>,
    size: Vec<u32>,
    free_end: Vec<u32>,
}

impl Cliques {
    /// Groups the variables of an elimination into cliques.
    pub(crate) fn build(&mut self, elimination: &Elimination) {
        let n = elimination.order.len();
        self.cliques.clear();
        self.clique_of.clear();
        self.clique_of.resize(n, u32::MAX);
        // From the roots down: a variable joins the clique of its parent, as its first frontal,
        // when the structures agree, or nearly do and the clique is small.
        for k in (0..n).rev() {
            let v = elimination.order[k];
            let separator = elimination.separator(k);
            let first = separator.iter().min_by_key(|&&u| elimination.position[u as usize]);
            let parent = first.map(|&u| self.clique_of[u as usize]);
            if let Some(p) = parent {
                let clique = &mut self.cliques[p as usize];
                let last = elimination.position[clique.last as usize] as usize;
                let front = clique.frontals.len() + elimination.separator(last).len();
                let extra = front - separator.len();
                if extra == 0 || (extra <= EXTRA_BLOCKS && clique.frontals.len() < SMALL_CLIQUE) {
                    clique.frontals.push(v);
                    self.clique_of[v as usize] = p;
                    continue;
                }
            }
            self.clique_of[v as usize] = self.cliques.len() as u32;
            let frontals = SmallVec::from_slice(&[v]);
            self.cliques.push(SymbolicClique { frontals, last: v, parent });
        }
        self.sort();
    }

    /// Finds the postorder, given that every parent stands before its children.
    fn sort(&mut self) {
        let n = self.cliques.len();
        self.size.clear();
        self.size.resize(n, 1);
        for c in (0..n).rev() {
            if let Some(p) = self.cliques[c].parent {
                self.size[p as usize] += self.size[c];
            }
        }
        // A subtree of s cliques that ends before `end` has its root at end - 1 and its children's
        // subtrees before that, one after the other.
        self.free_end.clear();
        self.free_end.resize(n, 0);
        self.postorder.clear();
        self.postorder.resize(n, 0);
        let mut root_end = n as u32;
        for c in 0..n {
            let end = match self.cliques[c].parent {
                Some(p) => &mut self.free_end[p as usize],
                None => &mut root_end,
            };
            let place = *end - 1;
            *end -= self.size[c];
            self.free_end[c] = place;
            self.postorder[place as usize] = c as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ordering::{Groups, Orderer};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn cliques_form_a_junction_tree_in_postorder() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for n in [1, 2, 7, 40, 150] {
            let mut groups = Groups::default();
            for v in 1..n as u32 {
                groups.push([v - 1, v]);
            }
            for _ in 0..n {
                let (a, b) = (rng.random_range(0..n as u32), rng.random_range(0..n as u32));
                if a != b {
                    groups.push([a, b]);
                }
            }
            let mut orderer = Orderer::default();
            orderer.order(n, &groups, Some(n as u32 - 1));
            let elimination = orderer.elimination;
            let mut built = Cliques::default();
            built.build(&elimination);
            let position = |v: &u32| elimination.position[*v as usize];
            let separator =
                |c: u32| elimination.separator(position(&built.cliques[c as usize].last) as usize);
            let mut owner = vec![u32::MAX; n];
            let mut done = vec![false; built.cliques.len()];
            for &c in &built.postorder {
                let clique = &built.cliques[c as usize];
                done[c as usize] = true;
                for &v in &clique.frontals {
                    assert_eq!(owner[v as usize], u32::MAX, "a variable is frontal once");
                    owner[v as usize] = c;
                    assert_eq!(built.clique_of[v as usize], c);
                }
                if let Some(p) = clique.parent {
                    assert!(!done[p as usize], "parents come after their children");
                    let parent = &built.cliques[p as usize];
                    for v in separator(c) {
                        assert!(parent.frontals.contains(v) || separator(p).contains(v));
                    }
                    assert!(separator(c).iter().any(|v| parent.frontals.contains(v)));
                }
                assert!(clique.frontals.iter().rev().map(position).is_sorted());
            }
            assert!(owner.iter().all(|&c| c != u32::MAX));
            // What each variable needs is in its clique.
            for k in 0..n {
                let c = owner[elimination.order[k] as usize];
                let frontals = &built.cliques[c as usize].frontals;
                for v in elimination.separator(k) {
                    assert!(frontals.contains(v) || separator(c).contains(v));
                }
            }
        }
    }
}
