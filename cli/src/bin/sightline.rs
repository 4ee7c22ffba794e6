//! The `sightline` command.

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: sightline_cli::Allocator = sightline_cli::Allocator;

fn main() -> ExitCode {
    sightline_cli::command()
}
