//! The registry of factor types and variable types.

use std::any::TypeId;
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::sync::Arc;

use evergraph_model::{Factor, Kernel, KernelError, Robust, Value, user_code};

use super::conditioned;
use super::data::{FactorData, ValueData};
use super::error::{CatalogueError, DataError};
use super::stored::{FactorReader, FactorWriter, StoredFactor};
use super::variables::{StoredVariable, VariableTypes};
use crate::conditioned::Conditioned;

/// The factor types and variable types that can be plain data, by their stable names.
///
/// A value like any other: two catalogues know nothing of each other. Cheap to clone compared with
/// a graph; one is enough for a program.
///
/// ```
/// use evergraph_factors::catalogue::{Catalogue, CatalogueError};
/// use evergraph_factors::BetweenPose2;
/// use evergraph_model::{Graph, Noise, Pose2};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut change = Graph::new().change();
/// let [a, b] = [0.0, 1.0].map(|x| change.add_variable(&Pose2::new(x, 0.0, 0.0)));
/// let factor = BetweenPose2::new(a, b, Pose2::new(1.0, 0.0, 0.1), Noise::isotropic(3, 0.1)?)?;
///
/// let catalogue = Catalogue::standard();
/// let mut data = catalogue.to_data(&factor)?;
/// assert_eq!((data.name.as_str(), data.numbers[0]), ("Between<Pose2>", 1.0));
/// change.add_factor(catalogue.to_factor(&data)?);
///
/// data.name = "Sonar".into();
/// let error = catalogue.to_factor(&data).unwrap_err();
/// assert!(matches!(error, CatalogueError::UnknownFactor { name, .. } if name == "Sonar"));
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Default)]
pub struct Catalogue {
    variables: VariableTypes,
    factors: BTreeMap<String, Entry>,
    /// The names of the types, with and without a kernel around them.
    names: HashMap<TypeId, String>,
}

#[derive(Clone, Copy)]
struct Entry {
    kind: TypeId,
    store: Store,
    restore: Restore,
}

/// Stores a factor under a name; `None` for one of another type.
type Store = fn(&VariableTypes, &str, &dyn Factor) -> Option<Result<FactorData, DataError>>;
type Restore = fn(&VariableTypes, &FactorData) -> Result<Arc<dyn Factor>, DataError>;

impl fmt::Debug for Catalogue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Catalogue")
            .field("variables", &self.variables)
            .field("factors", &self.factors.keys())
            .finish()
    }
}

impl Catalogue {
    /// A catalogue without any type.
    pub fn empty() -> Self {
        Self::default()
    }

    /// Adds a factor type, under a kernel or not. A type that is registered already stays.
    ///
    /// # Errors
    /// [`CatalogueError::NameTaken`] when another type has the name.
    pub fn register_factor<F: StoredFactor>(&mut self) -> Result<(), CatalogueError> {
        let name = F::stored_name().into_owned();
        let kind = TypeId::of::<F>();
        let entry = Entry { kind, store: store::<F>, restore: restore::<F> };
        let known = self.factors.entry(name.clone()).or_insert(entry);
        if known.kind != kind {
            return Err(CatalogueError::NameTaken { name });
        }
        self.names.insert(TypeId::of::<Robust<F>>(), name.clone());
        self.names.insert(kind, name);
        Ok(())
    }

    /// Adds a variable type. A type that is registered already stays.
    ///
    /// # Errors
    /// [`CatalogueError::NameTaken`] when another type has the name.
    pub fn register_variable<V: StoredVariable>(&mut self) -> Result<(), CatalogueError> {
        self.variables.register::<V>()
    }

    /// The names of the factor types, sorted.
    pub fn factor_names(&self) -> impl Iterator<Item = &str> {
        self.factors.keys().map(String::as_str)
    }

