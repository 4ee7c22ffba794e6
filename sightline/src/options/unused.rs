//! The check for options that a job does not use, which returns an error or the options for a note.

use sightline_model::{Completion, Granularity, MethodName, SamplerName};

use super::cells::Cells;
use super::job_options::{CubeOptions, JobOptions};
use crate::error::Error;
use crate::tracers::TracerOption;

/// The options that only some jobs use, each with its condition. If the condition of a given option does not
/// hold, [`JobOptions::unused`] rejects the job. Other unused options cause a note.
const NEEDS: &[(&str, &str)] = &[
    (
        "--certificates",
        "--method exact or verified, because sampling creates no proofs",
    ),
    (
        "--granularity",
        "--method aggressive: exact queries decide triangles. `dump --items objects` lists the objects of an \
         exact result",
    ),
    (
        "--complete",
        "--method aggressive with --sampler lines, and no --min-share",
    ),
    ("--sampler", "a method that samples"),
    ("--contributions", "a method that samples"),
    (
        "--backend",
        "a method that samples; --backend none is for --method portals",
    ),
    (
        "--triangle-budget",
        "a method that samples, and --sampler lines or cubes; give --cells in place of --triangle-budget",
    ),
    (
        "--cells walls:N",
        "--sampler lines or guided, or --method portals: visibility cubes are shared by the cells \
         of a grid",
    ),
    (
        "--max-error",
        "--sampler lines, and --cells or --cell-size in place of --triangle-budget",
    ),
    (
        "--min-share",
        "--sampler lines and known cells (--cells), and cannot be given with --max-error",
    ),
    (
        "--time-budget",
        "--method portals, or --sampler lines or guided",
    ),
    (
        "--cells",
        "a job without --triangle-budget and without --cell-budget and --byte-budget",
    ),
    (
        "--cell-size",
        "a job without --cells, --triangle-budget, --cell-budget and --byte-budget",
    ),
    ("--cell-budget", "a job without --triangle-budget"),
    (
        "--byte-budget",
        "a job without --cell-budget and --triangle-budget",
    ),
    ("--fine", "--cell-budget or --byte-budget"),
    ("--cost", "--cell-budget or --byte-budget"),
    ("--max-depth", "--triangle-budget"),
    ("--eye-heights", "--view-mesh"),
    ("--reach", "--viewpoints"),
];

