//! Compounding and merging of measurements (section V of the laser paper): the baseline.

use std::sync::Arc;

use evergraph_model::Factor;

use crate::error::RemovalError;
use crate::neighborhood::Neighborhood;
use crate::overlay::Overlay;
use crate::topology::Tree;

pub(crate) fn keep_composable(
    _neighborhood: &mut Neighborhood,
    _overlay: &Overlay<'_>,
) -> Result<(), RemovalError> {
    Ok(())
}

pub(crate) fn factors(
    _overlay: &Overlay<'_>,
    _neighborhood: &Neighborhood,
    _tree: &Tree,
) -> Result<Vec<Arc<dyn Factor>>, RemovalError> {
    Ok(Vec::new())
}
