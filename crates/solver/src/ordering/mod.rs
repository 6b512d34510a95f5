//! In which order variables are eliminated, and what each elimination touches.
//!
//! An order is found on the graph of *variables* (not scalars), anew for the affected part in each
//! update: appending to an old order keeps the fill of every order before it.

mod amd;
mod elimination;
mod groups;
mod minimum_degree;

pub(crate) use elimination::Elimination;
pub(crate) use groups::Groups;
use minimum_degree::MinimumDegree;

/// Largest problem for adjacency rows of bits, whose memory and time grow with the square.
const BIT_ROWS: usize = 2048;

/// Finds orders; keeps the last one, and its buffers.
#[derive(Debug, Default)]
pub(crate) struct Orderer {
    minimum_degree: MinimumDegree,
    pub(crate) elimination: Elimination,
}

impl Orderer {
    /// Orders `n` variables to keep the factor sparse; `last`, if given, comes last, so that the
    /// next change, which is most often next to the newest variable, touches little.
    pub(crate) fn order(&mut self, n: usize, groups: &Groups, last: Option<u32>) {
        if n <= BIT_ROWS {
            self.minimum_degree.order(n, groups, last, &mut self.elimination);
        } else {
            let order = amd::order(n, groups, last);
            symbolic(n, groups, &order, &mut self.elimination);
        }
    }
}

/// The structure that a given order leads to, by lists: the separator of a variable is what its
/// groups and its children's separators hold beyond itself. O(entries of the factor).
fn symbolic(n: usize, groups: &Groups, order: &[u32], elimination: &mut Elimination) {
    let mut position = vec![0_u32; n];
    for (k, &v) in order.iter().enumerate() {
        position[v as usize] = k as u32;
    }
    // Each group is read once, at its first-eliminated member; children hang at their parent.
    let lists: Vec<&[u32]> = groups.iter().collect();
    let mut groups_at = Chains::new(n);
    for (g, list) in lists.iter().enumerate() {
        if let Some(first) = list.iter().min_by_key(|&&v| position[v as usize]) {
            groups_at.push(*first, g as u32);
        }
    }
    let mut children = Chains::new(n);
    let mut seen = vec![u32::MAX; n];
    let mut separator = Vec::new();
    elimination.start(n);
    for (k, &v) in order.iter().enumerate() {
        separator.clear();
        seen[v as usize] = k as u32;
        let mut visit = |list: &[u32]| {
            for &u in list {
                if seen[u as usize] != k as u32 {
                    seen[u as usize] = k as u32;
                    separator.push(u);
                }
            }
        };
        groups_at.iter(v).for_each(|g| visit(lists[g as usize]));
        children.iter(v).for_each(|child| visit(elimination.separator(child as usize)));
        if let Some(parent) = separator.iter().min_by_key(|&&u| position[u as usize]) {
            children.push(*parent, k as u32);
        }
        elimination.push(v, separator.iter().copied());
    }
}

/// Lists of numbers, each linked through one array; every number is in at most one list.
struct Chains {
    heads: Vec<u32>,
    next: Vec<u32>,
}

impl Chains {
    fn new(n: usize) -> Self {
        Self { heads: vec![u32::MAX; n], next: Vec::new() }
    }

    fn push(&mut self, list: u32, item: u32) {
        if self.next.len() <= item as usize {
            self.next.resize(item as usize + 1, u32::MAX);
        }
        self.next[item as usize] = std::mem::replace(&mut self.heads[list as usize], item);
    }

    fn iter(&self, list: u32) -> impl Iterator<Item = u32> {
        let some = |item: u32| (item != u32::MAX).then_some(item);
        std::iter::successors(some(self.heads[list as usize]), move |&item| {
            some(self.next[item as usize])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::collections::BTreeSet;

    fn random_groups(n: usize, count: usize, rng: &mut ChaCha8Rng) -> Groups {
        let mut groups = Groups::default();
        for v in 1..n as u32 {
            groups.push([v - 1, v]);
        }
        for _ in 0..count {
            let size = rng.random_range(1..5);
            let group: BTreeSet<u32> = (0..size).map(|_| rng.random_range(0..n as u32)).collect();
            groups.push(group);
        }
        groups
    }

    /// The structure by playing elimination on explicit sets.
    fn reference(n: usize, groups: &Groups, order: &[u32]) -> Vec<BTreeSet<u32>> {
        let mut adjacent = vec![BTreeSet::new(); n];
        for group in groups.iter() {
            for &a in group {
                adjacent[a as usize].extend(group.iter().copied().filter(|&b| b != a));
            }
        }
        order
            .iter()
            .map(|&v| {
                let separator = std::mem::take(&mut adjacent[v as usize]);
                for &u in &separator {
                    let row = &mut adjacent[u as usize];
                    row.extend(separator.iter().copied().filter(|&w| w != u));
                    row.remove(&v);
                }
                separator
            })
            .collect()
    }

    #[test]
    fn structures_are_those_of_explicit_elimination() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for n in [1, 2, 3, 10, 64, 65, 130] {
            let groups = random_groups(n, n / 2, &mut rng);
            let last = Some(rng.random_range(0..n as u32));
            let (mut by_degree, mut by_amd) = (Elimination::default(), Elimination::default());
            MinimumDegree::default().order(n, &groups, last, &mut by_degree);
            symbolic(n, &groups, &amd::order(n, &groups, last), &mut by_amd);
            for elimination in [&by_degree, &by_amd] {
                let mut sorted = elimination.order.clone();
                sorted.sort_unstable();
                assert_eq!(sorted, (0..n as u32).collect::<Vec<_>>());
                assert_eq!(elimination.order.last().copied(), last);
                let expected = reference(n, &groups, &elimination.order);
                for (k, expected) in expected.iter().enumerate() {
                    let got: BTreeSet<u32> = elimination.separator(k).iter().copied().collect();
                    assert_eq!(&got, expected, "n {n}, step {k}");
                    assert_eq!(elimination.position[elimination.order[k] as usize], k as u32);
                }
            }
        }
    }

    #[test]
    fn a_chain_has_no_fill() {
        let mut groups = Groups::default();
        for v in 1..500 {
            groups.push([v - 1, v]);
        }
        let mut orderer = Orderer::default();
        orderer.order(500, &groups, Some(499));
        let elimination = orderer.elimination;
        assert!((0..500).all(|k| elimination.separator(k).len() <= 1));
    }
}
