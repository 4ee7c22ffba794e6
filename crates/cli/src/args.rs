//! The command line, as clap reads it. Its help texts are the manual.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use sightline_model::BackendChoice;

use crate::bench_args::BenchArgs;
use crate::choices::choice;
use crate::job_args::JobArgs;

/// Bakes from-region visibility: for every view cell of a static triangle scene,
/// the triangles visible from anywhere in it.
///
/// Start with:  sightline generate town --triangles 20000 -o town.glb
///              sightline bake town.glb -o town.pvs
///              sightline measure town.glb town.pvs
#[derive(Parser, Debug)]
#[command(name = "sightline", version, max_term_width = 110, verbatim_doc_comment, after_help = EXIT_CODES)]
pub struct Cli {
    /// Make stdout one JSON document. `dump` and `sightlines` print JSON Lines in any case.
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 internal error, 2 wrong usage, 3 bad input or a result that \
    `verify` refuses, 4 coordinator unreachable or \
refusing, 5 job failed, 130 interrupted (run the same command again to go on).\n\
SIGHTLINE_LOG=debug (or info, warn) sets how much is logged to stderr.";

impl Cli {
    /// Whether the command runs until it is stopped, so that its log wants times.
    pub fn serves(&self) -> bool {
        matches!(self.command, Command::Coordinator(_) | Command::Worker(_))
    }

    /// How much is logged when nobody says: servers tell what happens, commands only what is wrong.
    pub fn default_log(&self) -> &'static str {
        // The scheduler tells which backend was chosen, and why.
        if self.serves() { "info" } else { "warn,sightline_coordinator::scheduler=info" }
    }
}

#[derive(Subcommand, Debug)]
pub enum Command {
    /// Bake a scene on this machine.
    Bake(BakeArgs),
    /// Serve as coordinator of a cluster.
    Coordinator(CoordinatorArgs),
    /// Join a coordinator as worker.
    Worker(WorkerArgs),
    /// Ask whether a coordinator serves.
    Health(RemoteArgs),
    /// Send a scene and a job to a coordinator; prints the job's number.
    Submit(SubmitArgs),
    /// Follow a job until it ends.
    Watch(JobRefArgs),
    /// List a coordinator's jobs.
    Jobs(RemoteArgs),
    /// Show one job.
    Show(JobRefArgs),
    /// End a job; what it has is kept for `retry`.
    Cancel(JobRefArgs),
    /// Give out no more tiles of a job, and stop those at work, which begin anew when it goes on.
    Pause(JobRefArgs),
    /// Go on with a paused job.
    Resume(JobRefArgs),
    /// Go on with a failed or cancelled job, or try again what a finished one has set aside.
    Retry(JobRefArgs),
    /// Download a finished job's result.
    Fetch(FetchArgs),
    /// Write a scene's triangles as the program numbers them.
    Mesh(MeshArgs),
    /// Make a test scene.
    Generate(GenerateArgs),
    /// Say what is in a result.
    Info(InfoArgs),
    /// Print a result's sets as JSON Lines.
    Dump(DumpArgs),
    /// Print what is visible from a point's cell.
    Query(QueryArgs),
    /// Measure how wrong a result looks from random viewpoints or along a path.
    Measure(MeasureArgs),
    /// Decide exactly which polygons see each other.
    Sightlines(SightlinesArgs),
    /// Check every witness and every certificate of a result again.
    Verify(VerifyArgs),
    /// Measure time against error: every sampler from coarse to fine, as table and curves.
    Bench(BenchArgs),
}

#[derive(Args, Debug)]
pub struct BakeArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// Where the result goes.
    #[arg(short, long, value_name = "OUT.pvs")]
    pub output: PathBuf,
    #[command(flatten)]
    pub job: JobArgs,
    /// Workers in this process, 1 to 256: tiles in hand at once. All share all cores. Default: one a core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub workers: Option<u16>,
    /// Where unfinished work and finished results are kept. Default: $XDG_CACHE_HOME/sightline or
    /// ~/.cache/sightline.
    #[arg(long, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub struct CoordinatorArgs {
    /// Address to listen on; port 0 takes any free one.
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:7600")]
    pub listen: SocketAddr,
    /// Where jobs, scenes and results are kept.
    #[arg(long, value_name = "DIR", default_value = "sightline-data")]
    pub data_dir: PathBuf,
    /// Serve without encryption beyond this machine; only for private networks.
    #[arg(long)]
    pub allow_plaintext: bool,
}

