//! The contents of a file as they are read: its records, what was counted, and what was skipped.

use std::collections::BTreeMap;

use crate::check::{self, Finding};
use crate::error::FormatError;
use crate::kinds::Kinds;
use crate::options::Dialect;
use crate::record::{Line, Record};

/// The number of skipped lines that are listed; all are counted.
const LISTED: usize = 1000;

/// The contents of a document, counted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Summary {
    /// Lines of the file, blank ones included.
    pub lines: usize,
    /// Poses, with a VERTEX line or named by an edge.
    pub poses: usize,
    /// Landmarks, with a VERTEX line or named by an edge.
    pub landmarks: usize,
    /// VERTEX lines.
    pub vertices: usize,
    /// Edges between poses.
    pub pose_edges: usize,
    /// Observations of landmarks.
    pub landmark_edges: usize,
    /// Any other factors: priors, positions, ranges, bearings, partial states, linear factors.
    pub measurements: usize,
    /// Factors under a robust kernel, already counted as what they are.
    pub robust: usize,
    /// Ids that FIX lines name.
    pub fixed: usize,
    /// PARAMS lines.
    pub offsets: usize,
    /// Lines of tags that are recognized and passed over, and `#` lines, by tag.
    pub ignored: BTreeMap<String, usize>,
    /// Bad lines that were skipped because reading was lenient.
    pub skipped: usize,
    /// Information matrices that are indefinite by what the printed digits rounded away; where
    /// they are used, the negative part is taken as zero.
    pub clipped: usize,
    /// Quaternions whose length is off by more than 0.001; where they are used, they are
    /// normalized.
    pub long_quaternions: usize,
}

impl Summary {
    /// Warnings for the user, a sentence each.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.skipped > 0 {
            let listed = if self.skipped > LISTED {
                format!("; the first {} are listed", LISTED)
            } else {
                String::new()
            };
            warnings.push(format!("{} bad lines were skipped{listed}", self.skipped));
        }
        if self.clipped > 0 {
            warnings.push(format!(
                "{} information matrices have a negative eigenvalue that the printed digits explain; it is taken as zero",
                self.clipped
            ));
        }
        if self.long_quaternions > 0 {
            warnings.push(format!(
                "{} quaternions are off unit length by more than {}; they are normalized",
                self.long_quaternions,
                check::QUATERNION_TOLERANCE
            ));
        }
        warnings
    }
}

/// A line that was skipped because reading was lenient.
#[derive(Debug)]
#[non_exhaustive]
pub struct Skipped {
    /// The line, from 1.
    pub line: usize,
    /// The error.
    pub error: FormatError,
}

/// The contents before the records are reconciled.
#[derive(Default)]
pub(crate) struct Contents {
    pub dialect: Option<Dialect>,
    pub lines: Vec<Line>,
    pub total_lines: usize,
    pub summary: Summary,
    pub skipped: Vec<Skipped>,
}

impl Contents {
    pub fn ignore(&mut self, tag: &str) {
        match self.summary.ignored.get_mut(tag) {
            Some(count) => *count += 1,
            None => {
                self.summary.ignored.insert(tag.to_string(), 1);
            }
        }
    }

    /// Returns the error, or when reading leniently counts and lists it.
    pub(crate) fn reject(
        &mut self,
        error: FormatError,
        line: usize,
        lenient: bool,
    ) -> Result<(), FormatError> {
        if !lenient || error.spoils_the_file() {
            return Err(error);
        }
        self.summary.skipped += 1;
        if self.skipped.len() < LISTED {
            self.skipped.push(Skipped { line, error });
        }
        Ok(())
    }

    pub fn note(&mut self, finding: Finding) {
        self.summary.clipped += usize::from(finding.clipped);
        self.summary.long_quaternions += usize::from(finding.long_quaternion);
    }
}

impl Summary {
    pub(crate) fn count(&mut self, lines: &[Line], kinds: &Kinds) {
        let kinds = kinds.as_slice();
        self.poses = kinds.iter().filter(|(_, kind)| kind.is_pose()).count();
        self.landmarks = kinds.len() - self.poses;
        (self.vertices, self.pose_edges, self.landmark_edges) = (0, 0, 0);
        (self.fixed, self.offsets, self.measurements) = (0, 0, 0);
        self.robust = lines.iter().filter(|line| line.kernel().is_some()).count();
        for line in lines {
            let counter = match &line.record {
                Record::Vertex { .. } => &mut self.vertices,
                Record::Edge { measurement, .. } if measurement.kind().is_pose() => {
                    &mut self.pose_edges
                }
                Record::Edge { .. } => &mut self.landmark_edges,
                Record::Fix { .. } => &mut self.fixed,
                Record::SensorOffset { .. } => &mut self.offsets,
                Record::Measurement(_) | Record::Linear(_) => &mut self.measurements,
                Record::GeodeticOrigin { .. } => continue,
            };
            *counter += 1;
        }
    }
}
