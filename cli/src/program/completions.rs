//! `sightline completions`: prints the completions of the command line for a shell.

use clap::CommandFactory as _;
use sightline::Error;

use crate::args::cli::Cli;
use crate::args::results::CompletionsArgs;
use crate::terminal::stdout::print;

/// Prints the completion script of the shell in `args`.
pub fn run(args: &CompletionsArgs) -> Result<(), Error> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "sightline", &mut script);
    print(String::from_utf8_lossy(&script).trim_end())
}
