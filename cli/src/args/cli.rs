//! The command line, as clap reads it. The doc comments are the text of `--help`.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use sightline::JobOptions;
use sightline::options::arguments::named;
use sightline::options::text::{parse_box, parse_point};
use sightline_model::TracerChoice;

use crate::args::ambient::AmbientArgs;
use crate::args::bench::BenchArgs;
use crate::args::kinds::KindArgs;
use crate::args::remote::{
    FetchArgs, InvalidateArgs, JobRefArgs, JobsArgs, LogsArgs, PauseArgs, PriorityArgs, RemoteArgs,
    ShowArgs, SubmitArgs, WorkersArgs,
};
use crate::args::results::{CompletionsArgs, DiffArgs, ExportArgs, ManArgs, ReportArgs, ViewArgs};
use crate::args::serve::{CoordinatorArgs, LogFormat, WorkerArgs};
use crate::args::store::StoreCommandArgs;
use crate::args::tetra::{LookArgs, TetraArgs};
use crate::args::tiles::{AssembleArgs, PlanArgs, TileArgs};
use crate::args::token::TokenArgs;
use crate::args::traces::TraceArgs;
use crate::results::query_target::What;

/// Bakes from-region visibility: for every view cell of a static triangle scene,
/// the triangles visible from anywhere in it.
///
/// Start with:  sightline generate town --triangles 20000 -o town.glb
///              sightline bake town.glb -o town.pvs
///              sightline measure town.glb town.pvs
#[derive(Parser, Debug)]
#[command(name = "sightline", version, max_term_width = 110, verbatim_doc_comment, after_help = EXIT_CODES)]
pub struct Cli {
    /// Print one JSON document to stdout. `dump`, `sightlines`, `stab`, `look` and `ambient`
    /// with `--points` always print JSON Lines.
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 internal error, 2 wrong usage, 3 bad input or a result that `verify` refuses, \
4 coordinator unreachable or refusing, 5 job failed, 6 results that differ (`diff --fail-above`), \
130 interrupted (run the same command again to continue).\n\
SIGHTLINE_LOG=debug (or info, warn) sets how much is logged to stderr.";

impl Cli {
    /// Whether the command runs until it is stopped. The log of such a command has times.
    pub fn serves(&self) -> bool {
        matches!(self.command, Command::Coordinator(_) | Command::Worker(_))
    }

    /// How the log looks.
    pub fn log_format(&self) -> LogFormat {
        match &self.command {
            Command::Coordinator(args) => args.log_format,
            Command::Worker(args) => args.log_format,
            _ => LogFormat::Text,
        }
    }

    /// The log filter without SIGHTLINE_LOG: servers log events, other commands only warnings.
    pub fn default_log(&self) -> &'static str {
        // The scheduler logs which backend it chose, and why.
        if self.serves() {
            "info"
        } else {
            "warn,sightline_coordinator::profile=info"
        }
    }
}

