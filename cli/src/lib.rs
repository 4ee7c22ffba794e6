//! The `sightline` command: reads the arguments, runs the subcommand and turns its outcome into an exit code.
//!
//! Results go to stdout, everything else to stderr. A file of this crate holds one subcommand or a few
//! related ones. [`calls`] has some of the commands as functions, for programs that want values instead of
//! text. [`ambient_job`] computes ambient occlusion on a cluster.

#![allow(
    rustdoc::broken_intra_doc_links,
    reason = "the arguments' doc comments are help texts, not Markdown"
)]

mod ambient;
mod ambient_args;
mod ambient_distance;
mod ambient_file;
mod ambient_here;
pub mod ambient_job;
mod ambient_points;
mod answering;
mod answers;
mod args;
mod backends;
mod bake;
mod baking;
mod bench;
mod bench_args;
pub mod calls;
mod cells;
mod choices;
mod client;
mod coordinating;
mod diff;
mod diff_page;
mod dump;
mod enclosure;
mod error;
mod exhaustion;
mod export;
mod export_gltf;
mod farm;
mod files;
mod inspect;
mod job_args;
mod json_lines;
mod kind_args;
mod look;
mod look_lines;
mod look_portals;
mod look_tets;
mod manuals;
mod measuring;
mod memory;
mod migrating;
mod opening;
mod output;
mod pace;
mod place_args;
mod places;
mod portals;
mod printable;
mod progress;
mod query;
mod reasons;
mod remote;
mod remote_args;
mod replica;
mod report;
mod result_args;
mod serve;
mod serve_args;
mod showing;
mod sightlines;
mod stab;
mod store;
mod store_args;
mod store_place;
mod submitting;
mod tetra;
mod tetra_args;
mod tetra_export;
mod tiles;
mod tiles_args;
mod timeline;
mod token_args;
mod tokens;
mod traces;
mod verdict;
mod verify;
mod verify_hidden;
mod view;
mod what;
mod why;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::Parser as _;

use crate::args::{Cli, Command};
use crate::error::{CliError, INTERNAL};
pub use crate::exhaustion::Allocator;
use crate::exhaustion::Exhausted;
use crate::serve_args::LogFormat;

/// Runs the command that the arguments of this process name.
pub fn command() -> ExitCode {
    quiet_vulkan();
    exhaustion::watch();
    std::panic::catch_unwind(of_arguments).unwrap_or_else(|panic| {
        // The hook has printed the message.
        if Exhausted::in_panic(&*panic).is_none() {
            progress::say(
                "error: a fault of the program ended this command; report the message above",
            );
        }
        ExitCode::from(INTERNAL)
    })
}

fn of_arguments() -> ExitCode {
    let cli = Cli::parse_from(kind_args::with_opaque_alone(std::env::args_os()));
    let filter = tracing_subscriber::EnvFilter::try_from_env("SIGHTLINE_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(cli.default_log()));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(progress::LogWriter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false);
    match cli.log_format() {
        LogFormat::Json => log.json().init(),
        LogFormat::Text if cli.serves() => log.init(),
        LogFormat::Text => log.without_time().init(),
    }
    if cli.json {
        progress::tell_as_json();
    }
    let is_bake = matches!(cli.command, Command::Bake(_));
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => match e.exhausted(is_bake) {
            Some(what) => {
                progress::say(&format!("error: {e}; {}", what.remedy()));
                ExitCode::from(INTERNAL)
            }
            None => {
                progress::say(&format!("error: {e}"));
                if is_bake {
                    e.exit_code_of_bake()
                } else {
                    e.exit_code()
                }
            }
        },
    }
}

/// Sets a run-time directory if there is none, because Mesa's Vulkan drivers would complain on stderr.
#[allow(
    unsafe_code,
    reason = "set_var is unsafe where threads may read the environment; here there are none yet"
)]
fn quiet_vulkan() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: this is the first thing the program does; no other thread exists.
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", std::env::temp_dir()) };
    }
}

fn run(cli: Cli) -> Result<(), CliError> {
    let json = cli.json;
    match cli.command {
        Command::Bake(a) => bake::run(a, json),
        Command::Plan(a) => tiles::plan(&a, json),
        Command::Tile(a) => tiles::tile(&a, json),
        Command::Assemble(a) => tiles::assemble(&a, json),
        Command::Coordinator(a) => coordinating::coordinator(&a),
        Command::Token(a) => tokens::token(&a, json),
        Command::Worker(a) => serve::worker(&a),
        Command::Health(a) => remote::health(&a, json),
        Command::Submit(a) => submitting::submit(&a, json),
        Command::Watch(a) => remote::watch(&a, json),
        Command::Jobs(a) => remote::jobs(&a, json),
        Command::Show(a) => remote::show(&a, json),
        Command::Workers(a) => farm::workers(&a, json),
        Command::Store(a) => store::store(&a, json),
        Command::Invalidate(a) => farm::invalidate(&a, json),
        Command::Logs(a) => farm::logs(&a, json),
        Command::Delete(a) => remote::turn(&a, remote::Turn::Delete, json),
        Command::Cancel(a) => remote::turn(&a, remote::Turn::Cancel, json),
        Command::Pause(a) => remote::turn(&a.job, remote::Turn::Pause { now: a.now }, json),
        Command::Priority(a) => remote::prioritize(&a, json),
        Command::Resume(a) => remote::turn(&a, remote::Turn::Resume, json),
        Command::Retry(a) => remote::turn(&a, remote::Turn::Retry, json),
        Command::Fetch(a) => remote::fetch(&a, json),
        Command::Mesh(a) => files::mesh(&a, json),
        Command::Portals(a) => portals::run(&a, json),
        Command::Stab(a) => stab::run(&a),
        Command::Tetra(a) => tetra::run(&a, json),
        Command::Look(a) => look::run(&a),
        Command::Ambient(a) => ambient::run(&a, json),
        Command::Generate(a) => files::generate(&a, json),
        Command::Info(a) => inspect::info(&a, json),
        Command::Dump(a) => dump::dump(&a),
        Command::Diff(a) => diff::run(&a, json),
        Command::Export(a) => export::run(&a, json),
        Command::Query(a) => query::query(&a, json),
        Command::Measure(a) => measuring::run(&a),
        Command::Sightlines(a) => sightlines::run(&a),
        Command::Verify(a) => verify::run(&a, json),
        Command::Report(a) => report::run(&a, json),
        Command::View(a) => view::run(&a, json),
        Command::Bench(a) => bench::run(&a, json),
        Command::Completions(a) => manuals::completions(&a),
        Command::Man(a) => manuals::man(&a),
    }
}
