//! The arguments of a job, shared by `bake` and `submit`.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use sightline_model::numbers::{
    ErrorThreshold, InteriorThreshold, Length, MaxError, MinDistance, MinShare, RayCount,
    Resolution, TargetError, TileCells, TimeBudget, TriangleBudget,
};
use sightline_model::{
    Adaptive, BoxCells, CellToCell, CubeCells, CubeGrid, CubeParams, Effort, ErrorMeasure,
    Granularity, GridCells, JobSpec, KnownCells, LineAim, MOST_LINE_DEPTH, Method, MethodName,
    OutOfRange, Sampler, SamplerName, Sampling, SceneFacts, SpecError, Stop, SupersetChoice, Task,
    TracerChoice, USUAL_GRID, Viewpoints, Visibility,
};
use sightline_sampling::embree;
use sightline_scene::{Aabb, Scene, Triangle};
use sightline_viewcells::{DivisionError, KdTree, Lattice, MOST_BOXES, axis_name};

use crate::backends::BackendOption;
use crate::choices::choice;
use crate::error::CliError;
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
    #[arg(long, value_parser = choice::<MethodName>(), default_value_t)]
    method: MethodName,
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
    #[arg(long, value_parser = choice::<SamplerName>())]
    sampler: Option<SamplerName>,
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
    #[arg(long, value_parser = choice::<BackendOption>(), default_value_t)]
    pub backend: BackendOption,
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

/// The options that only some jobs have, each with its condition. The command rejects a job with an option
/// that it does not have; about all other unused options it prints a note.
const NEEDS: &[(&str, &str)] = &[
    (
        "--certificates",
        "--method exact or verified: sampling alone proves nothing",
    ),
    (
        "--granularity",
        "--method aggressive: exact queries decide triangles. `dump --items objects` lists the \
      objects of an exact result",
    ),
    ("--sampler", "a method that samples"),
    ("--contributions", "a method that samples"),
    (
        "--backend",
        "a method that samples; --backend none is for --method portals",
    ),
    (
        "--triangle-budget",
        "a method that samples, and --sampler lines or cubes; give --cells for another one",
    ),
    (
        "--cells walls:N",
        "--sampler lines or guided, or --method portals: visibility cubes are shared by the \
      cells of a grid",
    ),
    (
        "--max-error",
        "--sampler lines and a grid of cells (--cells)",
    ),
    (
        "--min-share",
        "--sampler lines and known cells (--cells), and cannot be given with --max-error",
    ),
    (
        "--time-budget",
        "--method portals, or --sampler lines or guided",
    ),
];

/// The options that were given and that no part of the job has taken yet.
struct UnusedOptions(Vec<&'static str>);

impl UnusedOptions {
    /// Takes options: the job makes use of them if they were given.
    fn take(&mut self, options: &[&str]) {
        self.0.retain(|option| !options.contains(option));
    }

    /// Rejects options without use that have a condition, and returns the other ones.
    fn finish(self) -> Result<Vec<&'static str>, CliError> {
        let needs = |option: &&str| NEEDS.iter().find(|(of, _)| of == option);
        let wrong = self.0.iter().filter_map(needs);
        let wrong: Vec<String> = wrong
            .map(|(option, needs)| format!("{option} needs {needs}"))
            .collect();
        match wrong.is_empty() {
            true => Ok(self.0),
            false => Err(CliError::Usage(wrong.join("; "))),
        }
    }
}

