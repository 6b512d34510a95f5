//! Calls into the code of users: a panic there becomes an error.
//!
//! Factors, manifolds and their stored forms may be types of a user. The engine calls them through this module
//! wherever a panic would leave its state half changed or would come from data that were loaded.
//! A panic that aborts the process cannot be caught.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::error::GraphError;
use crate::factor::Factor;
use crate::key::{FactorId, VariableId};
use crate::manifold::VariableType;

/// The result of `code`, or the message of its panic.
///
/// Everything that `code` may have left half done is discarded or overwritten by the caller. The panic hook of the
/// process runs as for any panic: by default it prints the message on standard error.
///
/// # Errors
/// The message of the panic.
///
/// ```
/// use evergraph_model::user_code;
/// assert_eq!(user_code::call(|| 1 + 1), Ok(2));
/// let numbers: &[f64] = &[];
/// assert!(user_code::call(|| numbers[0]).unwrap_err().contains("out of bounds"));
/// ```
pub fn call<R>(code: impl FnOnce() -> R) -> Result<R, String> {
    catch_unwind(AssertUnwindSafe(code)).map_err(|payload| message(&*payload))
}

/// [`call`], with the error of a factor.
pub(crate) fn guarded_factor<R>(
    id: FactorId,
    factor: &dyn Factor,
    call: impl FnOnce() -> R,
) -> Result<R, GraphError> {
    self::call(call).map_err(|message| GraphError::FactorPanicked {
        factor: id,
        name: name_of(factor),
        message,
    })
}

/// [`call`], with the error of a variable.
pub(crate) fn guarded_variable<R>(
    variable: VariableId,
    kind: &VariableType,
    call: impl FnOnce() -> R,
) -> Result<R, GraphError> {
    self::call(call).map_err(|message| GraphError::VariablePanicked {
        variable,
        kind: kind.name(),
        message,
    })
}

/// The name of a factor, or that it has none when its own code panics.
pub fn name_of(factor: &dyn Factor) -> String {
    call(|| factor.name()).unwrap_or_else(|_| "a factor without a name".into())
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("no message").to_owned()
}