#[derive(Subcommand, Debug)]
pub enum Command {
    /// Bake a scene on this machine.
    Bake(BakeArgs),
    Plan(PlanArgs),
    Tile(TileArgs),
    Assemble(AssembleArgs),
    /// Run the coordinator of a cluster, which keeps jobs and gives their tiles to workers.
    Coordinator(CoordinatorArgs),
    /// Make, list and revoke the tokens of a coordinator.
    Token(TokenArgs),
    /// Run a worker, which bakes tiles for a coordinator.
    Worker(WorkerArgs),
    /// Check that a coordinator is serving.
    Health(RemoteArgs),
    /// Send a scene and a job to a coordinator; prints the job's number.
    Submit(SubmitArgs),
    /// Follow a job until it ends.
    Watch(JobRefArgs),
    /// List the newest jobs of a coordinator.
    Jobs(JobsArgs),
    /// Show one job with its specification, who works on it, and the connected workers that cannot.
    Show(ShowArgs),
    /// List the connected workers of a coordinator: what they do, and how fast they are.
    Workers(WorkersArgs),
    /// Check, compact, export and import the store of a coordinator that does not run.
    Store(StoreCommandArgs),
    /// Compute tiles again whose results are not believed any more: of a job, of a worker, of a time.
    Invalidate(InvalidateArgs),
    /// Print what happened to a job, or on the whole farm, with times.
    Logs(LogsArgs),
    /// End a job. Its finished tiles, and finished phases of tiles at work, are kept for `retry`.
    Cancel(JobRefArgs),
    /// Pause a job: give out no more of its tiles. Workers finish those that they have begun.
    Pause(PauseArgs),
    /// Give a job another priority.
    Priority(PriorityArgs),
    /// Continue a paused job.
    Resume(JobRefArgs),
    /// Continue a failed or cancelled job, or bake again the tiles that a finished job has set aside.
    Retry(JobRefArgs),
    /// Delete a job that has ended, with its result.
    Delete(JobRefArgs),
    /// Download the result of a finished job, or what there is of it so far.
    Fetch(FetchArgs),
    /// Write the triangles of a scene to a PLY file, in the order of their ids.
    Mesh(MeshArgs),
    /// Divide a scene along its walls: what they enclose, the openings, and the way out of the scene.
    Portals(PortalsArgs),
    /// Generate a test scene.
    Generate(GenerateArgs),
    /// Summarise a result.
    Info(InfoArgs),
    /// Print the sets of a result as JSON Lines.
    Dump(DumpArgs),
    /// Compare two results of the same cells: what came into their sets and what went.
    Diff(DiffArgs),
    /// Write the objects of each cell for an engine, for streaming, or as a table.
    Export(ExportArgs),
    /// Print the set of the cell that contains a point, or why a triangle is in this set or not.
    Query(QueryArgs),
    /// Measure the fraction of wrong pixels from random viewpoints or along a camera path.
    Measure(MeasureArgs),
    Sightlines(SightlinesArgs),
    /// Decide exactly whether a line passes through a sequence of polygons.
    Stab(StabArgs),
    Tetra(TetraArgs),
    Look(LookArgs),
    /// Put ambient occlusion without noise into a scene's own file, or tell it at points.
    Ambient(AmbientArgs),
    Verify(VerifyArgs),
    /// Look at a result in a browser: walk through the scene as each cell draws it, and click to see why.
    View(ViewArgs),
    /// Write a report as HTML: the error with plots and worst frames, cells over budget, and which objects
    /// cost most, from how many cells they are seen and through which openings.
    Report(ReportArgs),
    /// Measure time against error for every sampler, from coarse to fine, as a table and curves.
    Bench(BenchArgs),
    /// Print the completions of this command line for a shell.
    Completions(CompletionsArgs),
    /// Write the manual pages of all commands.
    Man(ManArgs),
}

#[derive(Args, Debug)]
pub struct BakeArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The result file to write.
    #[arg(short, long, value_name = "OUT.pvs")]
    pub output: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    #[command(flatten)]
    pub job: JobOptions,
    /// Workers in this process, 1 to 256. Each bakes one tile at a time, and all share all cores. Default:
    /// one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub workers: Option<u16>,
    /// Directory for unfinished work and finished results. Default: $XDG_CACHE_HOME/sightline or
    /// ~/.cache/sightline.
    #[arg(long, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// Show the result in a browser afterwards, as `sightline view` does.
    #[arg(long)]
    pub view: bool,
}

/// Reads one coordinate of a point.
fn coordinate(text: &str) -> Result<f32, String> {
    text.parse()
        .map_err(|_| "give the point as three numbers, as in 1.5 0 -2".to_owned())
}

#[derive(Args, Debug)]
pub struct StabArgs {
    /// The sequences as JSON Lines; - for stdin: {"id":1,"portals":[[[x,y,z],…],…]}. Polygons are convex and
    /// exactly flat, with at most 64 corners in order around them. A coordinate is a number or "p/q".
    #[arg(long, value_name = "Q.jsonl")]
    pub queries: PathBuf,
    /// Add the antipenumbra of each stabbed sequence: the surfaces that bound and divide the space that is
    /// lit through it, each a plane [a,b,c,d] or a quadric [A,…,J] with Ax² + 2Bxy + 2Cxz + 2Dx + Ey² +
    /// 2Fyz + 2Gy + Hz² + 2Iz + J = 0.
    #[arg(long)]
    pub swaths: bool,
    /// Regions of line space that a query may visit before it ends as undecided.
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..))]
    pub max_regions: u32,
    /// Threads. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

