//! Factors and values as plain data with stable names, for files, snapshots and bindings.
//!
//! A [`Catalogue`] converts a factor into [`FactorData`] and back, and a value into [`ValueData`]
//! and back. Both are serde types: names, ids and numbers. A factor that was read back has the same
//! residual and the same Jacobian, bit for bit.
//!
//! [`Catalogue::standard`] has all types of the library, which [`STANDARD`] describes. Types of
//! your own are registered under names of your own:
//!
//! - a variable type implements [`StoredVariable`], which is its length in most cases;
//! - a factor type implements [`StoredFactor`]: what it writes, and how it is made of that;
//! - a factor by automatic differentiation needs [`StoredResidual`] of its error function only;
//! - the generic factors of the library can be registered for types of your own as they are, for
//!   example `Prior<MyVariable>`.
//!
//! A [`Conditioned`](crate::Conditioned) factor is stored as the factor that it conditions, together with the
//! [given values](FactorData::given). A kernel around it is stored as one around the whole factor, which has the
//! same residual, Jacobian and error.
//!
//! A text form keeps the bits only if numbers are read exactly: serde_json does with its feature
//! `float_roundtrip`.
//!
//! Data are not trusted: wrong lengths, numbers that are not finite, rotations and directions that
//! are none, unknown names, and all that a constructor refuses are typed errors. So is a panic in the code that
//! stores or loads a type of your own.

mod conditioned;
mod data;
mod error;
mod quantity;
mod registry;
mod standard;
mod stored;
mod variables;

pub use data::{FactorData, GivenData, NoiseData, ValueData};
pub use error::{CatalogueError, DataError};
pub use quantity::{Description, Part, Quantity};
pub use registry::Catalogue;
pub use standard::{STANDARD, StoredResidual};
pub use stored::{FactorReader, FactorWriter, StoredFactor, normalized};
pub use variables::StoredVariable;
