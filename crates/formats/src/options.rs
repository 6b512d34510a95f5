//! Which dialect, and what its matrices mean.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use crate::weight::WeightKind;

/// A family of graph files. Told by content, never by extension: see [`ReadOptions::format`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Dialect {
    /// `VERTEX_SE2`, `EDGE_SE2` and so on; the matrices are information.
    G2o,
    /// `VERTEX2`, `EDGE2`, `VERTEX3`, `EDGE3` of TORO and HOG-Man; the matrices are information.
    Toro,
    /// iSAM's `ODOMETRY`, `EDGE2`, `Constraint2`, `LANDMARK`, `EDGE3`, `POINT3`; no vertices; the
    /// matrices are square roots of information unless [`ReadOptions::isam_matrix`] says otherwise.
    Isam,
    /// PyFactorGraph's `VERTEX_SE2`, `EDGE_SE2`, `EDGE_RANGE` and so on, with times, and names such
    /// as `A0` for ids; the matrices are covariances and the vertices ground truth.
    Pyfg,
}

impl Dialect {
    /// The name that [`FromStr`] reads: `g2o`, `toro`, `isam` or `pyfg`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::G2o => "g2o",
            Self::Toro => "toro",
            Self::Isam => "isam",
            Self::Pyfg => "pyfg",
        }
    }

    /// The dialect that a file of this name is *written* in: `.g2o`, `.graph` and `.toro` (TORO),
    /// `.txt` (iSAM), `.pyfg` (PyFactorGraph).
    pub fn of_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "g2o" => Some(Self::G2o),
            "graph" | "toro" => Some(Self::Toro),
            "txt" => Some(Self::Isam),
            "pyfg" => Some(Self::Pyfg),
            _ => None,
        }
    }
}

impl fmt::Display for Dialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::G2o => "g2o",
            Self::Toro => "TORO",
            Self::Isam => "iSAM",
            Self::Pyfg => "PyFactorGraph",
        })
    }
}

impl FromStr for Dialect {
    type Err = String;

    /// `g2o`, `toro`, `isam` or `pyfg`, in any case.
    fn from_str(name: &str) -> Result<Self, String> {
        match name.to_ascii_lowercase().as_str() {
            "g2o" => Ok(Self::G2o),
            "toro" => Ok(Self::Toro),
            "isam" => Ok(Self::Isam),
            "pyfg" => Ok(Self::Pyfg),
            _ => Err(format!("`{name}` is no format; there are g2o, toro, isam and pyfg")),
        }
    }
}

/// The unit of the rotation part of g2o's 3D information.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum G2oRotation {
    /// As it stands: the weight of an angle in radians, as GTSAM, SE-Sync and Ceres' example read it.
    #[default]
    Angle,
    /// g2o's own: the weight of the quaternion's vector part, about half the angle, so that the
    /// rotation rows and columns are each halved on the way to radians.
    Quaternion,
}

impl G2oRotation {
    /// The name that [`FromStr`] reads: `angle` or `quaternion`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Angle => "angle",
            Self::Quaternion => "quaternion",
        }
    }
}

impl FromStr for G2oRotation {
    type Err = String;

    /// `angle` or `quaternion`, in any case.
    fn from_str(name: &str) -> Result<Self, String> {
        match name.to_ascii_lowercase().as_str() {
            "angle" => Ok(Self::Angle),
            "quaternion" => Ok(Self::Quaternion),
            _ => Err(format!("`{name}` is no rotation unit; there are angle and quaternion")),
        }
    }
}

impl WeightKind {
    /// The name that [`FromStr`] reads: `sqrt`, `information` or `covariance`; standard deviations, which
    /// iSAM files do not have, are not read.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SquareRoot => "sqrt",
            Self::Information => "information",
            Self::Covariance => "covariance",
            Self::Sigmas => "standard deviations",
        }
    }
}

impl FromStr for WeightKind {
    type Err = String;

    /// `sqrt`, `information` or `covariance`, in any case.
    fn from_str(name: &str) -> Result<Self, String> {
        match name.to_ascii_lowercase().as_str() {
            "sqrt" => Ok(Self::SquareRoot),
            "information" => Ok(Self::Information),
            "covariance" => Ok(Self::Covariance),
            _ => Err(format!(
                "`{name}` is no kind of matrix; there are sqrt, information and covariance"
            )),
        }
    }
}

/// How a file is read.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ReadOptions {
    /// The dialect; told by content when `None` (the default). The tags that g2o and PyFactorGraph
    /// share are the latter's where there are names such as `A0` for ids. `EDGE2` and `EDGE3` are
    /// TORO's in a file with `VERTEX2` or `VERTEX3`, else iSAM's; where those vertices come later,
    /// a file is read again from its start, and [`parse`](crate::Document::parse), which cannot do
    /// that, gives an error. Every other tag belongs to one dialect.
    pub format: Option<Dialect>,
    /// What the matrices of an iSAM file are; nothing in the file says so. Default: square roots.
    pub isam_matrix: WeightKind,
    /// The unit of 3D rotation weights in g2o files, read or written. Default: angle.
    pub g2o_rotation: G2oRotation,
    /// Bad lines are skipped, counted and listed instead of being errors. Default: false.
    pub lenient: bool,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            format: None,
            isam_matrix: WeightKind::SquareRoot,
            g2o_rotation: G2oRotation::Angle,
            lenient: false,
        }
    }
}

impl ReadOptions {
    /// Sets [`format`](Self::format).
    #[must_use]
    pub const fn with_format(mut self, format: Option<Dialect>) -> Self {
        self.format = format;
        self
    }

    /// Sets [`isam_matrix`](Self::isam_matrix).
    #[must_use]
    pub const fn with_isam_matrix(mut self, isam_matrix: WeightKind) -> Self {
        self.isam_matrix = isam_matrix;
        self
    }

    /// Sets [`g2o_rotation`](Self::g2o_rotation).
    #[must_use]
    pub const fn with_g2o_rotation(mut self, g2o_rotation: G2oRotation) -> Self {
        self.g2o_rotation = g2o_rotation;
        self
    }

    /// Sets [`lenient`](Self::lenient).
    #[must_use]
    pub const fn with_lenient(mut self, lenient: bool) -> Self {
        self.lenient = lenient;
        self
    }
}

/// How a document is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct WriteOptions {
    /// Leaves out, and counts, what other readers of g2o do not know: lines of tags that are our
    /// own (`FACTOR_...`, `GEODETIC_ORIGIN`) and `ROBUST` before a line, which stays without it.
    /// Default: false.
    pub plain: bool,
}

impl WriteOptions {
    /// Sets [`plain`](Self::plain).
    #[must_use]
    pub const fn with_plain(mut self, plain: bool) -> Self {
        self.plain = plain;
        self
    }
}