#[derive(Args, Debug)]
pub struct PortalsArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// A point where a viewpoint can be. May be given several times. Without any, some points of the scene's
    /// box are tried, and those around which walls close are listed.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub reachable_from: Vec<[f32; 3]>,
    /// A file to look at: an object `cell N` for each convex part that the points reach, `portal N-M` for the
    /// opening between two of them, and `way out`, if there is one.
    #[arg(short, long, value_name = "OUT.glb")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
}

#[derive(Args, Debug)]
pub struct MeshArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The binary PLY file to write: three vertices for each triangle, in id order, in world space.
    #[arg(short, long, value_name = "OUT.ply")]
    pub output: PathBuf,
}

#[derive(Args, Debug)]
pub struct GenerateArgs {
    /// The kind of scene.
    #[arg(value_enum)]
    pub kind: SceneKind,
    /// The scene file to write, as binary glTF.
    #[arg(short, long, value_name = "OUT.glb")]
    pub output: PathBuf,
    /// Approximate number of triangles. Default: the size of the papers' scene of this kind.
    #[arg(long, value_name = "N")]
    pub triangles: Option<u64>,
    /// Seed of the scene. The same seed and size give the same bytes.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Forest: number of trees.
    #[arg(long)]
    pub trees: Option<u32>,
    /// Forest: triangles in each tree.
    #[arg(long)]
    pub triangles_per_tree: Option<u32>,
    /// Rooms and maze: columns and rows; slits: walls, and slits in each wall.
    #[arg(long, value_name = "NxM", value_parser = parse_grid)]
    pub grid: Option<[u32; 2]>,
    /// Slits: width of a slit as a fraction of the wall, 1e-7 to 0.1.
    #[arg(long)]
    pub slit_width: Option<f32>,
}

#[derive(ValueEnum, Clone, Copy, Debug)]
pub enum SceneKind {
    /// 200 trees of 25 000 triangles on the ground.
    Forest,
    /// Streets of houses whose furniture is seen through doors and windows.
    Town,
    /// A storey of rooms joined by doors.
    Rooms,
    /// A maze.
    Maze,
    /// Walls with narrow slits.
    Slits,
}

#[derive(Args, Debug)]
pub struct ResultArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
}

#[derive(Args, Debug)]
pub struct InfoArgs {
    #[command(flatten)]
    pub result: ResultArgs,
    /// Print how each cell was sampled, the hardest cells first, and the bounds on missed sight lines.
    #[arg(long)]
    pub cells: bool,
}

/// The kind of ids in a set.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Items {
    /// Triangle ids.
    Triangles,
    /// Object ids: glTF node and primitive, OBJ group; `info` lists them.
    Objects,
    /// Cluster ids of a result baked with --granularity clusters; the first line lists their triangles.
    Clusters,
    /// The cells that a cell sees.
    Cells,
}

impl Items {
    /// Its name on the command line and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Triangles => "triangles",
            Self::Objects => "objects",
            Self::Clusters => "clusters",
            Self::Cells => "cells",
        }
    }
}

#[derive(Args, Debug)]
pub struct DumpArgs {
    #[command(flatten)]
    pub result: ResultArgs,
    /// The kind of ids in the sets.
    #[arg(long, value_enum, default_value_t = Items::Triangles)]
    pub items: Items,
    /// Add to each cell how much of the view each of its visible items takes: the mean over the cell and the
    /// greatest from one viewpoint, each as a least and a greatest share of all directions, in the order of
    /// "visible". Needs a result baked with --contributions, and the items of its sets.
    #[arg(long)]
    pub contributions: bool,
    /// Print this cell alone. May be given several times.
    #[arg(long, value_name = "I")]
    pub cell: Vec<u32>,
}

