//! Where an error is: the line, and the field of it.

use std::fmt;
use std::sync::Arc;

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
#[non_exhaustive]
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

/// Cuts what is quoted in a message.
pub(crate) fn excerpt(text: &str) -> Box<str> {
    let end = text.char_indices().nth(40).map_or(text.len(), |(at, _)| at);
    let cut = if end < text.len() { "…" } else { "" };
    format!("{}{cut}", text[..end].escape_debug()).into()
}
