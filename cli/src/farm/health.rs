//! `sightline health`: checks that a coordinator serves.

use sightline::Error;

use crate::args::remote::RemoteArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Checks that a coordinator serves.
pub fn run(args: &RemoteArgs, json: bool) -> Result<(), Error> {
    args.client()?.health(&Terminal::new())?;
    print(if json {
        r#"{"status":"serving"}"#
    } else {
        "serving"
    })
}
