//! Names of variables and factors: generational, and bound to one graph.

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
            pub(crate) index: u32,
            pub(crate) generation: u32,
            pub(crate) graph: u32,
        }

        impl $name {
            /// The dense slot of this object in its graph; slots are reused, ids are not.
            pub fn index(self) -> usize {
                self.index as usize
            }

            /// How many objects lived in this slot before this one.
            pub fn generation(self) -> u32 {
                self.generation
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($letter, "{}"), self.index)?;
                if self.generation > 0 {
                    write!(f, "#{}", self.generation)?;
                }
                Ok(())
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
    /// Slot plus generation: when a variable is removed its id fails from then on and is never
    /// given to another. An id of another graph is refused as foreign.
    VariableId, "x"
}

identifier! {
    /// A factor of one graph. Generational, as [`VariableId`].
    FactorId, "f"
}

/// A [`VariableId`] whose manifold is known to the compiler.
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

    /// A key of an id that was read from data. The type is checked when the key is used: by the
    /// graph when a factor on the variable comes in, and by each query.
    pub fn assume(id: VariableId) -> Self {
        Self::new(id)
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
