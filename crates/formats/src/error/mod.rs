//! What can be wrong with a graph file, in words that say where and what to do.

mod place;

use std::io;
use std::sync::Arc;

use evergraph_model::VariableId;
use thiserror::Error;

pub(crate) use self::place::excerpt;
pub use self::place::{Field, Place};
use crate::names::spell_id;
use crate::options::Dialect;

/// The reason for which a file cannot be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The file could not be opened or read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The file.
        file: Arc<str>,
        /// What the system says.
        source: io::Error,
    },
    /// The file could not be created or written.
    #[error("{file}: cannot be written: {source}")]
    Write {
        /// The file.
        file: Arc<str>,
        /// What the system says.
        source: io::Error,
    },
    /// The name's extension names no format.
    #[error(
        "{file}: the extension does not say which format to write; use .g2o, .graph or .toro (TORO), .txt (iSAM) or .pyfg (PyFactorGraph)"
    )]
    UnknownExtension {
        /// The file.
        file: Arc<str>,
    },
    /// There is no graph in the file.
    #[error(
        "{file}: no vertex or edge line was found ({ignored} lines were passed over); is this a g2o, TORO, iSAM or PyFactorGraph graph?"
    )]
    Empty {
        /// The file.
        file: Arc<str>,
        /// Lines that hold no vertex or edge, bad ones included.
        ignored: usize,
    },
    /// A line is not text.
    #[error(
        "{place}: the line is not text (it holds {what}); is this a binary or compressed file? Unpack it first"
    )]
    NotText {
        /// Where.
        place: Place,
        /// What makes it so.
        what: &'static str,
    },
    /// A line is longer than any line of a graph.
    #[error(
        "{place}: the line is longer than {limit} bytes, which no line of a graph is; is this a graph file?"
    )]
    LineTooLong {
        /// Where.
        place: Place,
        /// The longest line that is read.
        limit: usize,
    },
    /// A tag that no supported format has.
    #[error(
        "{place}: `{tag}` is no line of a g2o, TORO, iSAM or PyFactorGraph graph that is supported; remove such lines, or read leniently to skip and count them"
    )]
    UnknownTag {
        /// Where.
        place: Place,
        /// The tag, cut to 40 characters.
        tag: Box<str>,
    },
    /// A tag of another dialect than the file's.
    #[error(
        "{place}: `{tag}` belongs to another dialect; the file is {dialect} {because}. Keep to one dialect, or name it with the format option (TORO files list their vertices before the first edge)"
    )]
    MixedDialects {
        /// Where.
        place: Place,
        /// The tag.
        tag: &'static str,
        /// The file's dialect.
        dialect: Dialect,
        /// How that is known.
        because: String,
    },
    /// Too few or too many fields.
    #[error(
        "{place}: {tag} has {found} fields after the tag, not {expected}; is the line cut off, or are two lines run together? Its fields are `{layout}`"
    )]
    FieldCount {
        /// Where.
        place: Place,
        /// The tag.
        tag: &'static str,
        /// How many there should be.
        expected: String,
        /// How many there are.
        found: usize,
        /// The fields in order.
        layout: &'static str,
    },
    /// A field that should be a number is not.
    #[error("{place}: {field}, which is not a number; correct or remove the line")]
    NotANumber {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
    },
    /// A number is infinite or NaN.
    #[error("{place}: {field}, which is not finite; correct or remove the line")]
    NotFinite {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
    },
    /// A number is so large that squares overflow.
    #[error(
        "{place}: {field}, which is too large: beyond {limit:.0e} here, products of squares do not fit 64-bit numbers; correct the number or its unit"
    )]
    TooLarge {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
        /// The largest size of this number; that of a measurement depends on its weight.
        limit: f64,
    },
    /// An id is not an unsigned 64-bit integer.
    #[error(
        "{place}: {field}, which is not an id; ids are whole numbers from 0 to 18446744073709551615"
    )]
    NotAnId {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
    },
    /// A field that should be a PyFactorGraph name is none.
    #[error(
        "{place}: {field}, which is not a name; names are a letter and a number below 2^56 without leading zeros, such as A0"
    )]
    NotAName {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
    },
    /// A field that says how many others follow does not fit the line.
    #[error("{place}: {field}, which is not a count from 1 to {most}; is the line cut off?")]
    NotACount {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
        /// How many there can be at most.
        most: usize,
    },
    /// A field that should be one of a few words is another.
    #[error("{place}: {field}, which is none of {words}")]
    NoSuchWord {
        /// Where.
        place: Place,
        /// The field.
        field: Box<Field>,
        /// The words.
        words: String,
    },
    /// A number that no such measurement can have.
    #[error("{place}: the {what} of the {tag} line is {value}, but has to be {demand}")]
    OutOfRange {
        /// Where.
        place: Place,
        /// The tag.
        tag: &'static str,
        /// What it is.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it should be.
        demand: &'static str,
    },
    /// A robust kernel that there is not, or before a line that is no factor.
    #[error(
        "{place}: the robust kernel cannot be used: {problem}; such a line is `ROBUST huber 1.345 EDGE_SE2 ...`"
    )]
    BadKernel {
        /// Where.
        place: Place,
        /// Why.
        problem: String,
    },
    /// A second GEODETIC_ORIGIN line.
    #[error(
        "{place}: the geodetic origin was given before, in line {first}; keep one of the two lines"
    )]
    SecondOrigin {
        /// Where.
        place: Place,
        /// The line that gave it first.
        first: usize,
    },
    /// TORO vertices after edges that were taken for iSAM's, which have the same tags.
    #[error(
        "{place}: `{tag}` makes this a TORO file, but its lines up to here were read as iSAM's, because no vertex came before the `{edge}` of line {first}; put the vertices first, or name the format (toro)"
    )]
    EdgesBeforeVertices {
        /// Where.
        place: Place,
        /// The vertex's tag.
        tag: &'static str,
        /// The first edge's tag.
        edge: &'static str,
        /// The first edge's line.
        first: usize,
    },
    /// An id that no PyFactorGraph name stands for.
    #[error(
        "{file}: {id} cannot be written as a PyFactorGraph name, which is a letter (top byte of the id) and an index; number the variables below 2^56", id = spell_id(*id)
    )]
    NoName {
        /// The file.
        file: Arc<str>,
        /// The id.
        id: u64,
    },
    /// Two variables would have the same PyFactorGraph name.
    #[error(
        "{file}: {id} and {other} would both be `{name}` in a PyFactorGraph file; renumber one", id = spell_id(*id), other = spell_id(*other)
    )]
    NameTaken {
        /// The file.
        file: Arc<str>,
        /// The id.
        id: u64,
        /// The name.
        name: String,
        /// The id that has the name already.
        other: u64,
    },
    /// Nothing of the document has a line in the target format.
    #[error(
        "{file}: {dialect} files have no line for anything in it, so nothing would be written; write another format"
    )]
    NothingToWrite {
        /// The file.
        file: Arc<str>,
        /// The format asked for.
        dialect: Dialect,
    },
    /// A second VERTEX or PARAMS line for the same id.
    #[error("{place}: {what} {id} was given before, in line {first}; keep one of the two lines", id = spell_id(*id))]
    Duplicate {
        /// Where.
        place: Place,
        /// `vertex` or `sensor offset`.
        what: &'static str,
        /// The id.
        id: u64,
        /// The line that gave it first.
        first: usize,
    },
    /// An edge from a variable to itself.
    #[error(
        "{place}: the edge leads from {id} to itself; an edge joins two variables, correct or remove the line", id = spell_id(*id)
    )]
    SelfEdge {
        /// Where.
        place: Place,
        /// The id.
        id: u64,
    },
    /// An id without a VERTEX line in a file that has VERTEX lines, or that no line but FIX names.
    #[error(
        "{place}: vertex {id} is not in the file; add its VERTEX line, or remove the line that names it", id = spell_id(*id)
    )]
    MissingVertex {
        /// Where.
        place: Place,
        /// The id.
        id: u64,
    },
    /// A sensor offset that no PARAMS line gives.
    #[error(
        "{place}: sensor offset {id} is not in the file; add a line `PARAMS_SE3OFFSET {id} x y z qx qy qz qw`"
    )]
    MissingOffset {
        /// Where.
        place: Place,
        /// The id.
        id: u64,
    },
    /// A variable is used as something that it is not.
    #[error(
        "{place}: {id} is used as a {used}, but elsewhere in the file it is a {actual}; poses and landmarks share one range of ids, so each id is one of them", id = spell_id(*id)
    )]
    WrongKind {
        /// Where.
        place: Place,
        /// The id.
        id: u64,
        /// What this line makes of it.
        used: &'static str,
        /// What it is.
        actual: &'static str,
    },
    /// The matrix of a measurement is not that of any measurement.
    #[error(
        "{place}: the {kind} matrix of the {tag} line is not positive {demand} (its smallest eigenvalue is {eigenvalue:.3e}, and the printed digits do not explain that); is it written in another order or as another kind of matrix?"
    )]
    NotPositive {
        /// Where.
        place: Place,
        /// The tag.
        tag: &'static str,
        /// `information` or `covariance`.
        kind: &'static str,
        /// `semi-definite` or `definite`.
        demand: &'static str,
        /// The smallest eigenvalue.
        eigenvalue: f64,
    },
    /// A quaternion of length zero.
    #[error(
        "{place}: the quaternion of the {tag} line has length zero and names no rotation; the identity is `0 0 0 1`"
    )]
    ZeroQuaternion {
        /// Where.
        place: Place,
        /// The tag.
        tag: &'static str,
    },
    /// The target format has no line for something.
    #[error(
        "{place}: {dialect} files cannot hold {what}; write another format, or remove it first"
    )]
    Unsupported {
        /// Where.
        place: Place,
        /// The format asked for.
        dialect: Dialect,
        /// What it cannot hold.
        what: &'static str,
    },
    /// A variable of a type that files do not hold.
    #[error(
        "{file}: variable {variable} is a {kind}, for which there is no line; files hold Pose2, Pose3, Point2 and Point3"
    )]
    NoLineForVariable {
        /// The file.
        file: Arc<str>,
        /// The variable.
        variable: VariableId,
        /// Its type.
        kind: &'static str,
    },
    /// A factor of a type that files do not hold.
    #[error(
        "{file}: there is no line for the factor {factor} on {ids:?}; files hold the factors of this library, under one robust kernel at most"
    )]
    NoLineForFactor {
        /// The file.
        file: Arc<str>,
        /// What the factor is called.
        factor: String,
        /// The ids of its variables.
        ids: Vec<u64>,
    },
    /// The caller has no id or no value for a variable of the graph.
    #[error("{file}: no {what} is given for variable {variable}; every variable needs one")]
    NotGiven {
        /// The file.
        file: Arc<str>,
        /// `id` or `value`.
        what: &'static str,
        /// The variable.
        variable: VariableId,
    },
    /// An estimate for an id that the document does not have, or of another type.
    #[error("{file}: the estimate given for {id} does not fit: {problem}", id = spell_id(*id))]
    BadEstimate {
        /// The file.
        file: Arc<str>,
        /// The id.
        id: u64,
        /// What is wrong.
        problem: String,
    },
    /// A TORO file is known by its vertices, and the document has none.
    #[error(
        "{file}: has no vertices, by which a TORO file is known; compose them from its edges first"
    )]
    NoVertices {
        /// The file.
        file: Arc<str>,
    },
    /// A factor could not be made from a line.
    #[error("{place}: the measurement cannot be used: {problem}")]
    BadMeasurement {
        /// Where.
        place: Place,
        /// Why.
        problem: String,
    },
}

