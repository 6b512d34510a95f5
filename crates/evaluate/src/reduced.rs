//! A reduced graph beside the full one, both as documents that were replayed.

use std::collections::BTreeSet;

use evergraph_formats::{Document, spell_id};
use evergraph_model::{Value, VariableId};
use evergraph_replay::{Overview, Replayer};
use evergraph_solver::SmootherError;
use thiserror::Error;

/// The reason why a full graph and a reduced one cannot be compared.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReducedError {
    /// The one is no reduced form of the other.
    #[error("{reduced}: is no reduced graph of {full}: {problem}")]
    NotReduced {
        /// The full graph's file.
        full: String,
        /// The reduced graph's file.
        reduced: String,
        /// The reason.
        problem: String,
    },
    /// The full graph has no estimate, or cannot be solved when it is held at the poses at which the reduced
    /// one is.
    #[error(transparent)]
    Full(Box<SmootherError>),
}

/// The values that the full graph's estimate has for the variables of the reduced document, by ids in the
/// file.
///
/// # Errors
/// [`ReducedError::NotReduced`] for a variable that the full graph does not have.
pub fn shared_values(
    full: &Replayer,
    reduced: &Document,
) -> Result<Vec<(u64, Value)>, ReducedError> {
    let estimates = full.smoother().estimates();
    let estimates = estimates.map_err(|source| ReducedError::Full(Box::new(source)))?;
    let ids = reduced.ids().into_iter();
    ids.map(|(id, kind)| {
        let replay = full.replay();
        let (same, other) = match kind.is_pose() {
            true => (replay.pose(id), replay.landmark(id)),
            false => (replay.landmark(id), replay.pose(id)),
        };
        let value = same.and_then(|variable| estimates.value(variable).ok());
        let problem = match other {
            None => "is not in the full graph's map",
            Some(_) => "is a pose in one and a landmark in the other",
        };
        let value = value.ok_or_else(|| ReducedError::NotReduced {
            full: full.name().into(),
            reduced: reduced.name().into(),
            problem: format!("{} {problem}", spell_id(id)),
        })?;
        Ok((id, value.to_value()))
    })
    .collect()
}

/// Pairs of the full and the reduced graph's variables with the same id in the files.
///
/// # Errors
/// [`ReducedError::NotReduced`] for a variable that the full graph does not have.
pub fn shared_variables(
    full: &Replayer,
    reduced: &Replayer,
) -> Result<Vec<(VariableId, VariableId)>, ReducedError> {
    let pair = |(id, variable): (u64, VariableId)| {
        let is_pose = reduced.replay().pose(id) == Some(variable);
        let replay = full.replay();
        let same = if is_pose { replay.pose(id) } else { replay.landmark(id) };
        same.map(|same| (same, variable)).ok_or_else(|| ReducedError::NotReduced {
            full: full.name().into(),
            reduced: reduced.name().into(),
            problem: format!("{} is not in the full graph's map", spell_id(id)),
        })
    };
    reduced.replay().ids().map(pair).collect()
}

/// The number of connected components of the full graph of which the reduced graph has nothing; `overview`
/// is that of the full graph's document.
pub fn components_gone(full: &Replayer, reduced: &Replayer, overview: &Overview) -> usize {
    let components = |replayer: &Replayer| -> BTreeSet<usize> {
        let replay = replayer.replay();
        let of = |(id, variable)| overview.component_of(id, replay.pose(id) == Some(variable));
        replay.ids().filter_map(of).collect()
    };
    components(full).difference(&components(reduced)).count()
}
