//! The arguments of the commands that show, compare and export results, and of the command that writes
//! manuals.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sightline::options::arguments::named;
use sightline::options::byte_size::parse_byte_size;
use sightline::{ByteSize, CellCost};
use sightline_model::{TracerChoice, Up};

use crate::args::kinds::KindArgs;

/// Find view cells for a budget in the grid of a result, without another bake.
///
/// A cell's set is the union of the sets of the grid cells in it. The expected set is the mean over all
/// viewpoints, which are equally likely in each reached part of a cell (a cell has 4x4x4 parts). Of the
/// kd-trees over the grid's planes on the lower convex hull of size and expected set, the command finds the
/// tree with the least expected set within the budget. It prints the number of cells, the bytes of their sets
/// and the expected set, the same numbers of the grid, and other budgets of the hull. Sets are coded
/// separately here. A result file stores differences from sets of inner nodes of the tree, and also offsets
/// and undecided sets.
#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("budget").required(true).args(["cell_budget", "byte_budget"])))]
pub struct CellsArgs {
    /// The result, baked with --cells NXxNYxNZ.
    #[arg(value_name = "RESULT.pvs")]
    pub result: PathBuf,
    /// The largest number of cells with a set.
    #[arg(long, value_name = "M", value_parser = clap::value_parser!(u64).range(1..))]
    pub cell_budget: Option<u64>,
    /// The largest sum of the sizes of the sets: a number with B, kB, MB or GB. Without a unit, the number is
    /// in bytes.
    #[arg(long, value_name = "N", value_parser = parse_byte_size)]
    pub byte_budget: Option<ByteSize>,
    /// The cost of a cell for a viewpoint in it. Default: triangles.
    #[arg(long, value_parser = named::<CellCost>())]
    pub cost: Option<CellCost>,
}

/// Compare two results cell by cell: the items that the sets gained and lost, their objects, and whether
/// sampling noise explains the differences. The command compares triangles if both scenes have the same
/// objects, and otherwise objects by name.
///
/// Gained items count as a change if they cover more of the view than the older result may miss (its
/// --max-error). Lost items count if they cover more than the newer result may miss. This needs two results
/// with --contributions and with --max-error or an exact method.
#[derive(Args, Debug)]
pub struct DiffArgs {
    /// The older result.
    #[arg(value_name = "OLDER.pvs")]
    pub older: PathBuf,
    /// The newer result.
    #[arg(value_name = "NEWER.pvs")]
    pub newer: PathBuf,
    /// Compare objects by name, even if triangles are comparable.
    #[arg(long)]
    pub objects: bool,
    /// End with exit code 6 if more than this fraction of the sets changed, 0 to 1, on average over the
    /// cells. Default: no limit.
    #[arg(long, value_name = "F", value_parser = parse_fraction)]
    pub fail_above: Option<f64>,
    /// Print Markdown, for example for a comment on a pull request.
    #[arg(long)]
    pub markdown: bool,
    /// The HTML page to write, like `sightline view`: the newer result with heat maps of the gained and lost
    /// items.
    #[arg(short, long, value_name = "OUT.html")]
    pub output: Option<PathBuf>,
    /// The scene of the newer result, for the page.
    #[arg(long, value_name = "SCENE", requires = "output")]
    pub scene: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
}

/// The format of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// JSON: the objects of the scene with their nodes, meshes and primitives in the glTF file, and for each
    /// cell its box and the numbers of the objects in its set
    Sidecar,
    /// JSON for streaming: the content of sidecar, the number of triangles of each cell, the neighbours to
    /// load next, and the view shares of the objects if the bake measured them
    Manifest,
    /// CSV: one line per pair of a cell and an object in its set
    Csv,
    /// The glTF or GLB file of the scene (--scene) with the extension SIGHTLINE_visibility
    Gltf,
}

/// Write the objects of each cell for an engine, for streaming, as a table, or into the glTF file of the
/// scene. Cells without viewpoints are skipped.
#[derive(Args, Debug)]
pub struct ExportArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// The format of the file.
    #[arg(long, value_enum)]
    pub format: ExportFormat,
    /// The glTF or GLB file that the result was baked from. Required by --format gltf.
    #[arg(long, value_name = "LEVEL.glb")]
    pub scene: Option<PathBuf>,
    /// The file to write.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

