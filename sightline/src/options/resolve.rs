//! The conversion of options into a job: checks of the numbers, the method, the sampler, and the scene.

use std::sync::Arc;

use sightline_model::numbers::{
    ErrorThreshold, InteriorThreshold, Length, MaxError, MinDistance, MinShare, RayCount,
    Resolution, TargetError, TileCells, TimeBudget,
};
use sightline_model::{
    CubeCells, CubeParams, Effort, JobSpec, LineAim, MOST_LINE_DEPTH, Method, MethodName,
    OutOfRange, Sampler, SamplerName, Sampling, SceneFacts, Stop, Task, TracerChoice, Visibility,
};
use sightline_scene::Scene;
use sightline_trace::{cpu, embree};

use super::cell_maker::CellMaker;
use super::cells::Cells;
use super::job_options::{CubeOptions, JobOptions};
use crate::error::Error;
use crate::observer::{Observer, note};

/// The fraction of a view cell by which rounding may move a sight line without a note.
const MUCH_MOVED: f64 = 1.0 / 16.0;
/// The default depth of adaptive trees.
const USUAL_DEPTH: u32 = 12;

impl CubeOptions {
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

/// The numeric options of a job, each within its range. The job may not use all of them.
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

/// Returns the facts of a scene that a job depends on.
fn facts(scene: &Scene) -> SceneFacts {
    SceneFacts {
        triangles: scene.len(),
        bounds: Some(scene.bounds()),
        has_masks: scene.kinds().any_masked(),
        is_culled: !scene.sides().are_both(),
    }
}

impl JobOptions {
    /// Checks the ranges of the numeric options, and returns the numbers.
    fn numbers(&self) -> Result<Numbers, OutOfRange> {
        let max_error = self.max_error.map(MaxError::new).transpose()?;
        // If only --max-error is given, it is also the target error.
        let target = self.target_error.or(self.max_error);
        // The minimum time budget is a millisecond.
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

    /// Returns the sampler. The default is lines, or cubes for trees that lines do not sample.
    pub(super) fn sampler_name(&self) -> SamplerName {
        let is_deep = self.triangle_budget.is_some() && self.max_depth() > MOST_LINE_DEPTH;
        self.sampler.unwrap_or(match is_deep {
            true => SamplerName::Cubes,
            false => SamplerName::Lines,
        })
    }

    /// Returns the depth of an adaptive tree.
    pub(super) fn max_depth(&self) -> u32 {
        self.max_depth.unwrap_or(USUAL_DEPTH)
    }

    /// Creates the job of these options for a scene. Computes cells along walls and restricted viewpoints,
    /// which can take minutes; the observer receives the progress.
    ///
    /// ```
    /// use sightline::{JobOptions, LoadOptions, SceneSource, Silent, read_scene};
    /// use sightline_scene::{Object, Triangle};
    ///
    /// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]].map(Into::into);
    /// let object = Object { name: "wall".into(), first: 0, count: 1 };
    /// let source = SceneSource::Triangles(vec![Triangle { v: corners }], vec![object]);
    /// let scene = read_scene(&source, &LoadOptions::default(), &Silent)?;
    ///
    /// let job = JobOptions::default().resolve(&scene, &Silent)?;
    /// assert_eq!(job.scene, scene.digest().0);
    ///
    /// let wrong = JobOptions { max_error: Some(2.0), ..Default::default() };
    /// assert_eq!(wrong.resolve(&scene, &Silent).unwrap_err().option(), Some("max-error"));
    /// # Ok::<(), sightline::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] with the option, if it is out of its range, the job cannot use it, or it
    /// does not suit the scene. [`crate::ErrorKind::Input`] if a file of viewpoints cannot be read, or a
    /// tracer cannot represent the scene. [`crate::ErrorKind::Cancelled`] if the observer cancels.
    pub fn resolve(&self, scene: &Arc<Scene>, observer: &dyn Observer) -> Result<JobSpec, Error> {
        let numbers = self.numbers()?;
        self.viewpoints.check()?;
        self.note_unused(observer)?;
        let viewpoints = &self.viewpoints;
        if self.by_cost.is_given() && viewpoints.viewpoints.is_some() && viewpoints.reach.is_none()
        {
            return Err(Error::usage(
                "cells by cost with --viewpoints need --reach R: every place within R of a viewpoint then \
                 has a set",
            )
            .about("reach"));
        }
        let method = self.method.unwrap_or_default();
        let tracer = self.backend.unwrap_or_default().0;
        let tracer = tracer.filter(|_| method != MethodName::Portals);
        let width = match tracer {
            Some(TracerChoice::Auto | TracerChoice::Cpu) => cpu::check_width(scene),
            Some(TracerChoice::Embree) => embree::check_width(scene),
            Some(TracerChoice::Gpu) | None => Ok(()),
        };
        width.map_err(|e| Error::scene(e.to_string()))?;
        let view_box = self.viewpoints.bounds(scene, observer)?;
        let job = |is_trial: bool| -> Result<JobSpec, Error> {
            let cells = CellMaker {
                options: self,
                scene,
                view_box,
                is_trial,
                observer,
            };
            let spec = JobSpec {
                scene: scene.digest().0,
                task: Task::Visibility(self.task(&numbers, &cells, tracer)?),
            };
            spec.check()?;
            spec.fits(&facts(scene))?;
            Ok(spec)
        };
        // Cells and viewpoints can take minutes, so check the other options with a trial job first.
        job(true)?;
        let spec = job(false)?;
        let displacement = spec
            .visibility()
            .map_or(Ok(0.0), Visibility::rounding_displacement)?;
        if displacement > MUCH_MOVED {
            note(
                observer,
                format!(
                    "note: coordinates are so large that rounding can move a sight line by {:.0} % \
                     of the thinnest view cell. A line counts for a cell only if it crosses at least this \
                     part of the cell, so the error is larger than --target-error. Use wider cells or \
                     smaller coordinates",
                    100.0 * displacement
                ),
            );
        }
        // Views from above need a view box without triangles, but most such boxes are mistakes about units or
        // axes.
        self.viewpoints.warn_of_bounds(scene, observer);
        Ok(spec)
    }

    /// Prints a note about the options that the job does not use.
    fn note_unused(&self, observer: &dyn Observer) -> Result<(), Error> {
        let unused = self.unused()?;
        if unused.is_empty() {
            return Ok(());
        }
        let user = match self.method.unwrap_or_default() {
            MethodName::Portals => "method portals".to_owned(),
            _ => format!("sampler {}", self.sampler_name()),
        };
        let cells = match (self.triangle_budget, self.cells) {
            (Some(_), _) => " in an adaptive tree",
            (None, Some(Cells::Walls(_))) => " in boxes along walls",
            (None, Some(Cells::Grid(_)) | None) => "",
        };
        let unused = unused.join(", ");
        note(
            observer,
            format!("note: the {user}{cells} does not use {unused}"),
        );
        Ok(())
    }

    /// Creates the task with its cells.
    fn task(
        &self,
        numbers: &Numbers,
        cells: &CellMaker<'_>,
        tracer: Option<TracerChoice>,
    ) -> Result<Visibility, Error> {
        let sampling = || -> Result<Sampling, Error> {
            Ok(Sampling {
                sampler: self.make_sampler(numbers, cells)?,
                tracer: tracer.unwrap_or_default(),
                contributions: self.contributions,
            })
        };
        let exact = |effort| -> Result<Method, Error> {
            Ok(Method::Exact {
                sampling: sampling()?,
                effort,
                certificates: self.certificates,
            })
        };
        let method = match self.method.unwrap_or_default() {
            MethodName::Aggressive => Method::Aggressive {
                sampling: sampling()?,
                items: self.granularity.unwrap_or_default(),
                completion: self.complete.unwrap_or_default(),
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
            pairs: self.cell_to_cell.unwrap_or_default(),
            seed: self.seed.unwrap_or_default(),
            up: self.viewpoints.up,
        })
    }

    /// Creates the sampler with its cells.
    fn make_sampler(&self, numbers: &Numbers, cells: &CellMaker<'_>) -> Result<Sampler, Error> {
        let exact = match self.method.unwrap_or_default() {
            MethodName::Exact | MethodName::Verified => Some(TileCells::EXACT),
            MethodName::Aggressive | MethodName::Portals => None,
        };
        let tile = |usual: TileCells| numbers.tile_cells.unwrap_or(exact.unwrap_or(usual));
        Ok(match (self.sampler_name(), self.triangle_budget) {
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
                credit: self.credit.unwrap_or_default(),
                time: numbers.time,
            },
            (SamplerName::Cubes, budget) => Sampler::Cubes {
                cells: match budget {
                    Some(budget) => CubeCells::Adaptive(cells.adaptive(budget)?),
                    None => CubeCells::Grid(cells.cube_grid()?),
                },
                params: numbers.cubes,
            },
        })
    }
}
