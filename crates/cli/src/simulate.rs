//! `evergraph simulate`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use evergraph::formats::WriteOptions;
use evergraph::simulate::{Closures, Grid, Landmarks, Surface, World};
use serde_json::json;

use crate::error::Error;
use crate::files;
use crate::options::Common;
use crate::report::{self, SCHEMA};

const EXAMPLES: &str = "\
Examples:
  evergraph simulate manhattan --poses 3500 --seed 1 --output town.g2o --truth truth.g2o
  evergraph simulate city --poses 10000 --landmarks --output city.g2o
  evergraph simulate sphere --poses 2500 --odometry-sigmas 0.1,0.1,0.1,0.01,0.01,0.01 -o ball.g2o
  evergraph simulate manhattan --poses 500 --closure-probability 0 -o chain.g2o

The same options give the same bits on every platform. The output holds the odometry as vertices
and every measurement; the truth holds the true vertices.";

/// The shape of the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Shape {
    /// 2D, a random walk on a grid of short blocks, as M3500
    Manhattan,
    /// 2D, long streets, visited many times, as city10000
    City,
    /// 3D, a spiral over a sphere, as sphere2500
    Sphere,
    /// 3D, a spiral around a torus
    Torus,
}

/// Make a world with known truth.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The shape of the world
    #[arg(value_enum)]
    shape: Shape,
    /// How many poses
    #[arg(long, value_name = "N", default_value_t = 1000)]
    poses: u32,
    /// Names the world: another seed, another walk and other noise
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// What the robot recorded
    #[arg(long, short, value_name = "FILE", help_heading = "Output")]
    output: PathBuf,
    /// Where everything really was
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    truth: Option<PathBuf>,
    /// Standard deviations of the odometry: x,y,theta or x,y,z,rx,ry,rz (m, rad)
    #[arg(long, value_name = "S,S,..", value_delimiter = ',', help_heading = "Noise")]
    odometry_sigmas: Option<Vec<f64>>,
    /// Standard deviations of loop closures, likewise
    #[arg(long, value_name = "S,S,..", value_delimiter = ',', help_heading = "Noise")]
    closure_sigmas: Option<Vec<f64>>,
    /// How likely a pose in reach is recognized; 0 for no loop closures
    #[arg(long, value_name = "P", help_heading = "Loop closures")]
    closure_probability: Option<f64>,
    /// How far away a recognized pose may be (m)
    #[arg(long, value_name = "M", help_heading = "Loop closures")]
    closure_radius: Option<f64>,
    /// At most so many closures at one pose
    #[arg(long, value_name = "N", help_heading = "Loop closures")]
    closures_per_pose: Option<u32>,
    /// Put landmarks beside the streets (manhattan, city)
    #[arg(long, help_heading = "Landmarks")]
    landmarks: bool,
    /// How many landmarks stand in a square meter
    #[arg(long, value_name = "D", requires = "landmarks", help_heading = "Landmarks")]
    landmark_density: Option<f64>,
    /// How far a pose can see (m)
    #[arg(long, value_name = "M", requires = "landmarks", help_heading = "Landmarks")]
    landmark_range: Option<f64>,
    /// Standard deviations of sightings: x,y in the robot's frame (m)
    #[arg(
        long,
        value_name = "S,S",
        value_delimiter = ',',
        requires = "landmarks",
        help_heading = "Landmarks"
    )]
    landmark_sigmas: Option<Vec<f64>>,
    #[command(flatten)]
    pub(crate) common: Common,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let common = &arguments.common;
    let output = common.output();
    let world = match arguments.shape {
        Shape::Manhattan => grid(Grid::manhattan(arguments.poses, arguments.seed), arguments)?,
        Shape::City => grid(Grid::city(arguments.poses, arguments.seed), arguments)?,
        Shape::Sphere => surface(Surface::sphere(arguments.poses, arguments.seed), arguments)?,
        Shape::Torus => surface(Surface::torus(arguments.poses, arguments.seed), arguments)?,
    };
    let written =
        files::write_document(&arguments.output, &world.document, WriteOptions::default())?;
    crate::convert::tell(&written, &arguments.output, output);
    if let Some(path) = &arguments.truth {
        let written = files::write_document(path, &world.truth, WriteOptions::default())?;
        crate::convert::tell(&written, path, output);
    }
    let summary = world.document.summary();
    let closures = summary.pose_edges + 1 - summary.poses;
    let report = json!({
        "schema": SCHEMA,
        "command": "simulate",
        "dataset": report::file_name(&arguments.output),
        "seed": arguments.seed,
        "poses": summary.poses,
        "landmarks": summary.landmarks,
        "pose_edges": summary.pose_edges,
        "closures": closures,
        "landmark_edges": summary.landmark_edges,
    });
    report::save(common.report.as_deref(), &report)?;
    output.result(&format!(
        "{}: {} poses, {} landmarks, {closures} loop closures, {} sightings",
        arguments.output.display(),
        summary.poses,
        summary.landmarks,
        summary.landmark_edges
    ))
}

fn grid(mut grid: Grid, arguments: &Arguments) -> Result<World, Error> {
    if let Some(sigmas) = &arguments.odometry_sigmas {
        grid.odometry = exactly(sigmas, "--odometry-sigmas")?;
    }
    close(&mut grid.closures, arguments)?;
    if arguments.landmarks {
        let mut landmarks = Landmarks::default();
        landmarks.density = arguments.landmark_density.unwrap_or(landmarks.density);
        landmarks.range = arguments.landmark_range.unwrap_or(landmarks.range);
        if let Some(sigmas) = &arguments.landmark_sigmas {
            landmarks.sigmas = exactly(sigmas, "--landmark-sigmas")?;
        }
        grid.landmarks = Some(landmarks);
    }
    Ok(grid.generate()?)
}

fn surface(mut surface: Surface, arguments: &Arguments) -> Result<World, Error> {
    if arguments.landmarks {
        let message = "--landmarks stand beside streets: only manhattan and city have them".into();
        return Err(Error::Usage { command: "simulate", message });
    }
    if let Some(sigmas) = &arguments.odometry_sigmas {
        surface.odometry = exactly(sigmas, "--odometry-sigmas")?;
    }
    close(&mut surface.closures, arguments)?;
    Ok(surface.generate()?)
}

fn close<const N: usize>(closures: &mut Closures<N>, arguments: &Arguments) -> Result<(), Error> {
    closures.probability = arguments.closure_probability.unwrap_or(closures.probability);
    closures.radius = arguments.closure_radius.unwrap_or(closures.radius);
    closures.per_pose = arguments.closures_per_pose.unwrap_or(closures.per_pose);
    if let Some(sigmas) = &arguments.closure_sigmas {
        closures.sigmas = exactly(sigmas, "--closure-sigmas")?;
    }
    Ok(())
}

fn exactly<const N: usize>(sigmas: &[f64], option: &str) -> Result<[f64; N], Error> {
    sigmas.try_into().map_err(|_| Error::Usage {
        command: "simulate",
        message: format!("{option} has {} numbers, but this world needs {N}", sigmas.len()),
    })
}
