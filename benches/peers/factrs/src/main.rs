//! Optimizes a g2o file with factrs, from the file's vertices to full convergence.
//!
//! usage: peer-factrs FILE.g2o gn|lm
//!
//! factrs' own between residual, which is `Log(xj^-1 xi z)`, and its own optimizers with their
//! default settings. Its SE(2) logarithm takes translations as they stand where the rotation is
//! negative (version 0.3.0), so that in 2D its optimum is not quite the others'. A prior of 0.01 m
//! and rad holds the first pose.
//!
//! Prints one line of JSON: `trace` has the error over the seconds that `optimize()` has taken so
//! far, which is the setup and, for each iteration, a step and an error.

#[path = "../../g2o.rs"]
mod g2o;

use std::time::Instant;

use factrs::assign_symbols;
use factrs::containers::FactorBuilder;
use factrs::core::{
    BetweenResidual, GaussNewton, GaussianNoise, Graph, LevenMarquardt, PriorResidual, SE2, SE3,
    SO3, Values,
};
use factrs::linalg::{Matrix3, Matrix6};
use factrs::optimizers::{OptError, Optimizer};
use nalgebra::{DMatrix, Vector3};

assign_symbols!(X: SE2, SE3);

const MAX_ITERATIONS: usize = 100;
/// Relative; where rounding ends a run's progress.
const CONVERGED: f64 = 1e-13;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, path, method] = &arguments[..] else { panic!("usage: peer-factrs FILE.g2o gn|lm") };
    let (graph, start) = factor_graph(&g2o::read(path));
    let (trace, status) = match method.as_str() {
        "gn" => optimize(GaussNewton::new_default(graph), start),
        "lm" => optimize(LevenMarquardt::new_default(graph), start),
        _ => panic!("{method} is neither gn nor lm"),
    };
    println!(
        "{}",
        serde_json::json!({"peer": "factrs", "version": "0.3.0", "method": method, "status": status, "trace": trace})
    );
}

/// `Optimizer::optimize` with a clock; its own tolerances would stop before the last digits.
fn optimize(mut optimizer: impl Optimizer, start: Values) -> (Vec<(f64, f64)>, String) {
    let clock = Instant::now();
    optimizer.init(&start);
    let mut values = start;
    let mut error = optimizer.error(&values);
    let mut trace = vec![(clock.elapsed().as_secs_f64(), error)];
    for iteration in 1..=MAX_ITERATIONS {
        match optimizer.step(values, iteration) {
            Ok((next, _)) => values = next,
            Err(OptError::FailedToStep) => return (trace, "no step lowers the error".to_owned()),
            Err(error) => return (trace, format!("{error:?}")),
        }
        let before = std::mem::replace(&mut error, optimizer.error(&values));
        trace.push((clock.elapsed().as_secs_f64(), error));
        if !error.is_finite() {
            return (trace, "diverged".to_owned());
        }
        if (before - error).abs() <= CONVERGED * before {
            return (trace, "converged".to_owned());
        }
    }
    (trace, "iterations used up".to_owned())
}

fn factor_graph(file: &g2o::PoseGraph) -> (Graph, Values) {
    let (mut graph, mut values) = (Graph::new(), Values::new());
    if file.is_3d() {
        let first = FactorBuilder::new1(PriorResidual::new(se3(&file.poses[0])), X(0));
        graph.add_factor(first.noise(GaussianNoise::<6>::from_scalar_sigma(0.01)).build());
        for (id, pose) in (0..).zip(&file.poses) {
            values.insert(X(id), se3(pose));
        }
        for edge in &file.edges {
            let noise =
                Matrix6::from_iterator(rotation_first(&edge.information, 3).iter().copied());
            let noise = GaussianNoise::from_matrix_inf(noise.as_view()).expect("positive definite");
            let between = BetweenResidual::new(se3(&edge.measurement));
            let keys = (X(edge.from as u32), X(edge.to as u32));
            graph.add_factor(FactorBuilder::new2(between, keys.0, keys.1).noise(noise).build());
        }
    } else {
        let first = FactorBuilder::new1(PriorResidual::new(se2(&file.poses[0])), X(0));
        graph.add_factor(first.noise(GaussianNoise::<3>::from_scalar_sigma(0.01)).build());
        for (id, pose) in (0..).zip(&file.poses) {
            values.insert(X(id), se2(pose));
        }
        for edge in &file.edges {
            let noise =
                Matrix3::from_iterator(rotation_first(&edge.information, 2).iter().copied());
            let noise = GaussianNoise::from_matrix_inf(noise.as_view()).expect("positive definite");
            let between = BetweenResidual::new(se2(&edge.measurement));
            let keys = (X(edge.from as u32), X(edge.to as u32));
            graph.add_factor(FactorBuilder::new2(between, keys.0, keys.1).noise(noise).build());
        }
    }
    (graph, values)
}

fn se2(pose: &g2o::Pose) -> SE2 {
    SE2::new(pose[2], pose[0], pose[1])
}

fn se3(pose: &g2o::Pose) -> SE3 {
    let rotation = SO3::from_xyzw(pose[3], pose[4], pose[5], pose[6]);
    SE3::from_rot_trans(rotation, Vector3::new(pose[0], pose[1], pose[2]))
}

/// g2o's tangent vectors start with the translation, factrs' with the rotation.
fn rotation_first(information: &DMatrix<f64>, translations: usize) -> DMatrix<f64> {
    let n = information.nrows();
    DMatrix::from_fn(n, n, |row, column| {
        information[((row + translations) % n, (column + translations) % n)]
    })
}