impl CubeArgs {
    /// Returns the names of all of its options, with whether each was given.
    fn all(&self) -> [(&'static str, bool); 7] {
        [
            ("--resolution", self.resolution.is_some()),
            ("--error-threshold", self.error_threshold.is_some()),
            ("--interior-threshold", self.interior_threshold.is_some()),
            ("--error-measure", self.error_measure.is_some()),
            ("--min-distance", self.min_distance.is_some()),
            ("--no-solids", self.no_solids),
            ("--superset", self.superset.is_some()),
        ]
    }

    /// Returns the parameters of the cubes.
    fn params(&self) -> Result<CubeParams, OutOfRange> {
        Ok(CubeParams {
            resolution: self
                .resolution
                .map_or(Ok(Resolution::default()), Resolution::new)?,
            measure: self.error_measure.unwrap_or_default(),
            error_threshold: self
                .error_threshold
                .map_or(Ok(ErrorThreshold::default()), ErrorThreshold::new)?,
            interior_threshold: self
                .interior_threshold
                .map_or(Ok(InteriorThreshold::default()), InteriorThreshold::new)?,
            min_distance: self
                .min_distance
                .map_or(Ok(MinDistance::default()), MinDistance::new)?,
            solids: !self.no_solids,
            superset: self.superset.unwrap_or_default(),
        })
    }
}

/// The numbers of a job, each in its range, whether the job makes use of them or not.
struct Numbers {
    target_error: TargetError,
    max_error: Option<MaxError>,
    min_share: Option<MinShare>,
    rays: RayCount,
    time: Option<TimeBudget>,
    far: Option<Length>,
    tile_cells: Option<TileCells>,
    cubes: CubeParams,
}

impl JobArgs {
    /// Returns true if the job has a time budget.
    pub fn has_time_budget(&self) -> bool {
        self.time_budget.is_some()
    }

    /// Checks the numbers.
    fn numbers(&self) -> Result<Numbers, OutOfRange> {
        let max_error = self.max_error.map(MaxError::new).transpose()?;
        // A bound is the target, too, unless another one is given.
        let target = self.target_error.or(self.max_error);
        // The least budget is a millisecond.
        let time = self.time_budget.map(|d| (d.as_millis() as u64).max(1));
        Ok(Numbers {
            target_error: target.map_or(Ok(TargetError::default()), TargetError::new)?,
            max_error,
            min_share: self.min_share.map(MinShare::new).transpose()?,
            rays: self.rays.map_or(Ok(RayCount::default()), RayCount::new)?,
            time: time.map(TimeBudget::new).transpose()?,
            far: self.far.map(|far| Length::new(far.into())).transpose()?,
            tile_cells: self.block_cells.map(TileCells::new).transpose()?,
            cubes: self.cubes.params()?,
        })
    }

    /// Returns the sampler: by default lines, and cubes for trees that lines do not sample.
    fn sampler(&self) -> SamplerName {
        let is_deep = self.triangle_budget.is_some() && self.max_depth > MOST_LINE_DEPTH;
        self.sampler.unwrap_or(match is_deep {
            true => SamplerName::Cubes,
            false => SamplerName::Lines,
        })
    }

    /// Returns the given options that not every job has.
    fn given(&self) -> UnusedOptions {
        let of = [
            ("--certificates", self.certificates),
            ("--granularity", self.granularity != Granularity::Triangles),
            ("--sampler", self.sampler.is_some()),
            ("--contributions", self.contributions),
            ("--backend", self.backend != BackendOption::default()),
            ("--triangle-budget", self.triangle_budget.is_some()),
            (
                "--cells walls:N",
                matches!(self.cells, Some(Cells::Walls(_))),
            ),
            ("--max-error", self.max_error.is_some()),
            ("--min-share", self.min_share.is_some()),
            ("--time-budget", self.time_budget.is_some()),
            ("--target-error", self.target_error.is_some()),
            ("--rays", self.rays.is_some()),
            ("--block-cells", self.block_cells.is_some()),
        ];
        let all = of.into_iter().chain(self.cubes.all());
        UnusedOptions(
            all.filter_map(|(option, is_given)| is_given.then_some(option))
                .collect(),
        )
    }

