//! The arguments of a job, shared by `bake` and `submit`.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use sightline_model::{
    BackendChoice, CellToCell, ErrorMeasure, Granularity, JobSpec, MOST_LINE_DEPTH, Method,
    Sampler, SamplingParams, SupersetChoice,
};
use sightline_sampling::embree;
use sightline_scene::{Aabb, Scene};
use sightline_viewcells::{Division, MOST_BOXES};

use crate::choices::choice;
use crate::error::CliError;
use crate::opening;
use crate::place_args::{PlaceArgs, parse_length};
use crate::progress::say;

/// Fraction of a view cell by which rounding may move a sight line before a note is printed.
const MUCH_MOVED: f64 = 1.0 / 16.0;

/// What to bake, and how.
#[derive(Args, Clone, Debug)]
pub struct JobArgs {
    /// How much of a cell's visibility is decided. aggressive: sampling alone, which may miss a few triangles
    /// and reports no hidden ones, up to single precision; exact: sampling, then exact queries, until every
    /// triangle has a witness or a proof; verified: the same with lower limits for a single query, meant for
    /// --time-budget. portals: nothing is sampled; what walls hide, seen through the doors and windows
    /// between them, is hidden, and what else has no witness is undecided. That takes a small fraction of the
    /// time of exact indoors, and hides little in the open. Undecided triangles are reported and drawn.
    #[arg(long, value_parser = choice::<Method>(), default_value_t)]
    method: Method,
    /// Keep a witness for every visible triangle and a proof for every hidden triangle in the result, for
    /// `sightline verify` and `sightline query --why`. Needs --method exact or verified. The file becomes
    /// many times larger.
    #[arg(long)]
    certificates: bool,
    /// A regular grid of view cells: their numbers along x, y and z. Default, without a triangle budget:
    /// 8x8x8. Or walls:N, at most N boxes of different sizes along the walls that lie across an axis: a wall
    /// in a face of such a box blocks. Where there are none, the largest boxes are halved.
    #[arg(long, value_name = "NXxNYxNZ|walls:N", value_parser = parse_cells)]
    #[arg(conflicts_with = "triangle_budget")]
    cells: Option<Cells>,
    /// A regular grid of view cells with sides of at most this length, in the scene's units, instead of a
    /// number of cells.
    #[arg(long, value_name = "M", value_parser = parse_size, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["cells", "triangle_budget"])]
    cell_size: Option<f64>,
    /// Adaptive cells instead of a grid: halve a cell while sampling shows more than this many triangles from
    /// it. The first three levels are always halved.
    #[arg(long, value_name = "T")]
    triangle_budget: Option<u32>,
    /// Deepest level of the adaptive tree, 1 to 22.
    #[arg(
        long,
        value_name = "D",
        default_value_t = 12,
        requires = "triangle_budget"
    )]
    max_depth: u32,
    /// How visibility is sampled. Default: lines; for adaptive trees deeper than 12: cubes.
    #[arg(long, value_parser = choice::<Sampler>())]
    sampler: Option<Sampler>,
    /// A cell is finished when it is expected to miss at most this fraction of the sight lines from it,
    /// including lines that meet nothing. A cell that takes many times the work of the others has a larger
    /// tolerance. The fraction is an estimate, not a bound. Default: 0.0001, or the value of --max-error.
    #[arg(long, value_name = "F", allow_negative_numbers = true)]
    target_error: Option<f64>,
    /// Refine each cell until the 95 % bound on the fraction of its missed sight lines is at most this. The
    /// bound comes from lines that took no part in the search and is kept in the result. It holds on average
    /// over the cell, not for the worst viewpoint. With --target-error as well, both must hold. Needs
    /// --sampler lines and a grid.
    #[arg(long, value_name = "F", allow_negative_numbers = true)]
    max_error: Option<f64>,
    /// Stop this long after the submission of the job, with the best result by then: 500ms, 30s, 5m, 2h; a
    /// number without a unit is in seconds. The clock keeps running while a bake is interrupted. With a time
    /// budget, two runs need not give the same bytes. Not for --sampler cubes.
    #[arg(long, value_name = "DUR", value_parser = parse_duration)]
    time_budget: Option<Duration>,
    /// Most cells in a tile of a grid, 1 to 4096. Sight lines are shared within a tile, so larger tiles cost
    /// less in total: on grids of 2048 and more cells, tiles of all cells took 15 % less time than those of
    /// 512 at the same error (docs/experiments/blocks.md). A tile takes two bits of memory for each pair of a
    /// cell and a triangle. Default: 512; fewer for large scenes and small errors; 8 for exact methods.
    #[arg(long, value_name = "N")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=i64::from(sightline_model::MOST_BLOCK_CELLS)))]
    block_cells: Option<u32>,
    /// Rays per cell of the sampler guided. Default: 200000.
    #[arg(long, value_name = "N")]
    rays: Option<u64>,
    /// What the sets name. With clusters (at most 128 neighbouring triangles of an object) or objects, fewer
    /// items are looked for, the tables and the file are smaller, and a cell draws a whole item when it sees
    /// a part of it. Needs --method aggressive.
    #[arg(long, value_parser = choice::<Granularity>(), default_value_t)]
    granularity: Granularity,
    /// Search until each item that takes this share of the sight lines from a cell is found with a
    /// probability of at least 95 %: 0.001 for a thousandth of the view. Replaces --target-error. Two seeds
    /// then agree on all but smaller items.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    min_share: Option<f64>,
    /// Measure, for each cell, the mean and the greatest share of the view that each visible item takes, and
    /// keep them in the result (dump --contributions).
    #[arg(long)]
    contributions: bool,
    /// Sight lines end at this distance from the viewpoint, in the scene's units: what is farther counts as
    /// not visible.
    #[arg(long, value_name = "D", allow_negative_numbers = true, value_parser = parse_length)]
    far: Option<f32>,
    /// Whether the result says which cells see which (dump --items cells, query --sees). auto: with at most
    /// 512 cells; on: with at most 32768.
    #[arg(long, value_parser = choice::<CellToCell>(), default_value_t)]
    cell_to_cell: CellToCell,
    #[command(flatten)]
    pub places: PlaceArgs,
    #[command(flatten)]
    cubes: CubeArgs,
    /// The backend that traces sight lines and renders cubes. auto times both on this scene and takes the
    /// faster one; the gpu has to be twice as fast as the cpu, so that timing noise does not decide which is
    /// used.
    #[arg(long, value_parser = choice::<BackendChoice>(), default_value_t)]
    pub backend: BackendChoice,
    /// Seed of all random numbers. The sampler cubes uses none.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
}

