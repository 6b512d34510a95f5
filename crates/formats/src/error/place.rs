//! Where an error is: the line, and the field of it.

use std::fmt;
use std::sync::Arc;

use super::FormatError;

/// A line of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file's name, as the caller gave it.
    pub file: Arc<str>,
    /// The line, from 1; 0 for a record that was not read from a line.
    pub line: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file, self.line)
    }
}

/// A field of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// The line's tag.
    pub tag: &'static str,
    /// The number of the field; the first after the tag is 1.
    pub number: usize,
    /// What the field is called, for example `theta` or `I12`.
    pub name: &'static str,
    /// What stands there, cut to 40 characters.
    pub text: Box<str>,
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "field {} ({}) of {} is `{}`", self.number, self.name, self.tag, self.text)
    }
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
            | Self::BadMeasurement { place, .. }
            | Self::NoEstimate { place, .. }
            | Self::StartNotFinite { place, .. } => Some(place),
            _ => None,
        }
    }

    /// The number of the line that is to blame; 0 when it is no single line.
    pub fn line(&self) -> usize {
        self.place().map_or(0, |place| place.line)
    }
}

/// Cuts what is quoted in a message.
pub(crate) fn excerpt(text: &str) -> Box<str> {
    let end = text.char_indices().nth(40).map_or(text.len(), |(at, _)| at);
    let cut = if end < text.len() { "…" } else { "" };
    format!("{}{cut}", text[..end].escape_debug()).into()
}
