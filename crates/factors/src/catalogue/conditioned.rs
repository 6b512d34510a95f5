//! Conditioned factors as plain data: the data of the whole factor, and the given values.

use std::sync::Arc;

use evergraph_model::{Factor, Kernel, VariableId};

use super::data::{FactorData, GivenData, ValueData};
use super::error::DataError;
use super::variables::VariableTypes;
use crate::conditioned::{Conditioned, Input};

/// A variable of the whole factor, and the value in its place.
type Slot = (VariableId, Option<ValueData>);

/// The data of `factor` under `kernel`, from those of its whole factor.
pub(super) fn store(
    types: &VariableTypes,
    factor: &Conditioned,
    kernel: Option<Kernel>,
    whole: FactorData,
) -> Result<FactorData, DataError> {
    if kernel.is_some() && whole.kernel.is_some() {
        return Err(DataError::Kernels);
    }
    // A whole factor that is conditioned itself has given values of its own.
    let mut slots = slots(&whole)?;
    let mut free: Vec<&mut Slot> = slots.iter_mut().filter(|(_, value)| value.is_none()).collect();
    for (position, value) in factor.given() {
        let value = types.to_data(value).map_err(|error| DataError::Value(Box::new(error)))?;
        free[position].1 = Some(value);
    }
    let given = slots.into_iter().enumerate().filter_map(|(position, (variable, value))| {
        value.map(|value| GivenData { position: position as u32, variable, value })
    });
    Ok(FactorData {
        ends: factor.keys().to_vec(),
        kernel: whole.kernel.or(kernel),
        given: given.collect(),
        ..whole
    })
}

/// The factor of `data`, some of whose values are given; `whole` makes the whole factor of its data.
pub(super) fn restore(
    types: &VariableTypes,
    data: &FactorData,
    whole: impl FnOnce(&FactorData) -> Result<Arc<dyn Factor>, DataError>,
) -> Result<Arc<dyn Factor>, DataError> {
    let slots = slots(data)?;
    let ends = slots.iter().map(|(variable, _)| *variable).collect();
    let whole = whole(&FactorData { ends, given: Vec::new(), ..data.clone() })?;
    let mut inputs = Vec::with_capacity(slots.len());
    for (variable, value) in slots {
        inputs.push(match value {
            None => Input::Variable(variable),
            Some(value) => {
                let value = types.to_value(&value);
                Input::Value(value.map_err(|error| DataError::Value(Box::new(error)))?)
            }
        });
    }
    let factor = Conditioned::with_inputs(whole, inputs).ok_or_else(|| misfit(data))?;
    Ok(Arc::new(factor))
}

/// The variables of the whole factor, in its order.
fn slots(data: &FactorData) -> Result<Vec<Slot>, DataError> {
    let mut slots = Vec::with_capacity(data.ends.len() + data.given.len());
    let mut ends = data.ends.iter();
    for given in &data.given {
        while slots.len() < given.position as usize {
            slots.push((*ends.next().ok_or_else(|| misfit(data))?, None));
        }
        // Behind its place: it stands there already, or its order is wrong.
        if slots.len() > given.position as usize {
            return Err(misfit(data));
        }
        slots.push((given.variable, Some(given.value.clone())));
    }
    slots.extend(ends.map(|end| (*end, None)));
    Ok(slots)
}

fn misfit(data: &FactorData) -> DataError {
    DataError::Given { given: data.given.len(), ends: data.ends.len() }
}