#[derive(Args, Debug)]
#[command(
    override_usage = "sightline query [OPTIONS] <OUT.pvs> <X> <Y> <Z> [--sees <X> <Y> <Z> | --box <BOX> | \
                      --cell <I>]"
)]
pub struct QueryArgs {
    #[command(flatten)]
    pub result: ResultArgs,
    /// The viewpoint, in world space.
    #[arg(num_args = 3, value_names = ["X", "Y", "Z"], required_unless_present = "cell")]
    #[arg(value_parser = coordinate, allow_negative_numbers = true)]
    pub point: Vec<f32>,
    /// Print whether the viewpoint's cell sees the cell of this point.
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    #[arg(value_parser = coordinate, conflicts_with_all = ["to_box", "cell", "why", "items"])]
    pub sees: Vec<f32>,
    /// Print whether the viewpoint's cell sees a cell that meets this box, as of a moving thing:
    /// x0,y0,z0,x1,y1,z1 in world space. A box that reaches beyond the view box counts as seen.
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    #[arg(conflicts_with_all = ["cell", "why", "items"])]
    pub to_box: Option<sightline_scene::Aabb>,
    /// Print whether the viewpoint's cell sees this cell; without a viewpoint, the set of this cell.
    #[arg(long, value_name = "I")]
    pub cell: Option<u32>,
    /// The kind of ids in the set.
    #[arg(long, value_enum, default_value_t = Items::Triangles)]
    pub items: Items,
    /// Print why a triangle (its number) or an object (its name, or object:NUMBER) is in the set or not: the
    /// witness, a segment along which it is visible; or the triangles that hide it; or that the closed
    /// surface it belongs to hides it. The reasons come from the result's certificates (bake --certificates)
    /// or, with --scene, from a new query.
    #[arg(long, value_name = "TRIANGLE|OBJECT", conflicts_with = "items", value_parser = What::parse)]
    pub why: Option<What>,
    /// Draw the answer of --why as a PNG: from the witness's begin or from the viewpoint, what is asked about
    /// in green with its outline, what hides it in red.
    #[arg(long, value_name = "OUT.png", requires_all = ["why", "scene"])]
    pub picture: Option<PathBuf>,
    /// The scene the result was baked from: for a new query of --why, and to check that the point is where
    /// viewpoints can be in a result of --reachable-from.
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
}

