//! Factors for the terms.

pub(crate) mod composition;
pub(crate) mod glc;
pub(crate) mod nonlinear;

use std::sync::Arc;

use evergraph_model::{Factor, Graph};
use nalgebra::DVector;

use crate::error::MakeError;
use crate::options::{Options, Recovery};
use crate::potential::Potential;
use crate::target::Target;

/// A new factor, and what of it does not follow from the target.
#[derive(Clone, Debug)]
pub(crate) struct Made {
    pub(crate) factor: Arc<dyn Factor>,
    /// Whether it is a generic linear constraint.
    pub(crate) linear: bool,
}

/// The factor for a term with its minimum at `offset` (in the members' tangents, from where they are
/// seen); `None` when it has no information by the rank rule.
pub(crate) fn make(
    graph: &Graph,
    target: &Target,
    potential: &Potential,
    offset: &DVector<f64>,
    options: &Options,
) -> Result<Option<Made>, MakeError> {
    if potential.rows.iter().chain(offset.iter()).any(|x| !x.is_finite()) {
        return Err(MakeError::NotFinite("its information or offset"));
    }
    if options.recovery == Recovery::Nonlinear
        && let Some(factor) = nonlinear::factor(graph, target, potential, offset)?
    {
        return Ok(Some(Made { factor, linear: false }));
    }
    let factor = glc::factor(target, potential, offset, options)?;
    Ok(factor.map(|factor| Made { factor: Arc::new(factor), linear: true }))
}
