//! The arguments of `sightline bench`.

use std::path::PathBuf;

use clap::Args;
use sightline::options::text::parse_box;
use sightline::options::text::parse_grid;
use sightline_bench::{ERRORS, Growth, Ladder, Sampler};
use sightline_scene::Aabb;

/// What to measure, and where to write it.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct BenchArgs {
    /// The scenes: .obj, .ply, .gltf or .glb. Only --grow triangles generates its own.
    pub scenes: Vec<PathBuf>,
    /// A regular grid of view cells: their numbers along x, y and z.
    #[arg(long, value_name = "NXxNYxNZ", value_parser = parse_grid, default_value = "8x8x8")]
    pub cells: [u32; 3],
    /// The box that holds all viewpoints, in world space: x0,y0,z0,x1,y1,z1. Default: each scene's bounds.
    #[arg(long, value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    pub view_box: Option<Aabb>,
    /// Number of random viewpoints of the error measure, the same for every bake. p99 needs at least 100.
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub viewpoints: u32,
    /// Seed of the viewpoints.
    #[arg(long, value_name = "S", default_value_t = 7)]
    pub seed: u64,
    /// Side of one face of the error measure's cubes in pixels, 8 to 4096.
    #[arg(long, value_name = "PX", default_value_t = 256)]
    pub resolution: u32,
    /// Folder for curves.csv, curves.svg and growth.csv; created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = "bench")]
    pub out: PathBuf,
    /// The samplers to measure. Default: all up to cubes-err2; with --grow: none, only the growth.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub samplers: Option<Vec<Sampler>>,
    /// How fine the parameter of each sampler becomes.
    #[arg(long, value_enum, default_value_t = Ladder::Quick)]
    pub points: Ladder,
    /// Bake each point so many times in a row. Its time is the median; files and tables also show the spread.
    #[arg(long, value_name = "N", default_value_t = 1)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub repeat: u32,
    /// After a bake that takes longer than this many seconds, leave out the finer points of its sampler or
    /// the larger points of its growth.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    pub max_seconds: f64,
    /// After a bake with at most this mean error, a fraction of the pixels, leave out the finer points of its
    /// sampler. Default: the smallest error in the table.
    #[arg(long, value_name = "F", default_value_t = ERRORS[ERRORS.len() - 1])]
    pub least_error: f64,
    /// Measure how time and memory grow, with bakes of --sampler lines at --grow-error.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub grow: Vec<Growth>,
    /// The --target-error of the bakes for --grow.
    #[arg(long, value_name = "F", default_value_t = 0.001)]
    pub grow_error: f64,
    /// Also write all tables to a Markdown file, with the machine and the command line.
    #[arg(long, value_name = "FILE.md")]
    pub results: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Each point is one run of `sightline bake --backend cpu` with an empty store, timed from start to exit; \
`sightline measure` then gives the error of its result. The table shows how long a sampler needs for a given \
mean error, interpolated between measured points and never beyond them. `≤` marks the time of a sampler's \
fastest point when that point already has a smaller error, `>` the time of its slowest point when no point \
reaches the error; ratios of such times are bounds. The baseline is guided: a fixed number of rays for each \
cell on its own.\n\n  \
  sightline bench level.glb                                  time against error, some minutes\n  \
  sightline bench level.glb town.glb --points full --max-seconds 600 --results RESULTS.md\n  \
  sightline bench level.glb --samplers lines,guided          two curves only\n  \
  sightline bench level.glb --samplers lines,max-error --repeat 5     with a bound; medians of five runs\n  \
  sightline bench level.glb --samplers verified,exact        undecided over time, and the time of a cell\n  \
  sightline bench --grow triangles                           generated forests, no scene needed\n  \
  sightline bench level.glb --grow cells,workers\n\n\
Other work on the machine lengthens the times; compare only times of one run. CPU seconds, of all threads, \
suffer less from it. Where Linux's /proc/stat says that other processes took more than a tenth of all cores, \
the command warns, before the first bake and after each point; --results and curves.csv say how much it was.";
