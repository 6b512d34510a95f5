//! PyFactorGraph's names of variables: a letter and an index, as `A0` or `L17`.
//!
//! The id of a name has the letter in its top byte and the index below, GTSAM's symbol, so that
//! name and id determine each other.

use crate::coordinates::Kind;

/// Bits of the index.
const INDEX_BITS: u32 = 56;

/// The letter of landmarks.
const LANDMARK: u8 = b'L';

/// The id of a name; `None` for what is no name. An index has one spelling.
pub(crate) fn parse(word: &str) -> Option<u64> {
    let (letter, digits) = word.as_bytes().split_first()?;
    let is_plain = !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
    let has_one_spelling = digits == b"0" || digits.first() != Some(&b'0');
    if !(letter.is_ascii_alphabetic() && is_plain && has_one_spelling) {
        return None;
    }
    let index: u64 = word[1..].parse().ok()?;
    (index >> INDEX_BITS == 0).then_some(u64::from(*letter) << INDEX_BITS | index)
}

/// Whether a word looks like a name rather than a number, well spelled or not.
pub(crate) fn looks_like_one(word: &str) -> bool {
    let mut bytes = word.bytes();
    bytes.next().is_some_and(|b| b.is_ascii_alphabetic())
        && bytes.len() > 0
        && bytes.all(|b| b.is_ascii_digit())
}

/// The name of an id: its own if its top byte is a letter, else one with the letter of its kind;
/// `None` for an id that has none.
pub(crate) fn of(id: u64, kind: Kind) -> Option<String> {
    let index = id & (u64::MAX >> (64 - INDEX_BITS));
    let letter = match u8::try_from(id >> INDEX_BITS).unwrap_or(0) {
        0 if kind.is_pose() => b'A',
        0 => LANDMARK,
        letter if letter.is_ascii_alphabetic() => letter,
        _ => return None,
    };
    Some(format!("{}{index}", char::from(letter)))
}

/// The letter and the index of an id that is that of a name, GTSAM's symbol; `None` for any other.
pub fn symbol(id: u64) -> Option<(char, u64)> {
    let letter = u8::try_from(id >> INDEX_BITS).ok().filter(u8::is_ascii_alphabetic)?;
    Some((char::from(letter), id & (u64::MAX >> (64 - INDEX_BITS))))
}

/// An id for a reader: as the file's numbers have it and, if it is that of a name, the name.
///
/// ```
/// assert_eq!(evergraph_formats::spell_id(17), "17");
/// assert_eq!(evergraph_formats::spell_id(5_476_377_146_882_523_143), "L7 (5476377146882523143)");
/// ```
pub fn spell_id(id: u64) -> String {
    match symbol(id) {
        Some((letter, index)) => format!("{letter}{index} ({id})"),
        None => id.to_string(),
    }
}

/// An id in a table: its name if it is that of one, else the number.
///
/// ```
/// use evergraph_formats::short_id;
/// assert_eq!((short_id(17).as_str(), short_id(5_476_377_146_882_523_143).as_str()), ("17", "L7"));
/// ```
pub fn short_id(id: u64) -> String {
    match symbol(id) {
        Some((letter, index)) => format!("{letter}{index}"),
        None => id.to_string(),
    }
}

/// The id that a reader's word stands for: a number, a name, or both as [`spell_id`] prints them;
/// `None` for anything else.
///
/// ```
/// use evergraph_formats::{parse_id, spell_id};
/// assert_eq!((parse_id("17"), parse_id("L7")), (Some(17), Some(5_476_377_146_882_523_143)));
/// assert_eq!(parse_id(&spell_id(5_476_377_146_882_523_143)), Some(5_476_377_146_882_523_143));
/// ```
pub fn parse_id(word: &str) -> Option<u64> {
    if word.starts_with(|first: char| first.is_ascii_digit()) {
        return word.parse().ok();
    }
    let name = word.split_once(' ').map_or(word, |(name, _)| name);
    let id = parse(name)?;
    (word == name || word == spell_id(id)).then_some(id)
}

/// The number in an id: of names of one robot, which all have the same letter, the number after it; else
/// the whole id. `ids` are ascending.
pub(crate) fn number_of(id: u64, ids: &[u64]) -> u64 {
    let letter = |id: Option<&u64>| id.map(|id| id >> INDEX_BITS);
    let is_one_robot = letter(ids.first()) == letter(ids.last());
    if is_one_robot { id & (u64::MAX >> (64 - INDEX_BITS)) } else { id }
}

/// Whether the id is that of no name, so that it gets one when it is written.
pub(crate) fn is_new(id: u64) -> bool {
    id >> INDEX_BITS == 0
}

/// What a name says about its variable: `L` is a landmark, any other letter a pose.
pub(crate) fn kind(id: u64, in_space: bool) -> Kind {
    match (u64::from(LANDMARK) == id >> INDEX_BITS, in_space) {
        (true, false) => Kind::Point2,
        (true, true) => Kind::Point3,
        (false, false) => Kind::Pose2,
        (false, true) => Kind::Pose3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_ids_determine_each_other() {
        for name in ["A0", "z7", "L17", "B72057594037927935"] {
            let id = parse(name).unwrap();
            assert_eq!(of(id, Kind::Pose2).unwrap(), name);
            assert!(!is_new(id));
        }
        assert_eq!(parse("A5"), Some(65 << 56 | 5));
        for word in ["", "A", "5", "A-1", "A+1", "A01", "AB1", "A1.0", "é1", "A72057594037927936"]
        {
            assert_eq!(parse(word), None, "{word}");
        }
        assert_eq!(of(3, Kind::Pose3).unwrap(), "A3");
        assert_eq!(of(3, Kind::Point2).unwrap(), "L3");
        assert_eq!(of(u64::MAX, Kind::Pose2), None);
        assert_eq!((kind(76 << 56, true), kind(65 << 56, false)), (Kind::Point3, Kind::Pose2));
    }
    #[test]
    fn a_spelled_id_is_read_back() {
        for id in [0, 17, u64::MAX, 65 << 56, 76 << 56 | 7, (91 << 56) - 1] {
            assert_eq!(parse_id(&spell_id(id)), Some(id));
        }
        assert_eq!(parse_id("A12"), Some(65 << 56 | 12));
        for word in [
            "",
            "-1",
            "+1",
            "1.0",
            "1 2",
            "18446744073709551616",
            "L",
            "L07",
            "L7 (7)",
            "L7 5476377146882523143",
            "L7 (5476377146882523143) ",
            "AB1",
            "three",
            "nan",
        ] {
            assert_eq!(parse_id(word), None, "{word}");
        }
    }
}
