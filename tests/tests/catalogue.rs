//! Every factor that the tests can make goes through plain data, as text and as bytes, and comes
//! back with the same bits; a graph takes it on the same variables.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::f64::consts::FRAC_PI_3;

use evergraph::factors::catalogue::{Catalogue, FactorData};
use evergraph::model::{Arguments, Change, Kernel, Linearization};
use evergraph::prelude::*;
use evergraph_tests::world::{Kind, MAKERS, Variable, Wiggle, catalogue};

fn add(change: &mut Change, kind: Kind, w: &mut Wiggle) -> Variable {
    let mut n = || w.next(3.0);
    let rotation = Rot3::from_roll_pitch_yaw(n(), n(), n());
    match kind {
        Kind::Pose2 => {
            let truth = Pose2::new(n(), n(), n());
            Variable::Pose2(change.add_variable(&truth), truth)
        }
        Kind::Pose3 => {
            let truth = Pose3::new(rotation, Point3::new(n(), n(), n()));
            Variable::Pose3(change.add_variable(&truth), truth)
        }
        Kind::Point2 => {
            let truth = Point2::new(n(), n());
            Variable::Point2(change.add_variable(&truth), truth)
        }
        Kind::Point3 => {
            let truth = Point3::new(n(), n(), n());
            Variable::Point3(change.add_variable(&truth), truth)
        }
        Kind::Rot2 => {
            let truth = Rot2::from_angle(FRAC_PI_3 * n());
            Variable::Rot2(change.add_variable(&truth), truth)
        }
        Kind::Rot3 => Variable::Rot3(change.add_variable(&rotation), rotation),
        Kind::Vector => {
            let truth = VectorN::new([n(), n(), n(), n()]);
            Variable::Vector(change.add_variable(&truth), truth)
        }
    }
}

/// Bits of the Jacobian, the residual and the loss.
fn bits(factor: &dyn Factor, at: &[Value]) -> Vec<u64> {
    let storages: Vec<&[f64]> = at.iter().map(Value::storage).collect();
    let mut columns = vec![0];
    for value in at {
        columns.push(columns[columns.len() - 1] + value.dim() as u32);
    }
    let rows = factor.residual_dim();
    let mut matrix = vec![0.0; rows * (columns[at.len()] as usize + 1)];
    let mut out = Linearization::new(rows, &columns, &mut matrix);
    factor.linearize(&Arguments::new(&storages), &mut out);
    let mut residual = vec![0.0; rows];
    factor.residual(&Arguments::new(&storages), &mut residual);
    let error = factor.error(&residual);
    matrix.iter().chain(&residual).chain([&error]).map(|x| x.to_bits()).collect()
}

fn through_text_and_bytes(data: &FactorData) -> [FactorData; 2] {
    let text = serde_json::to_string(data).unwrap();
    let config = bincode::config::standard();
    let bytes = bincode::serde::encode_to_vec(data, config).unwrap();
    let (read, _) = bincode::serde::decode_from_slice(&bytes, config).unwrap();
    [serde_json::from_str(&text).unwrap(), read]
}

#[test]
fn every_factor_comes_back_from_plain_data() {
    let catalogue: Catalogue = catalogue();
    let mut w = Wiggle::default();
    let kernels = [None, Kernel::huber(0.3).ok(), Kernel::pseudo_huber(2.0).ok()];
    for maker in MAKERS {
        for round in 0..30 {
            let mut graph = Graph::new();
            let mut change = graph.change();
            let ends: Vec<Variable> =
                maker.kinds.iter().map(|kind| add(&mut change, *kind, &mut w)).collect();
            let at: Vec<Value> = ends
                .iter()
                .map(|end| {
                    let truth = end.truth();
                    truth.retract(&w.vector(truth.dim(), 0.3)).unwrap()
                })
                .collect();
            let factor = maker.make(&ends, &mut w, kernels[round % 3]);
            let data = catalogue.to_data(&*factor).unwrap();
            for read in through_text_and_bytes(&data) {
                assert_eq!(read, data, "{}", maker.name);
                let again = catalogue.to_factor(&read).unwrap();
                assert_eq!(again.name(), factor.name());
                assert_eq!(again.keys(), factor.keys());
                assert_eq!(bits(&*again, &at), bits(&*factor, &at), "{}", maker.name);
                change.add_shared_factor(again);
            }
            let staged = graph.stage(&change).unwrap();
            graph.commit(staged);
        }
    }
}
