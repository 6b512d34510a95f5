//! Calls into factors and manifolds, which may be a user's: a panic there becomes an error.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::error::GraphError;
use crate::factor::Factor;
use crate::key::{FactorId, VariableId};
use crate::manifold::VariableType;

/// The result of `call`, or the message of its panic.
///
/// The caller owns everything that `call` may have left half done.
pub(crate) fn guarded<R>(call: impl FnOnce() -> R) -> Result<R, String> {
    catch_unwind(AssertUnwindSafe(call)).map_err(|payload| message(&*payload))
}

/// [`guarded`], with the error of a factor.
pub(crate) fn guarded_factor<R>(
    id: FactorId,
    factor: &dyn Factor,
    call: impl FnOnce() -> R,
) -> Result<R, GraphError> {
    guarded(call).map_err(|message| GraphError::FactorPanicked {
        factor: id,
        name: name_of(factor),
        message,
    })
}

/// [`guarded`], with the error of a variable.
pub(crate) fn guarded_variable<R>(
    variable: VariableId,
    kind: &VariableType,
    call: impl FnOnce() -> R,
) -> Result<R, GraphError> {
    guarded(call).map_err(|message| GraphError::VariablePanicked {
        variable,
        kind: kind.name(),
        message,
    })
}

/// The name of a factor, which its own code writes.
pub(crate) fn name_of(factor: &dyn Factor) -> String {
    guarded(|| factor.name()).unwrap_or_else(|_| "a factor without a name".into())
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("no message").to_owned()
}