#[derive(Args, Debug)]
pub struct WorkerArgs {
    /// The coordinator.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7600")]
    pub coordinator: String,
    /// Backends this worker offers; auto: all that work here.
    #[arg(long, value_parser = choice::<BackendChoice>(), default_value_t)]
    pub backend: BackendChoice,
    /// Use the Vulkan adapter whose name contains this.
    #[arg(long, value_name = "TEXT")]
    pub adapter: Option<String>,
    /// Threads that sample, 1 to 1024. Default: one per core.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
    /// Shown by the coordinator. Default: host name and process number.
    #[arg(long)]
    pub name: Option<String>,
    /// Stop when the coordinator cannot be reached for this many seconds. Default: go on trying.
    #[arg(long, value_name = "S")]
    pub give_up_after: Option<u64>,
}

#[derive(Args, Debug, Clone)]
pub struct RemoteArgs {
    /// The coordinator.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7600")]
    pub coordinator: String,
}

#[derive(Args, Debug)]
pub struct SubmitArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    #[command(flatten)]
    pub remote: RemoteArgs,
    #[command(flatten)]
    pub job: JobArgs,
    /// Shown beside the job's number. Default: the file's name.
    #[arg(long)]
    pub name: Option<String>,
    /// Submitting again with the same one is answered with the same job. Default: a fresh one.
    #[arg(long, value_name = "TEXT")]
    pub request_id: Option<String>,
}

/// Reads a number of threads.
fn thread_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=1024) => Ok(n),
        _ => Err("give a number from 1 to 1024, or leave --threads out for one thread per core".to_owned()),
    }
}

/// Reads the number of a job.
fn job_number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "a job is named by its number, as `sightline jobs` lists them".to_owned())
}

/// Reads one coordinate of a point.
fn coordinate(text: &str) -> Result<f32, String> {
    text.parse().map_err(|_| "give the point as three numbers, as in 1.5 0 -2".to_owned())
}

#[derive(Args, Debug)]
pub struct JobRefArgs {
    /// The job's number, as `submit` and `jobs` print it.
    #[arg(value_name = "JOB", value_parser = job_number)]
    pub id: u64,
    #[command(flatten)]
    pub remote: RemoteArgs,
}

#[derive(Args, Debug)]
pub struct FetchArgs {
    #[command(flatten)]
    pub job: JobRefArgs,
    /// Where the result goes.
    #[arg(short, long, value_name = "OUT.pvs")]
    pub output: PathBuf,
}

#[derive(Args, Debug)]
pub struct MeshArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// Binary PLY, three own vertices a triangle, in id order, world space.
    #[arg(short, long, value_name = "OUT.ply")]
    pub output: PathBuf,
}

#[derive(Args, Debug)]
pub struct GenerateArgs {
    /// What kind of scene.
    #[arg(value_enum)]
    pub kind: SceneKind,
    /// Where it goes.
    #[arg(short, long, value_name = "OUT.glb")]
    pub output: PathBuf,
    /// About how many triangles it should have. Default: the papers' size of its kind.
    #[arg(long, value_name = "N")]
    pub triangles: Option<u64>,
    /// The same seed and size give the same bytes.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Forest: how many trees.
    #[arg(long)]
    pub trees: Option<u32>,
    /// Forest: triangles of one tree.
    #[arg(long)]
    pub triangles_per_tree: Option<u32>,
    /// Rooms and maze: columns and rows; slits: walls and slits in each.
    #[arg(long, value_name = "NxM", value_parser = parse_grid)]
    pub grid: Option<[u32; 2]>,
    /// Slits: width as a fraction of the wall, 1e-7 to 0.1.
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
    /// How each cell was sampled, the hardest first, and its bound on what it misses.
    #[arg(long)]
    pub cells: bool,
}

/// What sets are made of.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Items {
    /// Triangle ids.
    Triangles,
    /// Object ids: glTF node and primitive, OBJ group; `info` lists them.
    Objects,
}

#[derive(Args, Debug)]
pub struct DumpArgs {
    #[command(flatten)]
    pub result: ResultArgs,
    /// What the sets are made of.
    #[arg(long, value_enum, default_value_t = Items::Triangles)]
    pub items: Items,
}