impl FormatError {
    /// Whether nothing of the file can be trusted, so that skipping the line would not do.
    pub(crate) fn spoils_the_file(&self) -> bool {
        matches!(self, Self::EdgesBeforeVertices { .. })
    }

    /// The line that is to blame, where it is one.
    pub fn place(&self) -> Option<&Place> {
        match self {
            Self::NotText { place, .. }
            | Self::LineTooLong { place, .. }
            | Self::UnknownTag { place, .. }
            | Self::MixedDialects { place, .. }
            | Self::FieldCount { place, .. }
            | Self::NotANumber { place, .. }
            | Self::NotFinite { place, .. }
            | Self::TooLarge { place, .. }
            | Self::NotAnId { place, .. }
            | Self::NotAName { place, .. }
            | Self::NotACount { place, .. }
            | Self::NoSuchWord { place, .. }
            | Self::OutOfRange { place, .. }
            | Self::BadKernel { place, .. }
            | Self::SecondOrigin { place, .. }
            | Self::EdgesBeforeVertices { place, .. }
            | Self::Duplicate { place, .. }
            | Self::SelfEdge { place, .. }
            | Self::MissingVertex { place, .. }
            | Self::MissingOffset { place, .. }
            | Self::WrongKind { place, .. }
            | Self::NotPositive { place, .. }
            | Self::ZeroQuaternion { place, .. }
            | Self::Unsupported { place, .. }
            | Self::BadMeasurement { place, .. } => Some(place),
            _ => None,
        }
    }

    /// The number of the line that is to blame; 0 when it is no single line.
    pub fn line(&self) -> usize {
        self.place().map_or(0, |place| place.line)
    }
}
