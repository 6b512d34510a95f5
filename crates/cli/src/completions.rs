//! `evergraph completions`.

use std::io::{self, Write};

use clap::Args;
use clap_complete::Shell;

use crate::error::Error;

const EXAMPLES: &str = "\
Examples:
  evergraph completions bash > ~/.local/share/bash-completion/completions/evergraph
  evergraph completions zsh > ~/.zfunc/_evergraph
  evergraph completions fish > ~/.config/fish/completions/evergraph.fish";

/// Print completions for a shell
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the completions of `program`.
pub(crate) fn run(arguments: &Arguments, mut program: clap::Command) -> Result<(), Error> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut program, "evergraph", &mut script);
    let mut out = io::stdout().lock();
    out.write_all(&script).and_then(|()| out.flush()).map_err(Error::Print)
}
