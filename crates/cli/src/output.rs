//! What goes to the terminal: results to standard output, all else to standard error.

use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

use crate::error::Error;
use crate::options::Common;

/// How much to say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Output {
    quiet: bool,
    verbose: bool,
}

impl Output {
    pub(crate) fn new(common: &Common) -> Self {
        Self { quiet: common.quiet, verbose: common.verbose > 0 }
    }

    /// The result.
    pub(crate) fn result(self, text: &dyn Display) -> Result<(), Error> {
        if self.quiet {
            return Ok(());
        }
        let mut out = io::stdout().lock();
        writeln!(out, "{text}").and_then(|()| out.flush()).map_err(Error::Print)
    }

    /// Something that the user should hear about.
    pub(crate) fn warn(self, text: &dyn Display) {
        if !self.quiet {
            to_stderr(&format!("warning: {text}"));
        }
    }

    /// Whether a bar can be drawn: somebody is looking, neither stream goes elsewhere, and no log
    /// runs through it.
    pub(crate) fn is_interactive(self) -> bool {
        let terminal = io::stdout().is_terminal() && io::stderr().is_terminal();
        terminal && !self.quiet && !self.verbose
    }
}

/// Why the program ends early; `--quiet` does not hide it.
pub(crate) fn complain(text: &str) {
    to_stderr(&format!("error: {text}"));
}

fn to_stderr(text: &str) {
    // A closed standard error leaves no place to say so.
    let _ = writeln!(io::stderr().lock(), "{text}");
}
