//! The arguments that say what is to be baked, shared by `bake` and `submit`.

use std::path::Path;
use std::time::Duration;

use clap::{Args, ValueEnum};
use glam::Vec3;
use sightline_job::JobSpec;
use sightline_sampling::params::{BackendChoice, ErrorMeasure, Sampler, SamplingParams, SupersetChoice};
use sightline_scene::Scene;
use sightline_viewcells::Division;

use crate::error::CliError;

/// What is to be baked.
#[derive(Args, Clone, Debug)]
pub struct JobArgs {
    /// How visibility is found: aggressive sampling, which sees nothing that is not visible and may miss little.
    #[arg(long, value_enum, default_value_t = Method::Aggressive)]
    method: Method,
    /// A regular grid of view cells. Default, without a triangle budget: 8x8x8.
    #[arg(long, value_name = "NXxNYxNZ", value_parser = parse_cells, conflicts_with = "triangle_budget")]
    cells: Option<[u32; 3]>,
    /// Adaptive cells instead of a grid: halve a cell while more triangles than this are visible from it.
    #[arg(long, value_name = "T")]
    triangle_budget: Option<u32>,
    /// Deepest level of the adaptive tree.
    #[arg(long, value_name = "D", default_value_t = 12, requires = "triangle_budget")]
    max_depth: u32,
    /// Where viewpoints may be: x0,y0,z0,x1,y1,z1. Default: the scene's bounds.
    #[arg(long, value_name = "BOX", value_parser = parse_box, allow_hyphen_values = true)]
    view_box: Option<[Vec3; 2]>,
    /// How sight lines are chosen. Default: lines; with a triangle budget: cubes.
    #[arg(long, value_enum)]
    sampler: Option<SamplerArg>,
    /// A cell is done when it is expected to miss at most this fraction of what is seen from it. An estimate, not a bound.
    #[arg(long, value_name = "F", default_value_t = SamplingParams::default().target_error)]
    target_error: f64,
    /// Refine each cell until its 95 % bound on missed sight lines, from lines that took no part in the search, is at most
    /// this. The bound is kept in the result; it holds on average over the cell, not for the worst view.
    #[arg(long, value_name = "F")]
    max_error: Option<f64>,
    /// Stop sampling this long after the start, with the best result by then: 500ms, 30s, 5m, 2h. Two runs then need not
    /// give the same bytes.
    #[arg(long, value_name = "DUR", value_parser = parse_duration)]
    time_budget: Option<Duration>,
    /// Rays a cell of the sampler guided.
    #[arg(long, value_name = "N", default_value_t = SamplingParams::default().rays)]
    rays: u64,
    /// Side of one item buffer in pixels, 8 to 4096 (sampler cubes, as are the flags down to --superset).
    #[arg(long, value_name = "PX", default_value_t = SamplingParams::default().resolution)]
    resolution: u32,
    /// Subdivide a sampled rectangle while its corners differ by more than this, 0 to 1.
    #[arg(long, value_name = "E", default_value_t = SamplingParams::default().error_threshold)]
    error_threshold: f64,
    /// The same for samples inside closed solids, where no viewpoint is expected.
    #[arg(long, value_name = "E", default_value_t = SamplingParams::default().interior_threshold)]
    interior_threshold: f64,
    /// How the corners are compared: their sets (Err), pixel by pixel (Err′), or sets in 24 directions (Err″).
    #[arg(long, value_enum, default_value_t = Measure::Strata)]
    error_measure: Measure,
    /// Never subdivide rectangles of at most this fraction of a view cell's size (the mean of its sides).
    #[arg(long, value_name = "F", default_value_t = SamplingParams::default().min_distance)]
    min_distance: f64,
    /// Do not judge samples inside closed solids apart.
    #[arg(long)]
    no_solids: bool,
    /// Render with what the cell above saw only. auto: on the gpu, where each triangle drawn costs.
    #[arg(long, value_enum, default_value_t = Superset::Auto)]
    superset: Superset,
    /// Where cubes are rendered. auto times both on this scene and takes the faster; the gpu has to be twice as fast
    /// as the cpu, so that noise does not decide what comes out.
    #[arg(long, value_enum, default_value_t = Backend::Auto)]
    pub backend: Backend,
    /// Seed of everything random (the sampler cubes has nothing random).
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    /// Sampling only.
    Aggressive,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum SamplerArg {
    /// Sight lines, each shared by all the cells it crosses, guided by what was found.
    Lines,
    /// The papers' adaptive visibility cubes.
    Cubes,
    /// A fixed number of guided rays for each cell on its own; to compare with.
    Guided,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Measure {
    /// Err.
    Sets,
    /// Err′.
    Pixels,
    /// Err″.
    Strata,
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Superset {
    /// On the gpu only.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Which backend.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// The faster one on the scene at hand.
    Auto,
    /// wgpu (Vulkan; a software driver will do).
    Gpu,
    /// Embree.
    Cpu,
}

impl JobArgs {
    /// The checked specification of a bake of `scene`.
    pub fn spec(&self, path: &Path, scene: &Scene) -> Result<JobSpec, CliError> {
        // One value until other methods exist.
        let Method::Aggressive = self.method;
        let adaptive = self.triangle_budget.is_some();
        let sampler = match self.sampler {
            None if adaptive => Sampler::Cubes,
            None | Some(SamplerArg::Lines) => Sampler::Lines,
            Some(SamplerArg::Cubes) => Sampler::Cubes,
            Some(SamplerArg::Guided) => Sampler::Guided,
        };
        let refuse = |what: &str| Err(CliError::Usage(what.to_owned()));
        if adaptive && sampler != Sampler::Cubes {
            return refuse(
                "an adaptive tree (--triangle-budget) is sampled with --sampler cubes; give --cells for another",
            );
        }
        if self.max_error.is_some() && sampler != Sampler::Lines {
            return refuse("--max-error needs --sampler lines and a grid of cells (--cells)");
        }
        if self.time_budget.is_some() && sampler == Sampler::Cubes {
            return refuse("--time-budget needs --sampler lines or guided and a grid of cells (--cells)");
        }
        let bounds = scene.bounds();
        let spec = JobSpec {
            scene: scene.digest().0,
            division: match self.triangle_budget {
                Some(budget) => Division::Adaptive { budget, max_depth: self.max_depth },
                None => Division::Grid(self.cells.unwrap_or([8, 8, 8])),
            },
            view_box: self.view_box.unwrap_or([bounds.min, bounds.max]),
            sampling: SamplingParams {
                sampler,
                target_error: self.target_error,
                max_error: self.max_error,
                rays: self.rays,
                resolution: self.resolution,
                measure: match self.error_measure {
                    Measure::Sets => ErrorMeasure::Sets,
                    Measure::Pixels => ErrorMeasure::Pixels,
                    Measure::Strata => ErrorMeasure::Strata,
                },
                error_threshold: self.error_threshold,
                interior_threshold: self.interior_threshold,
                min_distance: self.min_distance,
                solids: !self.no_solids,
                superset: match self.superset {
                    Superset::Auto => SupersetChoice::Auto,
                    Superset::On => SupersetChoice::On,
                    Superset::Off => SupersetChoice::Off,
                },
            },
            backend: match self.backend {
                Backend::Auto => BackendChoice::Auto,
                Backend::Gpu => BackendChoice::Gpu,
                Backend::Cpu => BackendChoice::Cpu,
            },
            seed: self.seed,
            // At least a millisecond: nothing means no limit.
            time_budget_ms: self.time_budget.map_or(0, |d| (d.as_millis() as u64).max(1)),
        };
        spec.sampling.check().map_err(|e| CliError::Usage(e.to_string()))?;
        spec.lattice().map_err(|e| match self.view_box {
            None if matches!(e, sightline_viewcells::DivisionError::Box { .. }) => CliError::Input(format!(
                "{}: the scene is flat, so its bounds are no view box; give --view-box ({e})",
                path.display()
            )),
            _ => CliError::Usage(e.to_string()),
        })?;
        Ok(spec)
    }
}

fn parse_duration(text: &str) -> Result<Duration, String> {
    /// A year.
    const MOST: Duration = Duration::from_secs(366 * 24 * 3600);
    let wrong = || "give a duration of at most a year, as in 500ms, 30s, 5m or 2h".to_owned();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[digits.len()..] {
        "ms" => 1e-3,
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(wrong()),
    };
    let seconds = digits.trim().parse::<f64>().map_err(|_| wrong())? * unit;
    Duration::try_from_secs_f64(seconds).ok().filter(|d| !d.is_zero() && *d <= MOST).ok_or_else(wrong)
}

/// A grid of cells, as in 8x8x8.
pub fn parse_cells(text: &str) -> Result<[u32; 3], String> {
    let parts = text.split(['x', 'X']).map(|p| p.trim().parse()).collect::<Result<Vec<u32>, _>>();
    parts.ok().and_then(|p| p.try_into().ok()).ok_or_else(|| "give three numbers as in 8x8x8".to_owned())
}

/// A box, as in -1,0,-1,1,2,1.
pub fn parse_box(text: &str) -> Result<[Vec3; 2], String> {
    let parts = text.split(',').map(|p| p.trim().parse()).collect::<Result<Vec<f32>, _>>();
    match parts.as_deref() {
        Ok([x0, y0, z0, x1, y1, z1]) => Ok([Vec3::new(*x0, *y0, *z0), Vec3::new(*x1, *y1, *z1)]),
        _ => Err("give six numbers as in -1,0,-1,1,2,1".to_owned()),
    }
}