    /// Rejects options that the job does not have, and returns unused options about which a note is enough.
    fn unused(&self) -> Result<Vec<&'static str>, CliError> {
        let mut given = self.given();
        let is_adaptive = self.triangle_budget.is_some();
        let has_walls = matches!(self.cells, Some(Cells::Walls(_)));
        match self.method {
            MethodName::Portals => {
                given.take(&["--cells walls:N", "--time-budget"]);
                if !has_walls {
                    given.take(&["--block-cells"]);
                }
                if self.backend == BackendOption(None) {
                    given.take(&["--backend"]);
                }
                return given.finish();
            }
            MethodName::Aggressive => given.take(&["--granularity"]),
            MethodName::Exact | MethodName::Verified => given.take(&["--certificates"]),
        }
        given.take(&["--sampler", "--contributions"]);
        if self.backend != BackendOption(None) {
            given.take(&["--backend"]);
        }
        match self.sampler() {
            SamplerName::Lines => {
                given.take(&[
                    "--target-error",
                    "--time-budget",
                    "--triangle-budget",
                    "--cells walls:N",
                ]);
                if !is_adaptive {
                    given.take(&["--max-error"]);
                    if self.max_error.is_none() {
                        given.take(&["--min-share"]);
                    }
                }
            }
            SamplerName::Guided => given.take(&["--rays", "--time-budget", "--cells walls:N"]),
            SamplerName::Cubes => {
                given.take(&["--triangle-budget"]);
                given.take(&self.cubes.all().map(|(option, _)| option));
            }
        }
        if self.sampler() != SamplerName::Cubes && !is_adaptive && !has_walls {
            given.take(&["--block-cells"]);
        }
        given.finish()
    }

    /// Returns the checked specification of a bake of `scene`.
    ///
    /// # Errors
    /// [`CliError`] naming the option.
    pub fn spec(&self, path: &Path, scene: &Arc<Scene>) -> Result<JobSpec, CliError> {
        let usage = |e: &dyn std::fmt::Display| CliError::Usage(e.to_string());
        let numbers = self.numbers().map_err(|e| usage(&e))?;
        let unused = self.unused()?;
        if !unused.is_empty() {
            let user = match self.method {
                MethodName::Portals => "method portals".to_owned(),
                _ => format!("sampler {}", self.sampler()),
            };
            let cells = match (self.triangle_budget, self.cells) {
                (Some(_), _) => " in an adaptive tree",
                (None, Some(Cells::Walls(_))) => " in boxes along walls",
                (None, Some(Cells::Grid(_)) | None) => "",
            };
            say(&format!(
                "note: the {user}{cells} makes no use of {}",
                unused.join(", ")
            ));
        }
        // Where no graphics card is found, auto means Embree.
        let tracer = self
            .backend
            .0
            .filter(|_| self.method != MethodName::Portals);
        if matches!(tracer, Some(TracerChoice::Auto | TracerChoice::Cpu)) {
            let narrow = |e| CliError::Input(format!("{}: {e}", path.display()));
            embree::check_width(scene).map_err(narrow)?;
        }
        let view_box = self.places.bounds(scene)?;
        let job = |is_trial: bool| -> Result<JobSpec, CliError> {
            let cells = CellArgs {
                args: self,
                path,
                scene,
                view_box,
                is_trial,
            };
            let task = self.task(&numbers, &cells, tracer)?;
            let spec = JobSpec {
                scene: scene.digest().0,
                task: Task::Visibility(task),
            };
            spec.check().map_err(|e| usage(&e))?;
            Ok(spec)
        };
        // Cells and viewpoints can cost minutes, so a job that is rejected is rejected before.
        job(true)?.fits(&facts(scene)).map_err(|e| usage(&e))?;
        let spec = job(false)?;
        spec.fits(&facts(scene)).map_err(|e| usage(&e))?;
        let displacement = spec
            .visibility()
            .map_or(Ok(0.0), Visibility::rounding_displacement);
        let displacement = displacement.map_err(|e| usage(&e))?;
        if displacement > MUCH_MOVED {
            say(&format!(
                "note: coordinates are so large that rounding can move a sight line by {:.0} % of the \
                 thinnest view cell. A line counts only if it crosses at least as much of a cell, so more is \
                 missed than --target-error says. Wider cells or smaller coordinates avoid this",
                100.0 * displacement
            ));
        }
        // Views from above need such a box; more often it is a mistake about units or axes.
        self.places.warn_of_empty(scene);
        Ok(spec)
    }

