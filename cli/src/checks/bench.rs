//! `sightline bench`: runs a benchmark and prints its report.

use sightline::Error;
use sightline_bench::{BenchError, Host, Options};

use crate::args::bench::BenchArgs;
use crate::terminal::stderr::say;
use crate::terminal::stdout::print;

/// Converts the arguments into options of the library.
fn options(args: &BenchArgs) -> Options {
    Options {
        scenes: args.scenes.clone(),
        cells: args.cells,
        view_box: args.view_box,
        viewpoints: args.viewpoints,
        seed: args.seed,
        resolution: args.resolution,
        out: args.out.clone(),
        samplers: args.samplers.clone(),
        points: args.points,
        repeat: args.repeat,
        max_seconds: args.max_seconds,
        least_error: args.least_error,
        grow: args.grow.clone(),
        grow_error: args.grow_error,
        results: args.results.clone(),
    }
}

/// Converts an error of the benchmark.
fn bench_error(e: BenchError) -> Error {
    match e {
        BenchError::Usage(m) => Error::usage(m),
        BenchError::Input(m) => Error::input(m),
        BenchError::Coordinator(m) => Error::coordinator(m),
        BenchError::Job(m) => Error::job(m),
        BenchError::Interrupted(m) => Error::cancelled(m),
        BenchError::Internal(m) => Error::internal(m),
    }
}

/// Runs the benchmark, writes the files, and prints the tables.
pub fn run(args: &BenchArgs, json: bool) -> Result<(), Error> {
    let program = std::env::current_exe()
        .map_err(|e| Error::internal(format!("the path of this program is unknown: {e}")))?;
    // The runtime listens for signals until it is dropped, so it must outlive the benchmark.
    let runtime = sightline::process::runtime()?;
    let on_stop = |stop: Box<dyn FnOnce() + Send>| {
        runtime.spawn(async move {
            crate::terminal::interrupt::stop_signal().await;
            stop();
        });
    };
    let report = sightline_bench::run(
        &options(args),
        &Host {
            program,
            say: &say,
            on_stop: &on_stop,
        },
    )
    .map_err(bench_error)?;
    print(&if json {
        report.document.to_string()
    } else {
        report.tables
    })
}

#[cfg(test)]
mod tests {
    use clap::{Parser as _, ValueEnum as _};
    use sightline_bench::{Ladder, Sampler};

    use super::*;

    #[test]
    fn bake_accepts_every_point() {
        for &sampler in Sampler::value_variants() {
            for rung in sampler.rungs(Ladder::Full) {
                let base = ["sightline", "bake", "a.glb", "-o", "a.pvs"].map(str::to_owned);
                let line = base.into_iter().chain(rung.flags.clone());
                crate::args::cli::Cli::try_parse_from(line)
                    .unwrap_or_else(|e| panic!("{:?}: {e}", rung.flags));
            }
        }
    }

    #[test]
    fn uniform_cubes_reach_message_of_job() {
        use sightline_model::{ErrorMeasure, JobSpec, SceneFacts, Visibility};
        use sightline_scene::generate::{SceneKind, SceneParams, generate};

        let scene =
            std::sync::Arc::new(generate(SceneKind::Rooms, &SceneParams::default()).unwrap());
        for rung in Sampler::CubesUniform.rungs(Ladder::Full) {
            let base = ["sightline", "bake", "a.glb", "-o", "a.pvs"].map(str::to_owned);
            let line = base.into_iter().chain(rung.flags);
            let crate::args::cli::Command::Bake(args) =
                crate::args::cli::Cli::parse_from(line).command
            else {
                panic!("the line is a bake");
            };
            let spec = args.job.resolve(&scene, &sightline::Silent).unwrap();
            let spec = JobSpec::from_message(&spec.to_message(), &SceneFacts::default()).unwrap();
            let sampling = spec.visibility().and_then(Visibility::sampling).unwrap();
            let params = sampling.sampler.cube_params().unwrap();
            assert_eq!(params.measure, ErrorMeasure::Uniform);
            let distance = params.min_distance.get();
            assert!(
                rung.parameter.ends_with(&format!(" {distance}")),
                "{} is {distance}",
                rung.parameter
            );
        }
    }

    #[test]
    fn command_line_and_library_have_same_defaults() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            bench: BenchArgs,
        }
        let line = Line::try_parse_from(["bench"]).unwrap().bench;
        assert_eq!(options(&line), Options::default());
    }
}
