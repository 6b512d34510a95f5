//! The map from variables to values.

use serde::ser::SerializeSeq;
use serde::{Serialize, Serializer};

use crate::error::GraphError;
use crate::graph::Graph;
use crate::key::{Key, VariableId, VariableIndex};
use crate::manifold::{Manifold, VariableType};
use crate::value::{Value, ValueRef};

/// One value for every variable of a graph, at the moment it was taken.
///
/// Flat: the numbers of all values stand in one array. Lookups take O(log n). Serializes as a list
/// of `(id, type name, numbers)`; [`from_entries`](Self::from_entries) is the way back.
#[derive(Clone, Debug, Default)]
pub struct Values {
    entries: Vec<Entry>,
    data: Vec<f64>,
    /// Places in `entries` by ascending id; empty where the entries are in that order.
    by_id: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    id: VariableId,
    kind: &'static VariableType,
    start: u32,
    dim: u32,
}

impl Values {
    /// Copies, for each variable of `graph`, its part of `data` (laid out as
    /// [`Graph::value_range`] says).
    ///
    /// # Panics
    /// When `data` is shorter than [`Graph::value_len`].
    pub fn from_arena(graph: &Graph, data: &[f64]) -> Self {
        let part = |v: VariableIndex| graph.value_ref(v, &data[graph.value_range(v)]);
        Self::collect(graph.variable_indices().map(|v| (graph.variable_id(v), part(v))))
    }

    /// From variables and their values, each variable once.
    ///
    /// # Errors
    /// [`GraphError::Twice`].
    pub fn from_entries(
        entries: impl IntoIterator<Item = (VariableId, Value)>,
    ) -> Result<Self, GraphError> {
        let entries: Vec<(VariableId, Value)> = entries.into_iter().collect();
        let values = Self::collect(entries.iter().map(|(id, value)| (*id, value.as_ref())));
        let twice = (1..values.len()).find(|&n| values.nth(n - 1).id == values.nth(n).id);
        match twice {
            Some(n) => Err(GraphError::Twice {
                what: format!("the value of variable {}", values.nth(n).id),
            }),
            None => Ok(values),
        }
    }

    fn collect<'a>(entries: impl Iterator<Item = (VariableId, ValueRef<'a>)>) -> Self {
        let mut values = Self::default();
        for (id, value) in entries {
            let (kind, start, dim) = (value.kind(), values.data.len() as u32, value.dim() as u32);
            values.entries.push(Entry { id, kind, start, dim });
            values.data.extend_from_slice(value.storage());
        }
        if !values.entries.is_sorted_by_key(|entry| entry.id) {
            values.by_id = (0..values.entries.len() as u32).collect();
            values.by_id.sort_by_key(|&place| values.entries[place as usize].id);
        }
        values
    }

    /// How many values there are.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The value of a variable.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`] when it has none here.
    pub fn value(&self, id: impl Into<VariableId>) -> Result<ValueRef<'_>, GraphError> {
        let variable = id.into();
        let found = match self.by_id.as_slice() {
            [] => self.entries.binary_search_by_key(&variable, |entry| entry.id).ok(),
            by_id => by_id
                .binary_search_by_key(&variable, |&place| self.entries[place as usize].id)
                .ok()
                .map(|n| by_id[n] as usize),
        };
        found.map(|place| self.at(place)).ok_or(GraphError::UnknownVariable { variable })
    }

    /// The value of a variable of known type.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`] when it has none here, [`GraphError::WrongType`].
    pub fn get<V: Manifold>(&self, key: Key<V>) -> Result<V, GraphError> {
        let value = self.value(key.id())?;
        value.get().ok_or(GraphError::WrongType {
            variable: key.id(),
            expected: V::NAME,
            actual: value.kind().name(),
        })
    }

    /// All variables with their values: by slot where they were taken from a graph, else in the
    /// order given.
    pub fn iter(&self) -> impl Iterator<Item = (VariableId, ValueRef<'_>)> {
        (0..self.entries.len()).map(|place| (self.entries[place].id, self.at(place)))
    }

    /// The entry with the nth id in ascending order.
    fn nth(&self, n: usize) -> Entry {
        self.entries[self.by_id.get(n).map_or(n, |&place| place as usize)]
    }

    fn at(&self, place: usize) -> ValueRef<'_> {
        let Entry { kind, start, dim, .. } = self.entries[place];
        let end = self.entries.get(place + 1).map_or(self.data.len(), |next| next.start as usize);
        ValueRef::from_storage(kind, dim as usize, &self.data[start as usize..end])
    }
}

impl Serialize for Values {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(self.len()))?;
        for (id, value) in self.iter() {
            list.serialize_element(&(id, value.kind().name(), value.storage()))?;
        }
        list.end()
    }
}