/// Write a report as HTML. The report contains the error with plots and the worst frames, the cells over
/// budget, and the most expensive objects.
#[derive(Args, Debug)]
pub struct ReportArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// The scene that the result was baked from.
    pub scene: PathBuf,
    /// The HTML file to write.
    #[arg(short, long, value_name = "OUT.html")]
    pub output: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// The budget of each cell: a JSON file with some of "triangles", "objects" and "bytes" (of all triangles
    /// of the objects). "bytes_per_triangle" sets the size of a triangle; its default is 36.
    #[arg(long, value_name = "FILE")]
    pub budget: Option<PathBuf>,
    /// End with exit code 6 if a cell exceeds the budget.
    #[arg(long, requires = "budget")]
    pub fail_over_budget: bool,
    /// Number of random viewpoints for measuring the error, 1 to 100000.
    #[arg(long, value_name = "N", default_value_t = 200)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub viewpoints: u32,
    /// Side of a face of each frame in pixels, 8 to 1024.
    #[arg(long, value_name = "N", default_value_t = 256)]
    pub resolution: u32,
    /// Seed of the viewpoints and segments.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Backend that renders the frames and traces the segments: cpu, gpu, embree or auto.
    #[arg(long, value_parser = named::<TracerChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: TracerChoice,
}

/// Show a result in a browser: the set of each cell as you walk or fly through the scene.
///
/// The page draws hidden triangles in red, and cells with their numbers as boxes. For a triangle that you
/// click, the page shows the reason why it is visible or hidden. Without -o, the command serves the page on
/// this machine and opens it. With -o, the page is a single file that needs no other file and no network.
#[derive(Args, Debug)]
pub struct ViewArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// The scene that the result was baked from. Default: the page shows only cells.
    pub scene: Option<PathBuf>,
    /// The HTML file to write instead of serving the page.
    #[arg(short, long, value_name = "VIEW.html")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// The number of the cell in which the page starts, from 0. Default: the cell with the median set size.
    #[arg(long, value_name = "CELL")]
    pub cell: Option<u32>,
    /// The output of `sightline measure --json`. The page lists the worst viewpoints of the measurement.
    #[arg(long, value_name = "MEASURED.json")]
    pub worst: Option<PathBuf>,
    /// The axis that points up. Default: the axis of the bake if it is known, otherwise y.
    #[arg(long, value_parser = named::<Up>())]
    pub up: Option<Up>,
    /// The port of this machine on which the command serves the page; 0 for any free port.
    #[arg(
        long,
        value_name = "PORT",
        default_value_t = 0,
        conflicts_with = "output"
    )]
    pub port: u16,
    /// Do not open a browser.
    #[arg(long, conflicts_with = "output")]
    pub no_open: bool,
}

impl ViewArgs {
    /// Returns the arguments that serve the page of a result with its scene, and open it in the browser.
    pub fn new(result: PathBuf, scene: PathBuf, kinds: KindArgs) -> Self {
        Self {
            result,
            scene: Some(scene),
            output: None,
            kinds,
            cell: None,
            worst: None,
            up: None,
            port: 0,
            no_open: false,
        }
    }
}

/// Print the completions of this command line for a shell, such as `sightline completions bash >
/// ~/.local/share/bash-completion/completions/sightline`.
#[derive(Args, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Write a manual page for each command, such as `sightline man ~/.local/share/man/man1`.
#[derive(Args, Debug)]
pub struct ManArgs {
    /// The folder to write; created if it does not exist.
    pub folder: PathBuf,
}

/// Parses a fraction from 0 to 1.
fn parse_fraction(text: &str) -> Result<f64, String> {
    let fraction = text.parse::<f64>().ok().filter(|f| (0.0..=1.0).contains(f));
    fraction.ok_or_else(|| "give a fraction from 0 to 1, as in 0.01".to_owned())
}
