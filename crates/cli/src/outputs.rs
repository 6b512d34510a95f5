//! The files that a solving subcommand leaves behind.

use std::path::{Path, PathBuf};

use clap::Args;
use evergraph::Replayer;
use evergraph::formats::{
    Document, Kind, Stamps, Trajectory, TrajectoryError, TrajectoryFormat, WriteOptions,
};
use evergraph::model::{Pose3, Value};
use evergraph::prelude::LieGroup;

use crate::convert;
use crate::error::Error;
use crate::files::{self, NewFile};
use crate::output::Output;
use crate::plot::PlotPath;
use crate::report::Report;
use crate::steps::StepName;

/// Where the result goes.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Output")]
pub(crate) struct Outputs {
    /// Write the graph with the estimates as its vertices; .g2o, .graph, .toro, .txt (iSAM) or .pyfg
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Leave out of --output what other readers of the format do not know
    #[arg(long, requires = "output")]
    plain: bool,
    /// Draw the map, edges of large residuals in colours (and, of a replay, the time of each step); .svg
    /// or .png
    #[arg(long, value_name = "FILE", value_parser = PlotPath::parse)]
    plot: Option<PlotPath>,
    /// Write the poses; .tum or .kitti
    #[arg(long, value_name = "FILE", value_parser = TrajectoryPath::parse)]
    trajectory: Option<TrajectoryPath>,
    /// Times for --trajectory, lines of `id,timestamp`; without, the file's own, or ids
    #[arg(long, value_name = "FILE.csv", requires = "trajectory")]
    times: Option<PathBuf>,
}

/// A path that names a trajectory.
#[derive(Clone, Debug)]
struct TrajectoryPath {
    path: PathBuf,
    format: TrajectoryFormat,
}

impl TrajectoryPath {
    fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let format = TrajectoryFormat::of_extension(&path)
            .ok_or("the extension says which format: .tum or .kitti")?;
        Ok(Self { path, format })
    }
}

/// Outputs that can be written as far as that can be known before the work.
#[derive(Debug)]
pub(crate) struct Prepared<'a> {
    outputs: &'a Outputs,
    stamps: Stamps,
}

impl Outputs {
    /// Checks every target, `others` too, and reads the times.
    pub(crate) fn prepare(
        &self,
        command: &'static str,
        document: &Document,
        others: [Option<&Path>; 2],
    ) -> Result<Prepared<'_>, Error> {
        let plot = self.plot.as_ref().map(PlotPath::path);
        let trajectory = self.trajectory.as_ref().map(|it| it.path.as_path());
        let [one, other] = others;
        let besides = || [one, other, plot, trajectory].into_iter().flatten();
        files::check_distinct(command, besides().chain(self.output.as_deref()))?;
        if let Some(path) = &self.output {
            files::check_output(path, document, self.options())?;
        }
        for path in besides() {
            files::check_writable(path)?;
        }
        let stamps = match &self.times {
            Some(path) => Stamps::read(path)?,
            None => Stamps::of_document(document),
        };
        let prepared = Prepared { outputs: self, stamps };
        if let Some(to) = &self.trajectory {
            // As it will be, but for where the poses are.
            let ids = document.ids().into_iter().filter(|(_, kind)| kind.is_pose());
            let somewhere = |(id, _): (u64, Kind)| (id, Value::new(&Pose3::identity()));
            let trajectory = prepared.stamped(document.name(), ids.map(somewhere))?;
            trajectory.write(&mut std::io::sink(), to.format)?;
        }
        Ok(prepared)
    }

    fn options(&self) -> WriteOptions {
        WriteOptions::default().with_plain(self.plain)
    }
}

impl Prepared<'_> {
    /// Writes them: the map first, which is what cost the work.
    pub(crate) fn write(
        &self,
        replayer: &Replayer,
        document: &Document,
        report: &Report,
        times: Option<Vec<(StepName, f64)>>,
        output: Output,
    ) -> Result<(), Error> {
        report.check(replayer)?;
        if let Some(path) = &self.outputs.output {
            let solution = replayer.solution(document)?;
            let written = files::write_document(path, &solution, self.outputs.options())?;
            convert::tell(&written, path, output);
        }
        if let Some(to) = &self.outputs.trajectory {
            self.write_trajectory(to, replayer)?;
        }
        if let Some(path) = &self.outputs.plot {
            report.plot(replayer, document, times)?.save(path)?;
        }
        Ok(())
    }

    fn write_trajectory(&self, to: &TrajectoryPath, replayer: &Replayer) -> Result<(), Error> {
        let estimates = replayer.smoother().estimates();
        let estimates = estimates.map_err(|source| Error::unsolvable(replayer, source))?;
        let values = replayer
            .replay()
            .ids()
            .filter_map(|(id, variable)| Some((id, estimates.value(variable).ok()?.to_value())));
        let trajectory = self.stamped(replayer.name(), values)?;
        let mut file = NewFile::create(&to.path)?;
        file.fill(|out| trajectory.write(out, to.format))?;
        file.finish()
    }

    fn stamped(
        &self,
        name: &str,
        values: impl Iterator<Item = (u64, Value)>,
    ) -> Result<Trajectory, TrajectoryError> {
        let trajectory = Trajectory::of_estimates(name, values)?;
        // A file whose poses have no times is written with ids in their place.
        if self.stamps.is_empty() && self.outputs.times.is_none() {
            return Ok(trajectory);
        }
        trajectory.with_stamps(&self.stamps)
    }
}
