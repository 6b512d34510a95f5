//! Trajectory files, a line at a time.

use std::io::{BufRead, Read};
use std::path::Path;
use std::sync::Arc;

use evergraph_model::{Manifold, Point3, Pose3, Rot3};
use nalgebra::{Matrix3, Vector4};

use super::error::TrajectoryError;
use super::lines::{LONGEST_LINE, for_each_line, number, open};
use super::{Trajectory, TrajectoryFormat};
use crate::error::{Field, FormatError, Place, excerpt};
use crate::matrix::half_units;

/// How far the length of a quaternion may be from 1: two printed digits explain no more.
const UNIT_TOLERANCE: f64 = 1e-2;

/// By how much `RᵀR` may differ from the identity beyond what the printed digits explain: matrices
/// multiplied in single precision pass.
const ORTHOGONALITY: f64 = 1e-5;

const TUM: &str = "timestamp tx ty tz qx qy qz qw";
const KITTI: &str = "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz";

impl Trajectory {
    /// Reads a trajectory file.
    ///
    /// Quaternions are normalized, and the rotations of KITTI files replaced by the closest
    /// orthogonal matrix, so that what the printed digits rounded away is restored.
    ///
    /// # Errors
    /// [`FormatError::Read`], [`TrajectoryError::NoPose`], and whatever is wrong with a line:
    /// the number of its fields, a field that is no finite number, a quaternion whose length is off
    /// by more than 0.01 or a matrix that is no rotation beyond what the printed digits explain
    /// ([`TrajectoryError::NotUnit`], [`TrajectoryError::NotARotation`]: both are a sign of other
    /// columns), a time that does not come after the one before
    /// ([`TrajectoryError::NotAscending`]: with equal times nobody could tell which pose is meant).
    pub fn read(path: impl AsRef<Path>, format: TrajectoryFormat) -> Result<Self, TrajectoryError> {
        let (name, file) = open(path.as_ref())?;
        Self::parse(&name, file, format)
    }

    /// Reads a trajectory from anything that gives bytes; `name` stands for the file in messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(
        name: &str,
        reader: impl BufRead,
        format: TrajectoryFormat,
    ) -> Result<Self, TrajectoryError> {
        let name: Arc<str> = name.into();
        let mut poses = Vec::new();
        let mut times: Vec<f64> = Vec::new();
        let mut matrices = Vec::new();
        for_each_line(&name, reader, |place, text| {
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match format {
                TrajectoryFormat::Tum => {
                    let [time, x, y, z, rotation @ ..] = numbers::<8>("TUM", TUM, &words, place)?;
                    let pose = Pose3::new(unit(rotation, place)?, Point3::new(x, y, z));
                    if let Some(&previous) = times.last().filter(|&&previous| previous >= time) {
                        let place = place.clone();
                        return Err(TrajectoryError::NotAscending { place, time, previous });
                    }
                    times.push(time);
                    poses.push(pose);
                }
                TrajectoryFormat::Kitti => {
                    let rows = numbers::<12>("KITTI", KITTI, &words, place)?;
                    poses.push(from_rows(&rows, &words, place)?);
                    matrices.push(rows);
                }
            }
            Ok(())
        })?;
        if poses.is_empty() {
            return Err(TrajectoryError::NoPose { name });
        }
        Ok(match format {
            TrajectoryFormat::Tum => {
                Self { name, poses, ids: None, times: Some(times), matrices: None, of_plane: false }
            }
            TrajectoryFormat::Kitti => {
                let ids = Some((0..poses.len() as u64).collect());
                Self { name, poses, ids, times: None, matrices: Some(matrices), of_plane: false }
            }
        })
    }
}

