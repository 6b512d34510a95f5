//! Names of variables and factors: never given twice, and valid across processes.

use std::fmt;
use std::hash::{Hash, Hasher};
use std::marker::PhantomData;

use serde::{Deserialize, Serialize};

/// Counts the changes that touched a variable; see [`crate::Change::require`].
pub type Version = u64;

macro_rules! identifier {
    ($(#[$doc:meta])* $name:ident, $letter:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        pub struct $name {
            pub(crate) number: u64,
            /// The source of numbers that minted it; see [`crate::Ids`].
            pub(crate) origin: u64,
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($letter, "{}"), self.number)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(self, f)
            }
        }
    };
}

identifier! {
    /// A variable of one graph, whatever its type.
    ///
    /// Ids are minted when a [`Change`](crate::Change) adds a variable and are never given twice:
    /// not after a refused change, not by clones of a graph, not after loading a saved one. The id
    /// of a removed variable fails from then on. An id of another graph is refused as foreign.
    ///
    /// Ids order by the time at which they were minted. The order depends on threads when several
    /// of them make changes; sort by [`VariableIndex`] where results depend on the order.
    VariableId, "x"
}

identifier! {
    /// A factor of one graph, named as a [`VariableId`] names a variable.
    FactorId, "f"
}

macro_rules! index {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        pub struct $name(u32);

        impl $name {
            /// No object: a mark in arrays, never the index of an object.
            pub const NONE: Self = Self(u32::MAX);

            /// The index of a place in an array.
            ///
            /// # Panics
            /// When `index` is 2³² - 1 or more, which no graph holds.
            #[inline]
            pub fn new(index: usize) -> Self {
                assert!(index < u32::MAX as usize, "a graph holds fewer than 2^32 - 1 objects");
                Self(index as u32)
            }

            /// The place in an array.
            #[inline]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                if *self == Self::NONE { f.write_str("none") } else { self.0.fmt(f) }
            }
        }
    };
}

index! {
    /// The dense slot of a variable in its graph. Slots are reused, ids are not.
    ///
    /// Assigned when a change is applied, in the order of the change, so that equal changes in
    /// equal order give equal indices on any number of threads.
    VariableIndex
}

index! {
    /// The dense slot of a factor in its graph; see [`VariableIndex`].
    FactorIndex
}

/// A [`VariableId`] whose manifold is known to the compiler.
///
/// Serializes as its id. The type of a key that was read back is checked when it is used.
pub struct Key<V> {
    id: VariableId,
    manifold: PhantomData<fn() -> V>,
}

impl<V> Key<V> {
    /// Only the graph and the change mint typed keys, so that the type is always right.
    pub(crate) fn new(id: VariableId) -> Self {
        Self { id, manifold: PhantomData }
    }

    /// The untyped id.
    pub fn id(self) -> VariableId {
        self.id
    }
}

// Derives would ask for `V: Clone` and so on; a key is plain data whatever `V` is.
impl<V> Clone for Key<V> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<V> Copy for Key<V> {}
impl<V> PartialEq for Key<V> {
    fn eq(&self, other: &Self) -> bool {
        self.id == other.id
    }
}
impl<V> Eq for Key<V> {}
impl<V> Hash for Key<V> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.id.hash(state);
    }
}
impl<V> PartialOrd for Key<V> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<V> Ord for Key<V> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.id.cmp(&other.id)
    }
}
impl<V> fmt::Debug for Key<V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.id, f)
    }
}
impl<V> From<Key<V>> for VariableId {
    fn from(key: Key<V>) -> Self {
        key.id
    }
}
impl<V> Serialize for Key<V> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.id.serialize(serializer)
    }
}
impl<'de, V> Deserialize<'de> for Key<V> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        VariableId::deserialize(deserializer).map(Self::new)
    }
}
