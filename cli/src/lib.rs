//! The `sightline` command: parses the arguments, runs the subcommand, and converts its outcome into an exit
//! code.
//!
//! Programs that want values instead of text use the library [`sightline`].
//!
//! # Modules
//!
//! A folder has the subcommands of one heading of `sightline --help`, and a file has one subcommand or a few
//! related ones.
//!
//! - `args`: the arguments, as clap reads them. The options of a job come from the library (feature `clap`).
//! - `bake`, `scenes`, `results`, `checks`, `queries`, `jobs`, `farm`, `program`: the subcommands.
//! - `terminal`: progress, stdout and stderr, signals, and exit codes.
//!
//! # Invariants
//!
//! - Results go to stdout, and everything else goes to stderr.
//! - Each kind of error of the library has one exit code (`docs/interfaces.md`).
//! - Output files are written through `crates/files`.

#![allow(
    rustdoc::broken_intra_doc_links,
    reason = "the arguments' doc comments are help texts, not Markdown"
)]

mod args;
mod bake;
mod checks;
mod farm;
mod jobs;
mod program;
mod queries;
mod results;
mod scenes;
mod terminal;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::FromArgMatches as _;
use sightline::{Error, JobAction};

use crate::args::cli::{Cli, Command};
pub use crate::terminal::exhaustion::Allocator;
use crate::terminal::exhaustion::Exhausted;
use crate::terminal::exit::{INTERNAL, exhausted, exit_code};

use crate::args::serve::LogFormat;

/// Runs the command that the arguments of this process name.
pub fn command() -> ExitCode {
    quiet_vulkan();
    terminal::exhaustion::watch();
    std::panic::catch_unwind(run_arguments).unwrap_or_else(|panic| {
        // The hook has printed the message.
        if Exhausted::in_panic(&*panic).is_none() {
            terminal::stderr::say(
                "error: an internal fault ended this command; report the message above",
            );
        }
        ExitCode::from(INTERNAL)
    })
}

fn run_arguments() -> ExitCode {
    let arguments = args::kinds::with_opaque_alone(std::env::args_os());
    let matches = args::groups::command().get_matches_from(arguments);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|e| e.exit());
    let filter = tracing_subscriber::EnvFilter::try_from_env("SIGHTLINE_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(cli.default_log()));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(terminal::stderr::LogWriter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false);
    match cli.log_format() {
        LogFormat::Json => log.json().init(),
        LogFormat::Text if cli.serves() => log.init(),
        LogFormat::Text => log.without_time().init(),
    }
    if cli.json {
        terminal::progress::tell_as_json();
    }
    let is_bake = matches!(cli.command, Command::Bake(_));
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => match exhausted(&e, is_bake) {
            Some(what) => {
                terminal::stderr::say(&format!("error: {e}; {}", what.remedy()));
                ExitCode::from(INTERNAL)
            }
            None => {
                terminal::stderr::say(&format!("error: {e}"));
                exit_code(&e, is_bake)
            }
        },
    }
}

/// Sets a run-time directory if none is set, because Mesa's Vulkan drivers would otherwise print warnings to
/// stderr.
#[allow(
    unsafe_code,
    reason = "set_var is unsafe where threads may read the environment; here there are none yet"
)]
fn quiet_vulkan() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: this call precedes all other code of the program, so no other thread exists.
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", std::env::temp_dir()) };
    }
}

fn run(cli: Cli) -> Result<(), Error> {
    let json = cli.json;
    match cli.command {
        Command::Bake(a) => bake::bake::run(a, json),
        Command::Plan(a) => bake::plan::run(&a, json),
        Command::Tile(a) => bake::tile::run(&a, json),
        Command::Assemble(a) => bake::assemble::run(&a, json),
        Command::Ambient(a) => bake::ambient::run(&a, json),
        Command::Generate(a) => scenes::generate::run(&a, json),
        Command::Mesh(a) => scenes::mesh::run(&a, json),
        Command::Portals(a) => scenes::portals::run(&a, json),
        Command::Tetra(a) => scenes::tetra::run(&a, json),
        Command::Info(a) => results::info::run(&a, json),
        Command::Cells(a) => results::cells::run(&a, json),
        Command::Dump(a) => results::dump::run(&a),
        Command::Query(a) => results::query::run(&a, json),
        Command::Look(a) => results::look_points::run(&a),
        Command::View(a) => results::view::run(&a, json),
        Command::Report(a) => results::report::run(&a, json),
        Command::Diff(a) => results::diff::run(&a, json),
        Command::Export(a) => results::export::run(&a, json),
        Command::Verify(a) => checks::verify::run(&a, json),
        Command::Measure(a) => checks::measure::run(&a),
        Command::Bench(a) => checks::bench::run(&a, json),
        Command::Sightlines(a) => queries::sightlines::run(&a),
        Command::Stab(a) => queries::stab::run(&a),
        Command::Submit(a) => jobs::submit::run(&a, json),
        Command::Watch(a) => jobs::watch::run(&a, json),
        Command::Jobs(a) => jobs::list::run(&a, json),
        Command::Show(a) => jobs::show::run(&a, json),
        Command::Fetch(a) => jobs::fetch::run(&a, json),
        Command::Logs(a) => jobs::logs::run(&a, json),
        Command::Cancel(a) => jobs::act::run(&a, JobAction::Cancel, json),
        Command::Pause(a) => jobs::act::run(&a.job, JobAction::Pause { now: a.now }, json),
        Command::Resume(a) => jobs::act::run(&a, JobAction::Resume, json),
        Command::Retry(a) => jobs::act::run(&a, JobAction::Retry, json),
        Command::Priority(a) => jobs::priority::run(&a, json),
        Command::Delete(a) => jobs::act::run(&a, JobAction::Delete, json),
        Command::Coordinator(a) => farm::coordinator::run(&a),
        Command::Worker(a) => farm::worker::run(&a),
        Command::Workers(a) => farm::workers::run(&a, json),
        Command::Health(a) => farm::health::run(&a, json),
        Command::Invalidate(a) => farm::invalidate::run(&a, json),
        Command::Store(a) => farm::store::run(&a, json),
        Command::Token(a) => farm::token::run(&a, json),
        Command::Completions(a) => program::completions::run(&a),
        Command::Man(a) => program::man::run(&a),
    }
}
