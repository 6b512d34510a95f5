//! Variable types by name.

use std::collections::BTreeMap;
use std::fmt;

use evergraph_model::{
    Manifold, Point2, Point3, Pose2, Pose3, Rot2, Rot3, Value, VariableType, VectorN, user_code,
};

use super::data::ValueData;
use super::error::{CatalogueError, DataError};

/// A variable type whose values can be stored as plain data.
///
/// [`Manifold::NAME`] is the stable name. Implement it for types of your own:
///
/// ```
/// # use evergraph_model::Manifold;
/// # #[derive(Clone, Debug, PartialEq)]
/// # struct Bias([f64; 2]);
/// # impl Manifold for Bias {
/// #     const NAME: &'static str = "acme.Bias";
/// #     const COMPONENTS: &'static [&'static str] = &["x", "y"];
/// #     fn dim(&self) -> usize { 2 }
/// #     fn storage_len(&self) -> usize { 2 }
/// #     fn store(&self, out: &mut [f64]) { out.copy_from_slice(&self.0); }
/// #     fn load(storage: &[f64]) -> Self { Self([storage[0], storage[1]]) }
/// #     fn retract(&self, d: &[f64]) -> Self { Self([self.0[0] + d[0], self.0[1] + d[1]]) }
/// #     fn local(&self, to: &Self, out: &mut [f64]) {
/// #         (0..2).for_each(|i| out[i] = to.0[i] - self.0[i]);
/// #     }
/// # }
/// use evergraph_factors::catalogue::StoredVariable;
///
/// impl StoredVariable for Bias {
///     const LENGTH: Option<usize> = Some(2);
/// }
/// ```
pub trait StoredVariable: Manifold {
    /// The count of numbers that [`store`](Manifold::store) writes; `None` when it depends on the
    /// value.
    const LENGTH: Option<usize>;

    /// Checks that [`load`](Manifold::load) can take these numbers. They are finite, and
    /// [`LENGTH`](Self::LENGTH) of them.
    ///
    /// # Errors
    /// A text that says what is wrong.
    fn check(_numbers: &[f64]) -> Result<(), String> {
        Ok(())
    }
}

/// Largest accepted difference of a stored rotation's squared length from one. Products
/// of rotations are within 1e-15.
const UNIT: f64 = 1e-9;

fn check_unit(what: &str, numbers: &[f64]) -> Result<(), String> {
    let squared: f64 = numbers.iter().map(|x| x * x).sum();
    if (squared - 1.0).abs() <= UNIT {
        Ok(())
    } else {
        Err(format!("its {what} has length {}, not 1", squared.sqrt()))
    }
}

macro_rules! stored {
    ($($kind:ty: $length:literal $(, $what:literal at $from:literal)?;)+) => {$(
        impl StoredVariable for $kind {
            const LENGTH: Option<usize> = Some($length);
            $(fn check(numbers: &[f64]) -> Result<(), String> {
                check_unit($what, &numbers[$from..])
            })?
        }
    )+};
}

stored! {
    Rot2: 2, "cosine and sine" at 0;
    Rot3: 4, "quaternion" at 0;
    Pose2: 4, "cosine and sine" at 2;
    Pose3: 7, "quaternion" at 3;
    Point2: 2;
    Point3: 3;
}

impl StoredVariable for VectorN {
    const LENGTH: Option<usize> = None;
}

/// The value that `numbers` store.
pub(super) fn load<V: StoredVariable>(numbers: &[f64]) -> Result<V, DataError> {
    if let Some(expected) = V::LENGTH
        && expected != numbers.len()
    {
        return Err(DataError::Numbers { expected, actual: numbers.len() });
    }
    if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
        return Err(DataError::NotFinite { index, number: numbers[index] });
    }
    V::check(numbers).map_err(|reason| DataError::NotOnManifold {
        kind: V::NAME,
        numbers: numbers.to_vec(),
        reason,
    })?;
    Ok(V::load(numbers))
}

/// The registered variable types.
#[derive(Clone, Default)]
pub(super) struct VariableTypes {
    types: BTreeMap<&'static str, Entry>,
}

#[derive(Clone, Copy)]
struct Entry {
    kind: &'static VariableType,
    load: fn(&[f64]) -> Result<Value, DataError>,
}

impl fmt::Debug for VariableTypes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.types.keys()).finish()
    }
}

impl VariableTypes {
    pub fn register<V: StoredVariable>(&mut self) -> Result<(), CatalogueError> {
        let kind = VariableType::of::<V>();
        let entry =
            Entry { kind, load: |numbers| load::<V>(numbers).map(|value| Value::new(&value)) };
        let known = self.types.entry(V::NAME).or_insert(entry);
        if known.kind == kind {
            Ok(())
        } else {
            Err(CatalogueError::NameTaken { name: V::NAME.into() })
        }
    }

    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.types.keys().copied()
    }

    fn unknown(&self, name: &str) -> CatalogueError {
        let known = self.names().map(str::to_owned).collect();
        CatalogueError::UnknownVariable { name: name.into(), known }
    }

    pub fn to_data(&self, value: &Value) -> Result<ValueData, CatalogueError> {
        let name = value.kind().name();
        match self.types.get(name) {
            Some(entry) if entry.kind == value.kind() => {
                Ok(ValueData { kind: name.into(), numbers: value.storage().to_vec() })
            }
            _ => Err(self.unknown(name)),
        }
    }

    pub fn to_value(&self, data: &ValueData) -> Result<Value, CatalogueError> {
        let entry = self.types.get(data.kind.as_str()).ok_or_else(|| self.unknown(&data.kind))?;
        user_code::call(|| (entry.load)(&data.numbers))
            .unwrap_or_else(|message| Err(DataError::Panicked { message }))
            .map_err(|source| CatalogueError::InvalidValue { name: data.kind.clone(), source })
    }
}
