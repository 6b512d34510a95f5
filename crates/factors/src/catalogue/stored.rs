//! Storing a factor type: its parts are written in an order, and read back in the same order.

use std::borrow::Cow;

use evergraph_model::{Factor, Key, Noise, Value, VariableId};
use nalgebra::Vector3;

use super::data::{FactorData, NoiseData};
use super::error::DataError;
use super::variables::{StoredVariable, VariableTypes, load};
use crate::sphere::unit;

/// A factor type that can be stored as plain data.
///
/// [`restore`](Self::restore) reads the parts in the order in which [`store`](Self::store) writes
/// them. The result must have the same residual and Jacobian, bit for bit. Implement it for types of your
/// own and register them with
/// [`Catalogue::register_factor`](super::Catalogue::register_factor).
pub trait StoredFactor: Factor + Sized {
    /// The stable name: data that are stored under it are read for as long as the type exists.
    /// Give names of your own a prefix, as `"acme.Odometer"`.
    fn stored_name() -> Cow<'static, str>;

    /// Writes everything but the variables, which are [`Factor::keys`].
    ///
    /// # Errors
    /// [`DataError::Value`] for a value of a type that is not registered.
    fn store(&self, to: &mut FactorWriter<'_>) -> Result<(), DataError>;

    /// Reads what [`store`](Self::store) wrote. The data may be damaged or hostile: no panic, and
    /// an error for everything that the constructor would refuse.
    ///
    /// # Errors
    /// [`DataError`].
    fn restore(from: &mut FactorReader<'_>) -> Result<Self, DataError>;
}

/// Takes the parts of a factor.
#[derive(Debug)]
pub struct FactorWriter<'a> {
    data: FactorData,
    types: &'a VariableTypes,
}

impl<'a> FactorWriter<'a> {
    pub(super) fn new(name: &str, ends: &[VariableId], types: &'a VariableTypes) -> Self {
        let data = FactorData {
            name: name.into(),
            ends: ends.to_vec(),
            numbers: Vec::new(),
            values: Vec::new(),
            noise: None,
            kernel: None,
            given: Vec::new(),
        };
        Self { data, types }
    }

    pub(super) fn finish(self) -> FactorData {
        self.data
    }

    /// A number.
    pub fn number(&mut self, number: f64) {
        self.data.numbers.push(number);
    }

    /// Several numbers.
    pub fn numbers(&mut self, numbers: impl IntoIterator<Item = f64>) {
        self.data.numbers.extend(numbers);
    }

    /// A direction of length one.
    pub fn direction(&mut self, direction: &Vector3<f64>) {
        self.numbers(direction.iter().copied());
    }

    /// A value of a type that the factor's name says.
    pub fn value<V: StoredVariable>(&mut self, value: &V) {
        let start = self.data.numbers.len();
        self.data.numbers.resize(start + value.storage_len(), 0.0);
        value.store(&mut self.data.numbers[start..]);
    }

    /// A value of any registered type.
    ///
    /// # Errors
    /// [`DataError::Value`] when its type is not registered.
    pub fn any_value(&mut self, value: &Value) -> Result<(), DataError> {
        let data = self.types.to_data(value).map_err(|error| DataError::Value(Box::new(error)))?;
        self.data.values.push(data);
        Ok(())
    }

    /// The noise.
    pub fn noise(&mut self, noise: &Noise) {
        self.data.noise = Some(noise.into());
    }
}

/// Gives the parts of a factor in the order in which they were written.
#[derive(Debug)]
pub struct FactorReader<'a> {
    data: &'a FactorData,
    types: &'a VariableTypes,
    /// Numbers and values that have been read.
    numbers: usize,
    values: usize,
    noise: bool,
}

impl<'a> FactorReader<'a> {
    pub(super) fn new(data: &'a FactorData, types: &'a VariableTypes) -> Self {
        Self { data, types, numbers: 0, values: 0, noise: false }
    }