    /// Makes the task with its cells.
    fn task(
        &self,
        numbers: &Numbers,
        cells: &CellArgs<'_>,
        tracer: Option<TracerChoice>,
    ) -> Result<Visibility, CliError> {
        let sampling = || -> Result<Sampling, CliError> {
            Ok(Sampling {
                sampler: self.made_sampler(numbers, cells)?,
                tracer: tracer.unwrap_or_default(),
                contributions: self.contributions,
            })
        };
        let exact = |effort| -> Result<Method, CliError> {
            Ok(Method::Exact {
                sampling: sampling()?,
                effort,
                certificates: self.certificates,
            })
        };
        let method = match self.method {
            MethodName::Aggressive => Method::Aggressive {
                sampling: sampling()?,
                items: self.granularity,
            },
            MethodName::Exact => exact(Effort::Full)?,
            MethodName::Verified => exact(Effort::Bounded)?,
            MethodName::Portals => Method::Portals {
                cells: cells.known(numbers.tile_cells.unwrap_or(TileCells::PORTALS))?,
                time: numbers.time,
            },
        };
        Ok(Visibility {
            method,
            far: numbers.far,
            pairs: self.cell_to_cell,
            seed: self.seed,
            up: self.places.up(),
        })
    }

    /// Makes the sampler with its cells.
    fn made_sampler(&self, numbers: &Numbers, cells: &CellArgs<'_>) -> Result<Sampler, CliError> {
        let exact = match self.method {
            MethodName::Exact | MethodName::Verified => Some(TileCells::EXACT),
            MethodName::Aggressive | MethodName::Portals => None,
        };
        let tile = |usual: TileCells| numbers.tile_cells.unwrap_or(exact.unwrap_or(usual));
        Ok(match (self.sampler(), self.triangle_budget) {
            (SamplerName::Lines, Some(budget)) => Sampler::Lines {
                aim: LineAim::Adaptive {
                    cells: cells.adaptive(budget)?,
                    error: numbers.target_error,
                },
                time: numbers.time,
            },
            (SamplerName::Lines, None) => {
                let (error, bound) = (numbers.target_error, numbers.max_error);
                let stop = match (bound, numbers.min_share) {
                    (Some(most), _) => Stop::Bound(most),
                    (None, Some(share)) => Stop::Share(share),
                    (None, None) => Stop::Expected,
                };
                let usual = TileCells::of_lines(cells.scene.len(), error, bound);
                let cells = cells.known(tile(usual))?;
                Sampler::Lines {
                    aim: LineAim::Known { cells, error, stop },
                    time: numbers.time,
                }
            }
            (SamplerName::Guided, _) => Sampler::Guided {
                cells: cells.known(tile(TileCells::default()))?,
                rays: numbers.rays,
                time: numbers.time,
            },
            (SamplerName::Cubes, budget) => Sampler::Cubes {
                cells: match budget {
                    Some(budget) => CubeCells::Adaptive(cells.adaptive(budget)?),
                    None => CubeCells::Grid(cells.of_cubes()?),
                },
                params: numbers.cubes,
            },
        })
    }
}

/// Returns the facts of a scene that a job depends on.
fn facts(scene: &Scene) -> SceneFacts {
    SceneFacts {
        triangles: scene.len(),
        bounds: Some(scene.bounds()),
        has_masks: scene.kinds().any_masked(),
        is_culled: !scene.sides().are_both(),
    }
}

/// The making of a job's cells from its options.
struct CellArgs<'a> {
    args: &'a JobArgs,
    path: &'a Path,
    scene: &'a Arc<Scene>,
    view_box: Aabb,
    /// Whether the cells only show which job this is: boxes are one box, and viewpoints are everywhere.
    is_trial: bool,
}

