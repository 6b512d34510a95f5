//! Writing trajectory files.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use evergraph_model::Pose3;

use super::{Trajectory, TrajectoryError, TrajectoryFormat};
use crate::error::FormatError;
use crate::write_line::push_number;

impl Trajectory {
    /// Writes the poses, a line each, in the shortest numbers that read back as the same bits.
    ///
    /// The time of a TUM line is the pose's time, or its id as a number where times are not known.
    /// What was read from a KITTI file is written to one with the same numbers.
    ///
    /// # Errors
    /// [`TrajectoryError::EqualTimes`] for poses of one time in a TUM file, [`FormatError::Write`].
    pub fn write(
        &self,
        out: &mut dyn Write,
        format: TrajectoryFormat,
    ) -> Result<(), TrajectoryError> {
        if format == TrajectoryFormat::Tum {
            self.check_times()?;
        }
        let io_error = |source| FormatError::Write { file: Arc::clone(&self.name), source };
        let mut text = String::new();
        for (index, pose) in self.poses.iter().enumerate() {
            text.clear();
            match (format, &self.matrices) {
                (TrajectoryFormat::Tum, _) => push(&mut text, &self.tum(index)),
                (TrajectoryFormat::Kitti, Some(matrices)) => push(&mut text, &matrices[index]),
                (TrajectoryFormat::Kitti, None) => push(&mut text, &rows(pose)),
            }
            out.write_all(text.as_bytes()).map_err(io_error)?;
        }
        Ok(out.flush().map_err(io_error)?)
    }

    /// Writes a file; the format goes by the extension, see [`TrajectoryFormat::of_extension`].
    ///
    /// # Errors
    /// [`TrajectoryError::UnknownExtension`] and those of [`write`](Self::write). What the format
    /// cannot hold is found before the file is touched.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), TrajectoryError> {
        let path = path.as_ref();
        let file = || -> Arc<str> { path.display().to_string().into() };
        let Some(format) = TrajectoryFormat::of_extension(path) else {
            return Err(TrajectoryError::UnknownExtension { file: file() });
        };
        self.write(&mut io::sink(), format)?;
        let target =
            File::create(path).map_err(|source| FormatError::Write { file: file(), source })?;
        self.write(&mut BufWriter::new(target), format).map_err(|error| match error {
            TrajectoryError::Format(FormatError::Write { source, .. }) => {
                FormatError::Write { file: file(), source }.into()
            }
            other => other,
        })
    }

    fn tum(&self, index: usize) -> [f64; 8] {
        let pose = &self.poses[index];
        let [qx, qy, qz, qw] = pose.rotation().quaternion();
        [self.time_or_id(index), pose.x(), pose.y(), pose.z(), qx, qy, qz, qw]
    }

    /// Whether a TUM file can tell all poses apart; ids beyond 2^53 are one number, too.
    fn check_times(&self) -> Result<(), TrajectoryError> {
        let id = |index: usize| self.ids.as_ref().map_or(index as u64, |ids| ids[index]);
        let equal = (1..self.len()).find(|&k| self.time_or_id(k) <= self.time_or_id(k - 1));
        match equal {
            None => Ok(()),
            Some(k) => Err(TrajectoryError::EqualTimes {
                name: Arc::clone(&self.name),
                first: id(k - 1),
                second: id(k),
                time: self.time_or_id(k),
            }),
        }
    }
}

/// The upper 3 rows of a pose's matrix.
fn rows(pose: &Pose3) -> [f64; 12] {
    let (r, t) = (pose.rotation().matrix(), [pose.x(), pose.y(), pose.z()]);
    std::array::from_fn(|k| if k % 4 == 3 { t[k / 4] } else { r[(k / 4, k % 4)] })
}

fn push(text: &mut String, numbers: &[f64]) {
    for (k, &x) in numbers.iter().enumerate() {
        if k > 0 {
            text.push(' ');
        }
        push_number(text, x);
    }
    text.push('\n');
}
