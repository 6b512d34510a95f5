//! Whatever the bytes, reading gives a document or an error; what it gives can be written, read
//! again and replayed.

mod common;

use evergraph_formats::{Dialect, Document, ReadOptions, Replay, ReplayOptions};
use evergraph_model::Graph;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SEEDS: &[&str] = &[
    "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 7 1 1\nFIX 1\n\
     EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400\nEDGE_SE2_XY 1 7 0.5 1e0 10 0 10\n",
    "PARAMS_SE3OFFSET 3 0 0 0.5 0 0 0 1\nVERTEX_TRACKXYZ 9 1 2 3\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n\
     VERTEX_SE3:QUAT 1 1 0 0 0 0 0.1 0.995\nEDGE_SE3_TRACKXYZ 1 9 3 1 1 1 5 0 0 5 0 5\n\
     EDGE_SE3:QUAT 0 1 1 0 0 0 0 0.1 0.995 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n",
    "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEQUIV 0 1\nEDGE2 1 0 -1 0 0 4 0.1 4 9 0 0.2\n",
    "VERTEX3 0 0 0 0 0 0 0\nVERTEX3 1 1 0 0 0.1 0.2 0.3\n\
     EDGE3 0 1 1 0 0 0.1 0.2 0.3 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n",
    "ODOMETRY 0 1 1 0 0 10 0 0 10 0 20\nConstraint2 1 2 1 0 0 10 0 0 10 0 20\nLANDMARK 2 1 1 1 2 0 2\n",
    "EDGE3 0 1 1 0 0 0 0 1\nEDGE3 1 2 1 0 0 0 0 1\nPOINT3 2 5 1 1 1\nPOINT3 1 5 1 1 1 2 0 0 2 0 2\n",
];

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
        let options = ReadOptions { lenient, ..ReadOptions::default() };
        let document = match Document::parse("mutant", bytes, &options) {
            Ok(document) => document,
            Err(error) => {
                assert!(error.to_string().starts_with("mutant"), "{error}");
                continue;
            }
        };
        for dialect in [Dialect::G2o, Dialect::Toro, Dialect::Isam] {
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
            assert!(document.records().eq(again.records()), "{}", String::from_utf8_lossy(bytes));
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

#[test]
fn mutants_of_small_graphs_do_not_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for round in 0..6000 {
        let mut bytes = SEEDS[round % SEEDS.len()].as_bytes().to_vec();
        mutate(&mut bytes, &mut rng);
        exercise(&bytes);
    }
}

#[test]
fn mutants_of_real_graphs_do_not_panic() {
    let Some(data) = common::data("mutants_of_real_graphs_do_not_panic") else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for path in common::graph_files(&data) {
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
            let options = ReadOptions { lenient, ..ReadOptions::default() };
            assert!(Document::parse("noise", bytes.as_slice(), &options).is_err(), "{length}");
        }
    }
}
