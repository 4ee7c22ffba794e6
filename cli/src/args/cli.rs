//! The command line, as clap parses it. The doc comments are the text of `--help`.

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
use crate::args::results::{
    CellsArgs, CompletionsArgs, DiffArgs, ExportArgs, ManArgs, ReportArgs, ViewArgs,
};
use crate::args::serve::{CoordinatorArgs, LogFormat, WorkerArgs};
use crate::args::store::StoreCommandArgs;
use crate::args::tetra::{LookArgs, TetraArgs};
use crate::args::tiles::{AssembleArgs, PlanArgs, TileArgs};
use crate::args::token::TokenArgs;
use crate::args::traces::TraceArgs;
use crate::results::query_target::QueryTarget;

/// Bakes from-region visibility: for every view cell of a static triangle scene,
/// the triangles visible from anywhere in it.
///
/// Start with:  sightline generate town --triangles 20000 -o town.glb
///              sightline bake town.glb -o town.pvs
///              sightline measure town.glb town.pvs
#[derive(Parser, Debug)]
#[command(name = "sightline", version, max_term_width = 110, verbatim_doc_comment, after_help = EXIT_CODES)]
pub struct Cli {
    /// Print JSON to stdout: one document, or for `logs` and `show --tiles` one line per event or tile.
    /// `measure` always prints a JSON document. `dump`, `sightlines`, `stab`, `look` and `ambient` with
    /// `--points` always print JSON Lines. Default: plain text.
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 success, 1 internal error, 2 wrong usage, 3 bad input or a result that `verify` rejects, \
4 coordinator unreachable or call rejected, 5 job failed, 6 results differ (`diff --fail-above`) or a cell \
exceeds its budget (`report --fail-over-budget`), 130 interrupted (run the same command again to continue).\n\
SIGHTLINE_LOG=debug (or info, warn) sets the level of the log on stderr.";

impl Cli {
    /// Returns true if the command runs until a signal stops it. The log lines of such a command have times.
    pub fn serves(&self) -> bool {
        matches!(self.command, Command::Coordinator(_) | Command::Worker(_))
    }

    /// Returns the format of the log.
    pub fn log_format(&self) -> LogFormat {
        match &self.command {
            Command::Coordinator(args) => args.log_format,
            Command::Worker(args) => args.log_format,
            _ => LogFormat::Text,
        }
    }

