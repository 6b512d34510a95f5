//! Values whose manifold is known only at run time.

use smallvec::SmallVec;

use crate::error::GraphError;
use crate::manifold::{Manifold, VariableType};
use crate::user_code;

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

    /// A value of this type from the numbers that [`Manifold::store`] wrote, as read from a file.
    ///
    /// # Errors
    /// [`GraphError::BadStorage`] for numbers that are no value of the type.
    pub fn from_parts(kind: &'static VariableType, storage: &[f64]) -> Result<Self, GraphError> {
        let bad = |problem: String| {
            let (kind, numbers) = (kind.name(), storage.len());
            GraphError::BadStorage { kind, numbers, problem }
        };
        // A type reads what it wrote itself; whatever else panics there is bad data.
        let (dim, again) = user_code::call(|| kind.reload(storage)).map_err(bad)?;
        if again != storage.len() {
            return Err(bad(format!("such a value has {again} numbers")));
        }
        Ok(Self { kind, dim, storage: storage.into() })
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