/// The parameters of the sampler cubes. They are Options, so that `given` can list the given flags.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Sampler cubes")]
struct CubeArgs {
    /// Side of one item buffer (a face of a cube) in pixels, 8 to 4096. Default: 256.
    #[arg(long, value_name = "PX")]
    resolution: Option<u32>,
    /// Subdivide a sampled rectangle while the cubes at its corners differ by more than this, 0 to 1.
    /// Default: 0.1.
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    error_threshold: Option<f64>,
    /// The same threshold for cubes inside closed solids, where no viewpoint is expected. Default: 0.5.
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    interior_threshold: Option<f64>,
    /// Comparison of the cubes at the corners: by their sets (Err), pixel by pixel (Err′), or by their sets
    /// in each of 24 groups of directions (Err″). With uniform, no cubes are compared, and every rectangle is
    /// subdivided down to --min-distance. Default: strata.
    #[arg(long, value_parser = choice::<ErrorMeasure>())]
    error_measure: Option<ErrorMeasure>,
    /// Never subdivide a rectangle within one cell whose longer side is at most this fraction of the cell's
    /// size (the geometric mean of its three sides). Default: 0.5.
    #[arg(long, value_name = "F", allow_negative_numbers = true)]
    min_distance: Option<f64>,
    /// Apply --error-threshold to all cubes, also to those inside closed solids.
    #[arg(long)]
    no_solids: bool,
    /// Render the cubes of a cell with only the triangles that its parent cell saw. auto: on for the gpu,
    /// where each drawn triangle costs time. Default: auto.
    #[arg(long, value_parser = choice::<SupersetChoice>())]
    superset: Option<SupersetChoice>,
}

impl CubeArgs {
    /// The flags that were given.
    fn given(&self) -> Vec<&'static str> {
        [
            ("--resolution", self.resolution.is_some()),
            ("--error-threshold", self.error_threshold.is_some()),
            ("--interior-threshold", self.interior_threshold.is_some()),
            ("--error-measure", self.error_measure.is_some()),
            ("--min-distance", self.min_distance.is_some()),
            ("--no-solids", self.no_solids),
            ("--superset", self.superset.is_some()),
        ]
        .into_iter()
        .filter_map(|(flag, given)| given.then_some(flag))
        .collect()
    }

    /// Copies the flags into `params`; a flag that was not given leaves its parameter as it is.
    fn apply(&self, params: &mut SamplingParams) {
        params.resolution = self.resolution.unwrap_or(params.resolution);
        params.error_threshold = self.error_threshold.unwrap_or(params.error_threshold);
        params.interior_threshold = self.interior_threshold.unwrap_or(params.interior_threshold);
        params.min_distance = self.min_distance.unwrap_or(params.min_distance);
        params.solids = !self.no_solids;
        params.measure = self.error_measure.unwrap_or(params.measure);
        params.superset = self.superset.unwrap_or(params.superset);
    }
}