    /// Returns the log filter for a process without SIGHTLINE_LOG. The coordinator and the worker log events;
    /// other commands log only warnings and the chosen backend.
    pub fn default_log(&self) -> &'static str {
        // The scheduler logs the chosen backend and the reason.
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
    /// Run the coordinator of a cluster, which stores jobs and leases their tiles to workers.
    Coordinator(CoordinatorArgs),
    /// Create, list and revoke the tokens of a coordinator.
    Token(TokenArgs),
    /// Run a worker, which bakes tiles for a coordinator.
    Worker(WorkerArgs),
    /// Check that a coordinator is serving.
    Health(RemoteArgs),
    /// Send a scene and a job to a coordinator, and print the number of the job.
    Submit(SubmitArgs),
    /// Follow a job until it ends.
    Watch(JobRefArgs),
    /// List the newest jobs of a coordinator.
    Jobs(JobsArgs),
    /// Show a job: its specification, its workers, and the connected workers that cannot compute it.
    Show(ShowArgs),
    /// List the connected workers of a coordinator with their current tiles and speeds.
    Workers(WorkersArgs),
    /// Check, compact, export and import the store of a stopped coordinator.
    Store(StoreCommandArgs),
    /// Compute untrusted tiles again, selected by job, worker or time.
    Invalidate(InvalidateArgs),
    /// Print the events of a job, or of the whole farm, with times.
    Logs(LogsArgs),
    /// Cancel a job. Finished tiles, and finished phases of running tiles, are stored for `retry`.
    Cancel(JobRefArgs),
    /// Pause a job: lease no more of its tiles. Workers finish their running tiles.
    Pause(PauseArgs),
    /// Change the priority of a job.
    Priority(PriorityArgs),
    /// Continue a paused job.
    Resume(JobRefArgs),
    /// Continue a failed or cancelled job, or bake the tiles again that a finished job has set aside.
    Retry(JobRefArgs),
    /// Delete an ended job and its result.
    Delete(JobRefArgs),
    /// Download the result of a finished job, or the finished part of an unfinished one.
    Fetch(FetchArgs),
    /// Write the triangles of a scene to a PLY file, in the order of their ids.
    Mesh(MeshArgs),
    /// Divide a scene along its walls into convex parts, and list the parts and their openings.
    Portals(PortalsArgs),
    /// Generate a test scene.
    Generate(GenerateArgs),
    /// Print a summary of a result.
    Info(InfoArgs),
    /// Print the sets of a result as JSON Lines.
    Dump(DumpArgs),
    /// Compare two results of the same cells, and print the items that their sets gained and lost.
    Diff(DiffArgs),
    Cells(CellsArgs),
    /// Write the objects of each cell for an engine, for streaming, or as a table.
    Export(ExportArgs),
    /// Print the set of the cell that contains a point, or the reason why a triangle is in this set or not.
    Query(QueryArgs),
    /// Measure the fraction of wrong pixels from random viewpoints or along a camera path.
    Measure(MeasureArgs),
    Sightlines(SightlinesArgs),
    /// Decide exactly whether a line passes through a sequence of polygons.
    Stab(StabArgs),
    Tetra(TetraArgs),
    Look(LookArgs),
    /// Compute noise-free ambient occlusion and write it to a GLB file, or print it for points.
    Ambient(AmbientArgs),
    Verify(VerifyArgs),
    /// Show a result in a browser. The page shows the set of each cell as you walk through the scene, and the
    /// reason why a clicked triangle is visible or hidden.
    View(ViewArgs),
    /// Write a report as HTML. The report contains the error with plots and the worst frames, the cells over
    /// budget, and the most expensive objects. For each object, it lists the number of cells that see the
    /// object, and the opening through which most of these cells see it.
    Report(ReportArgs),
    /// Measure the time and the error of every sampler, from coarse to fine, as a table and curves.
    Bench(BenchArgs),
    /// Print the shell completions of this command line.
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
    /// Unite the sets of a result of the same scene instead of sampling: FINE.pvs, baked with --cells
    /// NXxNYxNZ. Needs --cell-budget or --byte-budget. Of the other options of a job, only --cost and
    /// --viewpoints have a use; the file of --viewpoints gives the weights of the fine cells.
    #[arg(long, value_name = "FINE.pvs")]
    pub from: Option<PathBuf>,
    /// Workers in this process, 1 to 256. Each worker bakes one tile at a time, and all workers share all
    /// cores. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub workers: Option<u16>,
    /// Directory for unfinished work and finished results. Default: $XDG_CACHE_HOME/sightline or
    /// ~/.cache/sightline.
    #[arg(long, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    #[command(flatten)]
    pub traces: TraceArgs,
    /// Show the finished result in a browser, as `sightline view` does.
    #[arg(long)]
    pub view: bool,
}

/// Parses one coordinate of a point, in units of the scene.
fn coordinate(text: &str) -> Result<f32, String> {
    text.parse()
        .map_err(|_| "give the point as three numbers, as in 1.5 0 -2".to_owned())
}

#[derive(Args, Debug)]
pub struct StabArgs {
    /// The sequences of portals as JSON Lines; - for stdin: {"id":1,"portals":[[[x,y,z],…],…]}. Polygons are
    /// convex and exactly flat, with at most 64 corners in order around them. A coordinate is a number or
    /// "p/q".
    #[arg(long, value_name = "Q.jsonl")]
    pub queries: PathBuf,
    /// Add the antipenumbra of each stabbed sequence: the surfaces that bound and divide the space that is
    /// lit through the sequence. Each surface is a plane [a,b,c,d] or a quadric [A,…,J] with Ax² + 2Bxy +
    /// 2Cxz + 2Dx + Ey² + 2Fyz + 2Gy + Hz² + 2Iz + J = 0.
    #[arg(long)]
    pub swaths: bool,
    /// Maximum number of regions of line space that a query visits before it ends as undecided.
    #[arg(long, value_name = "N", default_value_t = 200_000)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..))]
    pub max_regions: u32,
    /// Threads, 1 to 256. Default: one per core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

#[derive(Args, Debug)]
pub struct PortalsArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// A point where a viewpoint can be. May be given several times. Default: the command tries 48 points of
    /// the box around the scene, and lists the eight largest spaces that walls enclose.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub reachable_from: Vec<[f32; 3]>,
    /// The GLB file to write, for viewing. It has an object `cell N` for each convex part that the points
    /// reach, and an object `portal N-M` for the opening between two parts. If walls do not enclose the
    /// points, the object `way out` contains the openings on a way out of the scene.
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
    pub kind: GeneratedKind,
    /// The scene file to write, as binary glTF.
    #[arg(short, long, value_name = "OUT.glb")]
    pub output: PathBuf,
    /// Approximate number of triangles. Default: depends on the kind of scene.
    #[arg(long, value_name = "N")]
    pub triangles: Option<u64>,
    /// Seed of the scene. The same kind, size and seed produce the same bytes.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Number of trees (forest only).
    #[arg(long)]
    pub trees: Option<u32>,
    /// Number of triangles per tree (forest only).
    #[arg(long)]
    pub triangles_per_tree: Option<u32>,
    /// Number of columns and number of rows (rooms and maze), or number of walls and number of slits per wall
    /// (slits).
    #[arg(long, value_name = "NxM", value_parser = parse_grid)]
    pub grid: Option<[u32; 2]>,
    /// Width of a slit as a fraction of the width of the wall, 1e-7 to 0.1 (slits only).
    #[arg(long)]
    pub slit_width: Option<f32>,
}

#[derive(ValueEnum, Clone, Copy, Debug)]
pub enum GeneratedKind {
    /// Trees on the ground. Default: 200 trees of 25,000 triangles each.
    Forest,
    /// Streets of houses with furniture that is visible through doors and windows.
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
    /// Print the sampling of each cell, the hardest cells first, and the bounds on missed sight lines.
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
    /// Cluster ids of a result baked with --granularity clusters; the first line lists the triangles of each
    /// cluster.
    Clusters,
    /// Ids of the cells that the cell of the set sees.
    Cells,
}

impl Items {
    /// Returns the name on the command line and in JSON.
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
    /// Add the share of the view that each visible item covers: the mean over the cell and the maximum over
    /// its viewpoints. Each value is a lower and an upper bound on the fraction of all directions. The items
    /// have the order of "visible". Requires a result baked with --contributions, and the --items of the
    /// bake's --granularity.
    #[arg(long)]
    pub contributions: bool,
    /// Print only the cell with this number, starting at 0. May be given several times.
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
    /// Print whether the cell of the viewpoint sees the cell of this point.
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    #[arg(value_parser = coordinate, conflicts_with_all = ["to_box", "cell", "why", "items"])]
    pub sees: Vec<f32>,
    /// Print whether the cell of the viewpoint sees a cell that intersects this box, such as the bounds of a
    /// moving object: x0,y0,z0,x1,y1,z1 in world space. A box that is not inside the view box counts as
    /// visible.
    #[arg(long = "box", value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    #[arg(conflicts_with_all = ["cell", "why", "items"])]
    pub to_box: Option<sightline_scene::Aabb>,
    /// Number of a cell, starting at 0. With a viewpoint, print whether the cell of the viewpoint sees this
    /// cell. Without a viewpoint, print the set of this cell.
    #[arg(long, value_name = "I")]
    pub cell: Option<u32>,
    /// The kind of ids in the set.
    #[arg(long, value_enum, default_value_t = Items::Triangles)]
    pub items: Items,
    /// Print the reason why a triangle (its number) or an object (its name, or object:NUMBER) is in the set
    /// or not. For a visible triangle, the reason is the witness, a segment along which the triangle is
    /// visible. For a hidden triangle, the reason is the triangles that hide it, or the closed surface that
    /// it belongs to. The reasons come from the certificates of the result (bake --certificates) or, with
    /// --scene, from a new query.
    #[arg(long, value_name = "TRIANGLE|OBJECT", conflicts_with = "items", value_parser = QueryTarget::parse)]
    pub why: Option<QueryTarget>,
    /// Draw the answer of --why as a PNG, from the start of the witness or from the viewpoint. The queried
    /// triangle or object is green with an outline, and the triangles that hide it are red.
    #[arg(long, value_name = "OUT.png", requires_all = ["why", "scene"])]
    pub picture: Option<PathBuf>,
    /// The scene that the result was baked from. It is used for a new query of --why and, in a result of
    /// --reachable-from, to check that viewpoints can be at the point.
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
}

/// Check every claim of a result with a checker that shares no code with the search
///
/// In every cell with viewpoints, the result must account for every triangle that has an area and shows
/// (docs/kinds.md). The triangle intersects the cell, has a witness (an unobstructed segment from the cell to
/// the triangle), has a certificate that it is hidden, or is listed as undecided. Integers decide, without
/// any tolerance. If a claim does not hold, the command prints the cell and the reason (with --json as
/// {"accepted":false,…}). The exit code is then 3, as for files that cannot be read or do not belong
/// together.
///
/// A triangle does not obstruct a witness if the witness touches it only in the plane of the visible
/// triangle, such as a floor at the foot of a wall. A triangle in the plane of the cell's face on which the
/// witness starts does not obstruct the witness, either.
#[derive(Args, Debug)]
pub struct VerifyArgs {
    /// The scene the result was baked from.
    pub scene: PathBuf,
    /// The result, baked with --method exact or verified and --certificates, or with --method portals.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// Number of randomly drawn claims to check, 1 to 10000000: pairs of a cell and a triangle, uniform over
    /// all pairs. The check that every triangle is accounted for is always complete. For a result of --method
    /// portals, the command runs exact queries for this number of hidden pairs. Default: check every claim,
    /// which can take several times as long as the bake.
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
    /// A file of viewpoints to measure at, with a line `x y z` or `x y z weight` for each. The mean error is
    /// weighted. If the file has more than --viewpoints lines, the command draws --viewpoints of them at
    /// random, in proportion to their weights.
    #[arg(long, value_name = "FILE", conflicts_with = "path")]
    pub viewpoints_file: Option<PathBuf>,
    /// Seed of the viewpoints.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// A file with a camera path to measure along, with one viewpoint `x y z` per line.
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Number of pairs of points for measuring cell-to-cell visibility, uniform in the view box, 0 to
    /// 10000000000. The command prints a fraction of the pairs whose points an unobstructed segment joins:
    /// the pairs whose cells do not see each other according to the result.
    #[arg(long, value_name = "N", default_value_t = 0)]
    #[arg(value_parser = clap::value_parser!(u64).range(0..=10_000_000_000))]
    pub pairs: u64,
    /// Measure without pixels: the fraction of all directions in which a visible triangle is not in the set,
    /// computed from exact sets at the viewpoints. Needs no backend, and includes triangles smaller than a
    /// pixel.
    #[arg(long, conflicts_with_all = ["resolution", "backend", "images", "turntable", "pairs"])]
    pub exact: bool,
    /// Side of one face of a cube in pixels, 8 to 4096.
    #[arg(long, value_name = "PX", default_value_t = 256)]
    pub resolution: u32,
    /// The backend that renders the frames: cpu, gpu, embree or auto. auto selects the cpu.
    #[arg(long, value_parser = named::<TracerChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: TracerChoice,
    /// The folder for the eight worst frames as PNG: correct pixels are green, wrong pixels red. The corners
    /// of the six faces around the viewpoint contain their names. Default: none.
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
    /// Also write `worst_turntable.png` to that folder: an animated PNG from a camera at the worst viewpoint
    /// that turns once around.
    #[arg(long, requires = "images")]
    pub turntable: bool,
}

/// Decide exactly for pairs of polygons whether one sees the other
///
/// Polygons are convex. Every blocking triangle obstructs, except a triangle in the plane of a or of
/// b. Each line of the input is a query. The command prints one line per query, in order. "micros"
/// is the time of the query in microseconds.
///
/// A query:
///
///   {"id":1,"a":[[x,y,z],…],"b":[[x,y,z],…]}
///
/// Visible, with an unobstructed segment from a to b:
///
///   {"id":1,"state":"visible","witness":[[x,y,z],[x,y,z]],"micros":…}
///
/// Hidden, with the triangles that the proof refers to:
///
///   {"id":1,"state":"hidden","blockers":[ids],"micros":…}
///
/// Undecided, because the query reached a limit:
///
///   {"id":1,"state":"undecided","reason":"…","micros":…}
///
/// The program uses no tolerance. A gap of a millionth of a wall's width transmits sight, and the
/// common edge of two triangles does not. A polygon that is visible only along single lines, such as
/// along an edge, counts as hidden. Two polygons in one plane are hidden from each other, without
/// blockers.
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
    /// Check every witness and every proof with a checker that shares no code with the search and uses only
    /// exact arithmetic.
    #[arg(long)]
    pub check: bool,
    /// Maximum number of regions of line space that a query visits before it ends as undecided.
    #[arg(long, value_name = "N", default_value_t = sightline_exact::QueryLimits::default().regions)]
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
        .ok_or_else(|| "give two whole numbers, such as 8x8".to_owned())
}
