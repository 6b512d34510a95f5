//! The ends of PyFactorGraph's ranges, whose lines do not say what they lead between.

use std::collections::HashMap;

use crate::coordinates::Kind;
use crate::error::FormatError;
use crate::measurement::{Measurement, Quantity};
use crate::names;
use crate::record::{Line, Record};

/// Finds out between what ranges lead: the names do not say whether they are in the plane or in
/// space, and VERTEX lines overrule them. Calls `reject` for each range where nothing says it, and
/// removes it.
pub(crate) fn resolve_ranges(
    lines: &mut Vec<Line>,
    mut reject: impl FnMut(usize, String) -> Result<(), FormatError>,
) -> Result<(), FormatError> {
    let is_range =
        |record: &Record| matches!(record, Record::Measurement(m) if m.quantity == Quantity::Range);
    let mut known: HashMap<u64, Kind> = HashMap::new();
    let mut in_space = None;
    for record in lines.iter().map(|line| &line.record).filter(|record| !is_range(record)) {
        if let Record::Vertex { id, at } = record {
            known.insert(*id, at.kind());
            in_space.get_or_insert(at.kind().is_in_space());
        }
        for (id, kind) in record.ends() {
            known.entry(id).or_insert(kind);
            in_space.get_or_insert(kind.is_in_space());
        }
    }
    let mut failure = None;
    lines.retain_mut(|line| {
        let number = line.number;
        let Record::Measurement(range) = &mut line.record else { return true };
        if range.quantity != Quantity::Range {
            return true;
        }
        let mut refuse = |problem: String| {
            if failure.is_none() {
                failure = reject(number, problem).err();
            }
            false
        };
        let mut seen = range.ends.iter().filter_map(|(id, _)| known.get(id));
        let Some(in_space) = seen.next().map(|kind| kind.is_in_space()).or(in_space) else {
            return refuse("no line says whether it is in the plane or in space".into());
        };
        for (id, end) in &mut range.ends {
            *end = known.get(id).copied().unwrap_or_else(|| names::kind(*id, in_space));
        }
        let kinds = range.ends.iter().map(|(_, kind)| *kind).collect::<Vec<_>>();
        if Measurement::shape(range.quantity, &kinds).is_none() {
            let words: Vec<_> = kinds.iter().map(|kind| kind.name()).collect();
            return refuse(format!("there is no range between a {}", words.join(" and a ")));
        }
        true
    });
    failure.map_or(Ok(()), Err)
}
