//! The arguments of `sightline bench`.

use std::path::PathBuf;

use clap::Args;
use sightline_bench::{ERRORS, Growth, Ladder, Sampler};
use sightline_scene::Aabb;

use crate::job_args::{parse_box, parse_cells};

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
    pub view_box: Option<Aabb>,
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
    /// Leave out a sampler's finer points after one with this mean error or less, a fraction. Default: the
    /// least that the table answers for.
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
`sightline measure` then says how wrong its result looks. The table answers what the curves show: how long \
a sampler \
needs for a given mean error, interpolated between measured points and never beyond them. `≤` is before a \
sampler's \
fastest point when that one is better already, `>` before its slowest when none was that good; ratios of \
such times are \
bounds. The baseline is guided: a fixed number of rays for each cell on its own.\n\n\
  sightline bench level.glb                                  time against error, some minutes\n  \
  sightline bench level.glb town.glb --points full --max-seconds 600 --results RESULTS.md\n  \
  sightline bench level.glb --samplers lines,guided          two curves only\n  \
  sightline bench --grow triangles                           generated forests, no scene needed\n  \
  sightline bench level.glb --grow cells,workers\n\n\
Other work on the machine shows in the times; compare those of one run.";
