//! Connected components, by union-find.

/// Nodes `0..n` in disjoint sets, each named by its lowest node.
#[derive(Debug)]
pub(crate) struct Components {
    /// A node of the same component that is not higher; itself for the lowest.
    parent: Vec<usize>,
}

impl Components {
    /// `nodes` components of one node each.
    pub fn new(nodes: usize) -> Self {
        Self { parent: (0..nodes).collect() }
    }

    /// Unites the components of all `nodes`.
    pub fn join(&mut self, nodes: &[usize]) {
        for pair in nodes.windows(2) {
            let (a, b) = (self.of(pair[0]), self.of(pair[1]));
            self.parent[a.max(b)] = a.min(b);
        }
    }

    /// The component of a node: its lowest node.
    pub fn of(&mut self, mut node: usize) -> usize {
        while self.parent[node] != node {
            // Paths are halved, so that long chains are walked once.
            self.parent[node] = self.parent[self.parent[node]];
            node = self.parent[node];
        }
        node
    }

    /// The component of each node.
    pub fn of_all(mut self) -> Vec<usize> {
        (0..self.parent.len()).map(|node| self.of(node)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_are_named_by_their_lowest_node() {
        let mut components = Components::new(8);
        components.join(&[6, 4]);
        components.join(&[7, 5, 6]);
        components.join(&[1, 2]);
        components.join(&[3]);
        components.join(&[]);
        assert_eq!(components.of(7), 4);
        assert_eq!(components.of_all(), [0, 1, 1, 3, 4, 4, 4, 4]);
    }

    /// Whatever the order of the links.
    #[test]
    fn a_chain_is_one_component() {
        let forward: Vec<usize> = (0..1000).collect();
        let backward: Vec<usize> = forward.iter().rev().copied().collect();
        for links in [forward, backward] {
            let mut components = Components::new(1001);
            for link in links.windows(2) {
                components.join(link);
            }
            let all = components.of_all();
            assert!(all[..1000].iter().all(|component| *component == 0));
            assert_eq!(all[1000], 1000);
        }
    }
}