impl JobArgs {
    /// The checked specification of a bake of `scene`.
    pub fn spec(&self, path: &Path, scene: &Arc<Scene>) -> Result<JobSpec, CliError> {
        let method = self.method;
        let adaptive = self.triangle_budget.is_some();
        let sampler = match self.sampler {
            None if adaptive && self.max_depth > MOST_LINE_DEPTH => Sampler::Cubes,
            Some(sampler) => sampler,
            None => Sampler::Lines,
        };
        let refuse = |what: &str| Err(CliError::Usage(what.to_owned()));
        if adaptive && sampler == Sampler::Guided {
            return refuse(
                "an adaptive tree (--triangle-budget) needs --sampler lines or cubes; give --cells for \
                 another sampler",
            );
        }
        if adaptive && sampler == Sampler::Lines && self.max_depth > MOST_LINE_DEPTH {
            return refuse(
                "--sampler lines supports a --max-depth of at most 12; give a smaller one, or --sampler \
                 cubes, which takes far longer",
            );
        }
        // Where no graphics card is found, auto means Embree.
        if matches!(self.backend, BackendChoice::Auto | BackendChoice::Cpu)
            && method != Method::Portals
        {
            let narrow = |e| CliError::Input(format!("{}: {e}", path.display()));
            embree::check_width(scene).map_err(narrow)?;
        }
        if self.certificates && method == Method::Aggressive {
            return refuse(
                "--certificates needs --method exact or verified: sampling alone proves nothing",
            );
        }
        if method != Method::Aggressive {
            opening::without_masks(scene)?;
        }
        if self.max_error.is_some() && (adaptive || sampler != Sampler::Lines) {
            return refuse("--max-error needs --sampler lines and a grid of cells (--cells)");
        }
        if self.time_budget.is_some() && sampler == Sampler::Cubes {
            return refuse("--time-budget needs --sampler lines or guided");
        }
        if method == Method::Portals {
            self.check_portals()?;
        }
        let sampling = self.sampling(sampler)?;
        if self.granularity != Granularity::Triangles && method != Method::Aggressive {
            return refuse(
                "--granularity clusters and objects need --method aggressive: exact queries decide \
                 triangles. `dump --items objects` lists the objects of an exact result",
            );
        }
        if self.min_share.is_some() && (sampler != Sampler::Lines || self.max_error.is_some()) {
            return refuse(
                "--min-share needs --sampler lines, and cannot be given with --max-error",
            );
        }
        if !scene.sides().are_both() && method != Method::Aggressive {
            return refuse(
                "--cull-back-faces needs --method aggressive: exact queries take every triangle as seen from \
                 both sides",
            );
        }
        if self.far.is_some() && self.certificates {
            return refuse(
                "--far has no certificates: they prove that triangles are hidden, and not that they are far; \
                 leave one of them out",
            );
        }
        let walled = self.walled(sampler)?;
        let view_box = self.places.bounds(scene)?;
        let mut spec = JobSpec {
            scene: scene.digest().0,
            division: match self.triangle_budget {
                Some(budget) => Division::Adaptive {
                    budget,
                    max_depth: self.max_depth,
                },
                None => Division::Grid(match (self.cell_size, self.cells) {
                    (Some(size), _) => cells_of_size(view_box, size),
                    (None, Some(Cells::Grid(cells))) => cells,
                    // Boxes are chosen once it is known that the view box is one.
                    (None, Some(Cells::Walls(_))) => [1; 3],
                    (None, None) => [8, 8, 8],
                }),
            },
            view_box,
            block_cells: if adaptive || walled.is_some() {
                sightline_model::USUAL_BLOCK_CELLS
            } else {
                self.block_cells
                    .filter(|_| sampler != Sampler::Cubes)
                    .unwrap_or_else(|| {
                        sightline_model::default_block_cells(scene.len(), &sampling, method)
                    })
            },
            sampling,
            backend: if method == Method::Portals {
                BackendChoice::None
            } else {
                self.backend
            },
            seed: self.seed,
            // At least one millisecond, because 0 stands for no limit.
            time_budget_ms: self
                .time_budget
                .map_or(0, |d| (d.as_millis() as u64).max(1)),
            method,
            certificates: self.certificates,
            viewpoints: None,
            up: self.places.up(),
            ambient: None,
        };
        spec.sampling
            .check()
            .map_err(|e| CliError::Usage(e.to_string()))?;
        let lattice = spec.lattice().map_err(|e| match (self.places.view_box.first(), e) {
            (None, sightline_viewcells::DivisionError::Box { axis, .. }) => {
                let along = sightline_viewcells::axis_name(axis);
                if let Some(mesh) = &self.places.view_mesh {
                    return CliError::Input(format!(
                        "{}: the places of viewpoints are flat along {along}, so they are no view box; give \
                         --view-box, and for a navigation mesh --eye-heights LO,HI with LO < HI and --up",
                        mesh.display()
                    ));
                }
                let nothing = scene.triangles().iter().all(sightline_scene::Triangle::is_degenerate);
                CliError::Input(format!(
                    "{}: {}, so its bounds are no view box; give --view-box x0,y0,z0,x1,y1,z1 with x0 < x1, \
                     y0 < y1 and z0 < z1",
                    path.display(),
                    if nothing {
                        "none of its triangles has an area".to_owned()
                    } else {
                        format!("the scene is flat along {along}")
                    }
                ))
            }
            (_, e) => CliError::Usage(e.to_string()),
        })?;
        // Proofs are about whole cells, and visibility cubes are at the lattice's points.
        let walls = !self.certificates && sampler != Sampler::Cubes;
        match walled {
            Some(most) => {
                (spec.division, spec.viewpoints) =
                    self.places.along_walls(scene, view_box, most)?;
            }
            None => {
                spec.viewpoints =
                    self.places
                        .marks(path, scene, (&spec.division, &lattice), walls)?
            }
        }
        spec.check().map_err(|e| CliError::Usage(e.to_string()))?;
        let moved = spec
            .moved_by_rounding()
            .map_err(|e| CliError::Usage(e.to_string()))?;
        if moved > MUCH_MOVED {
            say(&format!(
                "note: coordinates are so large that rounding can move a sight line by {:.0} % of the \
                 thinnest view cell. A line counts only if it crosses at least as much of a cell, so more is \
                 missed than --target-error says. Wider cells or smaller coordinates avoid this",
                100.0 * moved
            ));
        }
        // Views from above need such a box; more often it is a mistake about units or axes.
        self.places.warn_of_empty(scene);
        Ok(spec)
    }

