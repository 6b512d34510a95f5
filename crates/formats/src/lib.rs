//! Graph files: text to records, and records to text.
//!
//! Four families of files describe graphs of poses and landmarks: g2o, TORO (with HOG-Man), iSAM and
//! PyFactorGraph. A [`Document`] keeps the records of a file in the file's own numbers. Writing the
//! same family gives the same bits; writing another converts them. A graph in memory becomes a
//! document by [`Document::from_graph`]. The crate `evergraph-replay` turns a document into the changes that a
//! robot would have made, step by step.
//!
//! # Lines
//!
//! A pose is `world_from_robot`; an edge `i j` measures pose `j` in the frame of pose `i`. Lengths
//! are metres, angles radians; `3I` stands for the upper triangle of a 2 × 2 matrix row by row, `6I`
//! for 3 × 3, `21I` for 6 × 6; `pose` in a list of numbers is `x y theta` or `x y z qx qy qz qw`.
//!
//! | dialect | line | fields |
//! |---|---|---|
//! | g2o | `VERTEX_SE2` | `id x y theta` |
//! | g2o | `VERTEX_XY` | `id x y` |
//! | g2o | `VERTEX_SE3:QUAT` | `id x y z qx qy qz qw` |
//! | g2o | `VERTEX_TRACKXYZ` | `id x y z` |
//! | g2o | `EDGE_SE2` | `i j x y theta 6I` |
//! | g2o | `EDGE_SE2_XY` | `pose point x y 3I` |
//! | g2o | `EDGE_SE3:QUAT` | `i j x y z qx qy qz qw 21I` |
//! | g2o | `EDGE_SE3_TRACKXYZ` | `pose point offset x y z 6I` |
//! | g2o | `EDGE_PRIOR_SE2`, `EDGE_PRIOR_XY`, `EDGE_POINTXYZ_PRIOR` | `id`, as in the vertex line, `6I`, `3I`, `6I` |
//! | g2o | `EDGE_SE3_PRIOR` | `id offset x y z qx qy qz qw 21I`: the pose of the sensor |
//! | g2o | `EDGE_PRIOR_SE2_XY` | `id x y 3I`: position, as of 2D GPS |
//! | g2o | `EDGE_SE3_XYZ_PRIOR` | `id [offset] x y z 6I`: position; the offset, which g2o names and does not use, may be missing |
//! | g2o | `EDGE_SE3_PRIORXYZ` | `id x y z 6I`: position (hdl_graph_slam); written as the line above |
//! | g2o | `EDGE_BEARING_SE2_XY` | `pose point bearing I` |
//! | g2o | `EDGE_POINTXY`, `EDGE_POINTXYZ` | `i j x y 3I`, `i j x y z 6I` |
//! | g2o | `PARAMS_SE3OFFSET` | `id x y z qx qy qz qw`, `robot_from_sensor` |
//! | g2o | `FIX` | one id or several, of poses or landmarks that stay where they are |
//! | own | `FACTOR_ANTENNA_SE2`, `_SE3` | `id x y ax ay 3I`, `id x y z ax ay az 6I`: where in the world, then where on the robot |
//! | own | `FACTOR_DEPTH_SE3`, `FACTOR_HEADING_SE2`, `_SE3` | `id z I`, `id heading I` |
//! | own | `FACTOR_ROLL_PITCH_SE3` | `id roll pitch 3I` |
//! | own | `FACTOR_ATTITUDE_SE3` | `id gx gy gz mx my mz 3I`: a direction in the world, and as the robot sees it |
//! | own | `FACTOR_PLANE_SE3` | `id height 6I`: height and tilt of motion in a plane |
//! | own | `FACTOR_RANGE_SE2`, `_SE2_XY`, `_SE3`, `_SE3_XYZ`, `_XY`, `_XYZ` | `i j range I`, a pose before a point |
//! | own | `FACTOR_BEARING_SE2`, `_SE3`, `_SE3_XYZ` | `i j bearing I`, `i j bx by bz 3I` |
//! | own | `FACTOR_BEARING_RANGE_SE2`, `_SE2_XY`, `_SE3`, `_SE3_XYZ` | `i j bearing range 3I`, `i j bx by bz range 6I` |
//! | own | `FACTOR_DEPTH_DIFFERENCE_SE3`, `FACTOR_HEADING_DIFFERENCE_SE3` | `i j difference I` |
//! | own | `FACTOR_TRANSLATION_DIFFERENCE_SE2`, `_SE3` | `i j dx dy 3I`, `i j dx dy dz 6I`: in the world's axes |
//! | own | `FACTOR_PARTIAL_SE2`, `_SE3` | `i j k pose A I`: `k` combinations of the tangent, `k` rows of 3 or 6, then the upper triangle of `k` rows |
//! | own | `FACTOR_LINEAR` | `shift n`, `n` times `kind id` and a linearization point, `q`, `G` row by row, `d'`; `shift` is `none`, `root` or `inverse_root` ([`RootShift`](evergraph_factors::RootShift)), `kind` is `SE2`, `SE3`, `XY` or `XYZ` |
//! | own | `GEODETIC_ORIGIN` | `latitude longitude height` of the world's origin (degrees, m; WGS 84), one line at most |
//! | own | `ROBUST` | `huber` or `pseudo_huber`, a threshold, and the line of any factor of g2o or our own |
//! | TORO | `VERTEX2` | `id x y theta` |
//! | TORO | `EDGE2` | `i j x y theta I11 I12 I22 I33 I13 I23` |
//! | TORO | `VERTEX3` | `id x y z roll pitch yaw` |
//! | TORO | `EDGE3` | `i j x y z roll pitch yaw 21I` |
//! | TORO | `BR` | `pose landmark bearing range S1 S2`, standard deviations; landmarks have no vertices (GTSAM) |
//! | iSAM | `EDGE2`, `ODOMETRY`, `Constraint2` | `i j x y theta 6I` |
//! | iSAM | `LANDMARK` | `pose point x y 3I` |
//! | iSAM | `EDGE3` | `i j x y z roll pitch yaw 21I`, or no entries for the identity |
//! | iSAM | `POINT3` | `pose point x y z 6I`, or no entries for the identity |
//! | PyFactorGraph | `VERTEX_SE2`, `VERTEX_SE3:QUAT` | `time name pose` |
//! | PyFactorGraph | `VERTEX_XY`, `VERTEX_XYZ` | `[time] name x y`, `[time] name x y z` |
//! | PyFactorGraph | `VERTEX_SE2:PRIOR`, `VERTEX_SE3:QUAT:PRIOR`, `VERTEX_XY:PRIOR`, `VERTEX_XYZ:PRIOR` | `time name`, as in the vertex line, and the matrix |
//! | PyFactorGraph | `EDGE_SE2`, `EDGE_SE3:QUAT` | `time a b pose`, and the matrix |
//! | PyFactorGraph | `EDGE_SE2_XY`, `EDGE_SE3_XYZ` | `time pose point x y 3I`, `time pose point x y z 6I` |
//! | PyFactorGraph | `EDGE_RANGE` | `time a b range variance`, of poses and landmarks |
//!
//! Matrices of g2o, of our own lines (which stand in g2o files) and of TORO are information; iSAM's
//! are upper triangular square roots of it unless [`ReadOptions::isam_matrix`] says otherwise;
//! PyFactorGraph's are covariances. Rotations by Euler angles are `Rz(yaw) Ry(pitch) Rx(roll)`. 3D
//! rotation weights are per radian; see [`G2oRotation`], which speaks of `EDGE_SE3:QUAT` and
//! `EDGE_SE3_PRIOR`. Other readers of g2o know nothing of our own lines:
//! [`WriteOptions::plain`] leaves them out.
//!
//! PyFactorGraph's names are a letter and an index, `L` for landmarks where no VERTEX line says
//! otherwise; a name's id is GTSAM's symbol, the letter in the top byte. Its VERTEX lines are ground
//! truth, not an estimate ([`Document::vertices_are_truth`]).
//!
//! `EQUIV`, `DATA_FEATURE_POINTXY`, `ROBOTLASER1`, `ODOM`, `FLASER` and `#` lines are passed
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
//! G. Grisetti et al., TORO; M. Kaess et al., "iSAM: Incremental smoothing and mapping" (2008);
//! A. Papalia et al., PyFactorGraph.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod check;
mod contents;
mod convert;
mod coordinates;
mod document;
mod error;
mod estimate;
mod export;
mod factor_data;
mod fields;
mod kinds;
mod magnitude;
mod matrix;
mod measurement;
mod names;
mod noise;
mod options;
mod parse;
mod ranges;
mod read_line;
mod reconcile;
mod record;
mod source;
mod tags;
mod trajectory;
mod weight;
mod write;
mod write_line;

pub use contents::{Skipped, Summary};
pub use coordinates::{Coordinates, Kind};
pub use document::Document;
pub use error::{Field, FormatError, Place};
pub use factor_data::{Reading, ReadingError, catalogue, relative_data};
pub use measurement::{LinearMeasurement, Measurement, Quantity};
pub use names::{parse_id, short_id, spell_id, symbol};
pub use options::{Dialect, G2oRotation, ReadOptions, WriteOptions};
pub use record::{Line, Record};
pub use trajectory::{Stamps, Trajectory, TrajectoryError, TrajectoryFormat};
pub use weight::{Entries, EntryOrder, Weight, WeightKind};
pub use write::Written;
