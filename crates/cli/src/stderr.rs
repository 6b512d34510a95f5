//! Messages on standard error.

use std::io::{self, Write};

/// The reason why the program ends early; `--quiet` does not hide it.
pub(crate) fn complain(text: &str) {
    line(&format!("error: {text}"));
}

/// Writes a line.
pub(crate) fn line(text: &str) {
    // A closed standard error leaves no place to say so.
    let _ = writeln!(io::stderr().lock(), "{text}");
}
