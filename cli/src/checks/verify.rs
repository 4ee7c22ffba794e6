//! `sightline verify`: checks every witness and every certificate of a result with the independent checker.

use std::time::Instant;

use sightline::process::{threads, use_threads};
use sightline::words::human;
use sightline::{Error, NamedResult, SceneSource, VerifyOptions};

use crate::args::cli::VerifyArgs;
use crate::terminal::interrupt;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Checks a result against its scene, and prints the verdict.
pub fn run(args: &VerifyArgs, json: bool) -> Result<(), Error> {
    use_threads(threads(args.threads.map(usize::from)))?;
    let pvs = sightline::open(&args.result)?;
    interrupt::end_at_second();
    let terminal = Terminal::new();
    let start = Instant::now();
    let source = SceneSource::File(args.scene.clone());
    let options = VerifyOptions {
        scene: args.kinds.options.clone(),
        sample: args.sample,
        seed: args.seed,
    };
    let result = NamedResult::new(&pvs, &args.result);
    let verdict = sightline::verify(&source, result, &options, &terminal)?;
    terminal.end();
    let document = serde_json::json!(verdict).to_string();
    if !verdict.is_accepted() {
        if json {
            print(&document)?;
        }
        return Err(Error::input(verdict.to_string()));
    }
    say(&format!("verified in {}", human(start.elapsed())));
    print(&match json {
        true => document,
        false => verdict.to_string(),
    })
}