/// Returns the name of an option in [`NEEDS`] without dashes: the name of `--cells walls:N` is `cells`.
fn name(shown: &'static str) -> &'static str {
    let name = shown.trim_start_matches("--");
    name.split(' ').next().unwrap_or(name)
}

/// The given options that no part of the job has used yet.
struct UnusedOptions(Vec<&'static str>);

impl UnusedOptions {
    /// Marks options as used by the job.
    fn take(&mut self, options: &[&str]) {
        self.0.retain(|option| !options.contains(option));
    }

    /// Rejects unused options that have a condition, and returns the other unused ones.
    fn finish(self) -> Result<Vec<&'static str>, Error> {
        let needs = |option: &&str| NEEDS.iter().find(|(shown, _)| shown == option);
        let wrong: Vec<_> = self.0.iter().filter_map(needs).collect();
        let Some((first, _)) = wrong.first() else {
            return Ok(self.0);
        };
        let texts = wrong
            .iter()
            .map(|(option, needs)| format!("{option} needs {needs}"));
        Err(Error::usage(texts.collect::<Vec<_>>().join("; ")).about(name(first)))
    }
}

impl CubeOptions {
    /// Returns the names of all options of the cubes, each with true if the option was given.
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
}

impl JobOptions {
    /// Returns the given options among all options that only some jobs use.
    fn given(&self) -> UnusedOptions {
        let has_walls = matches!(self.cells, Some(Cells::Walls(_)));
        let places = &self.viewpoints;
        let coarse = self.granularity.unwrap_or_default() != Granularity::Triangles;
        let tracer = self.backend.unwrap_or_default() != TracerOption::default();
        // No method adds triangles if the option is off.
        let completes = self.complete == Some(Completion::Auto);
        let all = [
            ("--certificates", self.certificates),
            ("--granularity", coarse),
            ("--complete", completes),
            ("--sampler", self.sampler.is_some()),
            ("--contributions", self.contributions),
            ("--backend", tracer),
            ("--triangle-budget", self.triangle_budget.is_some()),
            ("--cells walls:N", has_walls),
            ("--cells", self.cells.is_some()),
            ("--cell-size", self.cell_size.is_some()),
            ("--cell-budget", self.by_cost.cell_budget.is_some()),
            ("--byte-budget", self.by_cost.byte_budget.is_some()),
            ("--fine", self.by_cost.fine.is_some()),
            ("--cost", self.by_cost.cost.is_some()),
            ("--max-depth", self.max_depth.is_some()),
            ("--max-error", self.max_error.is_some()),
            ("--min-share", self.min_share.is_some()),
            ("--time-budget", self.time_budget.is_some()),
            ("--target-error", self.target_error.is_some()),
            ("--rays", self.rays.is_some()),
            ("--credit", self.credit.is_some()),
            ("--block-cells", self.block_cells.is_some()),
            ("--eye-heights", places.eye_heights.is_some()),
            ("--reach", places.reach.is_some()),
        ];
        let all = all.into_iter().chain(self.cubes.all());
        UnusedOptions(
            all.filter_map(|(option, is_given)| is_given.then_some(option))
                .collect(),
        )
    }

    /// Rejects given options that [`NEEDS`] lists and the job does not use. Returns the other unused options,
    /// which cause only a note.
    pub(super) fn unused(&self) -> Result<Vec<&'static str>, Error> {
        let mut given = self.given();
        let method = self.method.unwrap_or_default();
        let backend = self.backend.unwrap_or_default();
        let is_adaptive = self.triangle_budget.is_some();
        let has_walls = matches!(self.cells, Some(Cells::Walls(_)));
        match (is_adaptive, self.by_cost.is_given(), self.cells.is_some()) {
            (true, _, _) => given.take(&["--max-depth"]),
            (false, true, _) => {
                given.take(&["--fine", "--cost"]);
                given.take(match self.by_cost.cell_budget {
                    Some(_) => &["--cell-budget"],
                    None => &["--byte-budget"],
                });
            }
            (false, false, true) => given.take(&["--cells"]),
            (false, false, false) => given.take(&["--cell-size"]),
        }
        if self.viewpoints.view_mesh.is_some() {
            given.take(&["--eye-heights"]);
        }
        if self.viewpoints.viewpoints.is_some() {
            given.take(&["--reach"]);
        }
        match method {
            MethodName::Portals => {
                given.take(&["--cells walls:N", "--time-budget"]);
                if !has_walls {
                    given.take(&["--block-cells"]);
                }
                if backend == TracerOption(None) {
                    given.take(&["--backend"]);
                }
                return given.finish();
            }
            MethodName::Aggressive => {
                given.take(&["--granularity"]);
                if self.sampler_name() == SamplerName::Lines && self.min_share.is_none() {
                    given.take(&["--complete"]);
                }
            }
            MethodName::Exact | MethodName::Verified => given.take(&["--certificates"]),
        }
        given.take(&["--sampler", "--contributions"]);
        if backend != TracerOption(None) {
            given.take(&["--backend"]);
        }
        match self.sampler_name() {
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
            SamplerName::Guided => {
                given.take(&["--rays", "--credit", "--time-budget", "--cells walls:N"]);
            }
            SamplerName::Cubes => {
                given.take(&["--triangle-budget"]);
                given.take(&self.cubes.all().map(|(option, _)| option));
            }
        }
        if self.sampler_name() != SamplerName::Cubes && !is_adaptive && !has_walls {
            given.take(&["--block-cells"]);
        }
        given.finish()
    }
}
