//! An order, and the structure that it leads to.

/// An elimination order with its symbolic structure: what is left adjacent to each variable at
/// the moment it is eliminated.
#[derive(Debug, Default)]
pub(crate) struct Elimination {
    /// Local variables, first eliminated first.
    pub(crate) order: Vec<u32>,
    /// Inverse of `order`.
    pub(crate) position: Vec<u32>,
    ends: Vec<usize>,
    pub(super) members: Vec<u32>,
}

impl Elimination {
    /// Empties it, for `n` variables.
    pub(super) fn start(&mut self, n: usize) {
        self.order.clear();
        self.position.clear();
        self.position.resize(n, u32::MAX);
        self.ends.clear();
        self.members.clear();
    }

    /// Appends the next variable; `separator` is in no particular order.
    pub(super) fn push(&mut self, variable: u32, separator: impl IntoIterator<Item = u32>) {
        self.position[variable as usize] = self.order.len() as u32;
        self.order.push(variable);
        self.members.extend(separator);
        self.ends.push(self.members.len());
    }

    /// What is adjacent to the `k`-th variable when it is eliminated.
    pub(crate) fn separator(&self, k: usize) -> &[u32] {
        let start = if k == 0 { 0 } else { self.ends[k - 1] };
        &self.members[start..self.ends[k]]
    }
}
