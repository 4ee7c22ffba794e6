//! The conversion between a specification and a message of the gRPC interface.
//!
//! Every number, flag and named value of the message is optional. The reader replaces an absent value by its
//! default. The writer writes every field, so a job has the same key if a default is written or absent.

use std::sync::Arc;

use sightline_proto::v1;
use sightline_viewcells::KdTree;

use super::cells::{Adaptive, BoxCells, Cells, CubeCells, CubeGrid, GridCells, KnownCells};
use super::fit::SceneFacts;
use super::names::{Completion, Effort, Granularity};
use super::numbers::{
    Length, MaxError, MinShare, TargetError, TileCells, TimeBudget, TriangleBudget,
};
use super::sampler::{CubeParams, LineAim, Sampler, Sampling, Stop};
use super::visibility::{Method, Visibility};
use super::{Ambient, CellsByCost, FieldValue, JobSpec, SpecError, Task, limits};

/// The default number of cells along each axis.
pub const USUAL_GRID: [u32; 3] = [8; 3];

/// The default maximum depth of an adaptive tree.
pub const USUAL_DEPTH: u32 = 12;

/// Reads a field, or returns its default if the field is absent.
fn field<F: FieldValue + Default>(wire: Option<F::Wire>) -> Result<F, SpecError> {
    wire.map_or(Ok(F::default()), F::from_wire)
}

/// Reads a field that has no default. Returns `None` if the field is absent.
fn optional<F: FieldValue>(wire: Option<F::Wire>) -> Result<Option<F>, SpecError> {
    wire.map(F::from_wire).transpose()
}

/// Returns a value as a present field of a message.
fn written<F: FieldValue>(value: F) -> Option<F::Wire> {
    Some(value.to_wire())
}

impl JobSpec {
    /// Reads and checks a specification. Absent fields have their defaults for a scene with these facts.
    /// Messages of [`Self::to_message`] have every field and need no facts.
    ///
    /// # Errors
    /// [`SpecError`] for the first field that is rejected.
    pub fn from_message(m: &v1::JobSpec, scene: &SceneFacts) -> Result<Self, SpecError> {
        let digest = m.scene.as_slice().try_into();
        let digest = digest.map_err(|_| {
            SpecError::new(
                "scene",
                "its digest does not have 32 bytes; give the BLAKE3 digest",
            )
        })?;
        let task = match &m.task {
            Some(v1::job_spec::Task::Ambient(ambient)) => {
                Task::Ambient(Ambient::from_message(ambient)?)
            }
            Some(v1::job_spec::Task::Visibility(task)) => {
                Task::Visibility(Visibility::from_message(task, scene)?)
            }
            None => Task::Visibility(Visibility::from_message(&v1::Visibility::default(), scene)?),
        };
        Ok(Self {
            scene: digest,
            task,
        })
    }

    /// Returns the specification as a message. Every field is set, unless absence has its own meaning: no
    /// time budget, viewpoints everywhere, an unknown axis.
    pub fn to_message(&self) -> v1::JobSpec {
        let task = match &self.task {
            Task::Visibility(task) => v1::job_spec::Task::Visibility(task.to_message()),
            Task::Ambient(ambient) => v1::job_spec::Task::Ambient(ambient.to_message()),
        };
        v1::JobSpec {
            scene: self.scene.to_vec(),
            task: Some(task),
        }
    }
}

impl Visibility {
    fn from_message(m: &v1::Visibility, scene: &SceneFacts) -> Result<Self, SpecError> {
        let method = match &m.method {
            Some(v1::visibility::Method::Aggressive(m)) => aggressive(m, scene)?,
            Some(v1::visibility::Method::Exact(m)) => exact(m, scene)?,
            Some(v1::visibility::Method::Portals(m)) => portals(m, scene)?,
            None => aggressive(&v1::Aggressive::default(), scene)?,
        };
        let task = Self {
            method,
            far: optional::<Length>(m.far)?,
            pairs: field(m.cell_to_cell)?,
            seed: m.seed(),
            // The number 0 is the name of an unknown axis, as in all enums of proto3 without a default.
            up: optional(m.up.filter(|up| *up != v1::Up::Unspecified as i32))?,
        };
        limits::check(&task)?;
        Ok(task)
    }

