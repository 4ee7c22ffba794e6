//! `sightline bake`: a bake in this process, and what it says of its result.

use std::time::{Duration, Instant};

use crate::args::BakeArgs;
use crate::baking::{Hooks, Outcome, bake};
use crate::error::CliError;
use crate::inspect::Summary;
use crate::opening::Source;
use crate::output::{Format, Output};
use crate::progress::{Progress, human};
use crate::result_args::ViewArgs;
use crate::serve;
use crate::view;

/// Runs a bake.
pub fn run(args: BakeArgs, json: bool) -> Result<(), CliError> {
    let start = Instant::now();
    if args.view && json {
        return Err(CliError::Usage(
            "--view serves a page until it is interrupted, and --json prints one document; leave one of them \
             out, and give `sightline view` the result afterwards"
                .to_owned(),
        ));
    }
    let output = Output::check(&args.output, Format::Pvs, Some(&args.scene))?;
    let progress = Progress::new();
    let mut hooks = Hooks {
        follow: &mut |job| progress.job(job, true),
        stop: &|| false,
        stopped: Box::pin(serve::stop_signal()),
    };
    let outcome = bake(
        &args,
        &Source::File(args.scene.clone()),
        &output,
        &mut hooks,
    );
    drop(hooks);
    progress.end();
    report(&args, &outcome?, start.elapsed(), json)?;
    if !args.view {
        return Ok(());
    }
    let BakeArgs {
        scene,
        output,
        kinds,
        ..
    } = args;
    view::run(&ViewArgs::of(output, scene, kinds), json)
}

fn report(args: &BakeArgs, outcome: &Outcome, took: Duration, json: bool) -> Result<(), CliError> {
    let summary = Summary::of(&args.output)?;
    let job = &outcome.job;
    let peak = peak_memory();
    if json {
        let mut value = serde_json::to_value(&summary).map_err(CliError::internal)?;
        value["output"] = args.output.display().to_string().into();
        value["job"] = job.id.into();
        value["from_store"] = outcome.from_store.into();
        value["seconds"] = took.as_secs_f64().into();
        value["samples"] = job.samples.into();
        value["tiles_set_aside"] = job.tiles_set_aside.into();
        value["cpu_seconds"] = cpu_seconds().into();
        value["peak_memory_bytes"] = peak.into();
        serve::print(&value.to_string())
    } else {
        let mut lines = summary.lines();
        let peak = peak.map_or("not known here".to_owned(), |p| {
            format!("{:.0} MB", p as f64 / 1e6)
        });
        lines.push(if outcome.from_store {
            format!(
                "answered from the store in {}, where it was baked before with {} samples; peak memory \
                 {peak}",
                human(took),
                job.samples
            )
        } else {
            format!("baked in {}, {} samples, peak memory {peak}", human(took), job.samples)
        });
        if summary.sees_nothing() {
            // An exact bake finds small triangles too.
            let small = match summary.is_decided() {
                false => " Triangles that look very small from there need --method exact.",
                true => "",
            };
            lines.push(format!(
                "ATTENTION: no triangle is seen from any cell. Is the view box where viewpoints are, in the \
                 scene's units and axes?{small}"
            ));
        }
        if job.tiles_set_aside > 0 {
            lines.push(format!(
                "ATTENTION: {} tiles failed and were set aside; their cells show everything. Run the same \
                 command again to try them again; the log above says why they failed.",
                job.tiles_set_aside
            ));
        }
        lines.push(format!("wrote {}", args.output.display()));
        serve::print(&lines.join("\n"))
    }
}

/// The peak memory of this process in bytes, from Linux's /proc; `None` on other systems.
pub fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// The CPU seconds of all threads of this process so far, user and system; `None` where the system does not
/// tell.
#[cfg(unix)]
fn cpu_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
}

#[cfg(not(unix))]
fn cpu_seconds() -> Option<f64> {
    None
}
