//! A window of ten poses, the oldest removed at each step: the standard deviation of the newest heading.

use std::time::Instant;

use evergraph::factors::BetweenPose2;
use evergraph::prelude::*;
use evergraph::removal::{Consistency, Options};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::Failure;

const LAG: usize = 10;
const LOOP: usize = 8;
const SHOWN: [usize; 9] = [30, 200, 1_600, 3_000, 10_000, 30_000, 100_000, 150_000, 200_000];

/// One row for each way to remove. Trees drift, and are stopped after 3,000 steps.
pub(crate) fn run(steps: usize) -> Result<bool, Failure> {
    let shown: Vec<usize> = SHOWN.into_iter().filter(|&step| step <= steps).collect();
    let names: Vec<String> = shown.iter().map(|step| format!(" {step}")).collect();
    println!(
        "| removal |{} | factors | us a step, first 1,000 | last 1,000 | MB |",
        names.join(" |")
    );
    println!("|---|{}---|---|---|---|", "---|".repeat(shown.len()));
    for (name, options, most) in [
        ("default", Options::default(), steps),
        ("dense", Options::dense(), steps),
        ("tree", Options::tree(), steps.min(3_000)),
        (
            "tree, conservative",
            Options::tree().with_consistency(Consistency::Conservative),
            steps.min(3_000),
        ),
        ("tree, scaled", Options::tree().with_consistency(Consistency::Scaled), steps.min(3_000)),
        ("tree, unary absorbed", Options::tree().with_keep_unary(false), steps.min(3_000)),
    ] {
        println!("{}", row(name, options, most, &shown)?);
    }
    Ok(true)
}

fn row(name: &str, options: Options, steps: usize, shown: &[usize]) -> Result<String, Failure> {
    let odometry = Noise::from_sigmas(&[0.05, 0.05, 0.01])?;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut smoother = Smoother::new(Settings::default())?;
    let mut keys: Vec<Key<Pose2>> = Vec::new();
    let (mut cells, mut times) = (Vec::new(), Vec::new());
    let mut begun = Instant::now();
    for k in 0..=steps {
        let z = Pose2::new(1.0, 0.0, 0.1).compose(&noise(&mut rng));
        let off = noise(&mut rng);
        let mut change = smoother.change();
        let estimate = match keys.last() {
            Some(&last) => smoother.estimate(last)?.compose(&z),
            None => Pose2::identity(),
        };
        let key = change.add_variable(&estimate);
        match keys.last() {
            Some(&last) => {
                change.add_factor(BetweenPose2::new(last, key, z, odometry.clone())?);
            }
            None => {
                change.add_factor(Prior::new(key, estimate, Noise::isotropic(3, 0.1)?)?);
            }
        }
        if k >= LOOP {
            let from = keys[keys.len() - LOOP];
            let z = smoother.estimate(from)?.between(&estimate).compose(&off);
            change.add_factor(BetweenPose2::new(from, key, z, odometry.clone())?);
        }
        keys.push(key);
        smoother.apply(change)?;
        if keys.len() > LAG {
            let oldest = keys.remove(0);
            let plan =
                Removal::new(smoother.graph(), &smoother).with_options(options).plan(oldest)?;
            smoother.apply(plan.into_change())?;
        }
        if shown.contains(&k) {
            cells.push(format!(" {:.4} |", smoother.marginal(key)?[(2, 2)].sqrt()));
        }
        if k == 1_000 || k + 1_000 == steps || k == steps {
            times.push(begun.elapsed().as_secs_f64());
            begun = Instant::now();
        }
    }
    cells.resize(shown.len(), " |".into());
    let micros = |time: Option<&f64>| time.map_or(f64::NAN, |time| 1e3 * time);
    Ok(format!(
        "| {name} |{} {} | {:.0} | {:.0} | {:.2} |",
        cells.concat(),
        smoother.graph().factor_count(),
        micros(times.first()),
        micros(times.last()),
        smoother.memory_bytes() as f64 / 1e6
    ))
}

fn noise(rng: &mut ChaCha8Rng) -> Pose2 {
    // Standard normal, by Box and Muller.
    let mut normal = || {
        let (u, v) = (rng.random_range(1e-12..1.0_f64), rng.random_range(0.0..1.0_f64));
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    Pose2::new(0.05 * normal(), 0.05 * normal(), 0.01 * normal())
}