impl CellArgs<'_> {
    /// Makes the cells that are known before the bake.
    fn known(&self, tile_cells: TileCells) -> Result<KnownCells, CliError> {
        if let Some(Cells::Walls(most)) = self.args.cells {
            let boxes = match self.is_trial {
                true => self.one_box()?,
                false => self
                    .args
                    .places
                    .along_walls(self.scene, self.view_box, most)?,
            };
            return Ok(KnownCells::Boxes(boxes));
        }
        let usage = |e: SpecError| CliError::Usage(e.to_string());
        let grid = GridCells::new(self.view_box, self.sides()).map_err(|e| self.of_division(e))?;
        let grid = grid.with_tile_cells(tile_cells).map_err(usage)?;
        // Proofs are about whole cells.
        let walls = !self.args.certificates;
        let viewpoints = self.viewpoints((grid.sides(), grid.cells().lattice()), walls)?;
        grid.with_viewpoints(viewpoints)
            .map(KnownCells::Grid)
            .map_err(usage)
    }

    /// Makes the view box a box.
    fn one_box(&self) -> Result<BoxCells, CliError> {
        let tree = KdTree::new(&[3], &[]).map_err(CliError::internal)?;
        BoxCells::new(self.view_box, Arc::new(tree)).map_err(|e| self.of_division(e))
    }

    /// Makes the grid of visibility cubes, which are at the lattice's points and have no region.
    fn of_cubes(&self) -> Result<CubeGrid, CliError> {
        let grid = CubeGrid::new(self.view_box, self.sides()).map_err(|e| self.of_division(e))?;
        match self
            .viewpoints((grid.sides(), grid.cells().lattice()), false)?
            .mask()
        {
            Some(mask) => {
                let marked = grid.with_mask(Arc::clone(mask));
                marked.map_err(|e| CliError::Usage(e.to_string()))
            }
            None => Ok(grid),
        }
    }

    /// Makes the cells of an adaptive tree.
    fn adaptive<const DEPTH: u32>(&self, budget: u32) -> Result<Adaptive<DEPTH>, CliError> {
        if self.args.places.restrict() {
            return Err(CliError::Usage(
                "several view boxes, --view-mesh, --viewpoints and --reachable-from need a grid of cells; \
                 give --cells or --cell-size in place of --triangle-budget"
                    .to_owned(),
            ));
        }
        let budget = TriangleBudget::new(budget).map_err(|e| CliError::Usage(e.to_string()))?;
        let tree = Adaptive::new(self.view_box, budget, self.args.max_depth);
        tree.map_err(|e| match e {
            SpecError::Division(e) => self.of_division(e),
            e => CliError::Usage(e.to_string()),
        })
    }

    /// Returns the number of cells of the grid along each axis.
    fn sides(&self) -> [u32; 3] {
        match (self.args.cell_size, self.args.cells) {
            (Some(size), _) => cells_of_size(self.view_box, size),
            (None, Some(Cells::Grid(cells))) => cells,
            (None, Some(Cells::Walls(_)) | None) => USUAL_GRID,
        }
    }

    fn viewpoints(&self, grid: ([u32; 3], &Lattice), walls: bool) -> Result<Viewpoints, CliError> {
        if self.is_trial {
            return Ok(Viewpoints::Everywhere);
        }
        self.args
            .places
            .viewpoints(self.path, self.scene, grid, walls)
    }

    /// Explains why a view box cannot be divided. A view box that the user did not give comes from the scene.
    fn of_division(&self, e: DivisionError) -> CliError {
        let (DivisionError::Box { axis, .. }, None) = (&e, self.args.places.view_box.first())
        else {
            return CliError::Usage(e.to_string());
        };
        let along = axis_name(*axis);
        if let Some(mesh) = &self.args.places.view_mesh {
            return CliError::Input(format!(
                "{}: the places of viewpoints are flat along {along}, so they are no view box; give \
                 --view-box, and for a navigation mesh --eye-heights LO,HI with LO < HI and --up",
                mesh.display()
            ));
        }
        let nothing = self.scene.triangles().iter().all(Triangle::is_degenerate);
        CliError::Input(format!(
            "{}: {}, so its bounds are no view box; give --view-box x0,y0,z0,x1,y1,z1 with x0 < x1, y0 < y1 \
             and z0 < z1",
            self.path.display(),
            if nothing {
                "none of its triangles has an area".to_owned()
            } else {
                format!("the scene is flat along {along}")
            }
        ))
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
