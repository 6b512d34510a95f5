//! What goes to the terminal: results to standard output, all else to standard error.

use std::fmt::Display;
use std::io::{self, IsTerminal, Write};

use crate::error::Error;
use crate::stderr;

/// How much to say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Output {
    quiet: bool,
    verbose: bool,
}

impl Output {
    pub(crate) fn new(quiet: bool, verbose: bool) -> Self {
        Self { quiet, verbose }
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
            stderr::line(&format!("warning: {text}"));
        }
    }

    /// Whether a bar can be drawn: somebody is looking, neither stream goes elsewhere, and no log
    /// runs through it.
    pub(crate) fn is_interactive(self) -> bool {
        let terminal = io::stdout().is_terminal() && io::stderr().is_terminal();
        terminal && !self.quiet && !self.verbose
    }
}