    fn to_message(&self) -> v1::Visibility {
        let method = match &self.method {
            Method::Aggressive {
                sampling,
                items,
                completion,
            } => v1::visibility::Method::Aggressive(v1::Aggressive {
                sampling: Some(sampling.to_message()),
                items: written(*items),
                completion: written(*completion),
            }),
            Method::Exact {
                sampling,
                effort,
                certificates,
            } => v1::visibility::Method::Exact(v1::Exact {
                sampling: Some(sampling.to_message()),
                effort: written(*effort),
                certificates: Some(*certificates),
            }),
            Method::Portals { cells, time } => v1::visibility::Method::Portals(v1::Portals {
                cells: Some(match cells {
                    KnownCells::Grid(grid) => v1::portals::Cells::Grid(grid.to_message()),
                    KnownCells::Boxes(boxes) => v1::portals::Cells::Boxes(boxes.to_message()),
                }),
                time_budget_ms: time.map(TimeBudget::to_wire),
            }),
        };
        v1::Visibility {
            method: Some(method),
            far: self.far.map(Length::to_wire),
            cell_to_cell: written(self.pairs),
            seed: Some(self.seed),
            up: self.up.map(FieldValue::to_wire),
        }
    }
}

fn aggressive(m: &v1::Aggressive, scene: &SceneFacts) -> Result<Method, SpecError> {
    Ok(Method::Aggressive {
        sampling: Sampling::from_message(&m.sampling.clone().unwrap_or_default(), scene, None)?,
        items: field::<Granularity>(m.items)?,
        completion: field::<Completion>(m.completion)?,
    })
}

fn exact(m: &v1::Exact, scene: &SceneFacts) -> Result<Method, SpecError> {
    Ok(Method::Exact {
        sampling: Sampling::from_message(
            &m.sampling.clone().unwrap_or_default(),
            scene,
            Some(TileCells::EXACT),
        )?,
        effort: field::<Effort>(m.effort)?,
        certificates: m.certificates(),
    })
}

fn portals(m: &v1::Portals, scene: &SceneFacts) -> Result<Method, SpecError> {
    let cells = match &m.cells {
        Some(v1::portals::Cells::Grid(grid)) => known_grid(grid, scene, TileCells::PORTALS)?,
        Some(v1::portals::Cells::Boxes(boxes)) => known_boxes(boxes, scene)?,
        None => known_grid(&v1::GridCells::default(), scene, TileCells::PORTALS)?,
    };
    Ok(Method::Portals {
        cells,
        time: optional(m.time_budget_ms)?,
    })
}

impl Sampling {
    /// Reads a message. `usual` is the default number of cells of a tile, if the method determines it.
    fn from_message(
        m: &v1::Sampling,
        scene: &SceneFacts,
        usual: Option<TileCells>,
    ) -> Result<Self, SpecError> {
        let sampler = match &m.sampler {
            Some(v1::sampling::Sampler::Lines(m)) => lines(m, scene, usual)?,
            Some(v1::sampling::Sampler::Guided(m)) => guided(m, scene, usual)?,
            Some(v1::sampling::Sampler::Cubes(m)) => cubes(m, scene)?,
            None => lines(&v1::Lines::default(), scene, usual)?,
        };
        Ok(Self {
            sampler,
            tracer: field(m.backend)?,
            contributions: m.contributions(),
        })
    }

    fn to_message(&self) -> v1::Sampling {
        let sampler = match &self.sampler {
            Sampler::Lines { aim, time } => v1::sampling::Sampler::Lines(lines_message(aim, *time)),
            Sampler::Guided {
                cells,
                rays,
                credit,
                time,
            } => v1::sampling::Sampler::Guided(v1::Guided {
                cells: Some(match cells {
                    KnownCells::Grid(grid) => v1::guided::Cells::Grid(grid.to_message()),
                    KnownCells::Boxes(boxes) => v1::guided::Cells::Boxes(boxes.to_message()),
                }),
                rays: written(*rays),
                crediting: written(*credit),
                time_budget_ms: time.map(TimeBudget::to_wire),
            }),
            Sampler::Cubes { cells, params } => {
                v1::sampling::Sampler::Cubes(cubes_message(cells, params))
            }
        };
        v1::Sampling {
            sampler: Some(sampler),
            backend: written(self.tracer),
            contributions: Some(self.contributions),
        }
    }
}

