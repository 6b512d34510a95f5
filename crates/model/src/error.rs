//! Why a change, or a question, does not fit the graph.

use thiserror::Error;

use crate::key::{FactorId, VariableId};

/// Why a change, or a question, does not fit the graph.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GraphError {
    /// The id was removed, or was never given.
    #[error(
        "variable {variable} is not in the graph (it was removed, or the change that adds it has not been applied here)"
    )]
    UnknownVariable {
        /// The id asked for.
        variable: VariableId,
    },
    /// The id was removed, or was never given.
    #[error(
        "factor {factor} is not in the graph (it was dropped, or the change that adds it has not been applied here)"
    )]
    UnknownFactor {
        /// The id asked for.
        factor: FactorId,
    },
    /// The id or the change was made by another graph.
    #[error(
        "{what} belongs to another graph; ids and changes are only good for the graph that made them"
    )]
    Foreign {
        /// The id, or the change.
        what: String,
    },
    /// The variable is of another type.
    #[error("variable {variable} is a {actual}, not a {expected}")]
    WrongType {
        /// The variable.
        variable: VariableId,
        /// What was asked for.
        expected: &'static str,
        /// What it is.
        actual: &'static str,
    },
    /// A factor cannot be put on a variable of this type.
    #[error(
        "factor {factor} ({name}) does not take a {actual} of dimension {dim} as its variable number {position} ({variable})"
    )]
    NotAccepted {
        /// The factor.
        factor: FactorId,
        /// Its type.
        name: String,
        /// The variable.
        variable: VariableId,
        /// Place of the variable among the factor's keys, from 0.
        position: usize,
        /// The variable's type.
        actual: &'static str,
        /// The variable's dimension.
        dim: usize,
    },
    /// A factor names a variable twice, or none at all, or has no residual.
    #[error("factor {factor} ({name}) {problem}")]
    MalformedFactor {
        /// The factor.
        factor: FactorId,
        /// Its type.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A value holds a NaN or an infinity.
    #[error("the value given for variable {variable} is not finite: {value}")]
    NonFiniteValue {
        /// The variable.
        variable: VariableId,
        /// The offending numbers.
        value: String,
    },
    /// A value has another type or dimension than the variable it is for.
    #[error(
        "the value given for variable {variable} is a {actual} of dimension {dim}, which does not fit"
    )]
    ValueMismatch {
        /// The variable.
        variable: VariableId,
        /// Type of the value.
        actual: &'static str,
        /// Dimension of the value.
        dim: usize,
    },
    /// The variable still has factors.
    #[error(
        "variable {variable} cannot be dropped while factor {factor} holds it; drop that factor in the same change, or plan a removal that keeps its information"
    )]
    StillHeld {
        /// The variable.
        variable: VariableId,
        /// One of its factors.
        factor: FactorId,
    },
    /// The same object is dropped or moved twice.
    #[error("{what} appears twice in one change")]
    Twice {
        /// The object.
        what: String,
    },
    /// Something does not fit 32-bit offsets.
    #[error("{what} would need more than 2^32 numbers, which is more than a graph can hold")]
    TooLarge {
        /// What it is.
        what: String,
    },
    /// Another change came first.
    #[error("the change is stale: {reason}; make it again from the graph as it is now")]
    Stale {
        /// What has moved on.
        reason: String,
    },
    /// The same change was applied before, or an id of it otherwise entered the graph.
    #[error(
        "{what} has been in the graph already; a change is applied once, make a new one to add the same again"
    )]
    AddedBefore {
        /// The object.
        what: String,
    },
    /// Instructions of one change that exclude each other.
    #[error("variable {variable} is to be {first} and {second} in the same change; leave one out")]
    Contradiction {
        /// The variable.
        variable: VariableId,
        /// One instruction.
        first: &'static str,
        /// The other.
        second: &'static str,
    },
    /// The code of a factor panicked.
    #[error(
        "factor {factor} ({name}) panicked: {message}; nothing was changed. \
         Check its residual and Jacobian with `testing::check_jacobian`"
    )]
    FactorPanicked {
        /// The factor.
        factor: FactorId,
        /// Its type.
        name: String,
        /// The message of the panic.
        message: String,
    },
    /// The code of a manifold panicked.
    #[error(
        "the type {kind} of variable {variable} panicked: {message}; nothing was changed. \
         Check it with `testing::check_manifold`"
    )]
    VariablePanicked {
        /// The variable.
        variable: VariableId,
        /// Its type.
        kind: &'static str,
        /// The message of the panic.
        message: String,
    },
    /// A manifold gave a NaN or an infinity for finite numbers.
    #[error(
        "`retract` of {kind} gives a value that is not finite for variable {variable}; \
         check the type with `testing::check_manifold`"
    )]
    NonFiniteRetraction {
        /// The variable.
        variable: VariableId,
        /// Its type.
        kind: &'static str,
    },
    /// Stored numbers are no value of the type that they are for.
    #[error("{numbers} stored numbers are no value of type {kind}: {problem}")]
    BadStorage {
        /// The type.
        kind: &'static str,
        /// How many numbers there are.
        numbers: usize,
        /// The reason.
        problem: String,
    },
    /// A saved graph contradicts itself.
    #[error("the saved graph is damaged: {problem}")]
    Damaged {
        /// The contradiction.
        problem: String,
    },
    /// A saved graph has variables of a type that is not known here.
    #[error("the saved graph has variables of type {name}, which is not registered")]
    UnknownType {
        /// The type's name.
        name: String,
    },
}
