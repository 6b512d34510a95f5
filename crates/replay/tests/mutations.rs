//! Whatever the bytes, reading gives a document or an error; what it gives can be written, read
//! again and replayed.

#[path = "../../formats/tests/common/mod.rs"]
mod common;

use evergraph_formats::{Dialect, Document, ReadOptions};
use evergraph_model::Graph;
use evergraph_replay::{Replay, ReplayOptions};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Words that are likely to break something.
const WORDS: &[&str] = &[
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1e308",
    "-1e308",
    "1e-320",
    "0",
    "-1",
    "18446744073709551615",
    "18446744073709551616",
    "0x10",
    "",
    "\0",
    "EDGE_SE2",
    "VERTEX2",
    "FIX",
    "EDGE2",
    "#",
    "\r\n",
    "\n",
    "1 2 3 4",
    "A0",
    "L1",
    "A72057594037927935",
    "ROBUST huber 1",
    "FACTOR_LINEAR",
    "FACTOR_PARTIAL_SE3",
    "EDGE_RANGE",
    "EDGE_SE3_XYZ_PRIOR",
    "GEODETIC_ORIGIN",
    "-0",
    "2.5",
];

fn mutate(bytes: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    for _ in 0..rng.random_range(1..4) {
        if bytes.is_empty() {
            return;
        }
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..6) {
            0 => bytes[at] = (rng.next_u32() & 0xFF) as u8,
            1 => bytes.truncate(at),
            2 => drop(bytes.remove(at)),
            3 => {
                let word = WORDS[rng.random_range(0..WORDS.len())];
                let end = bytes[at..]
                    .iter()
                    .position(|b| b.is_ascii_whitespace())
                    .map_or(bytes.len(), |n| at + n);
                bytes.splice(at..end, word.bytes());
            }
            4 => {
                let end = (at + rng.random_range(0..60)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                let to = rng.random_range(0..bytes.len());
                bytes.splice(to..to, piece);
            }
            _ => bytes[at] ^= 1 << rng.random_range(0..8),
        }
    }
}

/// Everything that can be done with the bytes.
fn exercise(bytes: &[u8]) {
    for lenient in [false, true] {
        let options = ReadOptions::default().with_lenient(lenient);
        let document = match Document::parse("mutant", bytes, &options) {
            Ok(document) => document,
            Err(error) => {
                assert!(error.to_string().starts_with("mutant"), "{error}");
                continue;
            }
        };
        for dialect in [Dialect::G2o, Dialect::Toro, Dialect::Isam, Dialect::Pyfg] {
            let mut text = Vec::new();
            if document.write(&mut text, dialect).is_err() || dialect != document.dialect() {
                continue;
            }
            let again = Document::parse("again", text.as_slice(), &ReadOptions::default());
            let again = again.unwrap_or_else(|error| {
                panic!(
                    "{error}\n{}\n{}",
                    String::from_utf8_lossy(bytes),
                    String::from_utf8_lossy(&text)
                )
            });
            let said = |d: &Document| {
                d.lines()
                    .iter()
                    .map(|l| (l.time(), l.kernel(), l.record.clone()))
                    .collect::<Vec<_>>()
            };
            assert_eq!(said(&document), said(&again), "{}", String::from_utf8_lossy(bytes));
        }
        if let Ok(mut replay) = Replay::new(&document, &ReplayOptions::default()) {
            let graph = Graph::new();
            let mut change = graph.change();
            if replay.everything(&mut change).is_ok() {
                let mut graph = graph;
                let staged = graph.stage(&change).expect("the change fits");
                graph.commit(staged);
            }
        }
    }
}

/// A few lines of a graph, which still fit together: the vertices, and some of the rest.
fn some_lines(whole: &str, rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut text = String::new();
    for line in whole.lines() {
        let is_named = line.starts_with("VERTEX") || line.starts_with("PARAMS");
        if is_named || rng.random_range(0..8) == 0 {
            text.push_str(line);
            text.push('\n');
        }
    }
    text.into_bytes()
}

#[test]
fn files_cut_anywhere_do_not_panic() {
    for text in common::lines::ALL {
        (0..text.len()).step_by(5).for_each(|end| exercise(&text.as_bytes()[..end]));
    }
}

#[test]
fn line_ends_and_marks_of_other_systems_are_white_space() {
    for text in common::lines::ALL {
        let read = |text: &str| {
            let document =
                Document::parse("text", text.as_bytes(), &ReadOptions::default()).unwrap();
            document.lines().iter().map(|line| format!("{:?}", line.record)).collect::<Vec<_>>()
        };
        assert_eq!(read(text), read(&format!("\u{feff}{}", text.replace('\n', "\r\n"))));
        assert_eq!(read(text), read(&text.replace(' ', "  ").replace('\n', " \n\n")));
        assert_eq!(read(text), read(text.trim_end()));
    }
}

/// How many mutants of small graphs there are: 6000, or what `EVERGRAPH_MUTANTS` says.
fn rounds() -> usize {
    let asked = std::env::var("EVERGRAPH_MUTANTS").ok();
    asked.map_or(6000, |rounds| rounds.parse().expect("EVERGRAPH_MUTANTS is a number"))
}

#[test]
fn mutants_of_small_graphs_do_not_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for round in 0..rounds() {
        let mut bytes = some_lines(common::lines::ALL[round % common::lines::ALL.len()], &mut rng);
        mutate(&mut bytes, &mut rng);
        exercise(&bytes);
    }
}

#[test]
fn mutants_of_real_graphs_do_not_panic() {
    let Some(data) = common::data("mutants_of_real_graphs_do_not_panic") else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for path in common::all_graph_files(&data) {
        let whole = std::fs::read(&path).unwrap();
        for _ in 0..40 {
            // A piece from the middle of the file, so that each round is quick.
            let start = rng.random_range(0..whole.len());
            let mut bytes = whole[start..whole.len().min(start + 3000)].to_vec();
            mutate(&mut bytes, &mut rng);
            exercise(&bytes);
        }
    }
}

#[test]
fn noise_is_an_error() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for length in [0, 1, 10, 1000, 100_000] {
        let mut bytes = vec![0; length];
        rng.fill_bytes(&mut bytes);
        for lenient in [false, true] {
            let options = ReadOptions::default().with_lenient(lenient);
            assert!(Document::parse("noise", bytes.as_slice(), &options).is_err(), "{length}");
        }
    }
}
