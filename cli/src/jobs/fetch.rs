//! `sightline fetch`: downloads the result of a job.

use sightline::Error;

use crate::args::remote::FetchArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Downloads a result.
pub fn run(args: &FetchArgs, json: bool) -> Result<(), Error> {
    let (client, terminal) = (args.job.remote.client()?, Terminal::new());
    let bytes = match args.partial {
        true => client.fetch_partial(args.job.id, &args.output, &terminal)?,
        false => client.fetch(args.job.id, &args.output, &terminal)?,
    };
    let output = args.output.display();
    if json {
        let value = serde_json::json!({"output": output.to_string(), "bytes": bytes});
        return print(&value.to_string());
    }
    print(&format!("wrote {output} ({bytes} bytes)"))
}
