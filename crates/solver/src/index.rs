//! Index types: a number that counts cliques cannot be used where one counts variables.

/// A type of dense indices, 32 bits wide.
macro_rules! index_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub(crate) struct $name(u32);

        impl $name {
            /// The index `index`, which is below 2³² − 1: arrays of cliques and nodes are shorter
            /// than those of the graph's scalars, whose offsets are 32 bits wide.
            #[inline(always)]
            pub(crate) fn new(index: usize) -> Self {
                debug_assert!(index < u32::MAX as usize);
                Self(index as u32)
            }

            #[inline(always)]
            pub(crate) fn index(self) -> usize {
                self.0 as usize
            }
        }
    };
}

index_type! {
    /// A slot of the clique array of a [`Tree`](crate::tree::Tree).
    CliqueIndex
}

index_type! {
    /// A node of a [`Job`](crate::eliminate::Job).
    NodeIndex
}

index_type! {
    /// A clique of a [`Pending`](crate::pending::Pending) relinearization.
    PendingIndex
}

impl CliqueIndex {
    /// No clique: of variables outside the tree, and the parent of roots. A sentinel, because links
    /// fill the arrays that every update walks through, and an `Option` would double them.
    pub(crate) const NONE: Self = Self(u32::MAX);

    /// `None` for [`NONE`](Self::NONE).
    #[inline(always)]
    pub(crate) fn some(self) -> Option<Self> {
        (self != Self::NONE).then_some(self)
    }
}

impl NodeIndex {
    /// No node, in arrays by new clique.
    pub(crate) const NONE: Self = Self(u32::MAX);
}

impl PendingIndex {
    /// No place, in arrays by clique slot.
    pub(crate) const NONE: Self = Self(u32::MAX);
}