    /// Refuses what was not read.
    pub(super) fn finish(self) -> Result<(), DataError> {
        let FactorData { numbers, values, noise, .. } = self.data;
        if self.numbers != numbers.len() {
            return Err(DataError::Numbers { expected: self.numbers, actual: numbers.len() });
        }
        if self.values != values.len() {
            return Err(DataError::Values { expected: self.values, actual: values.len() });
        }
        if noise.is_some() && !self.noise { Err(DataError::NoiseUnused) } else { Ok(()) }
    }

    /// The variables.
    pub fn ends(&self) -> &'a [VariableId] {
        &self.data.ends
    }

    /// The variable at `position`. Its type is checked by the graph that the factor enters.
    ///
    /// # Errors
    /// [`DataError::Ends`].
    pub fn key<V>(&self, position: usize) -> Result<Key<V>, DataError> {
        let ends = &self.data.ends;
        let end = ends.get(position);
        end.copied()
            .map(Key::assume)
            .ok_or(DataError::Ends { expected: position + 1, actual: ends.len() })
    }

    /// The next `count` numbers, all finite.
    ///
    /// # Errors
    /// [`DataError::Numbers`], [`DataError::NotFinite`].
    pub fn numbers(&mut self, count: usize) -> Result<&'a [f64], DataError> {
        let all = &self.data.numbers;
        let end = self.numbers.saturating_add(count);
        let numbers = all
            .get(self.numbers..end)
            .ok_or(DataError::Numbers { expected: end, actual: all.len() })?;
        if let Some(at) = numbers.iter().position(|number| !number.is_finite()) {
            return Err(DataError::NotFinite { index: self.numbers + at, number: numbers[at] });
        }
        self.numbers = end;
        Ok(numbers)
    }

    /// The count of numbers that have not been read.
    pub fn remaining(&self) -> usize {
        self.data.numbers.len() - self.numbers
    }

    /// The next number.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers).
    pub fn number(&mut self) -> Result<f64, DataError> {
        self.numbers(1).map(|numbers| numbers[0])
    }

    /// The next value of a type of known length; of a type of unknown length all numbers that are
    /// left.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers), and [`DataError::NotOnManifold`].
    pub fn value<V: StoredVariable>(&mut self) -> Result<V, DataError> {
        let count = V::LENGTH.unwrap_or_else(|| self.remaining());
        load(self.numbers(count)?)
    }

    /// The next three numbers as a direction, of length one. Numbers of another length are
    /// normalized; those of length one, to rounding, are kept bit for bit.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers), and [`DataError::Factor`] for a direction without length.
    pub fn direction(
        &mut self,
        factor: &'static str,
        what: &'static str,
    ) -> Result<Vector3<f64>, DataError> {
        let direction = Vector3::from_column_slice(self.numbers(3)?);
        if (direction.norm_squared() - 1.0).abs() <= ROUNDING {
            return Ok(direction);
        }
        Ok(unit(factor, what, direction)?)
    }

    /// The next value of any registered type.
    ///
    /// # Errors
    /// [`DataError::Values`], [`DataError::Value`].
    pub fn any_value(&mut self) -> Result<Value, DataError> {
        let all = &self.data.values;
        let data = all
            .get(self.values)
            .ok_or(DataError::Values { expected: self.values + 1, actual: all.len() })?;
        self.values += 1;
        self.types.to_value(data).map_err(|error| DataError::Value(Box::new(error)))
    }

    /// The noise.
    ///
    /// # Errors
    /// [`DataError::NoiseMissing`], [`DataError::Noise`].
    pub fn noise(&mut self) -> Result<Noise, DataError> {
        self.noise = true;
        let data: &NoiseData = self.data.noise.as_ref().ok_or(DataError::NoiseMissing)?;
        data.to_noise()
    }
}

/// Largest difference of a normalized vector's squared length from one.
const ROUNDING: f64 = 1e-14;

/// A direction at length one, as the constructors of factors normalize it; `None` for one without
/// length or with numbers that are not finite.
pub fn normalized(direction: [f64; 3]) -> Option<[f64; 3]> {
    unit("", "", direction.into()).ok().map(Into::into)
}
