//! `sightline completions` and `sightline man`: what the arguments say of themselves, for shells and readers.

use std::path::Path;

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
    let mut all = Cli::command().disable_help_subcommand(true);
    all.build();
    write_pages(all, &args.folder).map_err(|e| to(&e))?;
    print(&format!(
        "wrote the manual pages to {}: man -l {0}/sightline.1",
        args.folder.display()
    ))
}

/// Writes the page of a command, after the pages of its subcommands.
fn write_pages(command: clap::Command, folder: &Path) -> std::io::Result<()> {
    for below in command.get_subcommands().filter(|c| !c.is_hide_set()) {
        write_pages(below.clone(), folder)?;
    }
    let page = clap_mangen::Man::new(command);
    let mut text = Vec::new();
    page.render(&mut text)?;
    sightline_files::write(&folder.join(page.get_filename()), text)
}
