//! How graph files are read, and the warnings about what is in them.

use std::io::{self, Read};
use std::path::Path;

use clap::Args;
use evergraph::evaluate::Map;
use evergraph::formats::{
    Dialect, Document, G2oRotation, ReadOptions, TrajectoryFormat, WeightKind,
};
use tracing::info;

use crate::error::Error;
use crate::options::Common;
use crate::output::Output;

/// How files are read.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Reading")]
pub(crate) struct Reading {
    /// The format; told by content if not given
    #[arg(long, value_name = "g2o|toro|isam|pyfg")]
    pub format: Option<Dialect>,
    /// What the matrices of an iSAM file are: nothing in the file says so
    #[arg(long, value_name = "sqrt|information|covariance", default_value = "sqrt", value_parser = weight_kind)]
    pub isam_matrix: WeightKind,
    /// The unit of rotation weights in 3D g2o files: of the angle, or g2o's own, of the
    /// quaternion's vector part
    #[arg(long, value_name = "angle|quaternion", default_value = "angle", value_parser = rotation)]
    pub g2o_rotation: G2oRotation,
}

fn weight_kind(name: &str) -> Result<WeightKind, String> {
    name.parse()
}

fn rotation(name: &str) -> Result<G2oRotation, String> {
    name.parse()
}

impl Reading {
    /// Reads a map to be measured, or to measure by, and warns about what is odd in it. Of a graph,
    /// the document too.
    pub(crate) fn read_map(
        &self,
        path: &Path,
        common: &Common,
    ) -> Result<(Map, Option<Document>), Error> {
        if path != Path::new(STANDARD_INPUT)
            && let Some(format) = TrajectoryFormat::of_content(path)?
        {
            return Ok((Map::read(path, Some(format), &self.options(common))?, None));
        }
        let document = self.read(path, common)?;
        Ok((Map::of_document(&document)?, Some(document)))
    }

    /// Reads a file and warns about what is odd in it.
    pub(crate) fn read(&self, path: &Path, common: &Common) -> Result<Document, Error> {
        let document = self.parse(path, &self.options(common))?;
        let (name, summary) = (document.name(), document.summary());
        let (lines, poses, landmarks) = (summary.lines, summary.poses, summary.landmarks);
        info!(lines, poses, landmarks, "read {name} ({})", document.dialect());
        tell(&document, common.output());
        Ok(document)
    }

    /// Reads a file, or standard input for `-`. After an error of a line the others are counted.
    fn parse(&self, path: &Path, options: &ReadOptions) -> Result<Document, Error> {
        let piped = if path == Path::new(STANDARD_INPUT) {
            let mut bytes = Vec::new();
            let failed = |source| Error::Read { path: "standard input".into(), source };
            io::stdin().lock().read_to_end(&mut bytes).map_err(failed)?;
            Some(bytes)
        } else {
            None
        };
        let read = |options: &ReadOptions| match &piped {
            Some(bytes) => Document::read_stream("standard input", &**bytes, options),
            None => Document::read(path, options),
        };
        let error = match read(options) {
            Ok(document) => return Ok(document),
            Err(error) => error,
        };
        // A pipe that has a name, as of `<(...)`, cannot be read twice.
        let again = piped.is_some() || path.is_file();
        let lenient = options.clone().with_lenient(true);
        let bad = match again && error.place().is_some() && !options.lenient {
            true => read(&lenient).map_or(0, |document| document.summary().skipped),
            false => 0,
        };
        match bad {
            0 => Err(error.into()),
            bad => Err(Error::BadLines { first: Box::new(error), more: bad - 1 }),
        }
    }

    pub(crate) fn options(&self, common: &Common) -> ReadOptions {
        ReadOptions::default()
            .with_format(self.format)
            .with_isam_matrix(self.isam_matrix)
            .with_g2o_rotation(self.g2o_rotation)
            .with_lenient(common.lenient)
    }

    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "format": self.format.map(Dialect::name),
            "isam_matrix": self.isam_matrix.name(),
            "g2o_rotation": self.g2o_rotation.name(),
        })
    }
}

/// Names standard input where a file is asked for.
pub(crate) const STANDARD_INPUT: &str = "-";

/// Bad lines that are listed without `--verbose`.
const LISTED: usize = 10;

fn tell(document: &Document, output: Output) {
    for warning in document.summary().warnings() {
        output.warn(&format!("{}: {warning}", document.name()));
    }
    for (at, skipped) in document.skipped().iter().enumerate() {
        if at < LISTED {
            output.warn(&format!("skipped {}", skipped.error));
        } else {
            info!("skipped {}", skipped.error);
        }
    }
    if document.skipped().len() > LISTED {
        let more = document.summary().skipped - LISTED;
        output.warn(&format!("{more} more bad lines were skipped; --verbose lists them"));
    }
    let summary = document.summary();
    let factors = summary.pose_edges + summary.landmark_edges + summary.measurements;
    if factors == 0 && summary.poses > 0 {
        output.warn(&format!("{}: there are no measurements in it", document.name()));
    }
    for (tag, count) in summary.ignored.iter().filter(|(tag, _)| *tag != "#") {
        output.warn(&format!(
            "{}: {count} {tag} lines were passed over; Evergraph has no factor for them",
            document.name()
        ));
    }
}
