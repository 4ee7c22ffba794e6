//! The arguments of `sightline bench`.

use std::path::PathBuf;

use clap::Args;
use sightline::options::text::parse_box;
use sightline::options::text::parse_grid;
use sightline_bench::{ERRORS, Growth, Ladder, Sampler};
use sightline_scene::Aabb;

/// The measurements of a benchmark and the paths of its output.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct BenchArgs {
    /// The scenes: .obj, .ply, .gltf or .glb. --grow triangles generates its own scenes.
    pub scenes: Vec<PathBuf>,
    /// A regular grid of view cells: the numbers of cells along x, y and z.
    #[arg(long, value_name = "NXxNYxNZ", value_parser = parse_grid, default_value = "8x8x8")]
    pub cells: [u32; 3],
    /// The box that contains all viewpoints, in world space: x0,y0,z0,x1,y1,z1. Default: the bounds of each
    /// scene.
    #[arg(long, value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    pub view_box: Option<Aabb>,
    /// Number of random viewpoints of the error measure, the same for every bake. The column p99 needs at
    /// least 100.
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub viewpoints: u32,
    /// Seed of the viewpoints.
    #[arg(long, value_name = "S", default_value_t = 7)]
    pub seed: u64,
    /// Side of one face of the cubes of the error measure in pixels, 8 to 4096.
    #[arg(long, value_name = "PX", default_value_t = 256)]
    pub resolution: u32,
    /// Folder for curves.csv, curves.svg and growth.csv; created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = "bench")]
    pub out: PathBuf,
    /// The samplers to measure. Default: all samplers from the start of the list below to cubes-err2; with
    /// --grow: none.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub samplers: Option<Vec<Sampler>>,
    /// The range of parameters of each sampler.
    #[arg(long, value_enum, default_value_t = Ladder::Quick)]
    pub points: Ladder,
    /// Number of bakes per point, 1 to 1000, in a row. The time of a point is the median; files and tables
    /// also contain the spread.
    #[arg(long, value_name = "N", default_value_t = 1)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub repeat: u32,
    /// Time limit in seconds: after a slower bake, skip the finer points of its sampler or the larger points
    /// of its growth.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    pub max_seconds: f64,
    /// Error limit: after a bake with at most this mean error, a fraction of the pixels, skip the finer
    /// points of its sampler. Default: the smallest error in the table.
    #[arg(long, value_name = "F", default_value_t = ERRORS[ERRORS.len() - 1])]
    pub least_error: f64,
    /// Quantities whose effect on time and memory the command measures, with bakes of --sampler lines at
    /// --grow-error. Default: none.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub grow: Vec<Growth>,
    /// Value of --target-error for the bakes of --grow.
    #[arg(long, value_name = "F", default_value_t = 0.001)]
    pub grow_error: f64,
    /// The Markdown file for all tables, with the machine and the command line. Default: none.
    #[arg(long, value_name = "FILE.md")]
    pub results: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Each point is one run of `sightline bake --backend cpu` with an empty store, timed from start to \
exit; `sightline measure` then computes the error of its result. The table shows the time that a \
sampler needs for a given mean error, interpolated between measured points. Times are never \
extrapolated: `≤` marks the time of a sampler's fastest point when that point already has a smaller \
error, and `>` marks the time of its slowest point when no point reaches the error. Ratios of such \
times are bounds. The baseline is guided: a fixed number of guided rays for each \
cell, which credit every cell that they cross. The rays of guided-own credit only their own cell.\n\n  \
  sightline bench level.glb                                  time against error, some minutes\n  \
  sightline bench level.glb town.glb --points full --max-seconds 600 --results RESULTS.md\n  \
  sightline bench level.glb --samplers lines,guided          two curves only\n  \
  sightline bench level.glb --samplers lines,max-error --repeat 5     with a bound; medians of five runs\n  \
  sightline bench level.glb --samplers verified,exact        undecided over time, and the time of a cell\n  \
  sightline bench --grow triangles                           generated forests, no scene needed\n  \
  sightline bench level.glb --grow cells,workers\n\n\
Other work on the machine lengthens the times; compare only times of one run. CPU seconds, summed over all \
threads, are less affected. If /proc/stat on Linux shows that other processes used more than a tenth of all \
cores, the command prints a warning, before the first bake and after each point; --results and curves.csv \
contain the measured share.";
