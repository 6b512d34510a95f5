//! Errors of conversions between factors and plain data.

use std::error::Error as StdError;

use evergraph_model::{KernelError, NoiseError};
use thiserror::Error;

use crate::error::FactorError;

/// The reason for which a catalogue cannot convert a factor or a value.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CatalogueError {
    /// A factor type that is not registered.
    #[error(
        "no factor named {name:?} is in the catalogue; register its type, or use one of: {}",
        known.join(", ")
    )]
    UnknownFactor {
        /// The name in the data, or [`Factor::name`](evergraph_model::Factor::name) of the factor.
        name: String,
        /// All registered names, sorted.
        known: Vec<String>,
    },
    /// A variable type that is not registered.
    #[error(
        "no variable type named {name:?} is in the catalogue; register it, or use one of: {}",
        known.join(", ")
    )]
    UnknownVariable {
        /// The name in the data, or [`Manifold::NAME`](evergraph_model::Manifold::NAME).
        name: String,
        /// All registered names, sorted.
        known: Vec<String>,
    },
    /// A second type under a name.
    #[error(
        "the name {name:?} is taken by another type; a stable name belongs to one type, so choose another"
    )]
    NameTaken {
        /// The name.
        name: String,
    },
    /// Data that do not make a factor of the type that they name.
    #[error("the data of {name} are not valid: {source}")]
    InvalidFactor {
        /// The factor's name.
        name: String,
        /// The reason.
        source: DataError,
    },
    /// Data that do not make a value of the type that they name.
    #[error("the data of a {name} are not valid: {source}")]
    InvalidValue {
        /// The variable type's name.
        name: String,
        /// The reason.
        source: DataError,
    },
}

/// A fault in the data of a factor or a value.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DataError {
    /// A number of ends that the factor does not have.
    #[error("it has {actual} ends, {expected} are needed")]
    Ends {
        /// The number that is needed.
        expected: usize,
        /// The number given.
        actual: usize,
    },
    /// Too few or too many numbers.
    #[error("it has {actual} numbers, {expected} are needed")]
    Numbers {
        /// The number that is needed.
        expected: usize,
        /// The number given.
        actual: usize,
    },
    /// Too few or too many values.
    #[error("it has {actual} values, {expected} are needed")]
    Values {
        /// The number that is needed.
        expected: usize,
        /// The number given.
        actual: usize,
    },
    /// A NaN or an infinity.
    #[error("number {index} is {number}; all numbers must be finite")]
    NotFinite {
        /// Its place, from 0.
        index: usize,
        /// The number.
        number: f64,
    },
    /// Numbers that are no value of the type.
    #[error("{numbers:?} is no {kind}: {reason}")]
    NotOnManifold {
        /// The variable type's name.
        kind: &'static str,
        /// The numbers.
        numbers: Vec<f64>,
        /// The reason.
        reason: String,
    },
    /// A number that stands for one of several choices, and for none of them.
    #[error("{number} is no {what}; {choices} are")]
    Choice {
        /// The choice.
        what: &'static str,
        /// The number.
        number: f64,
        /// All choices.
        choices: &'static str,
    },
    /// A factor without noise where the type has one.
    #[error("it has no noise, and its type needs one")]
    NoiseMissing,
    /// A noise where the type has none.
    #[error("it has a noise, and its type has none")]
    NoiseUnused,
    /// A noise with a number of entries that does not fit its form.
    #[error(
        "its noise has {actual} entries; a diagonal has at most 64, and an upper triangle of n rows n (n + 1) / 2"
    )]
    NoiseEntries {
        /// The number given.
        actual: usize,
    },
    /// Numbers that are no noise.
    #[error(transparent)]
    Noise(#[from] NoiseError),
    /// A threshold that is none.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// Numbers that the factor's constructor refuses.
    #[error(transparent)]
    Factor(#[from] FactorError),
    /// A value of a type that the catalogue does not have, or that is not valid.
    #[error(transparent)]
    Value(Box<CatalogueError>),
    /// Given values in places that do not fit the factor's variables.
    #[error(
        "its {given} given values and {ends} ends do not fit together: positions have to ascend, and each be one of a variable that takes the value"
    )]
    Given {
        /// The number of given values.
        given: usize,
        /// The number of ends.
        ends: usize,
    },
    /// A kernel around a factor that has one already.
    #[error("it stands under two robust kernels, and data hold one")]
    Kernels,
    /// A panic in the code of a type.
    #[error("its code panicked: {message}; correct how the type is stored and loaded")]
    Panicked {
        /// Message of the panic.
        message: String,
    },
    /// The reason of a type from outside this crate.
    #[error("{0}")]
    Other(Box<dyn StdError + Send + Sync>),
}

impl DataError {
    /// The reason of a type from outside this crate: an error or a text.
    pub fn other(reason: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        Self::Other(reason.into())
    }
}
