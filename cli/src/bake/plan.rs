//! `sightline plan`: writes a job with its scene and its plan to a folder.

use serde_json::json;
use sightline::process::{threads, use_threads};
use sightline::words::plural;
use sightline::{Error, SceneSource, read_scene, tiles};

use crate::args::tiles::PlanArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Plans the bake in the arguments, and writes the plan to the folder or bucket.
pub fn run(args: &PlanArgs, json: bool) -> Result<(), Error> {
    use_threads(threads(None))?;
    let terminal = Terminal::new();
    let source = SceneSource::File(args.scene.clone());
    let scene = read_scene(&source, &args.kinds.options, &terminal)?;
    let job = args.job.resolve(&scene, &terminal);
    let job = job.map_err(|e| e.naming_scene(&args.scene))?;
    let planned = tiles::plan(&scene, &job, &args.output, &terminal)?;
    if json {
        return print(&json!(planned).to_string());
    }
    print(&format!(
        "{}: {} for the numerics profile {}; compute each with `sightline tile {} N`",
        planned.output,
        plural(planned.tiles as usize, "tile"),
        planned.profile,
        planned.output
    ))
}