fn lines(
    m: &v1::Lines,
    scene: &SceneFacts,
    usual: Option<TileCells>,
) -> Result<Sampler, SpecError> {
    let stop = match m.stop {
        None => Stop::Expected,
        Some(v1::lines::Stop::MaxError(most)) => Stop::Bound(MaxError::from_wire(most)?),
        Some(v1::lines::Stop::MinShare(share)) => Stop::Share(MinShare::from_wire(share)?),
    };
    let bound = match stop {
        Stop::Bound(most) => Some(most),
        Stop::Expected | Stop::Share(_) => None,
    };
    // A bound is also the target error, unless another target error is given.
    let error = TargetError::from_wire(match (m.target_error, bound) {
        (Some(error), _) => error,
        (None, Some(most)) => most.get(),
        (None, None) => TargetError::default().get(),
    })?;
    let usual = usual.unwrap_or_else(|| TileCells::of_lines(scene.triangles, error, bound));
    let known = |cells| LineAim::Known { cells, error, stop };
    let aim = match &m.cells {
        Some(v1::lines::Cells::Grid(grid)) => known(known_grid(grid, scene, usual)?),
        Some(v1::lines::Cells::Boxes(boxes)) => known(known_boxes(boxes, scene)?),
        Some(v1::lines::Cells::Adaptive(_)) if stop != Stop::Expected => {
            return Err(SpecError::combination(
                "max-error or min-share",
                "an adaptive tree",
            ));
        }
        Some(v1::lines::Cells::Adaptive(tree)) => LineAim::Adaptive {
            cells: Adaptive::from_message(tree, scene)?,
            error,
        },
        None => known(known_grid(&v1::GridCells::default(), scene, usual)?),
    };
    Ok(Sampler::Lines {
        aim,
        time: optional(m.time_budget_ms)?,
    })
}

fn lines_message(aim: &LineAim, time: Option<TimeBudget>) -> v1::Lines {
    let (cells, error, stop) = match aim {
        LineAim::Known { cells, error, stop } => {
            let cells = match cells {
                KnownCells::Grid(grid) => v1::lines::Cells::Grid(grid.to_message()),
                KnownCells::Boxes(boxes) => v1::lines::Cells::Boxes(boxes.to_message()),
            };
            (cells, *error, *stop)
        }
        LineAim::Adaptive { cells, error } => (
            v1::lines::Cells::Adaptive(cells.to_message()),
            *error,
            Stop::Expected,
        ),
    };
    v1::Lines {
        cells: Some(cells),
        target_error: written(error),
        stop: match stop {
            Stop::Expected => None,
            Stop::Bound(most) => Some(v1::lines::Stop::MaxError(most.get())),
            Stop::Share(share) => Some(v1::lines::Stop::MinShare(share.get())),
        },
        time_budget_ms: time.map(TimeBudget::to_wire),
    }
}

fn guided(
    m: &v1::Guided,
    scene: &SceneFacts,
    usual: Option<TileCells>,
) -> Result<Sampler, SpecError> {
    let usual = usual.unwrap_or_default();
    Ok(Sampler::Guided {
        cells: match &m.cells {
            Some(v1::guided::Cells::Grid(grid)) => known_grid(grid, scene, usual)?,
            Some(v1::guided::Cells::Boxes(boxes)) => known_boxes(boxes, scene)?,
            None => known_grid(&v1::GridCells::default(), scene, usual)?,
        },
        rays: field(m.rays)?,
        credit: field(m.crediting)?,
        time: optional(m.time_budget_ms)?,
    })
}

fn cubes(m: &v1::Cubes, scene: &SceneFacts) -> Result<Sampler, SpecError> {
    let cells = match &m.cells {
        Some(v1::cubes::Cells::Grid(grid)) => CubeCells::Grid(CubeGrid::from_message(grid, scene)?),
        Some(v1::cubes::Cells::Adaptive(tree)) => {
            CubeCells::Adaptive(Adaptive::from_message(tree, scene)?)
        }
        None => CubeCells::Grid(CubeGrid::from_message(&v1::CubeGrid::default(), scene)?),
    };
    let params = CubeParams {
        resolution: field(m.resolution)?,
        measure: field(m.measure)?,
        error_threshold: field(m.error_threshold)?,
        interior_threshold: field(m.interior_threshold)?,
        min_distance: field(m.min_distance)?,
        solids: m.solids.unwrap_or(CubeParams::default().solids),
        superset: field(m.superset)?,
    };
    Ok(Sampler::Cubes { cells, params })
}

