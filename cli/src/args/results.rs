//! The arguments of the commands that show, compare and export results, and of those that write manuals.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sightline::options::arguments::named;
use sightline_model::{TracerChoice, Up};

use crate::args::kinds::KindArgs;

/// Compares two results cell by cell: what came into the sets, what went, in which objects, and whether
/// sampling alone may explain it. Triangles are compared where both scenes have the same objects, else
/// objects by name.
///
/// Items that came are a change when they take more of the view than the older result may miss (its bound of
/// --max-error), and those that went when they take more than the newer one may. This needs both results with
/// --max-error (or an exact method) and with --contributions.
#[derive(Args, Debug)]
pub struct DiffArgs {
    /// The older result.
    #[arg(value_name = "OLDER.pvs")]
    pub older: PathBuf,
    /// The newer result.
    #[arg(value_name = "NEWER.pvs")]
    pub newer: PathBuf,
    /// Compare objects by name, although triangles could be compared.
    #[arg(long)]
    pub objects: bool,
    /// End with exit code 6 if more than this fraction of the sets changed, on average over the cells.
    #[arg(long, value_name = "F", value_parser = parse_fraction)]
    pub fail_above: Option<f64>,
    /// Print Markdown, for a comment on a change.
    #[arg(long)]
    pub markdown: bool,
    /// Also write a page, as `sightline view` does: the newer result with heat maps of what came and went.
    #[arg(short, long, value_name = "OUT.html")]
    pub output: Option<PathBuf>,
    /// The scene of the newer result, for the page.
    #[arg(long, value_name = "SCENE", requires = "output")]
    pub scene: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
}

/// A form of export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// JSON: the scene's objects with their places in the glTF file, and for each cell its box and objects
    Sidecar,
    /// JSON for streaming: the same with each cell's number of triangles, the neighbours to load next, and
    /// the objects' shares of the view where the bake measured those of objects
    Manifest,
    /// A line for each pair of a cell and an object in its set
    Csv,
    /// The scene's own glTF or GLB file (--scene) with the extension SIGHTLINE_visibility
    Gltf,
}

/// Writes the objects of each cell for an engine, for streaming, as a table, or into the scene's glTF file.
/// Cells without viewpoints are left out.
#[derive(Args, Debug)]
pub struct ExportArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// The form.
    #[arg(long, value_enum)]
    pub format: ExportFormat,
    /// The glTF or GLB file that the result was baked from; with --format gltf.
    #[arg(long, value_name = "LEVEL.glb")]
    pub scene: Option<PathBuf>,
    /// The file to write.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

/// Shows a result in a browser: what each cell draws as one walks or flies through the scene, hidden
/// triangles in red, cells and their numbers as boxes, and for what is clicked why it is visible or hidden.
/// Without -o the page is served on this machine and opened; with -o it is one file that needs no other and
/// no network.
#[derive(Args, Debug)]
pub struct ReportArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// The scene that it was baked from.
    pub scene: PathBuf,
    /// The document to write.
    #[arg(short, long, value_name = "OUT.html")]
    pub output: PathBuf,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// What a cell may draw: a JSON file with some of "triangles", "objects" and "bytes" (of all triangles of
    /// the objects; 36 a triangle, or "bytes_per_triangle").
    #[arg(long, value_name = "FILE")]
    pub budget: Option<PathBuf>,
    /// End with exit code 6 when a cell is over the budget.
    #[arg(long, requires = "budget")]
    pub fail_over_budget: bool,
    /// Random viewpoints at which the error is measured.
    #[arg(long, value_name = "N", default_value_t = 200)]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub viewpoints: u32,
    /// Side of a face of each frame in pixels, 8 to 1024.
    #[arg(long, value_name = "N", default_value_t = 256)]
    pub resolution: u32,
    /// Seed of viewpoints and segments.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Backend that renders the frames and traces the segments.
    #[arg(long, value_parser = named::<TracerChoice>(), default_value_t, hide_possible_values = true)]
    pub backend: TracerChoice,
}

#[derive(Args, Debug)]
pub struct ViewArgs {
    /// The result.
    #[arg(value_name = "OUT.pvs")]
    pub result: PathBuf,
    /// The scene that it was baked from. Without it only cells are shown.
    pub scene: Option<PathBuf>,
    /// Write the page to this file instead of serving it.
    #[arg(short, long, value_name = "VIEW.html")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub kinds: KindArgs,
    /// The cell in which the page begins. Default: one whose set is neither large nor small.
    #[arg(long, value_name = "CELL")]
    pub cell: Option<u32>,
    /// What `sightline measure` has printed: the page lists its worst viewpoints.
    #[arg(long, value_name = "MEASURED.json")]
    pub worst: Option<PathBuf>,
    /// The axis that points up. Default: that of the bake, else y.
    #[arg(long, value_parser = named::<Up>())]
    pub up: Option<Up>,
    /// The port of this machine on which the page is served; 0 for any that is free.
    #[arg(
        long,
        value_name = "PORT",
        default_value_t = 0,
        conflicts_with = "output"
    )]
    pub port: u16,
    /// Open no browser.
    #[arg(long, conflicts_with = "output")]
    pub no_open: bool,
}

impl ViewArgs {
    /// The page of a result and its scene, served and opened.
    pub fn of(result: PathBuf, scene: PathBuf, kinds: KindArgs) -> Self {
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

/// Prints the completions of this command line for a shell, such as
/// `sightline completions bash > ~/.local/share/bash-completion/completions/sightline`.
#[derive(Args, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Writes a manual page for each command, such as `sightline man ~/.local/share/man/man1`.
#[derive(Args, Debug)]
pub struct ManArgs {
    /// The folder, which is made if it is not there.
    pub folder: PathBuf,
}

/// A fraction from 0 to 1.
fn parse_fraction(text: &str) -> Result<f64, String> {
    let fraction = text.parse::<f64>().ok().filter(|f| (0.0..=1.0).contains(f));
    fraction.ok_or_else(|| "give a fraction from 0 to 1, as in 0.01".to_owned())
}