impl TrajectoryFormat {
    /// Tells from the first line that holds anything whether a file is a trajectory: twelve fields
    /// that begin with a number are KITTI, any others that do TUM. `None` where they begin with a
    /// word, as the lines of graph files do.
    ///
    /// # Errors
    /// [`FormatError::Read`].
    pub fn of_content(path: impl AsRef<Path>) -> Result<Option<Self>, FormatError> {
        let (name, mut file) = open(path.as_ref())?;
        let mut line = Vec::new();
        loop {
            line.clear();
            let limited = (&mut file).take(LONGEST_LINE as u64).read_until(b'\n', &mut line);
            if limited.map_err(|source| FormatError::Read { file: name.clone(), source })? == 0 {
                return Ok(None);
            }
            let text = line.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(&line).trim_ascii();
            if text.is_empty() || text[0] == b'#' {
                continue;
            }
            let words = text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
            let is_number = matches!(text[0], b'0'..=b'9' | b'+' | b'-' | b'.');
            return Ok(is_number.then(|| match words.count() {
                12 => Self::Kitti,
                _ => Self::Tum,
            }));
        }
    }
}

/// The fields of a line, all of them finite numbers.
fn numbers<const N: usize>(
    format: &'static str,
    layout: &'static str,
    words: &[&str],
    place: &Place,
) -> Result<[f64; N], TrajectoryError> {
    if words.len() != N {
        let (place, found) = (place.clone(), words.len());
        return Err(TrajectoryError::FieldCount { place, format, expected: N, found, layout });
    }
    let mut numbers = [0.0; N];
    for (at, ((out, word), name)) in
        numbers.iter_mut().zip(words).zip(layout.split(' ')).enumerate()
    {
        *out = number(word, place, || Field {
            tag: format,
            number: at + 1,
            name,
            text: excerpt(word),
        })?;
    }
    Ok(numbers)
}

/// The rotation of a quaternion. One that is of unit length already keeps its bits, so that what
/// was written reads back as it was.
fn unit(quaternion: [f64; 4], place: &Place) -> Result<Rot3, TrajectoryError> {
    let length = Vector4::from(quaternion).norm();
    if (length - 1.0).abs() <= 4.0 * f64::EPSILON {
        return Ok(Rot3::load(&quaternion));
    }
    let [qx, qy, qz, qw] = quaternion;
    Rot3::from_quaternion(qx, qy, qz, qw)
        .ok()
        .filter(|_| (length - 1.0).abs() <= UNIT_TOLERANCE)
        .ok_or_else(|| TrajectoryError::NotUnit { place: place.clone(), length })
}

/// The pose of a line of a KITTI file; `words` are its numbers as printed.
fn from_rows(rows: &[f64; 12], words: &[&str], place: &Place) -> Result<Pose3, TrajectoryError> {
    let left = |list: &[f64]| Matrix3::from_fn(|i, j| list[4 * i + j]);
    let texts: Vec<&str> = (0..3).flat_map(|i| words[4 * i..4 * i + 3].iter().copied()).collect();
    let rounding = Matrix3::from_row_slice(&half_units(&texts));
    let matrix = left(rows);
    let (size, determinant) = (matrix.abs(), matrix.determinant());
    let deviation = matrix.transpose() * matrix - Matrix3::identity();
    // |(M + E)ᵀ(M + E) - MᵀM| <= |M|ᵀH + Hᵀ|M| + HᵀH for |E| <= H.
    let half = size.transpose() * rounding;
    let allowed = half + half.transpose() + rounding.transpose() * rounding;
    let fits = (0..9).all(|k| deviation[k].abs() <= ORTHOGONALITY + allowed[k]);
    let rotation = if fits { closest_rotation(matrix) } else { None };
    let translation = Point3::new(rows[3], rows[7], rows[11]);
    rotation.map(|rotation| Pose3::new(rotation, translation)).ok_or_else(|| {
        TrajectoryError::NotARotation {
            place: place.clone(),
            deviation: deviation.amax(),
            determinant,
        }
    })
}

/// The orthogonal factor of the polar decomposition, by Newton's iteration (Higham 1986), which
/// squares the deviation in every step; `None` where that is a reflection.
fn closest_rotation(mut matrix: Matrix3<f64>) -> Option<Rot3> {
    const STEPS: usize = 5;
    for _ in 0..STEPS {
        matrix = 0.5 * (matrix + matrix.try_inverse()?.transpose());
    }
    Rot3::from_matrix(&matrix).ok()
}
