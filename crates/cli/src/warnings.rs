//! Warnings about a map that a replay or an optimization made.

use evergraph::Replayer;
use evergraph::formats::spell_id;

use crate::output::Output;

/// Directions that nothing measures.
pub(crate) fn warn_of_weak_priors(replayer: &Replayer, output: Output) {
    for prior in replayer.replay().gauge_priors().iter().filter(|prior| prior.weak) {
        let (id, count) = (spell_id(prior.id), prior.directions);
        let directions = if count == 1 { "1 direction" } else { &format!("{count} directions") };
        output.warn(&format!(
            "no measurement determines {directions} of the part that begins with pose {id}; a weak prior \
             (sigma {} m and rad) keeps it near its start",
            prior.sigma
        ));
    }
}

/// Landmarks that are not in the map.
pub(crate) fn warn_of_landmarks(replayer: &Replayer, output: Output) {
    const LISTED: usize = 5;
    let unseen = replayer.replay().unseen_landmarks();
    if unseen > 0 {
        output.warn(&format!("{unseen} landmarks that no pose sees were left out"));
    }
    let held: Vec<u64> = replayer.replay().held_back_ids().collect();
    if !held.is_empty() {
        let mut names: Vec<String> = held.iter().take(LISTED).map(|id| spell_id(*id)).collect();
        if held.len() > LISTED {
            names.push("...".into());
        }
        let (count, names) = (held.len(), names.join(", "));
        let were = if count == 1 { "landmark was" } else { "landmarks were" };
        output.warn(&format!(
            "{count} {were} held back and left out, because what was measured does not place it (a \
             single bearing, ranges from one line): {names}"
        ));
    }
}