#[derive(Args, Debug)]
#[command(override_usage = "sightline query [OPTIONS] <OUT.pvs> <X> <Y> <Z>")]
pub struct QueryArgs {
    #[command(flatten)]
    pub result: ResultArgs,
    /// The viewpoint.
    #[arg(num_args = 3, value_names = ["X", "Y", "Z"], required = true, allow_negative_numbers = true)]
    #[arg(value_parser = coordinate)]
    pub point: Vec<f32>,
    /// What the set is made of.
    #[arg(long, value_enum, default_value_t = Items::Triangles)]
    pub items: Items,
    /// Say why this triangle is in the set or is not: the witness segment along which it is seen, or the
    /// triangles that hide it, or that the closed surface it is part of does. From the result's certificates
    /// (bake --certificates), or with --scene by asking anew.
    #[arg(long, value_name = "TRIANGLE", conflicts_with = "items")]
    pub why: Option<u32>,
    /// The scene the result was baked from, for --why.
    #[arg(long, value_name = "SCENE", requires = "why")]
    pub scene: Option<PathBuf>,
}

/// Checks what a result rests on again, with a checker that shares no code with the search.
///
/// Every triangle has to be accounted for in every cell: it meets the cell, or has a witness (a segment from
/// the cell that ends on it and meets nothing else), or a certificate that it is hidden, or is said to be
/// undecided. Integers decide, no tolerance. When something does not hold the cell and the reason are said
/// (with --json as {"accepted":false,…}) and the exit code is 3, as for files that cannot be read or do not
/// belong together.
///
/// A triangle that meets the witness in the plane of the one that is seen, a floor under a wall's foot say,
/// is not in the way; neither is one in the plane of the cell's face the witness begins on.
#[derive(Args, Debug)]
pub struct VerifyArgs {
    /// The scene the result was baked from.
    pub scene: PathBuf,
    /// The result, baked with --method exact or verified and --certificates.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// Check only what is claimed about this many pairs of cell and triangle, drawn evenly from all; that
    /// every triangle is accounted for is checked all the same. At most 10000000. Default: everything, which
    /// can take several times as long as the bake.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub sample: Option<u64>,
    /// Seed of the draw.
    #[arg(long, value_name = "S", default_value_t = 1, requires = "sample")]
    pub seed: u64,
    /// Threads. Default: one a core.
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
    /// Random viewpoints, uniform in the view box; each is a full cube.
    #[arg(long, value_name = "N", default_value_t = 200, conflicts_with = "path")]
    pub viewpoints: u32,
    /// Seed of the viewpoints.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Viewpoints along a camera path instead: a file of lines `x y z`.
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// Side of one face in pixels.
    #[arg(long, value_name = "PX", default_value_t = 256)]
    pub resolution: u32,
    /// What renders the frames; auto: cpu where Embree is there.
    #[arg(long, value_parser = choice::<BackendChoice>(), default_value_t)]
    pub backend: BackendChoice,
    /// Write the worst frames as PNG: seen triangles green, wrong ones red.
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
}

/// Decides for pairs of convex polygons whether one sees the other among the triangles of a scene.
///
/// All triangles block, except where they lie in the plane of a or b. Every line of the input is a query, and
/// is answered by one line, in order:
///
///   {"id":1,"a":[[x,y,z],…],"b":[[x,y,z],…]}
///   {"id":1,"state":"visible","witness":[[x,y,z],[x,y,z]],"micros":…}   a segment that nothing is in the way
///   of {"id":1,"state":"hidden","blockers":[ids],"micros":…}               proved; the triangles the proof
///   rests on {"id":1,"state":"undecided","reason":"…","micros":…}                neither, within the limits
///
/// No tolerance decides: a gap a millionth of a wall wide is seen through, a shared edge is not. What is seen
/// only along single lines, such as an edge, counts as hidden; so do polygons in one plane from each other,
/// with no blockers.
#[derive(Args, Debug)]
#[command(verbatim_doc_comment)]
pub struct SightlinesArgs {
    /// The scene: .obj, .ply, .gltf or .glb.
    pub scene: PathBuf,
    /// The queries, as JSON Lines; - for stdin. Corners in order around convex flat polygons of at most 64.
    #[arg(long, value_name = "Q.jsonl")]
    pub queries: PathBuf,
    /// Have a checker that shares no code with the search go over every witness and every proof, by exact
    /// arithmetic alone.
    #[arg(long)]
    pub check: bool,
    /// Regions of line space a query may look at before it ends undecided.
    #[arg(long, value_name = "N", default_value_t = sightline_exact::Limits::default().regions)]
    pub max_regions: u32,
    /// Threads. Default: one a core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

fn parse_grid(text: &str) -> Result<[u32; 2], String> {
    let parts = text.split(['x', 'X']).map(|p| p.trim().parse()).collect::<Result<Vec<u32>, _>>();
    parts.ok().and_then(|p| p.try_into().ok()).ok_or_else(|| "give two numbers as in 8x8".to_owned())
}
