//! Random sequences of operations, good and bad, on graphs of every kind of variable and factor in
//! the plane and in space, each operation checked against an independent batch solution.
//!
//! `PROPTEST_CASES=2560` makes it 100,000 operations for each elimination; what runs by default is a
//! tenth of that.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::cell::RefCell;
use std::env;

use evergraph::prelude::*;
use evergraph_tests::check_against_batch;
use evergraph_tests::world::{MAKERS, Maker, Operation, World};
use proptest::prelude::*;
use proptest::test_runner::{FileFailurePersistence, TestRunner};

fn operation() -> impl Strategy<Value = Operation> {
    let choice = any::<usize>;
    prop_oneof![
        6 => (any::<u8>(), choice(), -0.6..0.6_f64)
            .prop_map(|(kind, from, turn)| Operation::Extend { kind, from, turn }),
        3 => (choice(), choice()).prop_map(|(maker, pick)| Operation::Weak { maker, pick }),
        10 => (choice(), choice(), any::<bool>())
            .prop_map(|(maker, pick, robust)| Operation::Measure { maker, pick, robust }),
        2 => choice().prop_map(Operation::DropFactor),
        2 => choice().prop_map(Operation::DropVariable),
        1 => choice().prop_map(Operation::Replace),
        1 => choice().prop_map(Operation::Move),
        2 => any::<u8>().prop_map(Operation::Fail),
        1 => Just(Operation::Relinearize),
        1 => Just(Operation::Optimize),
    ]
}

fn any_sequence(elimination: Elimination) {
    let cases = env::var("PROPTEST_CASES").map_or(256, |cases| cases.parse().unwrap());
    let persistence = FileFailurePersistence::Direct(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/proptest-regressions/every_factor.txt"
    ));
    let config = ProptestConfig {
        cases,
        failure_persistence: Some(Box::new(persistence)),
        ..ProptestConfig::default()
    };
    let applied = RefCell::new(vec![0; MAKERS.len()]);
    let (performed, refused) = (RefCell::new(0_usize), RefCell::new(0_usize));
    let sequences = prop::collection::vec(operation(), 1..80);
    let outcome = TestRunner::new(config).run(&sequences, |operations| {
        let mut world = World::new(elimination);
        for (step, operation) in operations.iter().enumerate() {
            world.run(operation);
            check_against_batch(&world.smoother, &format!("step {step}, {operation:?}"));
        }
        *performed.borrow_mut() += operations.len();
        *refused.borrow_mut() += world.refused;
        let mut applied = applied.borrow_mut();
        applied.iter_mut().zip(&world.applied).for_each(|(sum, count)| *sum += count);
        Ok(())
    });
    outcome.unwrap_or_else(|error| panic!("{error}"));
    if cases >= 256 {
        // Refusals are part of it, and not most of it.
        let (performed, refused) = (*performed.borrow(), *refused.borrow());
        assert!(performed > 20 * cases as usize && refused > 100 && 3 * refused < performed);
        let never: Vec<_> = World::never_applied(&applied.borrow()).collect();
        assert!(never.is_empty(), "no sequence applied {never:?}");
    }
}

#[test]
fn any_sequence_with_cholesky() {
    any_sequence(Elimination::Cholesky);
}

#[test]
fn any_sequence_with_qr() {
    any_sequence(Elimination::Qr);
}

/// A factor that is added to the library without a maker would go untested here and in the tests of
/// node removal.
#[test]
fn every_factor_of_the_library_is_measured() {
    let library = include_str!("../../crates/factors/src/lib.rs");
    // The table of factors in the documentation of the crate, which every new one is a row of.
    let names: Vec<&str> = library
        .lines()
        .filter(|line| line.starts_with("//! | ["))
        .flat_map(|line| line.split('|').nth(1).into_iter().flat_map(|cell| cell.split(", ")))
        .map(|name| name.trim().trim_start_matches("[`").trim_end_matches("`]"))
        .collect();
    assert!(names.len() > 20 && names.contains(&"Linear"), "{names:?}");
    let of = |maker: &Maker| maker.name.split([' ', '<']).next();
    let missing = |name: &&&str| !MAKERS.iter().any(|maker| of(maker) == Some(**name));
    let missing: Vec<_> = names.iter().filter(missing).collect();
    assert!(missing.is_empty(), "no maker for {missing:?}; add one to tests/src/world/makers.rs");
    // And the table has them all.
    let folder = evergraph_tests::repository().join("crates/factors/src");
    let mut sources: Vec<_> =
        std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()).collect();
    sources.extend(std::fs::read_dir(folder.join("autodiff")).unwrap().map(|e| e.unwrap().path()));
    let mut implemented = 0;
    for file in sources.iter().filter(|path| path.extension().is_some_and(|end| end == "rs")) {
        let text = std::fs::read_to_string(file).unwrap();
        for line in text.lines().filter(|line| line.starts_with("impl")) {
            let Some((_, rest)) = line.split_once(" Factor for ") else { continue };
            let name = rest.split(['<', ' ']).next().unwrap();
            if name == "Conditioned" {
                continue; // Any factor of the table, with some of its variables given.
            }
            assert!(
                names.contains(&name),
                "{name} is not in the table of crates/factors/src/lib.rs"
            );
            implemented += 1;
        }
    }
    assert!(implemented > 20, "{implemented} factors found");
}
