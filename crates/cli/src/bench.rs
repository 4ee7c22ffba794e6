//! `sightline bench`: the arguments, and what is printed.

use std::path::PathBuf;

use clap::Args;
use glam::Vec3;

use sightline_bench::{ERRORS, Growth, Host, Ladder, Options, Sampler};

use crate::error::CliError;
use crate::job_args::{parse_box, parse_cells};
use crate::progress::say;
use crate::serve::{self, print};

/// What is measured, and where it goes.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct BenchArgs {
    /// The scenes: .obj, .ply, .gltf or .glb. Only --grow triangles makes its own.
    pub scenes: Vec<PathBuf>,
    /// A regular grid of view cells.
    #[arg(long, value_name = "NXxNYxNZ", value_parser = parse_cells, default_value = "8x8x8")]
    pub cells: [u32; 3],
    /// Where viewpoints may be: x0,y0,z0,x1,y1,z1. Default: each scene's bounds.
    #[arg(long, value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    pub view_box: Option<[Vec3; 2]>,
    /// Random viewpoints of the error measure, the same for every point. p99 wants at least 100 of them.
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub viewpoints: u32,
    /// Seed of the viewpoints.
    #[arg(long, value_name = "S", default_value_t = 7)]
    pub seed: u64,
    /// Side of one face of the error measure in pixels, 8 to 4096.
    #[arg(long, value_name = "PX", default_value_t = 256)]
    pub resolution: u32,
    /// Folder for curves.csv, curves.svg and growth.csv; it is made where it is not there.
    #[arg(long, value_name = "DIR", default_value = "bench")]
    pub out: PathBuf,
    /// Which samplers to measure. Default: all; with --grow: none, only the growth.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub samplers: Option<Vec<Sampler>>,
    /// How far each sampler's parameter goes.
    #[arg(long, value_enum, default_value_t = Ladder::Quick)]
    pub points: Ladder,
    /// Leave out a sampler's finer points, and a growth's greater ones, after one that took longer than this.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    pub max_seconds: f64,
    /// Leave out a sampler's finer points after one with this mean error or less, a fraction. Default: the least that
    /// the table answers for.
    #[arg(long, value_name = "F", default_value_t = ERRORS[ERRORS.len() - 1])]
    pub least_error: f64,
    /// Measure how time and memory grow: bakes with --sampler lines and --grow-error.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub grow: Vec<Growth>,
    /// The --target-error of --grow's bakes.
    #[arg(long, value_name = "F", default_value_t = 0.001)]
    pub grow_error: f64,
    /// Also write everything as Markdown, with the machine and the command line.
    #[arg(long, value_name = "FILE.md")]
    pub results: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Each point is one `sightline bake --backend cpu` of its own, from an empty store, timed from start to exit; \
`sightline measure` then says how wrong its result looks. The table answers what the curves show: how long a sampler \
needs for a given mean error, interpolated between measured points and never beyond them. `≤` is before a sampler's \
fastest point when that one is better already, `>` before its slowest when none was that good; ratios of such times are \
bounds. The baseline is guided: a fixed number of rays for each cell on its own.\n\n\
  sightline bench level.glb                                  time against error, some minutes\n  \
  sightline bench level.glb town.glb --points full --max-seconds 600 --results RESULTS.md\n  \
  sightline bench level.glb --samplers lines,guided          two curves only\n  \
  sightline bench --grow triangles                           generated forests, no scene needed\n  \
  sightline bench level.glb --grow cells,workers\n\n\
Other work on the machine shows in the times; compare those of one run.";

/// The options of the library.
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
        max_seconds: args.max_seconds,
        least_error: args.least_error,
        grow: args.grow.clone(),
        grow_error: args.grow_error,
        results: args.results.clone(),
    }
}

/// Measures, writes the files, prints the tables.
pub fn run(args: &BenchArgs, json: bool) -> Result<(), CliError> {
    let program = std::env::current_exe()
        .map_err(|e| CliError::Internal(format!("the file of this program is unknown: {e}")))?;
    // Listens for signals as long as it lives.
    let runtime = serve::runtime()?;
    let on_stop = |stop: Box<dyn FnOnce() + Send>| {
        runtime.spawn(async move {
            serve::stop_signal().await;
            stop();
        });
    };
    let report = sightline_bench::run(&options(args), &Host { program, say: &say, on_stop: &on_stop })?;
    print(&if json { report.document.to_string() } else { report.tables })
}

#[cfg(test)]
mod tests {
    use clap::{Parser as _, ValueEnum as _};

    use super::*;

    #[test]
    fn bake_accepts_every_point() {
        for &sampler in Sampler::value_variants() {
            for rung in sampler.rungs(Ladder::Full) {
                let base = ["sightline", "bake", "a.glb", "-o", "a.pvs"].map(str::to_owned);
                let line = base.into_iter().chain(rung.flags.clone());
                crate::args::Cli::try_parse_from(line).unwrap_or_else(|e| panic!("{:?}: {e}", rung.flags));
            }
        }
    }

    #[test]
    fn the_defaults_of_the_command_line_are_those_of_the_library() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            bench: BenchArgs,
        }
        let line = Line::try_parse_from(["bench"]).unwrap().bench;
        assert_eq!(options(&line), Options::default());
    }
}