    /// The names of the variable types, sorted.
    pub fn variable_names(&self) -> impl Iterator<Item = &'static str> {
        self.variables.names()
    }

    /// A factor as plain data.
    ///
    /// # Errors
    /// [`CatalogueError::UnknownFactor`] for a type that is not registered;
    /// [`CatalogueError::InvalidFactor`] when it holds values of a type that is not, and for a panic in its code.
    pub fn to_data(&self, factor: &dyn Factor) -> Result<FactorData, CatalogueError> {
        user_code::call(|| self.stored(factor)).unwrap_or_else(|message| {
            Err(invalid(&user_code::name_of(factor), DataError::Panicked { message }))
        })
    }

    fn stored(&self, factor: &dyn Factor) -> Result<FactorData, CatalogueError> {
        if let Some((conditioned, kernel)) = factor.downcast::<Conditioned>() {
            let whole = self.stored(&**conditioned.whole())?;
            let data = conditioned::store(&self.variables, conditioned, kernel, whole);
            return data.map_err(|source| invalid(&factor.name(), source));
        }
        let unknown = || self.unknown(factor.name());
        let name = self.names.get(&factor.as_any().type_id()).ok_or_else(unknown)?;
        let data = (self.factors[name].store)(&self.variables, name, factor);
        data.ok_or_else(unknown)?.map_err(|source| invalid(name, source))
    }

    /// The factor that plain data describe, with the same bits.
    ///
    /// # Errors
    /// [`CatalogueError::UnknownFactor`]; [`CatalogueError::InvalidFactor`] for everything that the
    /// factor's constructor refuses, for numbers or ends too many or too few, and for a panic in its code.
    pub fn to_factor(&self, data: &FactorData) -> Result<Arc<dyn Factor>, CatalogueError> {
        let entry = self.factors.get(&data.name).ok_or_else(|| self.unknown(data.name.clone()))?;
        let plain = |data: &FactorData| (entry.restore)(&self.variables, data);
        let restored = user_code::call(|| {
            if data.given.is_empty() {
                plain(data)
            } else {
                conditioned::restore(&self.variables, data, plain)
            }
        });
        restored
            .unwrap_or_else(|message| Err(DataError::Panicked { message }))
            .map_err(|source| invalid(&data.name, source))
    }

    /// A value as plain data.
    ///
    /// # Errors
    /// [`CatalogueError::UnknownVariable`].
    pub fn to_value_data(&self, value: &Value) -> Result<ValueData, CatalogueError> {
        self.variables.to_data(value)
    }

    /// The value that plain data describe, with the same bits.
    ///
    /// # Errors
    /// [`CatalogueError::UnknownVariable`], [`CatalogueError::InvalidValue`].
    pub fn to_value(&self, data: &ValueData) -> Result<Value, CatalogueError> {
        self.variables.to_value(data)
    }

    fn unknown(&self, name: String) -> CatalogueError {
        CatalogueError::UnknownFactor { name, known: self.factors.keys().cloned().collect() }
    }
}

fn invalid(name: &str, source: DataError) -> CatalogueError {
    CatalogueError::InvalidFactor { name: name.into(), source }
}

/// `None` for another type than `F`.
fn store<F: StoredFactor>(
    types: &VariableTypes,
    name: &str,
    factor: &dyn Factor,
) -> Option<Result<FactorData, DataError>> {
    let (factor, kernel) = factor.downcast::<F>()?;
    let mut writer = FactorWriter::new(name, factor.keys(), types);
    let stored = factor.store(&mut writer);
    Some(stored.map(|()| FactorData { kernel, ..writer.finish() }))
}

fn restore<F: StoredFactor>(
    types: &VariableTypes,
    data: &FactorData,
) -> Result<Arc<dyn Factor>, DataError> {
    let kernel = data.kernel.map(checked).transpose()?;
    let mut reader = FactorReader::new(data, types);
    let factor = F::restore(&mut reader)?;
    reader.finish()?;
    if factor.keys() != data.ends {
        let (expected, actual) = (factor.keys().len(), data.ends.len());
        return Err(DataError::Ends { expected, actual });
    }
    Ok(match kernel {
        Some(kernel) => Arc::new(Robust::new(factor, kernel)),
        None => Arc::new(factor),
    })
}

/// A kernel that was read: its threshold has not been checked.
fn checked(kernel: Kernel) -> Result<Kernel, KernelError> {
    match kernel {
        Kernel::Huber { threshold, .. } => Kernel::huber(threshold),
        Kernel::PseudoHuber { threshold, .. } => Kernel::pseudo_huber(threshold),
    }
}
