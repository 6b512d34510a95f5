//! Values whose manifold is known only at run time, and the map from variables to them.

use smallvec::SmallVec;

use crate::graph::{Graph, GraphError};
use crate::key::{Key, VariableId};
use crate::manifold::{Manifold, VariableType};

/// A point on some manifold.
#[derive(Clone, Debug, PartialEq)]
pub struct Value {
    kind: &'static VariableType,
    dim: usize,
    storage: SmallVec<[f64; 7]>,
}

impl Value {
    /// Erases the type of `value`.
    pub fn new<V: Manifold>(value: &V) -> Self {
        let mut storage = SmallVec::from_elem(0.0, value.storage_len());
        value.store(&mut storage);
        Self { kind: VariableType::of::<V>(), dim: value.dim(), storage }
    }

    /// Numbers that a manifold of this kind stored.
    pub(crate) fn from_storage(kind: &'static VariableType, dim: usize, storage: &[f64]) -> Self {
        Self { kind, dim, storage: storage.into() }
    }

    /// A borrowed view.
    pub fn as_ref(&self) -> ValueRef<'_> {
        ValueRef { kind: self.kind, dim: self.dim, storage: &self.storage }
    }

    /// The value as a `V`, if it is one.
    pub fn get<V: Manifold>(&self) -> Option<V> {
        self.as_ref().get()
    }

    /// The manifold.
    pub fn kind(&self) -> &'static VariableType {
        self.kind
    }

    /// Dimension of the tangent space.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// The stored numbers, as [`Manifold::store`] wrote them.
    pub fn storage(&self) -> &[f64] {
        &self.storage
    }

    /// A value of the same type and dimension with other stored numbers.
    ///
    /// # Panics
    /// When `storage` has another length than [`storage`](Self::storage).
    #[must_use]
    pub fn with_storage(&self, storage: &[f64]) -> Self {
        assert_eq!(
            storage.len(),
            self.storage.len(),
            "a stored {} has its length",
            self.kind.name()
        );
        Self::from_storage(self.kind, self.dim, storage)
    }

    /// The value moved by a tangent vector: [`Manifold::retract`]. `None` when the vector has
    /// another length than [`dim`](Self::dim).
    pub fn retract(&self, delta: &[f64]) -> Option<Self> {
        let mut moved = self.clone();
        (delta.len() == self.dim)
            .then(|| self.kind.retract(&self.storage, delta, &mut moved.storage))?;
        Some(moved)
    }
}

/// A borrowed [`Value`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueRef<'a> {
    kind: &'static VariableType,
    dim: usize,
    storage: &'a [f64],
}

impl<'a> ValueRef<'a> {
    /// Numbers that a manifold of this kind stored.
    pub(crate) fn from_storage(
        kind: &'static VariableType,
        dim: usize,
        storage: &'a [f64],
    ) -> Self {
        Self { kind, dim, storage }
    }

    /// The value as a `V`, if it is one.
    pub fn get<V: Manifold>(&self) -> Option<V> {
        self.kind.is::<V>().then(|| V::load(self.storage))
    }

    /// The manifold.
    pub fn kind(&self) -> &'static VariableType {
        self.kind
    }

    /// Dimension of the tangent space.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// The stored numbers, as [`Manifold::store`] wrote them.
    pub fn storage(&self) -> &'a [f64] {
        self.storage
    }

    /// An owned copy.
    pub fn to_value(&self) -> Value {
        Value { kind: self.kind, dim: self.dim, storage: self.storage.into() }
    }
}

/// One value for every variable of a graph, at the moment it was taken.
///
/// Flat: the numbers of all values stand in one array, laid out by the graph.
#[derive(Clone, Debug)]
pub struct Values {
    variables: Vec<(VariableId, &'static VariableType, u32, u32)>,
    data: Vec<f64>,
    /// From a variable's slot to its place in `variables`; `u32::MAX` for slots without one.
    places: Vec<u32>,
}

impl Values {
    /// Copies, for each variable of `graph`, its part of `data` (laid out as
    /// [`Graph::value_range`] says).
    pub fn from_arena(graph: &Graph, data: &[f64]) -> Self {
        let mut values = Self {
            variables: Vec::new(),
            data: Vec::new(),
            places: vec![u32::MAX; graph.variable_slots()],
        };
        for id in graph.variables() {
            let range = graph.value_range(id.index());
            values.places[id.index()] = values.variables.len() as u32;
            let dim = graph.dim_at(id.index()) as u32;
            values.variables.push((id, graph.kind_at(id.index()), values.data.len() as u32, dim));
            values.data.extend_from_slice(&data[range]);
        }
        values
    }

    /// How many values there are.
    pub fn len(&self) -> usize {
        self.variables.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.variables.is_empty()
    }

    /// The value of a variable.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`] when it has none here.
    pub fn value(&self, id: VariableId) -> Result<ValueRef<'_>, GraphError> {
        let place = self.places.get(id.index()).copied().unwrap_or(u32::MAX) as usize;
        match self.variables.get(place) {
            Some(entry) if entry.0 == id => Ok(self.at(place)),
            _ => Err(GraphError::UnknownVariable { variable: id }),
        }
    }

    /// The value of a variable of known type.
    ///
    /// # Errors
    /// [`GraphError::UnknownVariable`] when it has none here.
    pub fn get<V: Manifold>(&self, key: Key<V>) -> Result<V, GraphError> {
        let value = self.value(key.id())?;
        value.get().ok_or(GraphError::WrongType {
            variable: key.id(),
            expected: V::NAME,
            actual: value.kind().name(),
        })
    }

    /// All variables with their values, in the order of their slots.
    pub fn iter(&self) -> impl Iterator<Item = (VariableId, ValueRef<'_>)> {
        (0..self.variables.len()).map(|place| (self.variables[place].0, self.at(place)))
    }

    fn at(&self, place: usize) -> ValueRef<'_> {
        let (_, kind, start, dim) = self.variables[place];
        let end = self.variables.get(place + 1).map_or(self.data.len(), |next| next.2 as usize);
        ValueRef { kind, dim: dim as usize, storage: &self.data[start as usize..end] }
    }
}
