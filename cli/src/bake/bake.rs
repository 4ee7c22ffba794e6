//! `sightline bake`: runs a bake in this process, and prints a summary of its result.

use std::time::{Duration, Instant};

use sightline::output::{Format, Output};
use sightline::process::{threads, use_threads};
use sightline::words::{human, plural, scene_in_words};
use sightline::{Baked, Error, Local, SceneSource, TracerSearch, bake_after, read_scene};

use crate::args::cli::BakeArgs;
use crate::args::results::ViewArgs;
use crate::bake::resources::{cpu_seconds, peak_memory};
use crate::bake::unite;
use crate::results::info::Summary;
use crate::results::view;
use crate::terminal::progress::Terminal;
use crate::terminal::stderr::say;

/// Runs a bake.
pub fn run(args: BakeArgs, json: bool) -> Result<(), Error> {
    let start = Instant::now();
    if args.view && json {
        return Err(Error::usage(
            "--view serves a page until it is interrupted, but --json prints one document; omit \
             --view, and run `sightline view` afterwards",
        ));
    }
    let output = Output::check(&args.output, Format::Pvs, Some(&args.scene))?;
    if let Some(from) = &args.from {
        unite::run(&args, from, json)?;
        return show(args, json);
    }
    use_threads(threads(None))?;
    // Starting the drivers may take longer than reading most scenes, so it runs in parallel.
    let search = TracerSearch::begin(args.job.backend.unwrap_or_default());
    let terminal = Terminal::new();
    let source = SceneSource::File(args.scene.clone());
    let scene = read_scene(&source, &args.kinds.options, &terminal)?;
    let job = args.job.resolve(&scene, &terminal);
    let job = job.map_err(|e| e.naming_scene(&args.scene))?;
    say(&format!(
        "{}: {} in {}, read in {}",
        args.scene.display(),
        plural(scene.len() as usize, "triangle"),
        plural(scene.objects().len(), "object"),
        human(start.elapsed())
    ));
    scene_in_words(&scene).iter().for_each(|line| say(line));
    let name = args.scene.file_name().unwrap_or_default();
    let local = Local {
        name: name.to_string_lossy().into_owned(),
        data_dir: args.data_dir.clone(),
        workers: args.workers,
        output: Some(output.path().to_owned()),
        traces: args.traces.options(),
    };
    let outcome = bake_after(search, &scene, &job, &local, &terminal);
    terminal.end();
    report(&args, &outcome?, start.elapsed(), json)?;
    show(args, json)
}

/// Shows the result in a browser if the user requested this.
fn show(args: BakeArgs, json: bool) -> Result<(), Error> {
    if !args.view {
        return Ok(());
    }
    let BakeArgs {
        scene,
        output,
        kinds,
        ..
    } = args;
    view::run(&ViewArgs::new(output, scene, kinds), json)
}

fn report(args: &BakeArgs, outcome: &Baked, took: Duration, json: bool) -> Result<(), Error> {
    let summary = Summary::open(&args.output)?;
    let job = outcome.job.message();
    let peak = peak_memory();
    if json {
        let mut value = serde_json::to_value(&summary).map_err(Error::internal)?;
        value["output"] = args.output.display().to_string().into();
        value["job"] = job.id.into();
        value["from_store"] = outcome.from_store.into();
        value["seconds"] = took.as_secs_f64().into();
        value["samples"] = job.samples.into();
        value["tiles_set_aside"] = job.tiles_set_aside.into();
        value["cpu_seconds"] = cpu_seconds().into();
        value["peak_memory_bytes"] = peak.into();
        crate::terminal::stdout::print(&value.to_string())
    } else {
        let mut lines = summary.lines();
        let peak = peak.map_or("unknown on this system".to_owned(), |p| {
            format!("{:.0} MB", p as f64 / 1e6)
        });
        lines.push(if outcome.from_store {
            format!(
                "read from the data directory in {}: an earlier bake computed this result with {} \
                 samples; peak memory {peak}",
                human(took),
                job.samples
            )
        } else {
            format!(
                "baked in {}, {} samples, peak memory {peak}",
                human(took),
                job.samples
            )
        });
        if summary.sees_nothing() {
            // An exact bake includes small triangles, too.
            let small = match summary.is_decided() {
                false => " Triangles that look very small from the cells need --method exact.",
                true => "",
            };
            lines.push(format!(
                "ATTENTION: no triangle is visible from any cell. Check that the view box contains the \
                 viewpoints, in the scene's units and axes.{small}"
            ));
        }
        if job.tiles_set_aside > 0 {
            lines.push(format!(
                "ATTENTION: {} tiles failed and were set aside; the sets of their cells contain \
                 every triangle. Run the same command again to retry these tiles; the log above \
                 contains the reasons.",
                job.tiles_set_aside
            ));
        }
        lines.push(format!("wrote {}", args.output.display()));
        crate::terminal::stdout::print(&lines.join("\n"))
    }
}
