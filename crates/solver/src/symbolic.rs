//! From an elimination order to cliques.

use smallvec::SmallVec;

use crate::ordering::Elimination;

/// A clique of the elimination tree before it has numbers; variables are local.
#[derive(Debug)]
pub(crate) struct SymbolicClique {
    /// In the order of elimination.
    pub(crate) frontals: SmallVec<[u32; 4]>,
    /// In the order of elimination.
    pub(crate) separator: SmallVec<[u32; 8]>,
    pub(crate) parent: Option<usize>,
}

/// A clique takes in a variable that does not share its whole structure while it has fewer
/// frontals than this ...
const SMALL_CLIQUE: usize = 4;
/// ... and the variable's column gets at most so many blocks of zeros by it. Both are absolute: a
/// rule relative to the size of the front compounds over thousands of updates.
const EXTRA_BLOCKS: usize = 2;

/// Groups the variables of an elimination into cliques, in postorder (children before parents,
/// every subtree contiguous).
pub(crate) fn cliques(elimination: &Elimination) -> Vec<SymbolicClique> {
    let n = elimination.order.len();
    // Built from the roots down: a variable joins the clique of its parent, as its first frontal,
    // when the structures agree, or nearly do and the clique is small.
    let mut built: Vec<SymbolicClique> = Vec::with_capacity(n);
    let mut clique_of = vec![usize::MAX; n];
    for k in (0..n).rev() {
        let v = elimination.order[k];
        let separator = elimination.separator(k);
        let parent = separator
            .iter()
            .min_by_key(|&&u| elimination.position[u as usize])
            .map(|&u| clique_of[u as usize]);
        if let Some(p) = parent {
            let clique = &mut built[p];
            let extra = clique.frontals.len() + clique.separator.len() - separator.len();
            if extra == 0 || (extra <= EXTRA_BLOCKS && clique.frontals.len() < SMALL_CLIQUE) {
                clique.frontals.push(v);
                clique_of[v as usize] = p;
                continue;
            }
        }
        clique_of[v as usize] = built.len();
        let mut separator: SmallVec<[u32; 8]> = separator.into();
        separator.sort_unstable_by_key(|&u| elimination.position[u as usize]);
        built.push(SymbolicClique { frontals: SmallVec::from_slice(&[v]), separator, parent });
    }
    for clique in &mut built {
        clique.frontals.reverse();
    }
    postorder(built)
}

/// Reorders cliques of which every parent stands before its children.
fn postorder(cliques: Vec<SymbolicClique>) -> Vec<SymbolicClique> {
    let n = cliques.len();
    let mut size = vec![1_usize; n];
    for c in (0..n).rev() {
        if let Some(p) = cliques[c].parent {
            size[p] += size[c];
        }
    }
    // A subtree of s cliques that ends before `end` has its root at end - 1 and its children's
    // subtrees before that, one after the other.
    let mut place = vec![0_usize; n];
    let mut free_end = vec![0_usize; n];
    let mut root_end = n;
    for c in 0..n {
        let end = match cliques[c].parent {
            Some(p) => &mut free_end[p],
            None => &mut root_end,
        };
        place[c] = *end - 1;
        *end -= size[c];
        free_end[c] = place[c];
    }
    let mut ordered: Vec<Option<SymbolicClique>> = (0..n).map(|_| None).collect();
    for (c, mut clique) in cliques.into_iter().enumerate() {
        clique.parent = clique.parent.map(|p| place[p]);
        ordered[place[c]] = Some(clique);
    }
    ordered.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ordering::{Groups, order};
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
            let elimination = order(n, &groups, Some(n as u32 - 1));
            let cliques = cliques(&elimination);
            let mut owner = vec![usize::MAX; n];
            for (c, clique) in cliques.iter().enumerate() {
                for &v in &clique.frontals {
                    assert_eq!(owner[v as usize], usize::MAX, "a variable is frontal once");
                    owner[v as usize] = c;
                }
                if let Some(p) = clique.parent {
                    assert!(p > c, "parents come after their children");
                    let parent = &cliques[p];
                    for v in &clique.separator {
                        assert!(parent.frontals.contains(v) || parent.separator.contains(v));
                    }
                    assert!(clique.separator.iter().any(|v| parent.frontals.contains(v)));
                }
                let position = |v: &u32| elimination.position[*v as usize];
                let all: Vec<_> =
                    clique.frontals.iter().chain(&clique.separator).map(position).collect();
                assert!(all.is_sorted(), "elimination order inside the clique");
            }
            assert!(owner.iter().all(|&c| c != usize::MAX));
            // What each variable needs is in its clique.
            for k in 0..n {
                let clique = &cliques[owner[elimination.order[k] as usize]];
                for v in elimination.separator(k) {
                    assert!(clique.frontals.contains(v) || clique.separator.contains(v));
                }
            }
        }
    }
}