    /// The most boxes along walls, if these are the cells.
    fn walled(&self, sampler: Sampler) -> Result<Option<usize>, CliError> {
        let Some(Cells::Walls(most)) = self.cells else {
            return Ok(None);
        };
        let given = [
            ("--sampler cubes", sampler == Sampler::Cubes),
            ("--certificates", self.certificates),
            ("--cell-to-cell on", self.cell_to_cell == CellToCell::On),
            ("--block-cells", self.block_cells.is_some()),
        ];
        let given: Vec<&str> = given
            .iter()
            .filter_map(|(flag, given)| given.then_some(*flag))
            .collect();
        if given.is_empty() {
            return Ok(Some(most));
        }
        Err(CliError::Usage(format!(
            "--cells walls:N: boxes along walls are open and of different sizes, and each is a tile of its \
             own: leave out {}, or give --cells NXxNYxNZ",
            given.join(", ")
        )))
    }

    /// Refuses what the method portals does not do.
    fn check_portals(&self) -> Result<(), CliError> {
        let given = [
            ("--triangle-budget", self.triangle_budget.is_some()),
            ("--sampler", self.sampler.is_some()),
            ("--target-error", self.target_error.is_some()),
            ("--max-error", self.max_error.is_some()),
            ("--min-share", self.min_share.is_some()),
            ("--rays", self.rays.is_some()),
            ("--contributions", self.contributions),
            ("--certificates", self.certificates),
            ("--cell-to-cell on", self.cell_to_cell == CellToCell::On),
            (
                "--backend",
                !matches!(self.backend, BackendChoice::Auto | BackendChoice::None),
            ),
        ];
        let given: Vec<&str> = given
            .iter()
            .filter_map(|(flag, given)| given.then_some(*flag))
            .collect();
        if given.is_empty() {
            return Ok(());
        }
        Err(CliError::Usage(format!(
            "--method portals samples nothing, keeps no proofs and needs a grid of cells: leave out {}, or \
             give another method",
            given.join(", ")
        )))
    }

