//! `sightline completions` and `sightline man`: what the arguments say of themselves, for shells and readers.

use clap::CommandFactory as _;

use crate::args::Cli;
use crate::error::CliError;
use crate::result_args::{CompletionsArgs, ManArgs};
use crate::serve::print;

/// Prints the completions for a shell.
pub fn completions(args: &CompletionsArgs) -> Result<(), CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "sightline", &mut script);
    print(String::from_utf8_lossy(&script).trim_end())
}

/// Writes a page for each command.
pub fn man(args: &ManArgs) -> Result<(), CliError> {
    let to = |e: &std::io::Error| CliError::writing(&args.folder, e);
    std::fs::create_dir_all(&args.folder).map_err(|e| to(&e))?;
    clap_mangen::generate_to(Cli::command(), &args.folder).map_err(|e| to(&e))?;
    print(&format!("wrote the manual pages to {}: man -l {0}/sightline.1", args.folder.display()))
}
