//! Graph files: text to records, records to text, and records to the changes of a replay.
//!
//! Three families of files describe the same thing, poses that measure each other and landmarks, in
//! different words and numbers: g2o, TORO (with HOG-Man) and iSAM. A [`Document`] keeps what a file
//! says in the file's own numbers, so that writing the same family gives the same bits, and knows
//! how to say it in another. A [`Replay`] turns a document into the
//! [`Change`](evergraph_model::Change)s that a robot would have made, step by step.
//!
//! # Lines
//!
//! A pose is `world_from_robot`; an edge `i j` measures pose `j` in the frame of pose `i`. Lengths
//! are metres, angles radians; `I` are matrix entries.
//!
//! | dialect | line | fields |
//! |---|---|---|
//! | g2o | `VERTEX_SE2` | `id x y theta` |
//! | g2o | `VERTEX_XY` | `id x y` |
//! | g2o | `VERTEX_SE3:QUAT` | `id x y z qx qy qz qw` |
//! | g2o | `VERTEX_TRACKXYZ` | `id x y z` |
//! | g2o | `EDGE_SE2` | `i j x y theta I11 I12 I13 I22 I23 I33` |
//! | g2o | `EDGE_SE2_XY` | `pose point x y I11 I12 I22` |
//! | g2o | `EDGE_SE3:QUAT` | `i j x y z qx qy qz qw` and 21 entries, the upper triangle row by row |
//! | g2o | `EDGE_SE3_TRACKXYZ` | `pose point offset x y z I11 I12 I13 I22 I23 I33` |
//! | g2o | `PARAMS_SE3OFFSET` | `id x y z qx qy qz qw`, `robot_from_sensor` |
//! | g2o | `FIX` | one id or several |
//! | TORO | `VERTEX2` | `id x y theta` |
//! | TORO | `EDGE2` | `i j x y theta I11 I12 I22 I33 I13 I23` |
//! | TORO | `VERTEX3` | `id x y z roll pitch yaw` |
//! | TORO | `EDGE3` | `i j x y z roll pitch yaw` and 21 entries, the upper triangle row by row |
//! | iSAM | `EDGE2`, `ODOMETRY`, `Constraint2` | `i j x y theta R11 R12 R13 R22 R23 R33` |
//! | iSAM | `LANDMARK` | `pose point x y R11 R12 R22` |
//! | iSAM | `EDGE3` | `i j x y z roll pitch yaw` and 21 entries, or none for the identity |
//! | iSAM | `POINT3` | `pose point x y z R11 R12 R13 R22 R23 R33`, or no entries for the identity |
//!
//! Matrices of g2o and TORO are information; iSAM's are upper triangular square roots of it unless
//! [`ReadOptions::isam_matrix`] says otherwise. Rotations by Euler angles are
//! `Rz(yaw) Ry(pitch) Rx(roll)`. 3D rotation weights are per radian; see [`G2oRotation`].
//!
//! `EQUIV`, `BR`, `DATA_FEATURE_POINTXY`, `ROBOTLASER1`, `ODOM`, `FLASER` and `#` lines are passed
//! over and counted; every other line is an error that names file and line, unless reading is
//! lenient.
//!
//! ```
//! use evergraph_formats::{Dialect, Document, ReadOptions};
//! # fn main() -> Result<(), evergraph_formats::FormatError> {
//! let text = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 1 0 -1 0 0 4 0 4 9 0 0\n";
//! let document = Document::parse("example.graph", text.as_bytes(), &ReadOptions::default())?;
//! assert_eq!(document.dialect(), Dialect::Toro);
//! let mut g2o = Vec::new();
//! document.write(&mut g2o, Dialect::G2o)?;
//! assert!(g2o.ends_with(b"EDGE_SE2 1 0 -1 0 0 4 0 0 4 0 9\n"));
//! # Ok(())
//! # }
//! ```
//!
//! References: R. Kümmerle et al., "g2o: A general framework for graph optimization" (2011);
//! G. Grisetti et al., TORO; M. Kaess et al., "iSAM: Incremental smoothing and mapping" (2008).
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod check;
mod convert;
mod document;
mod error;
mod estimate;
mod export;
mod fields;
mod kinds;
mod matrix;
mod measurement;
mod names;
mod options;
mod parse;
mod read_line;
mod reconcile;
mod record;
mod replay;
mod tags;
mod trajectory;
mod weight;
mod write;
mod write_line;

pub use document::{Document, Skipped, Summary};
pub use error::{Field, FormatError, Place};
pub use measurement::{LinearMeasurement, Measurement, Quantity};
pub use options::{Dialect, G2oRotation, ReadOptions, WriteOptions};
pub use record::{Coordinates, Kind, Line, Record};
pub use replay::{GaugePrior, Initial, Replay, ReplayOptions, Step, StepKind};
pub use trajectory::{Stamps, Trajectory, TrajectoryError, TrajectoryFormat};
pub use weight::{Entries, EntryOrder, Weight, WeightKind};
pub use write::Written;
