//! `sightline measure`: the fraction of wrong pixels of a result, compared with item buffers of the full
//! scene, or the error by exact sets.

use sightline::process::{threads, use_threads};
use sightline::{Error, MeasureOptions, NamedResult, SceneSource};

use crate::args::cli::MeasureArgs;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Measures a result and prints one JSON object.
pub fn run(args: &MeasureArgs) -> Result<(), Error> {
    use_threads(threads(None))?;
    let pvs = sightline::open(&args.result)?;
    let terminal = Terminal::new();
    let options = MeasureOptions {
        scene: args.kinds.options.clone(),
        viewpoints: args.viewpoints,
        viewpoints_file: args.viewpoints_file.clone(),
        seed: args.seed,
        path: args.path.clone(),
        pairs: args.pairs,
        exact: args.exact,
        resolution: args.resolution,
        backend: args.backend,
        images: args.images.clone(),
        turntable: args.turntable,
    };
    let source = SceneSource::File(args.scene.clone());
    let result = NamedResult::new(&pvs, &args.result);
    let report = sightline::measure(&source, result, &options, &terminal)?;
    terminal.end();
    print(&serde_json::json!(report).to_string())
}