fn cubes_message(cells: &CubeCells, params: &CubeParams) -> v1::Cubes {
    v1::Cubes {
        cells: Some(match cells {
            CubeCells::Grid(grid) => v1::cubes::Cells::Grid(grid.to_message()),
            CubeCells::Adaptive(tree) => v1::cubes::Cells::Adaptive(tree.to_message()),
        }),
        resolution: written(params.resolution),
        measure: written(params.measure),
        error_threshold: written(params.error_threshold),
        interior_threshold: written(params.interior_threshold),
        min_distance: written(params.min_distance),
        solids: Some(params.solids),
        superset: written(params.superset),
    }
}

/// Returns the numbers of cells along each axis; absent numbers have their defaults.
fn sides(given: [Option<u32>; 3]) -> [u32; 3] {
    [0, 1, 2].map(|axis| given[axis].unwrap_or(USUAL_GRID[axis]))
}

fn known_grid(
    m: &v1::GridCells,
    scene: &SceneFacts,
    usual: TileCells,
) -> Result<KnownCells, SpecError> {
    let grid = GridCells::new(scene.view_box(&m.view_box)?, sides([m.x, m.y, m.z]))?;
    let grid = grid.with_tile_cells(optional(m.tile_cells)?.unwrap_or(usual))?;
    let grid = grid.with_encoded_viewpoints(&m.viewpoints)?;
    let by_cost = m.cells_by_cost.as_ref().map(CellsByCost::from_message);
    Ok(KnownCells::Grid(
        grid.with_cells_by_cost(by_cost.transpose()?)?,
    ))
}

fn known_boxes(m: &v1::BoxCells, scene: &SceneFacts) -> Result<KnownCells, SpecError> {
    let tree = Arc::new(KdTree::new(&m.axes, &m.planes)?);
    let boxes = BoxCells::new(scene.view_box(&m.view_box)?, tree)?;
    Ok(KnownCells::Boxes(
        boxes.with_encoded_viewpoints(&m.viewpoints)?,
    ))
}

/// Returns the corners of the view box in the form of a message: minimum, then maximum.
fn corners(cells: &Cells) -> Vec<f32> {
    let [min, max] = cells.view_box().corners().map(|c| c.to_array());
    min.into_iter().chain(max).collect()
}

impl GridCells {
    fn to_message(&self) -> v1::GridCells {
        let [x, y, z] = self.sides().map(Some);
        v1::GridCells {
            x,
            y,
            z,
            view_box: corners(self.cells()),
            tile_cells: written(self.tile_cells()),
            viewpoints: self.viewpoints().encode(),
            cells_by_cost: self.cells_by_cost().map(CellsByCost::to_message),
        }
    }
}

impl BoxCells {
    fn to_message(&self) -> v1::BoxCells {
        let (axes, planes) = self.tree().parts();
        v1::BoxCells {
            axes,
            planes,
            view_box: corners(self.cells()),
            viewpoints: self.viewpoints().encode(),
        }
    }
}

impl CubeGrid {
    fn from_message(m: &v1::CubeGrid, scene: &SceneFacts) -> Result<Self, SpecError> {
        let grid = Self::new(scene.view_box(&m.view_box)?, sides([m.x, m.y, m.z]))?;
        let by_cost = m.cells_by_cost.as_ref().map(CellsByCost::from_message);
        let grid = grid.with_encoded_mask(&m.viewpoints)?;
        grid.with_cells_by_cost(by_cost.transpose()?)
    }

    fn to_message(&self) -> v1::CubeGrid {
        let [x, y, z] = self.sides().map(Some);
        v1::CubeGrid {
            x,
            y,
            z,
            view_box: corners(self.cells()),
            viewpoints: self.viewpoints().encode(),
            cells_by_cost: self.cells_by_cost().map(CellsByCost::to_message),
        }
    }
}

impl<const DEPTH: u32> Adaptive<DEPTH> {
    fn from_message(m: &v1::Adaptive, scene: &SceneFacts) -> Result<Self, SpecError> {
        let budget = m.triangle_budget.ok_or(SpecError::new(
            TriangleBudget::OPTION,
            "an adaptive division needs a triangle budget; give at least 1",
        ))?;
        let depth = m.max_depth.unwrap_or(USUAL_DEPTH);
        Self::new(
            scene.view_box(&m.view_box)?,
            TriangleBudget::from_wire(budget)?,
            depth,
        )
    }