/// Check every claim of a result with a checker that shares no code with the search
///
/// In every cell each triangle with an area must be accounted for: it meets the cell, or it has a witness (an
/// unobstructed segment from the cell to the triangle), or it has a certificate that it is hidden, or it is
/// listed as undecided. Integers decide, without any tolerance. If a claim does not hold, the cell and the
/// reason are printed (with --json as {"accepted":false,…}) and the exit code is 3, as for files that cannot
/// be read or do not belong together.
///
/// A triangle that a witness touches only in the plane of the visible triangle, such as a floor at the foot
/// of a wall, does not obstruct the witness. Neither does a triangle in the plane of the cell's face on which
/// the witness begins.
#[derive(Args, Debug)]
pub struct VerifyArgs {
    /// The scene the result was baked from.
    pub scene: PathBuf,
    /// The result, baked with --method exact or verified and --certificates, or with --method portals.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Check only the claims about this many pairs of cell and triangle, drawn uniformly from all pairs. That
    /// every triangle is accounted for is checked in any case. At most 10000000. Default: check every claim,
    /// which can take several times as long as the bake. Of a result of --method portals, ask exact queries
    /// about this many pairs that are called hidden.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub sample: Option<u64>,
    /// Seed of the sample.
    #[arg(long, value_name = "S", default_value_t = 1, requires = "sample")]
    pub seed: u64,
    /// Threads, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

#[derive(Args, Debug)]
pub struct MeasureArgs {
    /// The scene the result was baked from.
    pub scene: PathBuf,
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Number of random viewpoints, uniform in the cells with viewpoints. Each frame is a full cube around a
    /// viewpoint.
    #[arg(long, value_name = "N", default_value_t = 200, conflicts_with = "path")]
    pub viewpoints: u32,
    /// Measure at the viewpoints of a file instead: a line `x y z` or `x y z weight` for each. The mean error
    /// is weighted. Of more than --viewpoints lines, so many are drawn by their weights.
    #[arg(long, value_name = "FILE", conflicts_with = "path")]
    pub viewpoints_file: Option<PathBuf>,
    /// Seed of the viewpoints.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Measure along a camera path instead: a file with one viewpoint `x y z` per line.
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Also measure which cells see which: draw this many pairs of points, uniform in the view box, and print
    /// of those that an unobstructed segment joins the fraction whose cells are said not to see each other.
    #[arg(long, value_name = "N", default_value_t = 0)]
    #[arg(value_parser = clap::value_parser!(u64).range(0..=10_000_000_000))]
    pub pairs: u64,
    /// Measure without pixels: the part of all directions in which a triangle is seen that is not in the set,
    /// by exact sets from the viewpoints. Needs no backend and finds what falls between pixels.
    #[arg(long, conflicts_with_all = ["resolution", "backend", "images", "turntable", "pairs"])]
    pub exact: bool,
    /// Side of one face of a cube in pixels, 8 to 4096.
    #[arg(long, value_name = "PX", default_value_t = 256)]
    pub resolution: u32,
    /// The backend that renders the frames: cpu, gpu, or auto, the cpu if Embree is installed, else the gpu.
    #[arg(long, value_parser = named::<TracerChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: TracerChoice,
    /// Write the eight worst frames to this folder as PNG: correct pixels green, wrong pixels red. The six
    /// faces around the viewpoint have their names in their corners.
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
    /// Also write `worst_turntable.png` there, an animated PNG: what a camera at the worst viewpoint sees
    /// while it turns once around.
    #[arg(long, requires = "images")]
    pub turntable: bool,
}

/// Decide exactly for pairs of polygons whether one sees the other
///
/// Polygons are convex. Every blocking triangle obstructs, except a triangle in the plane of a or of
/// b. Each line of the input is a query and gets one line as its answer, in order. The time of a
/// query is in microseconds.
///
///   {"id":1,"a":[[x,y,z],…],"b":[[x,y,z],…]}    a query
///   {"id":1,"state":"visible","witness":[[x,y,z],[x,y,z]],"micros":…}
///                                               an unobstructed segment from a to b
///   {"id":1,"state":"hidden","blockers":[ids],"micros":…}
///                                               proved; the triangles the proof names
///   {"id":1,"state":"undecided","reason":"…","micros":…}
///                                               the limits did not suffice
///
/// No tolerance decides: a gap of a millionth of a wall's width transmits sight, the common edge of
/// two triangles does not. A polygon that is visible only along single lines, such as along an edge,
/// counts as hidden. Two polygons in one plane are hidden from each other, with no blockers.
#[derive(Args, Debug)]
#[command(verbatim_doc_comment)]
pub struct SightlinesArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The queries as JSON Lines; - for stdin. Polygons are convex and planar, with at most 64 corners in
    /// order around them.
    #[arg(long, value_name = "Q.jsonl")]
    pub queries: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Check every witness and every proof with a checker that shares no code with the search and uses exact
    /// arithmetic alone.
    #[arg(long)]
    pub check: bool,
    /// Regions of line space that a query may visit before it ends as undecided.
    #[arg(long, value_name = "N", default_value_t = sightline_exact::Limits::default().regions)]
    pub max_regions: u32,
    /// Threads, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

fn parse_grid(text: &str) -> Result<[u32; 2], String> {
    let parts = text
        .split(['x', 'X'])
        .map(|p| p.trim().parse())
        .collect::<Result<Vec<u32>, _>>();
    parts
        .ok()
        .and_then(|p| p.try_into().ok())
        .ok_or_else(|| "give two numbers as in 8x8".to_owned())
}
