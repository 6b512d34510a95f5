//! Optimizes a g2o file with apex-solver, from the file's vertices to full convergence.
//!
//! usage: peer-apex FILE.g2o gn|lm
//!
//! apex-solver's own between factor, which is `Log(xj^-1 xi z)`, whitened by the file's matrices,
//! and its sparse Cholesky. Levenberg-Marquardt with its preset for 2D pose graphs, or its default
//! in 3D, and the first pose fixed; Gauss-Newton with a prior on the first pose, as in the
//! crate's own programs. Tolerances are set to nothing: runs go on until rounding ends them.
//!
//! Prints one line of JSON: `trace` has the error over the seconds of `optimize()` so far.

#[path = "../../g2o.rs"]
mod g2o;

use std::sync::{Arc, Mutex};
use std::time::Instant;

use apex_solver::core::VarKey;
use apex_solver::core::problem::Problem;
use apex_solver::core::variable::ManifoldVariable;
use apex_solver::optimizer::gauss_newton::GaussNewtonConfig;
use apex_solver::{
    BetweenFactor, GaussNewton, JacobianMode, LevenbergMarquardt, LevenbergMarquardtConfig,
    ManifoldType, NoiseModel, OptObserver, PriorFactor, SE2, SE3,
};
use nalgebra::{Quaternion, Vector3, dvector};
use slotmap::SlotMap;

const MAX_ITERATIONS: usize = 100;
/// Relative; where rounding ends a run's progress.
const CONVERGED: f64 = 1e-13;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, path, method] = &arguments[..] else { panic!("usage: peer-apex FILE.g2o gn|lm") };
    let file = g2o::read(path);
    let mut problem = problem(&file, method == "lm");
    let clock = Clock { begun: Instant::now(), trace: Arc::default() };
    let trace = Arc::clone(&clock.trace);
    let result = match method.as_str() {
        "gn" => {
            let settings = GaussNewtonConfig::new()
                .with_max_iterations(MAX_ITERATIONS)
                .with_cost_tolerance(CONVERGED)
                .with_parameter_tolerance(0.0)
                .with_gradient_tolerance(0.0);
            let mut solver = GaussNewton::with_config(settings);
            solver.add_observer(clock);
            solver.optimize(&mut problem)
        }
        "lm" => {
            let preset = match file.is_3d() {
                true => LevenbergMarquardtConfig::new(),
                false => LevenbergMarquardtConfig::for_2d_pose_graph(),
            };
            let settings = preset
                .with_max_iterations(MAX_ITERATIONS)
                .with_cost_tolerance(CONVERGED)
                .with_parameter_tolerance(0.0)
                .with_gradient_tolerance(0.0);
            let mut solver = LevenbergMarquardt::with_config(settings);
            solver.add_observer(clock);
            solver.optimize(&mut problem)
        }
        _ => panic!("{method} is neither gn nor lm"),
    };
    let status = match &result {
        Ok(result) => format!("{:?}", result.status),
        Err(error) => error.to_string(),
    };
    let mut errors = vec![(0.0, result.map_or(f64::NAN, |result| result.initial_cost))];
    errors.extend(trace.lock().expect("one thread").iter());
    println!(
        "{}",
        serde_json::json!({"peer": "apex-solver", "version": "1.5.0", "method": method, "status": status, "trace": errors})
    );
}

/// Writes down the error after each iteration, and when.
struct Clock {
    begun: Instant,
    trace: Arc<Mutex<Vec<(f64, f64)>>>,
}

impl OptObserver for Clock {
    fn on_step(&self, _: &SlotMap<VarKey, Box<dyn ManifoldVariable>>, _: usize) {}

    fn set_iteration_metrics(&self, cost: f64, _: f64, _: Option<f64>, _: f64, _: Option<f64>) {
        self.trace.lock().expect("one thread").push((self.begun.elapsed().as_secs_f64(), cost));
    }
}

fn problem(file: &g2o::PoseGraph, fix_first: bool) -> Problem {
    let mut problem = Problem::new(JacobianMode::Sparse);
    let dimension = if file.is_3d() { 6 } else { 3 };
    let keys: Vec<VarKey> = file
        .poses
        .iter()
        .map(|p| match file.is_3d() {
            true => problem.add_variable(
                ManifoldType::SE3,
                dvector![p[0], p[1], p[2], p[6], p[3], p[4], p[5]],
            ),
            false => problem.add_variable(ManifoldType::SE2, p.clone()),
        })
        .collect();
    if fix_first {
        for direction in 0..dimension {
            problem.fix_variable(keys[0], direction);
        }
    } else if file.is_3d() {
        problem.add_residual_block(
            &[keys[0]],
            Box::new(PriorFactor::new(se3(&file.poses[0]))),
            None,
        );
    } else {
        problem.add_residual_block(
            &[keys[0]],
            Box::new(PriorFactor::new(se2(&file.poses[0]))),
            None,
        );
    }
    for edge in &file.edges {
        let noise =
            NoiseModel::from_information(edge.information.clone()).expect("positive definite");
        let ends = [keys[edge.from], keys[edge.to]];
        if file.is_3d() {
            let between = Box::new(BetweenFactor::new(se3(&edge.measurement)));
            problem.add_residual_block_with_noise(&ends, between, None, noise);
        } else {
            let between = Box::new(BetweenFactor::new(se2(&edge.measurement)));
            problem.add_residual_block_with_noise(&ends, between, None, noise);
        }
    }
    problem
}

fn se2(pose: &g2o::Pose) -> SE2 {
    SE2::from_xy_angle(pose[0], pose[1], pose[2])
}

fn se3(pose: &g2o::Pose) -> SE3 {
    let rotation = Quaternion::new(pose[6], pose[3], pose[4], pose[5]);
    SE3::from_translation_quaternion(Vector3::new(pose[0], pose[1], pose[2]), rotation)
}
