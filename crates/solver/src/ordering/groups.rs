//! The graph to be ordered, as cliques.

/// Sets of mutually adjacent variables, numbered locally from 0: the variables of a factor, or the
/// separator of a subtree that is kept.
#[derive(Debug, Default)]
pub(crate) struct Groups {
    members: Vec<u32>,
    ends: Vec<usize>,
}

impl Groups {
    pub(crate) fn clear(&mut self) {
        self.members.clear();
        self.ends.clear();
    }

    pub(crate) fn push(&mut self, group: impl IntoIterator<Item = u32>) {
        self.members.extend(group);
        self.ends.push(self.members.len());
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.ends.len()).map(|g| {
            let start = if g == 0 { 0 } else { self.ends[g - 1] };
            &self.members[start..self.ends[g]]
        })
    }
}