    /// The parameters of `sampler`. A note names given flags of other samplers; they are left out, because a
    /// parameter without effect would still change the job's key.
    fn sampling(&self, sampler: Sampler) -> Result<SamplingParams, CliError> {
        let mut params = SamplingParams {
            sampler,
            granularity: self.granularity,
            min_share: self.min_share,
            far: self.far.map(f64::from),
            cell_to_cell: self.cell_to_cell,
            contributions: self.contributions,
            ..SamplingParams::default()
        };
        // A value outside its range is refused even if the sampler does not use it.
        let mut all = SamplingParams {
            max_error: self.max_error,
            target_error: self.target_error.unwrap_or(params.target_error),
            rays: self.rays.unwrap_or(params.rays),
            ..params.clone()
        };
        self.cubes.apply(&mut all);
        all.check().map_err(|e| CliError::Usage(e.to_string()))?;
        let mut unused = Vec::new();
        if sampler == Sampler::Lines {
            params.max_error = self.max_error;
            params.target_error = self
                .target_error
                .or(self.max_error)
                .unwrap_or(params.target_error);
        } else {
            unused.extend(self.target_error.map(|_| "--target-error"));
        }
        match self.rays {
            Some(rays) if sampler == Sampler::Guided => params.rays = rays,
            Some(_) => unused.push("--rays"),
            None => {}
        }
        if sampler == Sampler::Cubes {
            self.cubes.apply(&mut params);
        } else {
            unused.extend(self.cubes.given());
        }
        if sampler == Sampler::Cubes || self.triangle_budget.is_some() {
            unused.extend(self.block_cells.map(|_| "--block-cells"));
        }
        if !unused.is_empty() {
            let name = sampler.to_string();
            let tree = if self.triangle_budget.is_some() {
                " in an adaptive tree"
            } else {
                ""
            };
            say(&format!(
                "note: the sampler {name}{tree} makes no use of {}",
                unused.join(", ")
            ));
        }
        Ok(params)
    }
}

pub fn parse_duration(text: &str) -> Result<Duration, String> {
    /// A year.
    const MOST: Duration = Duration::from_secs(366 * 24 * 3600);
    let wrong =
        || "give a duration of at most a year, as in 500ms, 30s (or 30), 5m or 2h".to_owned();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[digits.len()..] {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(wrong()),
    };
    let seconds = digits.trim().parse::<f64>().map_err(|_| wrong())? * unit;
    Duration::try_from_secs_f64(seconds)
        .ok()
        .filter(|d| !d.is_zero() && *d <= MOST)
        .ok_or_else(wrong)
}

/// The length of a cell's side.
fn parse_size(text: &str) -> Result<f64, String> {
    let size = text
        .parse::<f64>()
        .ok()
        .filter(|s| s.is_finite() && *s > 0.0);
    size.ok_or_else(|| "give a length above 0, as in 2.5".to_owned())
}

/// The fewest cells along each axis of a box whose sides are at most `size`.
fn cells_of_size(of: Aabb, size: f64) -> [u32; 3] {
    // The cast saturates; a grid that is too fine is refused with its numbers.
    (of.max.as_dvec3() - of.min.as_dvec3())
        .to_array()
        .map(|extent| ((extent / size).ceil() as u32).max(1))
}

/// Which cells there are.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cells {
    /// A grid with this many cells along each axis.
    Grid([u32; 3]),
    /// At most this number of boxes along walls.
    Walls(usize),
}

/// A grid of cells as in 8x8x8, or boxes along walls as in walls:512.
fn parse_cells(text: &str) -> Result<Cells, String> {
    if let Some(most) = text.trim().strip_prefix("walls:") {
        let most = most.parse().ok().filter(|n| (1..=MOST_BOXES).contains(n));
        return most
            .map(Cells::Walls)
            .ok_or_else(|| format!("give walls:N with N from 1 to {MOST_BOXES}"));
    }
    parse_grid(text)
        .map(Cells::Grid)
        .map_err(|e| format!("{e}, or walls:N for boxes along walls"))
}

/// A grid of cells, as in 8x8x8.
pub fn parse_grid(text: &str) -> Result<[u32; 3], String> {
    let parts = text
        .split(['x', 'X'])
        .map(|p| p.trim().parse())
        .collect::<Result<Vec<u32>, _>>();
    parts
        .ok()
        .and_then(|p| p.try_into().ok())
        .ok_or_else(|| "give three numbers as in 8x8x8".to_owned())
}