    fn to_message(&self) -> v1::Adaptive {
        let (budget, depth) = self.limits();
        v1::Adaptive {
            triangle_budget: Some(budget),
            max_depth: Some(depth),
            view_box: corners(self.cells()),
        }
    }
}

/// Returns the time budget of a job's message, in milliseconds, or `None` if the message has no time budget.
pub fn time_budget_ms(m: &v1::JobSpec) -> Option<u64> {
    let Some(v1::job_spec::Task::Visibility(task)) = &m.task else {
        return None;
    };
    let sampling = match task.method.as_ref()? {
        v1::visibility::Method::Aggressive(method) => method.sampling.as_ref()?,
        v1::visibility::Method::Exact(method) => method.sampling.as_ref()?,
        v1::visibility::Method::Portals(method) => return method.time_budget_ms,
    };
    match sampling.sampler.as_ref()? {
        v1::sampling::Sampler::Lines(lines) => lines.time_budget_ms,
        v1::sampling::Sampler::Guided(guided) => guided.time_budget_ms,
        v1::sampling::Sampler::Cubes(_) => None,
    }
}

/// Removes the parts of a message that can be large: the viewpoints, the weights of cells by cost, and the
/// axes and planes of boxes. Returns true if the message contained such a part.
pub fn remove_large_parts(m: &mut v1::JobSpec) -> bool {
    let Some(parts) = large_parts(m) else {
        return false;
    };
    let viewpoints = std::mem::take(parts.viewpoints);
    let weights = parts
        .by_cost
        .map(|by_cost| std::mem::take(&mut by_cost.weights));
    let boxes = parts
        .boxes
        .map(|(axes, planes)| (std::mem::take(axes), std::mem::take(planes)));
    !viewpoints.is_empty() || weights.is_some_and(|weights| !weights.is_empty()) || boxes.is_some()
}

/// Returns true if the cells of a message are boxes.
pub fn has_boxes(m: &v1::JobSpec) -> bool {
    let mut m = m.clone();
    large_parts(&mut m).is_some_and(|parts| parts.boxes.is_some())
}

/// The parts of a message that can be large.
struct LargeParts<'a> {
    viewpoints: &'a mut Vec<u8>,
    by_cost: Option<&'a mut v1::CellsByCost>,
    /// The axes and the planes of boxes.
    boxes: Option<(&'a mut Vec<u32>, &'a mut Vec<f32>)>,
}

fn large_parts(m: &mut v1::JobSpec) -> Option<LargeParts<'_>> {
    use v1::{cubes, guided, lines, portals, sampling, visibility};
    fn grid(m: &mut v1::GridCells) -> Option<LargeParts<'_>> {
        Some(LargeParts {
            viewpoints: &mut m.viewpoints,
            by_cost: m.cells_by_cost.as_mut(),
            boxes: None,
        })
    }
    fn boxes(m: &mut v1::BoxCells) -> Option<LargeParts<'_>> {
        Some(LargeParts {
            viewpoints: &mut m.viewpoints,
            by_cost: None,
            boxes: Some((&mut m.axes, &mut m.planes)),
        })
    }
    let Some(v1::job_spec::Task::Visibility(task)) = &mut m.task else {
        return None;
    };
    let sampling = match task.method.as_mut()? {
        visibility::Method::Aggressive(m) => m.sampling.as_mut()?,
        visibility::Method::Exact(m) => m.sampling.as_mut()?,
        visibility::Method::Portals(m) => {
            return match m.cells.as_mut()? {
                portals::Cells::Grid(m) => grid(m),
                portals::Cells::Boxes(m) => boxes(m),
            };
        }
    };
    match sampling.sampler.as_mut()? {
        sampling::Sampler::Lines(m) => match m.cells.as_mut()? {
            lines::Cells::Grid(m) => grid(m),
            lines::Cells::Boxes(m) => boxes(m),
            lines::Cells::Adaptive(_) => None,
        },
        sampling::Sampler::Guided(m) => match m.cells.as_mut()? {
            guided::Cells::Grid(m) => grid(m),
            guided::Cells::Boxes(m) => boxes(m),
        },
        sampling::Sampler::Cubes(m) => match m.cells.as_mut()? {
            cubes::Cells::Grid(m) => Some(LargeParts {
                viewpoints: &mut m.viewpoints,
                by_cost: m.cells_by_cost.as_mut(),
                boxes: None,
            }),
            cubes::Cells::Adaptive(_) => None,
        },
    }
}
