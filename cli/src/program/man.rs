//! `sightline man`: writes the manual pages of all commands.

use std::path::Path;

use clap::CommandFactory as _;
use sightline::Error;

use crate::args::cli::Cli;
use crate::args::results::ManArgs;
use crate::terminal::stdout::print;

/// Writes a manual page for each command to the folder in `args`.
pub fn run(args: &ManArgs) -> Result<(), Error> {
    let to = |e: &std::io::Error| Error::writing(&args.folder, e);
    std::fs::create_dir_all(&args.folder).map_err(|e| to(&e))?;
    let mut all = Cli::command().disable_help_subcommand(true);
    all.build();
    write_pages(all, &args.folder).map_err(|e| to(&e))?;
    print(&format!(
        "wrote the manual pages to {}; read the first page with: man -l {0}/sightline.1",
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
