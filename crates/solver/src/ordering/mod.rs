//! In which order variables are eliminated, and what each elimination touches.
//!
//! An order is found on the graph of *variables* (not scalars), anew for the affected part in each
//! update: appending to an old order keeps the fill of every order before it.

mod amd;
mod minimum_degree;

/// Sets of mutually adjacent variables, numbered locally from 0: the variables of a factor, or the
/// separator of a subtree that is kept.
#[derive(Debug, Default)]
pub(crate) struct Groups {
    members: Vec<u32>,
    ends: Vec<u32>,
}

impl Groups {
    pub(crate) fn push(&mut self, group: impl IntoIterator<Item = u32>) {
        self.members.extend(group);
        self.ends.push(self.members.len() as u32);
    }

    fn iter(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.ends.len()).map(|g| {
            let start = if g == 0 { 0 } else { self.ends[g - 1] };
            &self.members[start as usize..self.ends[g] as usize]
        })
    }
}

/// An elimination order with its symbolic structure: what is left adjacent to each variable at
/// the moment it is eliminated.
#[derive(Debug)]
pub(crate) struct Elimination {
    /// Local variables, first eliminated first.
    pub(crate) order: Vec<u32>,
    /// Inverse of `order`.
    pub(crate) position: Vec<u32>,
    ends: Vec<u32>,
    members: Vec<u32>,
}

impl Elimination {
    fn with_capacity(n: usize) -> Self {
        Self {
            order: Vec::with_capacity(n),
            position: vec![u32::MAX; n],
            ends: Vec::with_capacity(n),
            members: Vec::with_capacity(4 * n),
        }
    }

    /// Appends the next variable; `separator` is in no particular order.
    fn push(&mut self, variable: u32, separator: impl IntoIterator<Item = u32>) {
        self.position[variable as usize] = self.order.len() as u32;
        self.order.push(variable);
        self.members.extend(separator);
        self.ends.push(self.members.len() as u32);
    }

    /// What is adjacent to the `k`-th variable when it is eliminated.
    pub(crate) fn separator(&self, k: usize) -> &[u32] {
        let start = if k == 0 { 0 } else { self.ends[k - 1] };
        &self.members[start as usize..self.ends[k] as usize]
    }
}

/// Largest problem for adjacency rows of bits, whose memory and time grow with the square.
const BIT_ROWS: usize = 2048;

/// Orders `n` variables to keep the factor sparse; `last`, if given, comes last, so that the next
/// change, which is most often next to the newest variable, touches little.
pub(crate) fn order(n: usize, groups: &Groups, last: Option<u32>) -> Elimination {
    if n <= BIT_ROWS {
        minimum_degree::order(n, groups, last)
    } else {
        let order = amd::order(n, groups, last);
        symbolic(n, groups, &order)
    }
}

/// The structure that a given order leads to, by lists: the separator of a variable is what its
/// groups and its children's separators hold beyond itself. O(entries of the factor).
fn symbolic(n: usize, groups: &Groups, order: &[u32]) -> Elimination {
    let mut position = vec![0_u32; n];
    for (k, &v) in order.iter().enumerate() {
        position[v as usize] = k as u32;
    }
    // Each group is read once, at its first-eliminated member; children hang at their parent.
    let mut groups_at = vec![Vec::new(); n];
    let lists: Vec<&[u32]> = groups.iter().collect();
    for (g, list) in lists.iter().enumerate() {
        if let Some(first) = list.iter().min_by_key(|&&v| position[v as usize]) {
            groups_at[*first as usize].push(g);
        }
    }
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); n];
    let mut seen = vec![u32::MAX; n];
    let mut elimination = Elimination::with_capacity(n);
    let mut separator = Vec::new();
    for (k, &v) in order.iter().enumerate() {
        separator.clear();
        seen[v as usize] = k as u32;
        {
            let mut visit = |list: &[u32]| {
                for &u in list {
                    if seen[u as usize] != k as u32 {
                        seen[u as usize] = k as u32;
                        separator.push(u);
                    }
                }
            };
            for &g in &groups_at[v as usize] {
                visit(lists[g]);
            }
            for &child in &children[v as usize] {
                visit(elimination.separator(child));
            }
        }
        if let Some(parent) = separator.iter().min_by_key(|&&u| position[u as usize]) {
            children[*parent as usize].push(k);
        }
        elimination.push(v, separator.iter().copied());
    }
    elimination
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
            let by_degree = minimum_degree::order(n, &groups, last);
            let amd_order = amd::order(n, &groups, last);
            let by_amd = symbolic(n, &groups, &amd_order);
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
        let elimination = order(500, &groups, Some(499));
        assert!((0..500).all(|k| elimination.separator(k).len() <= 1));
    }
}
