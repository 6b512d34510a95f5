//! Removal of a fixed variable: its value is put into its factors.

use std::sync::Arc;

use evergraph_factors::Conditioned;
use evergraph_model::{Factor, Value, VariableId, linearize_at};

use crate::error::RemovalError;
use crate::neighborhood::blanket;
use crate::overlay::{Overlay, Source};

/// Factors of a fixed variable, conditioned on its value.
pub(crate) struct Conditioning {
    /// The other variables of the factors that are not fixed, by slot.
    pub(crate) blanket: Vec<VariableId>,
    /// The factors that are replaced.
    pub(crate) absorbed: Vec<Source>,
    pub(crate) factors: Vec<Arc<dyn Factor>>,
    /// Error of the factors without a variable left.
    pub(crate) constant: f64,
    /// Rows of those.
    pub(crate) constant_rows: usize,
}

/// Conditions all factors of `node`, which is fixed, on its value. Nothing is linearized and no information is lost. A
/// factor without another variable becomes a constant.
pub(crate) fn condition(
    overlay: &Overlay<'_>,
    node: VariableId,
) -> Result<Conditioning, RemovalError> {
    overlay.check(node)?;
    let blanket = blanket(overlay, &[node]);
    overlay.check_last_pose(&[node], &blanket)?;
    let value = value(overlay, node)?;
    let mut found = Conditioning {
        blanket,
        absorbed: Vec::new(),
        factors: Vec::new(),
        constant: 0.0,
        constant_rows: 0,
    };
    for (source, factor) in overlay.factors_of(node) {
        found.absorbed.push(source);
        let others = factor.keys().iter().filter(|&&key| key != node);
        if others.clone().next().is_none() {
            let linearized = linearize_at(factor, &[value.as_ref()]).map_err(|error| {
                RemovalError::Factor { factor: source.to_string(), source: error }
            })?;
            found.constant += linearized.error();
            found.constant_rows += linearized.rows();
        } else if let Some(whole) = overlay.shared_factor(source) {
            let given = [(node, value.clone())];
            let conditioned = Conditioned::new(whole, &given);
            let conditioned = conditioned.ok_or_else(|| RemovalError::NotRepresentable {
                removed: vec![node],
                reason: format!("{} does not take the value of {node}", factor.name()),
            })?;
            found.factors.push(Arc::new(conditioned));
        }
    }
    Ok(found)
}

/// The value of a fixed variable.
fn value(overlay: &Overlay<'_>, node: VariableId) -> Result<Value, RemovalError> {
    let mut members = overlay.members(&[node], f64::INFINITY)?;
    members.pop().map(|member| member.value).ok_or(RemovalError::Nothing)
}
